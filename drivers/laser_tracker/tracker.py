"""A laser tracker behind an emScon server: points, and poses of a probe where the tracker measures them."""

import asyncio
import logging
import struct
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass

from cellcal.drivers.errors import BusyError, DeviceError, RefusedError, WrongDeviceError
from cellcal.drivers.interfaces import (
    Condition,
    Identity,
    PointReading,
    PoseReading,
    Readiness,
    TrackerCapabilities,
)
from cellcal.drivers.laser_tracker.link import EmsconLink, meaning
from cellcal.drivers.laser_tracker.packets import Change, Command, Mode, Result
from cellcal.drivers.laser_tracker.readings import Judge, Limits
from cellcal.drivers.laser_tracker.settings import Settings
from cellcal.drivers.wire.deadline import deadline

_LOG = logging.getLogger(__name__)
VERIFIED_ON: tuple[str, ...] = ()  # model:firmware this driver has run on; none yet, see README.md
_INITIALISED, _READY, _BUSY = 5, 2, 1  # ES_TrackerProcessorStatus, ES_TrackerStatus
_POLL_S = 0.1
_MOVED = {
    Change.COMPENSATION: "its compensation was changed",
    Change.STATION_ORIENTATION: "somebody gave it another station",
    Change.TRANSFORMATION: "somebody gave it another frame",
    Change.INITIALIZATION: "it was initialised again",
    Change.TILT: "its level sensor says that it was touched",
    Change.SENSOR_DETECTED: "its sensor was unplugged",
    Change.SENSOR_DISCONNECTED: "its sensor was unplugged",
    Change.SERVER_STARTED: "its controller was started again",
}
_NEW_STATION = (
    "What was measured before and after cannot be used together. Raise `station` in cell.toml and begin the "
    "measurement anew."
)


@dataclass(frozen=True, slots=True)
class TrackerOptions:
    """What the cell file says about this tracker."""

    serial: int
    station: int
    reflector: int | None
    search_distance_m: float
    initialise: bool
    measures_poses: bool
    measure_deadline_s: float
    initialise_deadline_s: float
    limits: Limits


