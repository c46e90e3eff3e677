"""The controller's registers by name: SI values out, SI values in."""

from collections.abc import Mapping, Sequence

from cellcal.calibration.message import make_message
from cellcal.drivers.errors import DeviceError, RefusedError, WireProtocolError, WrongDeviceError
from cellcal.drivers.modbus_robot.profile import ControllerProfile
from cellcal.drivers.modbus_robot.registers import (
    RegisterAccess,
    RobotRegister,
    Words,
    decode_text,
    decode_words,
    encode_values,
)
from cellcal.drivers.wire.modbus import ModbusLink

_PROFILE = "Compare the controller's assignments with the profile's document."


class RegisterBlock:
    """Words that came in one telegram."""

    def __init__(self, device: str, registers: Mapping[str, RobotRegister], first: int, words: Words) -> None:
        self._device, self._registers, self._first, self._words = device, registers, first, words

    def numbers_of(self, name: str) -> tuple[float, ...]:
        """Return the SI values of one register."""
        try:
            return decode_words(self._registers[name], self._words_of(name))
        except ValueError as error:
            raise WireProtocolError(
                self._device,
                make_message("register {name}: {error}.", name=name, error=error),
                remedy=_PROFILE,
                frame=self.to_hex(name),
            ) from error

    def integers_of(self, name: str) -> tuple[int, ...]:
        """Return whole numbers; int32 passes through float exactly."""
        return tuple(int(value) for value in self.numbers_of(name))

    def integer_of(self, name: str) -> int:
        """Return the only value of one register."""
        return self.integers_of(name)[0]

    def text_of(self, name: str) -> str:
        """Return the text of one register."""
        return decode_text(self._registers[name], self._words_of(name))

    def to_hex(self, name: str) -> str:
        """Return the words as they came, for the journal."""
        return "".join(f"{word:04x}" for word in self._words_of(name))

    def _words_of(self, name: str) -> Words:
        start = self._registers[name].address - self._first
        return self._words[start : start + self._registers[name].words]


class RegisterClient:
    """Reads and writes registers of one profile over one link."""

    def __init__(self, link: ModbusLink, profile: ControllerProfile) -> None:
        self.link, self.profile, self.device = link, profile, link.device
        self._registers: dict[tuple[tuple[str, ...], int], dict[str, RobotRegister]] = {}

    async def read_block(self, name: str) -> RegisterBlock:
        """Read one block of the profile in one telegram."""
        return await self.read_registers(*self.profile.blocks[name])

    async def read_registers(self, *names: str, number: int = 1) -> RegisterBlock:
        """Read registers in one telegram; ``number`` counts repeated quantities from 1."""
        registers = self._numbered_registers(names, number)
        first, count = ControllerProfile.register_span(list(registers.values()))
        return RegisterBlock(self.device, registers, first, await self.link.read(first, count))

    async def write_registers(self, values: Mapping[str, Sequence[float]], *, number: int = 1) -> None:
        """Write registers that lie side by side in one telegram."""
        registers = self._numbered_registers(tuple(values), number)
        words: list[int] = []
        first = min(register.address for register in registers.values())
        for name, register in sorted(registers.items(), key=lambda item: item[1].address):
            if register.access is RegisterAccess.READ or register.address != first + len(words):
                raise ValueError(f"register {name} cannot be written here")
            words.extend(self._encode_values(name, register, values[name]))
        await self.link.write(first, words)

    def _encode_values(self, name: str, register: RobotRegister, values: Sequence[float]) -> Words:
        try:
            return encode_values(register, values)
        except ValueError as error:
            raise self.refused_error(
                make_message("{path} cannot be written: {strerror}.", path=name, strerror=error)
            ) from error

    def refused_error(self, message: str) -> RefusedError:
        """Return the error for a request that we turn down ourselves."""
        return RefusedError(self.device, message, remedy="Nothing was sent. Correct the value.")

    def _numbered_registers(self, names: tuple[str, ...], number: int) -> dict[str, RobotRegister]:
        found = self._registers.get((names, number))
        if found is None:
            try:
                found = {name: self.profile.registers[name].register_of_item(number) for name in names}
            except ValueError as error:
                raise self.refused_error(
                    make_message("{names}: {error}.", names=names[0], error=error)
                ) from error
            self._registers[names, number] = found  # asked ten times a second
        return found


class SerialCheck:
    """Compares the serial number at every connect, before anything else is asked."""

    def __init__(self, profile: ControllerProfile, expected: str) -> None:
        self._register, self._expected = profile.registers["serial"], expected

    async def __call__(self, link: ModbusLink) -> None:
        words = await link.read_during_check(self._register.address, self._register.words)
        found = decode_text(self._register, words)
        if found != self._expected:
            raise self._wrong_device_error(link.device, found)

    def _wrong_device_error(self, device: str, found: str) -> DeviceError:
        return WrongDeviceError(
            device,
            make_message(
                "the robot at this address has the serial number {found!r}, cell.toml says {expected!r}.",
                found=found,
                expected=self._expected,
            ),
            remedy="Check the address and the cables; change cell.toml only if the robot was exchanged.",
        )
