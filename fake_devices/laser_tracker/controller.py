"""The emScon server's firmware: what it answers, what takes time, what it tells unasked.

Imitates
    An emScon server 3.8 with an AT901 sensor and a camera for probes.
Source
    ES_C_API_Def.h of the emScon TPI/SDK 3.6 (commands, statuses, events); the maker's sample clients for the order
    of answers: a start is acknowledged at once, its result comes as a packet of its own. The number of the error
    that a broken beam sends unasked is not in the header; ``C_UNKNOWN`` stands for it here.
Modelled
    Units, axes, system settings, modes, station orientation and transformation, reflector, statistics, air;
    initialising; one measurement at a time with ``RS_BUSY`` for whatever would disturb it; events to all clients.
Not modelled
    Command queue, bird bath and interferometer reset, compensation procedures, two faces. What is not known is
    answered with ``RS_NOT_IMPLEMENTED``.
"""

import asyncio
import struct
from collections.abc import Callable
from dataclasses import dataclass

from cellcal.fake_devices.clock import WorldClock
from cellcal.fake_devices.laser_tracker import layout as at
from cellcal.fake_devices.laser_tracker.results import EmsconSettings, result_packet
from cellcal.fake_devices.laser_tracker.sensor import TrackerSensor

_NOT_INITIALISED, _INITIALISED = 4, 5
_STATUS_NOT_READY, _STATUS_BUSY, _STATUS_READY = 0, 1, 2
_INITIALISE_S, _FIND_S = 40.0, 1.5
_SENSOR_AT901_MR = 14
_ALLOWED_WHILE_BUSY = frozenset({1, 2, 6, 13, 15, 21, 25, 27, 29, 41, 48, 52, 81, 85, 132})


@dataclass(frozen=True)
class _StoredSetting:
    """A setting that is written and read as a block of numbers."""

    name: str
    layout: str
    event: int


_SETTERS = {
    at.C_SET_UNITS: _StoredSetting("units", "<5I", at.SSC_UNITS),
    at.C_SET_ORIENTATION: _StoredSetting("orientation", "<6d", at.SSC_ORIENTATION),
    at.C_SET_TRANSFORMATION: _StoredSetting("transformation", "<7d", at.SSC_TRANSFORMATION),
    at.C_SET_MODE: _StoredSetting("mode", "<I", at.SSC_MODE),
    at.C_SET_AXES: _StoredSetting("axes", "<I", at.SSC_AXES),
    at.C_SET_STATIONARY: _StoredSetting("stationary", "<2i", 18),
    at.C_SET_REFLECTOR: _StoredSetting("reflector", "<i", at.SSC_REFLECTOR),
    at.C_SET_SETTINGS: _StoredSetting("settings", "<I8i", at.SSC_SETTINGS),
    at.C_SET_STATISTICS: _StoredSetting("statistics", "<2I", at.SSC_STATISTICS),
}
_GETTERS = {
    at.C_GET_UNITS: _SETTERS[at.C_SET_UNITS],
    at.C_GET_ORIENTATION: _SETTERS[at.C_SET_ORIENTATION],
    at.C_GET_TRANSFORMATION: _SETTERS[at.C_SET_TRANSFORMATION],
    at.C_GET_MODE: _SETTERS[at.C_SET_MODE],
    at.C_GET_AXES: _SETTERS[at.C_SET_AXES],
    at.C_GET_STATIONARY: _SETTERS[at.C_SET_STATIONARY],
    at.C_GET_REFLECTOR: _SETTERS[at.C_SET_REFLECTOR],
    at.C_GET_SETTINGS: _SETTERS[at.C_SET_SETTINGS],
    at.C_GET_STATISTICS: _SETTERS[at.C_SET_STATISTICS],
    at.C_GET_COMPENSATION: _StoredSetting("compensation", "<i", at.SSC_COMPENSATION),
}
Reply = Callable[[bytes], None]


