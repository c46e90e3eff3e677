"""A laser tracker behind an emScon server: points, and poses of a probe where the tracker measures them."""

import asyncio
import logging
import struct
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass

from cellcal.calibration.message import make_message
from cellcal.drivers.errors import BusyError, DeviceError, RefusedError, WrongDeviceError
from cellcal.drivers.interfaces import (
    Condition,
    Identity,
    PointReading,
    PoseReading,
    Readiness,
    TrackerCapabilities,
)
from cellcal.drivers.laser_tracker.link import EmsconLink, status_meaning
from cellcal.drivers.laser_tracker.packets import (
    MeasurementMode,
    StationaryResult,
    StatusChange,
    TrackerCommand,
)
from cellcal.drivers.laser_tracker.readings import ResultChecker, TrackerLimits
from cellcal.drivers.laser_tracker.settings import TrackerSettings
from cellcal.drivers.wire.deadline import answer_deadline

_LOG = logging.getLogger(__name__)
VERIFIED_ON: tuple[str, ...] = ()  # model:firmware this driver has run on; none yet, see README.md
_INITIALISED, _READY, _BUSY = 5, 2, 1  # ES_TrackerProcessorStatus, ES_TrackerStatus
_POLL_S = 0.1
_MOVED = {
    StatusChange.COMPENSATION: "its compensation was changed",
    StatusChange.STATION_ORIENTATION: "it was given another station",
    StatusChange.TRANSFORMATION: "it was given another frame",
    StatusChange.INITIALIZATION: "it was initialised again",
    StatusChange.TILT: "its level sensor says that it was touched",
    StatusChange.SENSOR_DETECTED: "its sensor was unplugged",
    StatusChange.SENSOR_DISCONNECTED: "its sensor was unplugged",
    StatusChange.SERVER_STARTED: "its controller was started again",
}
_NEW_STATION = (
    "What was measured before and after cannot be used together. Raise `station` in cell.toml and begin the "
    "measurement anew."
)


@dataclass(frozen=True, slots=True)
class TrackerOptions:
    """The cell file's options of this tracker."""

    serial: int
    station: int
    reflector: int | None
    search_distance_m: float
    initialise: bool
    measures_poses: bool
    measure_deadline_s: float
    initialise_deadline_s: float
    limits: TrackerLimits


