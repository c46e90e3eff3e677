"""A draw-wire encoder on CANopen. Every length is asked for (SDO): it cannot be older than the question."""

import logging
import time
from collections.abc import Awaitable, Callable
from dataclasses import dataclass

from cellcal.calibration.message import make_message
from cellcal.drivers.draw_wire.ends import moved_zero_error, refuse_near_ends
from cellcal.drivers.draw_wire.objects import ObjectTable, decode_entry
from cellcal.drivers.errors import DeviceError, RefusedError, WireProtocolError, WrongDeviceError
from cellcal.drivers.interfaces import Alarm, Condition, GaugeCapabilities, Identity, LengthReading, Readiness
from cellcal.drivers.wire.can_session import Emergency
from cellcal.drivers.wire.canopen import CanopenLink
from cellcal.drivers.wire.deadline import answer_deadline
from cellcal.drivers.wire.tables import CodeEntry, code_table

_LOG = logging.getLogger(__name__)
VERIFIED_ON: tuple[str, ...] = ()  # vendor:product:revision this driver has run on; none yet, see README.md
_OBJECT_MISSING = (0x06020000, 0x06090011)
_GENERIC = 0x1000  # an error register without the EMCY that belongs to it
_Read = Callable[[int, int], Awaitable[bytes]]


@dataclass(frozen=True, slots=True)
class GaugeOptions:
    """The cell file's options of this gauge."""

    serial: int
    range_m: float
    sigma_m: float
    end_margin_m: float
    deadline_s: float


