"""The controller's registers by name: SI values out, SI values in."""

from collections.abc import Mapping, Sequence

from cellcal.drivers.errors import DeviceError, RefusedError, WireProtocolError, WrongDeviceError
from cellcal.drivers.modbus_robot.profile import Profile
from cellcal.drivers.modbus_robot.registers import Access, Register, Words, decode, decode_text, encode
from cellcal.drivers.wire.modbus import ModbusLink

_PROFILE = "Compare the controller's assignments with the profile's document."


class Block:
    """Words that came in one telegram."""

    def __init__(self, device: str, registers: Mapping[str, Register], first: int, words: Words) -> None:
        self._device, self._registers, self._first, self._words = device, registers, first, words

    def numbers(self, name: str) -> tuple[float, ...]:
        """Return the SI values of one register."""
        try:
            return decode(self._registers[name], self._slice(name))
        except ValueError as error:
            raise WireProtocolError(
                self._device, f"register {name}: {error}.", remedy=_PROFILE, frame=self.hex(name)
            ) from error

    def integers(self, name: str) -> tuple[int, ...]:
        """Return whole numbers; int32 passes through float exactly."""
        return tuple(int(value) for value in self.numbers(name))

    def integer(self, name: str) -> int:
        """Return the only value of one register."""
        return self.integers(name)[0]

    def text(self, name: str) -> str:
        """Return the text of one register."""
        return decode_text(self._registers[name], self._slice(name))

    def hex(self, name: str) -> str:
        """Return the words as they came, for the journal."""
        return "".join(f"{word:04x}" for word in self._slice(name))

    def _slice(self, name: str) -> Words:
        start = self._registers[name].address - self._first
        return self._words[start : start + self._registers[name].words]


class Panel:
    """Reads and writes registers of one profile over one link."""

    def __init__(self, link: ModbusLink, profile: Profile) -> None:
        self.link, self.profile, self.device = link, profile, link.device

    async def block(self, name: str) -> Block:
        """Read one block of the profile in one telegram."""
        return await self.read(*self.profile.blocks[name])

    async def read(self, *names: str, number: int = 1) -> Block:
        """Read registers in one telegram; ``number`` counts repeated quantities from 1."""
        registers = self._numbered(names, number)
        first, count = Profile.span(list(registers.values()))
        return Block(self.device, registers, first, await self.link.read(first, count))

    async def write(self, values: Mapping[str, Sequence[float]], *, number: int = 1) -> None:
        """Write registers that lie side by side in one telegram."""
        registers = self._numbered(tuple(values), number)
        words: list[int] = []
        first = min(register.address for register in registers.values())
        for name, register in sorted(registers.items(), key=lambda item: item[1].address):
            if register.access is Access.READ or register.address != first + len(words):
                raise ValueError(f"register {name} cannot be written here")
            words.extend(self._encoded(name, register, values[name]))
        await self.link.write(first, words)

    def _encoded(self, name: str, register: Register, values: Sequence[float]) -> Words:
        try:
            return encode(register, values)
        except ValueError as error:
            raise self.refusal(f"{name} cannot be written: {error}.") from error

    def refusal(self, message: str) -> RefusedError:
        """Return the error for a request that we turn down ourselves."""
        return RefusedError(self.device, message, remedy="Nothing was sent. Correct the value.")

    def _numbered(self, names: Sequence[str], number: int) -> dict[str, Register]:
        try:
            return {name: self.profile.registers[name].numbered(number) for name in names}
        except ValueError as error:
            raise self.refusal(f"{names[0]}: {error}.") from error


class SerialCheck:
    """Compares the serial number at every connect, before anything else is asked."""

    def __init__(self, profile: Profile, expected: str) -> None:
        self._register, self._expected = profile.registers["serial"], expected

    async def __call__(self, link: ModbusLink) -> None:
        words = await link.read_during_greeting(self._register.address, self._register.words)
        found = decode_text(self._register, words)
        if found != self._expected:
            raise self._wrong(link.device, found)

    def _wrong(self, device: str, found: str) -> DeviceError:
        return WrongDeviceError(
            device,
            f"the robot at this address has the serial number {found!r}, cell.toml says {self._expected!r}.",
            remedy="Check the address and the cables; change cell.toml only if the robot was exchanged.",
        )
