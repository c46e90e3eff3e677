"""The CANopen node in the draw-wire's housing.

Imitates
    A linear encoder after CiA 406 on CiA 301, as the makers of string-pull gauges build them.
Source
    Device manuals of TR-Electronic, MTS, ASM, SICK, SIKO as collected in the project's wire facts: 6003h
    and 6004h are signed on linear encoders, the step 6005h:1 counts nanometres, a preset is lost without
    1010h save.
Modelled
    Boot-up, NMT states (no PDO before Operational, no SDO while Stopped), heartbeat, SDO, TPDO1 on a timer
    or on SYNC, preset through the offset, direction, step, both ends of the range with EMCY set and
    cleared, error history, identity with serial number, save and restore, power off and on.
Not modelled
    LSS, node guarding, TPDO mapping beyond position and speed, cams, bit-rate objects. Heartbeats and
    cycles run in real time, because the client's watchdogs do.
"""

import struct
from collections.abc import Callable
from functools import partial

from cellcal.fake_devices.draw_wire.objects import (
    CANNOT_STORE,
    OUT_OF_RANGE,
    AbortError,
    ObjectDictionary,
    ObjectSettings,
    SdoEntry,
)
from cellcal.fake_devices.draw_wire.sdo import SdoServer
from cellcal.fake_devices.link_faults import LinkFaults
from cellcal.fake_devices.wire_gauge import WireGauge

Send = Callable[[int, bytes], None]

BOOT_UP, STOPPED, OPERATIONAL, PRE_OPERATIONAL = 0, 4, 5, 127
RANGE_EMCY, VENDOR, PRODUCT, REVISION = 0x5000, 0x0000FA4E, 0x00003000, 0x00010002
SAVE, LOAD = 0x65766173, 0x64616F6C
MIN_PERIOD_S = 0.001
_POSITION, _SPEED = 0x60040020, 0x60300110
_RANGE_CHECK_S = 0.2

KINDS: dict[str, dict[str, object]] = {
    "heartbeat_stop": {},
    "tpdo_stop": {},
    "tpdo_frozen": {},
    "sdo_silent": {},
    "sdo_slow": {"delay_s": 0.5},
    "sdo_abort": {"code": 0x08000000},
    "sdo_wrong_object": {},
}