class TrackerController:
    """Answers one command at a time; ``broadcast`` reaches every client."""

    def __init__(self, sensor: TrackerSensor, clock: WorldClock, serial: int, measures_poses: bool) -> None:
        self.sensor, self._clock, self.serial, self.measures_poses = sensor, clock, serial, measures_poses
        self.setup = EmsconSettings()
        self.broadcast: Reply = lambda _data: None
        self.initialised = True
        self.measurements = 0
        self.refusals: dict[int, int] = {}  # command -> status, while a fault lasts
        self._work: asyncio.Task[None] | None = None
        self._measuring = False

    @property
    def is_busy(self) -> bool:
        """Whether something that takes time is under way."""
        return self._work is not None and not self._work.done()

    def receive_packet(self, data: bytes, reply: Reply) -> None:
        """Obey one packet of a client."""
        kind, command = struct.unpack_from("<II", data, 4)
        if kind != at.DT_COMMAND:
            reply(at.make_error(at.C_UNKNOWN, at.RS_WRONG_PARAMETER))
        elif command in self.refusals:
            reply(at.make_reply(command, self.refusals[command]))
        elif self.is_busy and command not in _ALLOWED_WHILE_BUSY:
            reply(at.make_reply(command, at.RS_BUSY))
        elif command in _SETTERS:
            reply(at.make_reply(command, self._set_setting(_SETTERS[command], data[12:])))
        elif command in _GETTERS:
            reply(at.make_reply(command, at.RS_OK, self._get_setting(_GETTERS[command])))
        else:
            self._run_command(command, data[12:], reply)

    def stop_work(self) -> None:
        """Give up what is under way."""
        if self._work is not None:
            self._work.cancel()
            self._work = None
        self._measuring = False

    async def end_work(self) -> None:
        """Give up what is under way and see it ended."""
        work = self._work
        self.stop_work()
        if work is not None:
            await asyncio.wait({work})

    # what happens to it

    def beam_breaks(self, findable: bool) -> None:
        """Lose the reflector; ``findable`` tells whether a search would bring it back."""
        self.sensor.locked, self.sensor.hidden_target = False, not findable
        if self._measuring:
            self.stop_work()
            self._tell_error(at.C_START, at.RS_NO_RESULT)
        else:
            self._tell_error(at.C_UNKNOWN, at.RS_UNKNOWN)
        self.broadcast(at.status_change(at.SSC_NOT_READY))

    def beam_returns(self) -> None:
        """Lock on the reflector again."""
        if not self.sensor.locked:
            self.sensor.locked, self.sensor.hidden_target = True, False
            self.broadcast(at.status_change(at.SSC_READY))

    def other_program(self, name: str, value: object, silently: bool) -> None:
        """Let another client change a setting."""
        stored = next(stored for stored in _GETTERS.values() if stored.name == name)
        setattr(self.setup, name, value)
        if not silently:
            self.broadcast(at.status_change(stored.event))

    def restart_server(self) -> None:
        """Come up as after the main switch: nothing set, not initialised."""
        self.stop_work()
        reflector, self.setup = self.setup.reflector, EmsconSettings()
        self.setup.reflector = reflector
        self.initialised = False

    # inside

    def _set_setting(self, stored: _StoredSetting, data: bytes) -> int:
        if len(data) != struct.calcsize(stored.layout):
            return at.RS_WRONG_PARAMETER
        values = struct.unpack(stored.layout, data)
        if stored.name == "mode" and values[0] != at.MM_STATIONARY:
            if values[0] != at.MM_6D_STATIONARY:
                return at.RS_NOT_IMPLEMENTED
            if not self.measures_poses:
                return at.RS_NO_SIX_D
        setattr(self.setup, stored.name, values[0] if len(values) == 1 else values)
        self.broadcast(at.status_change(stored.event))
        return at.RS_OK

    def _get_setting(self, stored: _StoredSetting) -> bytes:
        value = getattr(self.setup, stored.name)
        return struct.pack(stored.layout, *(value if isinstance(value, tuple) else (value,)))

    def _run_command(self, command: int, data: bytes, reply: Reply) -> None:
        acts: dict[int, Callable[[bytes, Reply], None]] = {
            at.C_GET_SYSTEM_STATUS: self._system_status,
            at.C_GET_TRACKER_STATUS: self._tracker_status,
            at.C_GET_TRACKER_INFO: self._tracker_info,
            at.C_GET_ENVIRONMENT: self._answer_environment,
            at.C_SET_ENVIRONMENT: self._enter_environment,
            at.C_INITIALIZE: self._initialise_sensor,
            at.C_START: self._start_measurement,
            at.C_STOP: self._stop_measurement,
            at.C_FIND: self._find_reflector,
        }
        if command in acts:
            acts[command](data, reply)
        else:
            reply(at.make_reply(command, at.RS_NOT_IMPLEMENTED))

    def _system_status(self, _data: bytes, reply: Reply) -> None:
        state = _INITIALISED if self.initialised else _NOT_INITIALISED
        values = (0, state, 3, 2, 3, 8, 900, self.setup.settings[0], 0, self.serial)
        reply(at.make_reply(at.C_GET_SYSTEM_STATUS, at.RS_OK, struct.pack("<4I3iI2i", *values)))

    def _tracker_status(self, _data: bytes, reply: Reply) -> None:
        state = _STATUS_READY if self.sensor.locked and self.initialised else _STATUS_NOT_READY
        reply(
            at.make_reply(
                at.C_GET_TRACKER_STATUS, at.RS_OK, struct.pack("<I", _STATUS_BUSY if self.is_busy else state)
            )
        )

    def _tracker_info(self, _data: bytes, reply: Reply) -> None:
        numbers = (self.serial, self.setup.compensation, 1, 1, 1, 0.0, 25.0, 0.5, 1000, 2, 4.2, 1.6, 1, 3, 4)
        body = struct.pack("<I64s5i3d2i2dI2i", _SENSOR_AT901_MR, at.wide_text("AT901-MR"), *numbers)
        reply(at.make_reply(at.C_GET_TRACKER_INFO, at.RS_OK, body))

    def _answer_environment(self, _data: bytes, reply: Reply) -> None:
        values = struct.pack("<3d", *self.setup.air_values(self.sensor.read_air()))
        reply(at.make_reply(at.C_GET_ENVIRONMENT, at.RS_OK, values))

    def _enter_environment(self, data: bytes, reply: Reply) -> None:
        if len(data) == struct.calcsize("<3d"):
            entered = struct.unpack("<3d", data)[0]
            self.sensor.entered_c = (entered - 32.0) / 1.8 if self.setup.units[2] else entered
            self.broadcast(at.status_change(at.SSC_ENVIRONMENT))
        reply(at.make_reply(at.C_SET_ENVIRONMENT, at.RS_OK if len(data) == 24 else at.RS_WRONG_PARAMETER))

    def _initialise_sensor(self, _data: bytes, reply: Reply) -> None:
        async def drive_sensor() -> None:
            await self._clock.sleep(_INITIALISE_S)
            self.initialised, self.sensor.locked = True, not self.sensor.hidden_target
            reply(at.make_reply(at.C_INITIALIZE, at.RS_OK))
            for event in (at.SSC_INITIALIZATION, at.SSC_READY if self.sensor.locked else at.SSC_NOT_READY):
                self.broadcast(at.status_change(event))

        self._work = asyncio.create_task(drive_sensor())

    def _start_measurement(self, _data: bytes, reply: Reply) -> None:
        if not self.initialised:
            reply(at.make_reply(at.C_START, at.RS_NOT_INITIALIZED))
        elif not self.sensor.locked:
            sixd = self.setup.mode == at.MM_6D_STATIONARY
            reply(at.make_reply(at.C_START, at.RS_NO_PROBE if sixd else at.RS_NOT_READY))
        else:
            self._measuring = True
            reply(at.make_reply(at.C_START, at.RS_OK))
            self.broadcast(at.status_change(at.SSC_BUSY))
            self._work = asyncio.create_task(self._measure_stationary())

    async def _measure_stationary(self) -> None:
        measurement = await self.sensor.measure_target(self.setup.stationary[0] * 1e-3)
        self._measuring = False
        self.measurements += 1
        self.broadcast(result_packet(self.setup, measurement, self.sensor.read_air()))
        self.broadcast(at.status_change(at.SSC_READY))

    def _stop_measurement(self, _data: bytes, reply: Reply) -> None:
        if self._measuring:
            self.stop_work()
            self.broadcast(at.status_change(at.SSC_READY))
        reply(at.make_reply(at.C_STOP, at.RS_OK))

    def _find_reflector(self, data: bytes, reply: Reply) -> None:
        if len(data) != struct.calcsize("<d"):
            reply(at.make_reply(at.C_FIND, at.RS_WRONG_PARAMETER))
            return

        async def search_reflector() -> None:
            await self._clock.sleep(_FIND_S)
            found = not self.sensor.hidden_target
            reply(at.make_reply(at.C_FIND, at.RS_OK if found else at.RS_NOT_READY))
            if found:
                self.beam_returns()

        self._work = asyncio.create_task(search_reflector())

    def _tell_error(self, command: int, status: int) -> None:
        if self.setup.settings[4]:
            self.broadcast(at.make_error(command, status))