class LaserTracker:
    """Tracker over one emScon server."""

    def __init__(self, link: EmsconLink, options: TrackerOptions) -> None:
        self._link, self._options = link, options
        self._settings = TrackerSettings(link, options.reflector)
        self._judge = ResultChecker(link.device, options.limits)
        self._doing = ""
        self._readings = 0
        self._moved = ""
        self._marks: tuple[float, ...] | None = None
        self._initialised = False
        link.check_server = self._check_device
        link.on_change = self._on_status_change

    @property
    def name(self) -> str:
        return self._link.device

    @property
    def capabilities(self) -> TrackerCapabilities:
        limits = self._options.limits
        return TrackerCapabilities(
            self._options.measures_poses, limits.range_m, limits.sigma_m, limits.sigma_per_m, limits.sigma_rad
        )

    async def connect(self) -> None:
        """Connect, check the device's identity, and note an untested device. Moves nothing."""
        identity = await self.identify()
        if f"{identity.model}:{identity.firmware}" not in VERIFIED_ON:
            _LOG.warning("%s: not verified on %s with %s", self.name, identity.model, identity.firmware)

    async def close(self) -> None:
        """Disconnect; the tracker keeps its settings."""
        await self._link.close()

    async def identify(self) -> Identity:
        with self._exclusive_use("asking who it is"):
            await self._link.ensure_connected()
            status = await self._read_status()
            model = await self._read_model()
        major, minor, build = (int(value) for value in status[4:7])
        return Identity("Leica Geosystems", model, str(int(status[9])), f"emScon {major}.{minor}.{build}")

    async def read_condition(self) -> Condition:
        if self._doing:
            return Condition(Readiness.READY, make_message("It is {doing}.", doing=self._doing))
        try:
            with self._exclusive_use("telling its condition"):
                await self._link.ensure_connected()
                self._require_station()
                return await self._current_condition()
        except RefusedError as error:
            return Condition(Readiness.NOT_READY, error.message, error.remedy)
        except DeviceError as error:
            return Condition(Readiness.UNREACHABLE, error.message, error.remedy)

    async def measure_point(self) -> PointReading:
        """Measure the reflector where it stands.

        Raises
        ------
        RefusedError
            No reflector in the beam, a target that moves, a tracker that was moved, settings that others change.
        """
        with self._exclusive_use("measuring a point"):
            found, taken_at_s = await self._measure_in_mode(MeasurementMode.POINT)
            reading = self._judge.point_reading(found, taken_at_s, self._options.station)
            self._readings += 1
        return reading

    async def measure_pose(self) -> PoseReading:
        """Measure the probe where it stands. Raises as ``measure_point``, and when its turn is not valid."""
        if not self._options.measures_poses:
            raise RefusedError(
                self.name,
                "this tracker measures no poses.",
                remedy="Set measures_poses = true in cell.toml where it has a camera and a probe.",
            )
        with self._exclusive_use("measuring a pose"):
            found, taken_at_s = await self._measure_in_mode(MeasurementMode.PROBE)
            reading = self._judge.pose_reading(found, taken_at_s, self._options.station)
            self._readings += 1
        return reading

    # measuring

    async def _measure_in_mode(self, mode: MeasurementMode) -> tuple[StationaryResult, float]:
        await self._link.ensure_connected()
        self._require_station()
        await self._initialise_sensor()
        await self._settings.apply_settings(mode)
        async with answer_deadline(self.name, self._options.measure_deadline_s, "measuring"):
            await self._lock_beam()
            found = await self._start_measurement()
        taken_at_s = time.monotonic()
        await self._settings.check_settings(mode)
        self._require_station()
        return found, taken_at_s

    async def _start_measurement(self) -> StationaryResult:
        """Measure, waiting while the tracker is still busy with something earlier."""
        while True:
            try:
                return await self._link.measure_stationary()
            except RefusedError as error:
                if status_meaning(error.vendor_code).kind != "busy":
                    raise
                await asyncio.sleep(_POLL_S)

    async def _lock_beam(self) -> None:
        """See that the beam is on a target; look for a lost one where cell.toml allows it."""
        searched = False
        while (state := await self._tracker_state()) != _READY:
            if state != _BUSY:
                if searched or not self._options.search_distance_m:
                    raise self._link.refused_error("measuring", 10004)
                await self._search_reflector()
                searched = True
            await asyncio.sleep(_POLL_S)

    async def _search_reflector(self) -> None:
        distance = self._options.search_distance_m
        seconds = self._options.measure_deadline_s
        await self._link.send_command(
            TrackerCommand.FIND_REFLECTOR, _pack_double(distance), deadline_s=seconds
        )

    async def _initialise_sensor(self) -> None:
        """Initialise a sensor that has not been, before the first reading only: it gives it a new frame."""
        if self._initialised:
            return
        if not self._options.initialise or self._readings:
            raise self._link.refused_error("measuring", 39)
        await self._link.send_command(
            TrackerCommand.INITIALIZE, deadline_s=self._options.initialise_deadline_s
        )
        if (await self._read_status())[1] != _INITIALISED:
            raise self._link.refused_error("initialising", 39)
        self._initialised = True
        self._marks = await self._read_station_marks()

    # what is known about where it stands

    async def _check_device(self) -> None:
        status = await self._read_status()
        if int(status[9]) != self._options.serial:
            raise WrongDeviceError(
                self.name,
                make_message(
                    "at this address is serial number {found}, cell.toml says {serial}.",
                    found=int(status[9]),
                    serial=self._options.serial,
                ),
                remedy="Check the address; change cell.toml only if the tracker was exchanged.",
            )
        self._initialised = status[1] == _INITIALISED
        await self._settings.frame_only()
        await self._settings.ask_covariances()
        marks = await self._read_station_marks()
        if self._readings and not self._initialised:
            self._note_moved("it was off")
        elif self._readings and marks != self._marks:
            self._note_moved("its station was changed while it was not connected")
        self._marks = marks

    async def _read_station_marks(self) -> tuple[float, ...]:
        """Return the station and compensation, whose change makes earlier readings invalid."""
        station = await self._link.send_command(TrackerCommand.GET_STATION_ORIENTATION, layout="<6d")
        frame = await self._link.send_command(TrackerCommand.GET_TRANSFORMATION, layout="<7d")
        try:
            compensation = await self._link.send_command(TrackerCommand.GET_COMPENSATION, layout="<i")
        except RefusedError:
            compensation = ()
        return (*station, *frame, *compensation)

    def _on_status_change(self, code: int) -> None:
        """Receive an event; before the first reading there is nothing that could be mixed up."""
        if self._readings and code in _MOVED:
            self._note_moved(_MOVED[StatusChange(code)])

    def _note_moved(self, why: str) -> None:
        self._moved = self._moved or why

    def _require_station(self) -> None:
        if self._moved:
            raise RefusedError(
                self.name,
                make_message(
                    "the tracker no longer stands in station {station}: {why}.",
                    station=self._options.station,
                    why=self._moved,
                ),
                remedy=_NEW_STATION,
            )

    # asking

    async def _read_status(self) -> tuple[float, ...]:
        return await self._link.send_command(TrackerCommand.GET_SYSTEM_STATUS, layout="<4I3iI2i")

    async def _tracker_state(self) -> int:
        return int((await self._link.send_command(TrackerCommand.GET_TRACKER_STATUS, layout="<I"))[0])

    async def _read_model(self) -> str:
        try:
            values: tuple[object, ...] = await self._link.send_command(
                TrackerCommand.GET_TRACKER_INFO, layout="<I64s5i3d2i2dI2i"
            )
        except RefusedError:
            return "emScon tracker"
        name = values[1]
        assert isinstance(name, bytes)
        return name.decode("utf-16-le", errors="replace").split("\0")[0] or "emScon tracker"

    async def _current_condition(self) -> Condition:
        if not self._initialised:
            message = "It is not initialised"
            if self._options.initialise:
                return Condition(
                    Readiness.READY,
                    make_message("{message}; the first reading will do it, its head turns.", message=message),
                )
            return Condition(
                Readiness.NOT_READY,
                make_message("{message}.", message=message),
                status_meaning(39).remedy,
            )
        state = await self._tracker_state()
        if state in (_READY, _BUSY) or self._options.search_distance_m:
            return Condition(Readiness.READY)
        entry = status_meaning(10004)
        return Condition(Readiness.NOT_READY, entry.text, entry.remedy)

    @contextmanager
    def _exclusive_use(self, doing: str) -> Iterator[None]:
        if self._doing:
            raise BusyError(
                self.name, make_message("{doing} while it is {current}.", doing=doing, current=self._doing)
            )
        self._doing = doing
        try:
            yield
        finally:
            self._doing = ""


def _pack_double(value: float) -> bytes:
    return struct.pack("<d", value)