class DrawWireNode:
    """Takes frames, sends frames; ``poll`` does what time demands."""

    def __init__(self, gauge: WireGauge, node_id: int, serial: int, faults: LinkFaults, send: Send) -> None:
        self.gauge, self.node_id, self.serial = gauge, node_id, serial
        self._faults, self._send = faults, send
        self.settings = ObjectSettings({
            "heartbeat_ms": 0, "pdo_cob": 0x180 + node_id, "pdo_type": 255, "pdo_timer_ms": 0,
            "cycle_ms": 100, "direction": 0, "step_nm": 10_000,
            "speed_step": 100, "offset": 0, "mapping": _POSITION,
        })  # fmt: skip
        self.powered = True
        self.state = PRE_OPERATIONAL
        self._errors: list[int] = []
        self._active: dict[int, int] = {}
        self._frozen: bytes | None = None
        self._next_heartbeat_s = self._next_pdo_s = self._next_check_s = 0.0
        self._syncs = 0
        self._pending_sdo: list[tuple[float, bytes]] = []
        self.sdo = SdoServer(ObjectDictionary(self._make_entries()))

    # measured values

    def read_position(self) -> int:
        """Return 6004h: steps, direction and offset applied; watch the ends of the range on the way."""
        length_m, inside = self.gauge.read_m()
        self._watch_range(inside)
        steps = round(length_m / (self.settings.now["step_nm"] * 1e-9))
        signed = -steps if self.settings.now["direction"] & 1 else steps
        return signed + self.settings.now["offset"]

    def set_preset(self, value: int) -> None:
        """Make the present position read ``value``; lost at power-off unless saved."""
        if abs(value) > 1 << 30:
            raise AbortError(OUT_OF_RANGE)
        self.settings.now["offset"] += value - self.read_position()

    def _watch_range(self, inside: bool) -> None:
        if not inside and RANGE_EMCY not in self._active:
            self.raise_emergency(RANGE_EMCY)
        elif inside and RANGE_EMCY in self._active:
            self.clear_emergency(RANGE_EMCY)

    # errors

    @property
    def error_register(self) -> int:
        """Return 1001h."""
        return 0x81 if self._active else 0

    def raise_emergency(self, code: int, length: int = 8) -> None:
        """Report an error; ``length`` below 8 is what a bad device sends."""
        self._active[code] = code
        self._errors.insert(0, code)
        del self._errors[8:]
        self._send_emergency(code, length)

    def clear_emergency(self, code: int | None = None) -> None:
        """Report the end of one error, or of all; 0000h only when none is left."""
        if code is None:
            self._active.clear()
        self._active.pop(code or 0, None)
        if not self._active:
            self._send_emergency(0)

    def _send_emergency(self, code: int, length: int = 8) -> None:
        if self.powered and self.state != STOPPED:
            self._send(
                0x80 + self.node_id, (struct.pack("<HB", code, self.error_register) + bytes(5))[:length]
            )

    # power and states

    def switch_off(self) -> None:
        """Vanish from the bus."""
        self.powered = False
        self._pending_sdo.clear()

    def switch_on(self, now_s: float) -> None:
        """Boot: saved settings, boot-up message, Pre-operational."""
        self.powered = True
        self.settings.power_on()
        self._errors.clear()
        self._active.clear()
        self._boot_up(now_s)

    def _boot_up(self, now_s: float) -> None:
        self.sdo.reset()
        self._send(0x700 + self.node_id, bytes([BOOT_UP]))
        self.state = PRE_OPERATIONAL
        self._next_heartbeat_s = now_s

    def _obey_nmt(self, command: int, now_s: float) -> None:
        states = {1: OPERATIONAL, 2: STOPPED, 0x80: PRE_OPERATIONAL}
        if command in states:
            self.state = states[command]
            self._next_pdo_s = now_s
        elif command == 0x81:
            self.switch_on(now_s)
        elif command == 0x82:
            self._boot_up(now_s)

    # frames

    def receive_frame(self, can_id: int, data: bytes, now_s: float) -> None:
        """Take one frame from the bus."""
        if not self.powered:
            return
        if can_id == 0x000 and len(data) >= 2 and data[1] in (0, self.node_id):
            self._obey_nmt(data[0], now_s)
        elif can_id == 0x080:
            self._on_sync()
        elif can_id == 0x600 + self.node_id and self.state != STOPPED:
            self._sdo_request(data, now_s)

    def _sdo_request(self, data: bytes, now_s: float) -> None:
        if self._faults.use_once("sdo_silent") is not None:
            return
        if (abort := self._faults.use_once("sdo_abort")) is not None:
            self._send(0x580 + self.node_id, b"\x80" + data[1:4] + struct.pack("<I", int(abort["code"])))
            return
        response = self.sdo.answer_request(data)
        if response is None:
            return
        if self._faults.use_once("sdo_wrong_object") is not None:
            response = response[:1] + struct.pack("<HB", 0x6FFF, 0) + response[4:]
        if (slow := self._faults.use_once("sdo_slow")) is not None:
            self._pending_sdo.append((now_s + float(slow["delay_s"]), response))
            return
        self._send(0x580 + self.node_id, response)

    def _on_sync(self) -> None:
        kind = self.settings.now["pdo_type"]
        if 1 <= kind <= 240 and self.state == OPERATIONAL:
            self._syncs += 1
            if self._syncs % kind == 0:
                self._send_pdo()

    def _send_pdo(self) -> None:
        cob = self.settings.now["pdo_cob"]
        if cob & 1 << 31 or self._faults.active_parameters("tpdo_stop") is not None:
            return
        data = struct.pack("<i", self.read_position())
        if self.settings.now["mapping"] == _SPEED:
            data = struct.pack("<h", 0)
        if self._faults.active_parameters("tpdo_frozen") is None:
            self._frozen = data
        self._send(cob & 0x7FF, self._frozen or data)

    # time

    def poll(self, now_s: float) -> float:
        """Send what is due at this real time; return when to be asked again."""
        if not self.powered:
            return now_s + _RANGE_CHECK_S
        while self._pending_sdo and self._pending_sdo[0][0] <= now_s:
            self._send(0x580 + self.node_id, self._pending_sdo.pop(0)[1])
        if now_s >= self._next_check_s:
            self._next_check_s = now_s + _RANGE_CHECK_S
            self.read_position()
        due = [self._next_check_s, *(pending[0] for pending in self._pending_sdo)]
        if (period_s := self.settings.now["heartbeat_ms"] * 1e-3) > 0.0:
            self._next_heartbeat_s = self._send_heartbeat(now_s, period_s)
            due.append(self._next_heartbeat_s)
        if (cycle_s := self._pdo_cycle_s()) is not None:
            if now_s >= self._next_pdo_s:
                self._send_pdo()
                self._next_pdo_s = max(self._next_pdo_s + cycle_s, now_s)
            due.append(self._next_pdo_s)
        return min(due)

    def _send_heartbeat(self, now_s: float, period_s: float) -> float:
        due_s = min(self._next_heartbeat_s, now_s + period_s)
        if now_s < due_s:
            return due_s
        if self._faults.active_parameters("heartbeat_stop") is None:
            self._send(0x700 + self.node_id, bytes([self.state]))
        return max(due_s + period_s, now_s)

    def _pdo_cycle_s(self) -> float | None:
        now = self.settings.now
        cycle_ms = now["pdo_timer_ms"] or now["cycle_ms"]
        if self.state != OPERATIONAL or now["pdo_type"] < 254 or cycle_ms == 0:
            return None
        return max(cycle_ms * 1e-3, MIN_PERIOD_S)

    # objects

    def _make_entries(self) -> dict[tuple[int, int], SdoEntry]:
        settings, node_id = self.settings, self.node_id
        return {
            **_constant_entries(
                ("U32", {(0x1000, 0): 0x00080196, (0x1005, 0): 0x80, (0x1014, 0): 0x80 + node_id}),
                ("U8", {(0x1018, 0): 4, (0x1800, 0): 5, (0x1A00, 0): 1, (0x6005, 0): 2, (0x6030, 0): 1}),
                ("U8", {(0x1010, 0): 1, (0x1011, 0): 1, (0x650A, 0): 3}),
                ("U32", {(0x1018, 1): VENDOR, (0x1018, 2): PRODUCT, (0x1018, 3): REVISION}),
                ("U32", {(0x1018, 4): self.serial, (0x650B, 0): self.serial, (0x6507, 0): 0x01000302}),
                ("U16", {(0x6500, 0): 4, (0x6504, 0): 1, (0x6506, 0): 0, (0x6505, 0): 0}),
                ("U32", {(0x6508, 0): 1234, (0x6501, 0): 10_000}),
                ("I32", {(0x650A, 1): 0, (0x650A, 2): 0, (0x650A, 3): 0}),
                ("I16", {(0x6030, 1): 0}),
            ),
            (0x1001, 0): SdoEntry("U8", lambda: self.error_register),
            (0x1003, 0): SdoEntry("U8", lambda: len(self._errors), self._clear_history),
            **{(0x1003, k + 1): SdoEntry("U32", partial(self._error_history, k)) for k in range(8)},
            (0x1008, 0): SdoEntry("VISIBLE", lambda: "DW-3000 draw-wire encoder"),
            (0x1009, 0): SdoEntry("VISIBLE", lambda: "HW 1.2"),
            (0x100A, 0): SdoEntry("VISIBLE", lambda: "SW 3.02"),
            (0x1010, 1): SdoEntry("U32", lambda: 1, self._save_settings),
            (0x1011, 1): SdoEntry("U32", lambda: 1, self._load_defaults),
            (0x1017, 0): settings.make_entry("heartbeat_ms", "U16", 0, 0xFFFF),
            (0x1800, 1): settings.make_entry("pdo_cob", "U32", 0, 0xFFFFFFFF),
            (0x1800, 2): settings.make_entry("pdo_type", "U8", 0, 255),
            (0x1800, 5): settings.make_entry("pdo_timer_ms", "U16", 0, 0xFFFF),
            (0x1A00, 1): SdoEntry("U32", lambda: settings.now["mapping"], self._set_mapping),
            (0x6000, 0): settings.make_entry("direction", "U16", 0, 0xF),
            (0x6001, 0): SdoEntry("U32", lambda: round(0.315 / (settings.now["step_nm"] * 1e-9))),
            (0x6002, 0): SdoEntry(
                "U32", lambda: round(self.gauge.range_m / (settings.now["step_nm"] * 1e-9))
            ),
            (0x6003, 0): SdoEntry("I32", lambda: 0, self.set_preset),
            (0x6004, 0): SdoEntry("I32", self.read_position),
            (0x6005, 1): settings.make_entry("step_nm", "U32", 1_000, 10_000_000),
            (0x6005, 2): settings.make_entry("speed_step", "U32", 1, 100_000),
            (0x6200, 0): settings.make_entry("cycle_ms", "U16", 0, 0xFFFF),
            (0x6503, 0): SdoEntry("U16", lambda: int(RANGE_EMCY in self._active)),
            (0x6509, 0): SdoEntry("I32", lambda: settings.now["offset"]),
        }

    def _error_history(self, k: int) -> int:
        return self._errors[k] if k < len(self._errors) else 0

    def _clear_history(self, value: int) -> None:
        if value != 0:
            raise AbortError(OUT_OF_RANGE)
        self._errors.clear()

    def _save_settings(self, signature: int) -> None:
        if signature != SAVE:
            raise AbortError(CANNOT_STORE)
        self.settings.save_settings()

    def _load_defaults(self, signature: int) -> None:
        if signature != LOAD:
            raise AbortError(CANNOT_STORE)
        self.settings.load_defaults()

    def _set_mapping(self, mapping: int) -> None:
        if mapping not in (_POSITION, _SPEED):
            raise AbortError(0x06040041)
        self.settings.now["mapping"] = mapping


def _constant_entries(*groups: tuple[str, dict[tuple[int, int], int]]) -> dict[tuple[int, int], SdoEntry]:
    return {
        address: SdoEntry(kind, partial(int, value))
        for kind, values in groups
        for address, value in values.items()
    }
