"""The I/O coupler: terminals, their process image, and the coupler's own registers.

Imitates
    A WAGO 750-352 Modbus TCP coupler with analogue inputs 4-20 mA (750-455), digital inputs and digital outputs.
Source
    WAGO manuals: image at 0000h (analogue words first, then digital bits packed into words), outputs at 0000h or
    0200h, watchdog 1000h-100Bh, LED error 1020h-1021h, image lengths in bits 1022h-1025h, MAC-ID 1031h, constants
    2000h-2008h, name plate 2010h-2014h; 750-455: 4 mA 0000h, 20 mA 7FF8h, value in bits 3 to 14, below range or
    broken wire 0003h, above range 7FFFh. A broken internal bus and an expired watchdog answer process data with
    exception 4 (statistics register 1029h, "SlaveDeviceFailure"). deploy/controller_setup/touch_probe.md.
Modelled
    Function codes 1 to 6, 15, 16; one wire from a digital output back to a digital input; the faults of ``KINDS``.
Not modelled
    The watchdog's own timer (``watchdog_expired`` sets its state), 2030h module list, BootP, FC 22 and 23, the
    limit of 15 connections, mixed Motorola formats.
"""

from collections.abc import Callable
from typing import Any

from cellcal.fake_devices.link_faults import LinkFaults
from cellcal.fake_devices.modbus_robot.server import ModbusError, ModbusServer, link_faults
from cellcal.fake_devices.modbus_tables import answer_request

KINDS: dict[str, dict[str, Any]] = {
    "image_frozen": {},  # the inputs stand still and nothing says so
    "bus_break": {"terminal": 2},  # the internal bus is interrupted after a terminal
    "watchdog_expired": {},
    "terminal_added": {},  # four more analogue words push the digital inputs away
}
_OUTPUTS, _HALF = 0x0200, 0x0100
_CONSTANTS = (0x0000, 0xFFFF, 0x1234, 0xAAAA, 0x5555, 0x7FFF, 0x8000, 0x3FFF, 0x4000)
_BROKEN, _ABOVE, _STEPS = 0x0003, 0x7FFF, 4095


class FakeCoupler:
    """Terminals on a rail. Channels count from 1; who is wired to one gives a function that reads it."""

    def __init__(self, host: str, port: int, mac: str, real: Callable[[], float]) -> None:
        self.analogue: list[Callable[[], float] | None] = [
            None
        ] * 4  # parts of 4-20 mA; below 0 is a broken wire
        self.digital: list[Callable[[], bool] | None] = [None] * 8
        self.outputs = [False] * 8
        self.output_writes = 0  # so far: who waits for an echo has had one before the next
        self.loops: dict[int, int] = {}  # output to input
        self._mac = [int(mac.replace("-", "").replace(":", "")[k : k + 4], 16) for k in (0, 4, 8)]
        self._frozen: list[int] | None = None
        self.faults: LinkFaults = link_faults(real, KINDS)
        self.server = ModbusServer(host, port, lambda request: answer_request(self, request), self.faults)

    # process image

    def run_cycle(self) -> None:
        """Run the internal bus once: what is frozen from now on is what there is now."""
        self._input_words()

    def _input_words(self) -> list[int]:
        """Return the image of all inputs, in words."""
        if self.faults.active_parameters("image_frozen") is None:
            self._frozen = None
        elif self._frozen is not None:
            return self._frozen
        words = [_analogue_code(channel) for channel in self.analogue]
        if self.faults.active_parameters("terminal_added") is not None:
            words += [0] * 4
        states = [channel is not None and channel() for channel in self.digital]
        for output, looped in self.loops.items():
            states[looped - 1] = self.outputs[output - 1]
        words.append(sum(bit << k for k, bit in enumerate(states)))
        if self.faults.active_parameters("image_frozen") is not None:
            self._frozen = words
        return words

    def _refuse_dead_bus(self) -> None:
        if (
            self.faults.active_parameters("bus_break") is not None
            or self.faults.active_parameters("watchdog_expired") is not None
        ):
            self.outputs = [False] * 8
            raise ModbusError(4)

    # tables

    def read_words(self, function: int, address: int, count: int) -> list[int]:
        if address < _OUTPUTS + _HALF:
            self._refuse_dead_bus()
            outputs = [sum(bit << k for k, bit in enumerate(self.outputs))]
            words = outputs if address >= _OUTPUTS else self._input_words()
            return _select_values(words, address % _OUTPUTS, count)
        registers = self._coupler_registers()
        addresses = range(address, address + count)
        if any(register not in registers for register in addresses):
            raise ModbusError(2)
        return [registers[register] for register in addresses]

    def read_bits(self, function: int, address: int, count: int) -> list[bool]:
        self._refuse_dead_bus()
        word = self._input_words()[-1]
        inputs = [bool(word >> k & 1) for k in range(len(self.digital))]
        return _select_values(self.outputs if address >= _OUTPUTS else inputs, address % _OUTPUTS, count)

    def write_words(self, address: int, values: list[int]) -> None:
        self._refuse_dead_bus()
        if address not in (0, _OUTPUTS) or len(values) != 1:
            raise ModbusError(2)
        self.outputs = [bool(values[0] >> k & 1) for k in range(len(self.outputs))]

    def write_bits(self, address: int, values: list[bool]) -> None:
        self._refuse_dead_bus()
        first = address % _OUTPUTS
        if first + len(values) > len(self.outputs):
            raise ModbusError(2)
        self.outputs[first : first + len(values)] = values
        self.output_writes += 1

    def _coupler_registers(self) -> dict[int, int]:
        broken = self.faults.active_parameters("bus_break")
        expired = self.faults.active_parameters("watchdog_expired") is not None
        analogue = len(self.analogue) + (
            4 if self.faults.active_parameters("terminal_added") is not None else 0
        )
        error = (4, int(broken["terminal"])) if broken is not None else (0, 0)
        runs = {
            0x1000: [100, 0xFFFF, 0xFFFF, 0, 0xFFFF, 0, 2 if expired else 0, 1, 0, 0],
            0x1020: [*error, 0, 16 * analogue, len(self.outputs), len(self.digital)],
            0x1030: [0, *self._mac],
            0x2000: list(_CONSTANTS),
            0x2010: [19, 750, 352, 3, 11],
        }
        return {first + k: word for first, words in runs.items() for k, word in enumerate(words)}


def _analogue_code(channel: Callable[[], float] | None) -> int:
    """Return the word of a 750-455 channel."""
    share = -1.0 if channel is None else channel()
    if share < -0.01:
        return _BROKEN
    if share > 1.0:
        return _ABOVE
    return max(round(share * _STEPS), 0) << 3


def _select_values(values: list[Any], first: int, count: int) -> list[Any]:
    if first + count > len(values):
        raise ModbusError(2)
    return values[first : first + count]