class DrawWire:
    """DistanceGauge over one CANopen node."""

    def __init__(self, link: CanopenLink, table: ObjectTable, options: GaugeOptions) -> None:
        self._link, self._table, self._options = link, table, options
        self._step_m = 0.0
        self._offset: int | None = None
        link.check_server = self._check_device

    @property
    def name(self) -> str:
        return self._link.device

    @property
    def capabilities(self) -> GaugeCapabilities:
        return GaugeCapabilities(self._options.range_m, self._step_m, self._options.sigma_m)

    async def connect(self) -> None:
        """Connect, check the device's identity, and note an untested device."""
        async with answer_deadline(self.name, self._options.deadline_s, "connecting"):
            await self._link.open()
        identity = await self.identify()
        if not f"{identity.vendor}:{identity.model}:{identity.firmware}".startswith(VERIFIED_ON):
            _LOG.warning(
                "%s: not verified on product %s of vendor %s", self.name, identity.model, identity.vendor
            )

    async def close(self) -> None:
        """Leave the bus."""
        await self._link.close()

    async def identify(self) -> Identity:
        async with answer_deadline(self.name, self._options.deadline_s, "asking who it is"):
            vendor = await self._read_value("vendor", self._link.read)
            product = await self._read_value("product", self._link.read)
            revision = await self._read_value("revision", self._link.read)
            serial = await self._read_value("serial", self._link.read)
        return Identity(f"{vendor:#x}", f"{product:#x}", str(serial), f"{revision >> 16}.{revision & 0xFFFF}")

    async def read_condition(self) -> Condition:
        try:
            async with answer_deadline(self.name, self._options.deadline_s, "asking its condition"):
                await self._read_value("error_register", self._link.read)
        except DeviceError as error:
            return Condition(Readiness.UNREACHABLE, error.message, error.remedy)
        emergency = self._link.emergency
        if emergency is not None:
            meaning = _find_meaning(emergency)
            alarm = Alarm(f"EMCY-{emergency.code:04X}", meaning.text)
            return Condition(
                Readiness.NOT_READY,
                make_message(
                    "{alarm_code}: {meaning_text}", alarm_code=alarm.code, meaning_text=meaning.text
                ),
                meaning.remedy,
                (alarm,),
            )
        if self._link.has_foreign_master:
            refusal = self._foreign_control_error()
            return Condition(Readiness.NOT_READY, refusal.message, refusal.remedy)
        return Condition(Readiness.READY)

    async def read_distance(self) -> LengthReading:
        async with answer_deadline(self.name, self._options.deadline_s, "reading the length"):
            raw = await self._read_value("position", self._link.read)
            taken_at_s = time.monotonic()
            # a second question lets a late answer to an earlier one show itself as one too many
            register = await self._read_value("error_register", self._link.read)
        self._raise_on_emergency(register)
        value_m = raw * self._step_m
        refuse_near_ends(self.name, value_m, self._options.range_m, self._options.end_margin_m)
        return LengthReading(value_m, self._options.sigma_m, taken_at_s, raw)

    async def _check_device(self, link: CanopenLink) -> None:
        read = link.read_during_check
        device_type = await self._read_value("device_type", read)
        if device_type & 0xFFFF != self._table.device_profile:
            raise self._wrong_device_error(
                make_message(
                    "a device of profile {profile}, not an encoder (406)", profile=device_type & 0xFFFF
                )
            )
        serial = await self._read_value("serial", read)
        if serial != self._options.serial:
            raise self._wrong_device_error(
                make_message(
                    "serial number {serial}, cell.toml says {named}",
                    serial=serial,
                    named=self._options.serial,
                )
            )
        self._step_m = await self._read_value("step", read) * self._table.objects["step"].scale
        await self._check_offset(read)
        if await self._read_value("error_register", read) == 0:
            link.forget_emergency()

    async def _check_offset(self, read: _Read) -> None:
        """Refuse to go on when a preset, lost or new, has moved the zero under readings already taken."""
        try:
            offset = await self._read_value("offset", read)
        except RefusedError as error:
            if error.vendor_code in _OBJECT_MISSING:
                return
            raise
        if self._offset is None:
            self._offset = offset
        if self._offset != offset:
            raise moved_zero_error(self.name, (offset - self._offset) * self._step_m)

    async def _read_value(self, name: str, read: _Read) -> int:
        entry = self._table.objects[name]
        data = await read(entry.index, entry.sub)
        try:
            return decode_entry(entry, data)
        except ValueError as error:
            raise WireProtocolError(
                self.name,
                make_message("object {index:04X}h: {error}.", index=entry.index, error=error),
                remedy="The object table does not fit this device; the reading was not used.",
                frame=data.hex(),
            ) from error

    def _raise_on_emergency(self, register: int) -> None:
        emergency = self._link.emergency
        if emergency is None and register:
            emergency = Emergency(_GENERIC, register, "")
        if emergency is not None:
            meaning = _find_meaning(emergency)
            raise RefusedError(
                self.name,
                make_message(
                    "the gauge reports error {emergency_code:04X}h: {meaning_text}.",
                    emergency_code=emergency.code,
                    meaning_text=meaning.text,
                ),
                remedy=meaning.remedy,
                vendor_code=emergency.code,
                vendor_text=meaning.text,
            )
        if self._link.has_foreign_master:
            raise self._foreign_control_error()

    def _foreign_control_error(self) -> RefusedError:
        return RefusedError(
            self.name,
            "another program controls this gauge.",
            remedy="End the other program on the CAN bus, wait two seconds, then try again.",
        )

    def _wrong_device_error(self, found: str) -> WrongDeviceError:
        return WrongDeviceError(
            self.name,
            make_message("at this node is {found}.", found=found),
            remedy="Check node number and cables; change cell.toml only if the gauge was exchanged.",
        )


def _find_meaning(emergency: Emergency) -> CodeEntry:
    """Return the most exact entry of the table for this code."""
    table = code_table("cellcal.drivers.draw_wire", "emergencies.tsv")
    code = emergency.code
    for key in (code, code & 0xFF00, code & 0xF000):
        if key in table:
            return table[key]
    return CodeEntry(
        code, "fault", make_message("error {code:04X}h", code=code), "Look at the gauge's manual."
    )
