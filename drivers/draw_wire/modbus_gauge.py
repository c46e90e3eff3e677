"""A draw-wire encoder on Modbus TCP. One block holds length, status, zero and name plate: it is read whole each time.

A length is used only if the same telegram says who sent it and that its zero has not moved.
"""

import logging
import time
from dataclasses import dataclass

from cellcal.calibration.message import join_messages, make_message
from cellcal.drivers.draw_wire.ends import moved_zero_error, refuse_near_ends
from cellcal.drivers.draw_wire.modbus_registers import EncoderMap
from cellcal.drivers.errors import DeviceError, RefusedError, WrongDeviceError
from cellcal.drivers.interfaces import Alarm, Condition, GaugeCapabilities, Identity, LengthReading, Readiness
from cellcal.drivers.wire.deadline import answer_deadline
from cellcal.drivers.wire.modbus import ModbusLink, Words

_LOG = logging.getLogger(__name__)
VERIFIED_ON: tuple[str, ...] = ()  # "vendor firmware" this driver has run on; none yet, see README.md
_ALARM_BITS = 8  # the status word's low byte repeats settings, the next one holds alarms


@dataclass(frozen=True, slots=True)
class EncoderOptions:
    """The cell file's options of this gauge."""

    serial: int
    step_m: float
    range_m: float
    sigma_m: float
    end_margin_m: float
    deadline_s: float


class ModbusDrawWire:
    """DistanceGauge over one Modbus TCP encoder."""

    def __init__(self, link: ModbusLink, table: EncoderMap, options: EncoderOptions) -> None:
        self._link, self._table, self._options = link, table, options
        self._offset: int | None = None
        link.check_server = self._check_device

    @property
    def name(self) -> str:
        return self._link.device

    @property
    def capabilities(self) -> GaugeCapabilities:
        return GaugeCapabilities(self._options.range_m, self._options.step_m, self._options.sigma_m)

    async def connect(self) -> None:
        """Connect, check the device's identity, and note an untested device."""
        async with answer_deadline(self.name, self._options.deadline_s, "connecting"):
            await self._link.open()
        identity = await self.identify()
        if not f"{identity.vendor} {identity.firmware}".startswith(VERIFIED_ON):
            _LOG.warning("%s: not verified on %s %s", self.name, identity.vendor, identity.firmware)

    async def close(self) -> None:
        """Hang up."""
        await self._link.close()

    async def identify(self) -> Identity:
        block = await self._read_block("asking who it is")
        value = self._table.decode_value
        return Identity(
            self._table.vendor,
            f"{self._table.name} hardware {_version_text(value('hardware', block))}",
            str(value("serial", block)),
            _version_text(value("firmware", block)),
        )

    async def read_condition(self) -> Condition:
        try:
            block = await self._read_block("asking its condition")
            self._require_same(block)
        except RefusedError as error:
            return Condition(Readiness.NOT_READY, error.message, error.remedy)
        except DeviceError as error:
            return Condition(Readiness.UNREACHABLE, error.message, error.remedy)
        alarm = self._find_alarm(block)
        if alarm is not None:
            alarms = (Alarm(f"alarm {alarm.vendor_code}", alarm.vendor_text),)
            return Condition(Readiness.NOT_READY, alarm.message, alarm.remedy, alarms)
        return Condition(Readiness.READY)

    async def read_distance(self) -> LengthReading:
        block = await self._read_block("reading the length")
        taken_at_s = time.monotonic()
        self._require_same(block)
        alarm = self._find_alarm(block)
        if alarm is not None:
            raise alarm
        raw = self._table.decode_value("position", block)
        value_m = raw * self._options.step_m
        refuse_near_ends(self.name, value_m, self._options.range_m, self._options.end_margin_m)
        return LengthReading(value_m, self._options.sigma_m, taken_at_s, raw)

    async def _read_block(self, doing: str) -> Words:
        async with answer_deadline(self.name, self._options.deadline_s, doing):
            return await self._link.read(self._table.first + 1, self._table.words)

    async def _check_device(self, link: ModbusLink) -> None:
        block = await link.read_during_check(self._table.first + 1, self._table.words)
        self._require_same(block)

    def _require_same(self, block: Words) -> None:
        """Refuse a stranger's block, and one whose zero is another than at first."""
        serial = self._table.decode_value("serial", block)
        if serial != self._options.serial:
            raise WrongDeviceError(
                self.name,
                make_message(
                    "the encoder has the serial number {found_serial}, cell.toml says {expected_serial}.",
                    found_serial=serial,
                    expected_serial=self._options.serial,
                ),
                remedy="Check address and cables, and the order of words; change cell.toml only if the gauge "
                "was exchanged.",
            )
        offset = self._table.decode_value("offset", block)
        if self._offset is None:
            self._offset = offset
        if offset != self._offset:
            raise moved_zero_error(self.name, (offset - self._offset) * self._options.step_m)

    def _find_alarm(self, block: Words) -> RefusedError | None:
        bits = self._table.decode_value("status", block) >> _ALARM_BITS & 0xFF
        if not bits:
            return None
        alarm_texts = [text for bit, text in self._table.alarms.items() if bits & bit] or [
            make_message("bits {bits:#04x}", bits=bits)
        ]
        return RefusedError(
            self.name,
            make_message(
                "the encoder reports an alarm: {alarm_texts}.", alarm_texts=join_messages(", ", alarm_texts)
            ),
            remedy="Switch the encoder off and on; if it stays, exchange it.",
            vendor_code=bits,
            vendor_text=", ".join(alarm_texts),
        )


def _version_text(value: int) -> str:
    return f"{value >> 16}.{value & 0xFFFF}"
