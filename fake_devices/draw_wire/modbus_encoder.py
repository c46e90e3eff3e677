"""A draw-wire with a Modbus TCP encoder: registers over the wire's length.

Imitates
    An absolute multi-turn encoder on the drum of a draw-wire, of the class of Lika EM58/HM58 MT or POSITAL LD0.
Source
    Lika EM58/HS58/HM58 MODBUS TCP/IP manual, chapter 7: current position, speed, status word, offset value,
    firmware and hardware versions, high word first; deploy/controller_setup/draw_wire_modbus.md for what is assumed.
Modelled
    Holding registers 94-137 and input registers 0-5; position in steps of the drum, speed, alarms in the status
    word, an offset that a preset changes; the faults of ``KINDS``.
Not modelled
    Writing parameters and presets over the link, the encoder's web page, scaling functions.
"""

import struct
from collections.abc import Callable
from typing import Any

from cellcal.fake_devices.modbus_robot.server import ModbusError
from cellcal.fake_devices.wire_gauge import WireGauge

KINDS: dict[str, dict[str, Any]] = {
    "encoder_alarm": {"bits": 1},  # bit 0 machine data, bit 1 flash memory
    "swapped_words": {},
    "other_device": {},  # another encoder has taken the address
}
_FIRST, _WORDS = 94, 44
_FIRMWARE, _HARDWARE, _LATER = 0x00010002, 0x00010001, 0x00010007


class ModbusEncoder:
    """Registers; addresses count from 0."""

    def __init__(self, gauge: WireGauge, serial: int, step_m: float, look: Callable[[str], Any]) -> None:
        self.gauge, self.serial, self.step_m = gauge, serial, step_m
        self._look = look
        self.offset_steps = 0

    def read_words(self, function: int, address: int, count: int) -> list[int]:
        words, first = (
            (self._holding_registers(), _FIRST) if function == 3 else (self._holding_registers()[:6], 0)
        )
        if address < first or address + count > first + len(words):
            raise ModbusError(2)
        return words[address - first : address - first + count]

    def read_bits(self, function: int, address: int, count: int) -> list[bool]:
        raise ModbusError(1)

    def write_words(self, address: int, values: list[int]) -> None:
        raise ModbusError(2)

    def write_bits(self, address: int, values: list[bool]) -> None:
        raise ModbusError(1)

    def _holding_registers(self) -> list[int]:
        length_m, _ = self.gauge.read_m()
        alarm = self._look("encoder_alarm")
        other = self._look("other_device") is not None
        values = {
            94: max(round(length_m / self.step_m) + self.offset_steps, 0),
            98: 0 if alarm is None else int(alarm["bits"]) << 8,
            126: self.offset_steps & 0xFFFFFFFF,
            128: _LATER if other else _FIRMWARE,
            130: _HARDWARE,
            136: self.serial + 1 if other else self.serial,
        }
        words = [0] * _WORDS
        for address, value in values.items():
            high, low = struct.unpack(">HH", struct.pack(">I", value))
            pair = (low, high) if self._look("swapped_words") is not None else (high, low)
            words[address - _FIRST : address - _FIRST + 2] = pair
        return words
