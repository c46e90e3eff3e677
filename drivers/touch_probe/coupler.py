"""The I/O coupler that a probe is wired to: its image of the inputs, and whether that image is updated.

An image that stands still looks like a contact that stays open. One output is therefore wired back to one input:
what is written there must come back, or the image is dead. Without that wire only the coupler's own registers tell.
"""

import asyncio
import logging
import time
from dataclasses import dataclass

from cellcal.calibration.message import make_message
from cellcal.drivers.errors import DeviceError, RefusedError, UnreachableError, WrongDeviceError
from cellcal.drivers.interfaces import Condition, Identity, Readiness
from cellcal.drivers.touch_probe.registers import CouplerMap
from cellcal.drivers.wire.modbus import ModbusLink, Words
from cellcal.drivers.wire.tables import CodeEntry, code_table

_LOG = logging.getLogger(__name__)
VERIFIED_ON: tuple[str, ...] = ()  # "750-352 …" of couplers this has run on; none yet, see README.md
_DEVICE_FAILURE = 4  # Modbus exception of process data on a dead internal bus
_EXPIRED = 2
_ECHO_PAUSE_S = 0.001
_WORD = 16


@dataclass(frozen=True, slots=True)
class CouplerWiring:
    """The terminals that are used; channels count from 1. ``echo`` is an output and the input it is wired to."""

    serial: str  # MAC-ID
    digital_input: int = 0  # 0: none is used
    analogue_input: int = 0
    echo: tuple[int, int] | None = None
    echo_s: float = 0.1