class LaserTracker:
    """Tracker over one emScon server."""

    def __init__(self, link: EmsconLink, options: TrackerOptions) -> None:
        self._link, self._options = link, options
        self._settings = Settings(link, options.reflector)
        self._judge = Judge(link.device, options.limits)
        self._doing = ""
        self._readings = 0
        self._moved = ""
        self._marks: tuple[float, ...] | None = None
        self._initialised = False
        link.greet = self._greet
        link.on_change = self._changed

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
        """Connect, check who answers, and note a device nobody has tried yet. Moves nothing."""
        identity = await self.identify()
        if f"{identity.model}:{identity.firmware}" not in VERIFIED_ON:
            _LOG.warning("%s: not verified on %s with %s", self.name, identity.model, identity.firmware)

    async def close(self) -> None:
        """Disconnect; the tracker keeps its settings."""
        await self._link.close()

    async def identify(self) -> Identity:
        with self._alone("asking who it is"):
            await self._link.ensure()
            status = await self._status()
            model = await self._model()
        major, minor, build = (int(value) for value in status[4:7])
        return Identity("Leica Geosystems", model, str(int(status[9])), f"emScon {major}.{minor}.{build}")

    async def condition(self) -> Condition:
        if self._doing:
            return Condition(Readiness.READY, f"It is {self._doing}.")
        try:
            with self._alone("telling its condition"):
                await self._link.ensure()
                self._require_station()
                return await self._condition()
        except RefusedError as error:
            return Condition(Readiness.NOT_READY, error.message, error.remedy)
        except DeviceError as error:
            return Condition(Readiness.UNREACHABLE, error.message, error.remedy)

    async def point(self) -> PointReading:
        """Measure the reflector where it stands.

        Raises
        ------
        RefusedError
            No reflector in the beam, a target that moves, a tracker that was moved, settings that others change.
        """
        with self._alone("measuring a point"):
            found, taken_at_s = await self._measured(Mode.POINT)
            reading = self._judge.point(found, taken_at_s, self._options.station)
            self._readings += 1
        return reading

    async def pose(self) -> PoseReading:
        """Measure the probe where it stands. Raises as ``point``, and when its turn is not valid."""
        if not self._options.measures_poses:
            raise RefusedError(
                self.name,
                "this tracker measures no poses.",
                remedy="Set measures_poses = true in cell.toml where it has a camera and a probe.",
            )
        with self._alone("measuring a pose"):
            found, taken_at_s = await self._measured(Mode.PROBE)
            reading = self._judge.pose(found, taken_at_s, self._options.station)
            self._readings += 1
        return reading

    # measuring

    async def _measured(self, mode: Mode) -> tuple[Result, float]:
        await self._link.ensure()
        self._require_station()
        await self._initialise()
        await self._settings.make(mode)
        async with deadline(self.name, self._options.measure_deadline_s, "measuring"):
            await self._lock()
            found = await self._start()
        taken_at_s = time.monotonic()
        await self._settings.hold(mode)
        self._require_station()
        return found, taken_at_s

    async def _start(self) -> Result:
        """Measure, waiting while the tracker is still busy with something earlier."""
        while True:
            try:
                return await self._link.measure()
            except RefusedError as error:
                if meaning(error.vendor_code).kind != "busy":
                    raise
                await asyncio.sleep(_POLL_S)

    async def _lock(self) -> None:
        """See that the beam is on a target; look for a lost one where cell.toml allows it."""
        searched = False
        while (state := await self._tracker_state()) != _READY:
            if state != _BUSY:
                if searched or not self._options.search_distance_m:
                    raise self._link.refusal("measuring", 10004)
                await self._search()
                searched = True
            await asyncio.sleep(_POLL_S)

    async def _search(self) -> None:
        distance = self._options.search_distance_m
        seconds = self._options.measure_deadline_s
        await self._link.ask(Command.FIND_REFLECTOR, _double(distance), deadline_s=seconds)

    async def _initialise(self) -> None:
        """Initialise a sensor that has not been, before the first reading only: it gives it a new frame."""
        if self._initialised:
            return
        if not self._options.initialise or self._readings:
            raise self._link.refusal("measuring", 39)
        await self._link.ask(Command.INITIALIZE, deadline_s=self._options.initialise_deadline_s)
        if (await self._status())[1] != _INITIALISED:
            raise self._link.refusal("initialising", 39)
        self._initialised = True
        self._marks = await self._read_marks()

    # what is known about where it stands

    async def _greet(self) -> None:
        status = await self._status()
        if int(status[9]) != self._options.serial:
            raise WrongDeviceError(
                self.name,
                f"at this address is serial number {int(status[9])}, cell.toml says {self._options.serial}.",
                remedy="Check the address; change cell.toml only if the tracker was exchanged.",
            )
        self._initialised = status[1] == _INITIALISED
        await self._settings.frame_only()
        await self._settings.ask_covariances()
        marks = await self._read_marks()
        if self._readings and not self._initialised:
            self._note_moved("it was off")
        elif self._readings and marks != self._marks:
            self._note_moved("its station was changed while it was not connected")
        self._marks = marks

    async def _read_marks(self) -> tuple[float, ...]:
        """Return what changes when somebody gives the tracker a new station or a new compensation."""
        station = await self._link.ask(Command.GET_STATION_ORIENTATION, layout="<6d")
        frame = await self._link.ask(Command.GET_TRANSFORMATION, layout="<7d")
        try:
            compensation = await self._link.ask(Command.GET_COMPENSATION, layout="<i")
        except RefusedError:
            compensation = ()
        return (*station, *frame, *compensation)

    def _changed(self, code: int) -> None:
        """Hear an event; before the first reading there is nothing that could be mixed up."""
        if self._readings and code in _MOVED:
            self._note_moved(_MOVED[Change(code)])

    def _note_moved(self, why: str) -> None:
        self._moved = self._moved or why

    def _require_station(self) -> None:
        if self._moved:
            raise RefusedError(
                self.name,
                f"the tracker no longer stands in station {self._options.station}: {self._moved}.",
                remedy=_NEW_STATION,
            )

    # asking

    async def _status(self) -> tuple[float, ...]:
        return await self._link.ask(Command.GET_SYSTEM_STATUS, layout="<4I3iI2i")

    async def _tracker_state(self) -> int:
        return int((await self._link.ask(Command.GET_TRACKER_STATUS, layout="<I"))[0])

    async def _model(self) -> str:
        try:
            values: tuple[object, ...] = await self._link.ask(
                Command.GET_TRACKER_INFO, layout="<I64s5i3d2i2dI2i"
            )
        except RefusedError:
            return "emScon tracker"
        name = values[1]
        assert isinstance(name, bytes)
        return name.decode("utf-16-le", errors="replace").split("\0")[0] or "emScon tracker"

    async def _condition(self) -> Condition:
        if not self._initialised:
            told = "It is not initialised"
            if self._options.initialise:
                return Condition(Readiness.READY, f"{told}; the first reading will do it, its head turns.")
            return Condition(Readiness.NOT_READY, f"{told}.", meaning(39).remedy)
        state = await self._tracker_state()
        if state in (_READY, _BUSY) or self._options.search_distance_m:
            return Condition(Readiness.READY)
        entry = meaning(10004)
        return Condition(Readiness.NOT_READY, entry.text, entry.remedy)

    @contextmanager
    def _alone(self, doing: str) -> Iterator[None]:
        if self._doing:
            raise BusyError(self.name, f"{doing} while it is {self._doing}.")
        self._doing = doing
        try:
            yield
        finally:
            self._doing = ""


def _double(value: float) -> bytes:
    return struct.pack("<d", value)