@dataclass(frozen=True, slots=True)
class InputImage:
    """The inputs, as they were some time between the two times [host monotonic]."""

    words: Words
    digital_at: int
    asked_s: float
    answered_s: float

    def digital_input(self, channel: int) -> bool:
        """Return one digital input; channels count from 1."""
        word, bit = divmod(channel - 1, _WORD)
        return bool(self.words[self.digital_at + word] >> bit & 1)

    def digital_word(self, channel: int) -> int:
        """Return the word that holds one digital input."""
        return self.words[self.digital_at + (channel - 1) // _WORD]


class Coupler:
    """One coupler over one link. Everything that is asked of it comes back with the times between which it was so."""

    def __init__(self, link: ModbusLink, table: CouplerMap, wiring: CouplerWiring) -> None:
        self.link, self.table, self.wiring = link, table, wiring
        self._digital_at = self._words = 0
        self._echo_wanted = False
        self._echo_shown: bool | None = None  # by the last image
        self._echo_due_s: float | None = None

    @property
    def name(self) -> str:
        """The device's name in the cell file."""
        return self.link.device

    async def identify(self) -> Identity:
        """Return the name plate."""
        firmware, series, item, major, minor = await self._read_register("name_plate")
        return Identity(
            "WAGO",
            f"{series}-{item}",
            await self._read_serial(),
            f"{major}.{minor} ({firmware})",
        )

    async def connect(self) -> None:
        """Connect, check who answers and what is on the rail."""
        await self.link.open()
        model = (await self.identify()).model
        if not model.startswith(VERIFIED_ON):
            _LOG.warning("%s: not verified on coupler %s", self.name, model)
        if self.wiring.echo is None:
            _LOG.warning("%s: no echo wire is named; an image that stands still cannot be seen", self.name)

    async def read_condition(self) -> Condition:
        """Return whether the rail can be used, in a technician's words."""
        try:
            trouble = await self._find_fault()
            if trouble is None:
                await self.read_fresh_image()
        except RefusedError as error:
            return Condition(Readiness.NOT_READY, error.message, error.remedy)
        except DeviceError as error:
            return Condition(Readiness.UNREACHABLE, error.message, error.remedy)
        if trouble is not None:
            return Condition(Readiness.NOT_READY, trouble.message, trouble.remedy)
        return Condition(Readiness.READY)

    async def read_image(self) -> InputImage:
        """Read all inputs in one telegram."""
        if not self._words:
            await self._read_layout()
        asked_s = time.monotonic()
        try:
            words = await self.link.read(self.table.registers["inputs"].address + 1, self._words)
        except RefusedError as error:
            await self._raise_fault(error)
            raise
        image = InputImage(words, self._digital_at, asked_s, time.monotonic())
        self._check_echo(image)
        return image

    async def read_fresh_image(self) -> InputImage:
        """Return an image that is newer than this call: the echo that is written now has come back in it."""
        if self.wiring.echo is None:
            return await self.read_image()
        await self._echo_back()  # one that was under way proves nothing about this call
        await self.turn_echo()
        return await self._echo_back()

    async def turn_echo(self) -> None:
        """Write to the echo what its input does not show, unless the last one is still under way."""
        if self.wiring.echo is None or self._echo_due_s is not None:
            return
        if self._echo_shown is None:
            await self.read_image()
        output, _ = self.wiring.echo
        echo_value = not self._echo_shown
        try:
            await self.link.write_coil(self.table.registers["outputs"].address + output, echo_value)
        except RefusedError as error:
            await self._raise_fault(error)
            raise
        self._echo_wanted, self._echo_due_s = echo_value, time.monotonic() + self.wiring.echo_s

    async def _echo_back(self) -> InputImage:
        image = await self.read_image()
        while self._echo_due_s is not None:
            await asyncio.sleep(_ECHO_PAUSE_S)
            image = await self.read_image()
        return image

    async def check_device(self, link: ModbusLink) -> None:
        """Check constants and MAC-ID at every connect; forget what was known of the rail."""
        self._words, self._echo_due_s, self._echo_shown = 0, None, None
        constants = self.table.registers["constants"]
        found = await link.read_during_check(constants.address + 1, constants.words)
        if found != self.table.constants.values:
            raise self._wrong_device_error("is no coupler of the WAGO 750 series")
        mac = self.table.registers["mac"]
        serial = _mac_text(await link.read_during_check(mac.address + 1, mac.words))
        if serial != _plain_serial(self.wiring.serial):
            raise self._wrong_device_error(
                make_message(
                    "is the coupler {serial}, cell.toml says {named}", serial=serial, named=self.wiring.serial
                )
            )

    def stale_image_error(self) -> UnreachableError:
        """Return the error for an image that stands still."""
        return UnreachableError(
            self.name,
            "the coupler answers, but its image of the inputs stands still.",
            remedy="Check the wire from the echo output to the echo input, then switch the coupler off and on.",
        )

    def _check_echo(self, image: InputImage) -> None:
        if self.wiring.echo is None:
            return
        self._echo_shown = image.digital_input(self.wiring.echo[1])
        if self._echo_due_s is None:
            return
        if self._echo_shown is self._echo_wanted:
            self._echo_due_s = None
        elif image.answered_s > self._echo_due_s:
            self._echo_due_s = None
            raise self.stale_image_error()

    async def _read_layout(self) -> None:
        _, analogue, outputs, inputs = await self._read_register("image_lengths")
        wiring = self.wiring
        echo = wiring.echo or (0, 0)
        self._refuse_missing("analogue input", wiring.analogue_input, analogue // _WORD)
        self._refuse_missing("digital input", max(wiring.digital_input, echo[1]), inputs)
        self._refuse_missing("digital output", echo[0], outputs)
        self._digital_at = -(-analogue // _WORD)
        self._words = self._digital_at + -(-inputs // _WORD)

    def _refuse_missing(self, what: str, channel: int, there: int) -> None:
        if channel > there:
            raise RefusedError(
                self.name,
                make_message(
                    "the coupler has {there} {what}s, cell.toml uses number {channel}.",
                    there=there,
                    what=what,
                    channel=channel,
                ),
                remedy="Compare the terminals on the rail with cell.toml.",
            )

    async def _find_fault(self) -> RefusedError | None:
        """Return what the coupler says of itself, if anything."""
        code, argument = await self._read_register("led_error")
        if code:
            entry = code_table("cellcal.drivers.touch_probe", "led_errors.tsv").get(
                code, _unknown_fault(code)
            )
            text = make_message(entry.text, argument=argument)
            return RefusedError(
                self.name,
                make_message(
                    "the coupler reports error {code}, argument {argument}: {text}.",
                    code=code,
                    argument=argument,
                    text=text,
                ),
                remedy=entry.remedy,
                vendor_code=code,
                vendor_text=text,
            )
        (watchdog,) = await self._read_register("watchdog_status")
        if watchdog == _EXPIRED:
            return RefusedError(
                self.name,
                "the coupler's watchdog has run out: it holds its inputs back.",
                remedy="End other programs that use the coupler, then switch it off and on.",
                vendor_code=_EXPIRED,
            )
        return None

    async def _raise_fault(self, error: RefusedError) -> None:
        """Raise what the coupler says of itself in the place of a bare exception 4."""
        if error.vendor_code == _DEVICE_FAILURE and (trouble := await self._find_fault()) is not None:
            raise trouble from error

    async def _read_register(self, name: str) -> Words:
        register = self.table.registers[name]
        return await self.link.read(register.address + 1, register.words)

    async def _read_serial(self) -> str:
        return _mac_text(await self._read_register("mac"))

    def _wrong_device_error(self, found: str) -> WrongDeviceError:
        return WrongDeviceError(
            self.name,
            make_message("what answers at this address {found}.", found=found),
            remedy="Check address and cables; change cell.toml only if the coupler was exchanged.",
        )


def _mac_text(words: Words) -> str:
    return "".join(f"{word:04x}" for word in words)


def _plain_serial(serial: str) -> str:
    return serial.replace("-", "").replace(":", "").lower()


def _unknown_fault(code: int) -> CodeEntry:
    return CodeEntry(code, "fault", "a fault that is not in our table", "Look at the coupler's manual.")
