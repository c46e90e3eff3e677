"""Instruments that measure places: laser trackers and cameras."""

from dataclasses import dataclass
from typing import Protocol

from cellcal.calibration.geometry import Pose
from cellcal.drivers.interfaces.device import Device


@dataclass(frozen=True, slots=True)
class TrackerCapabilities:
    """The capabilities of a device that measures places."""

    measures_poses: bool
    range_m: float  # farthest target it is used for
    sigma_m: float  # of one coordinate close by
    sigma_per_m: float = 0.0  # what each metre of distance adds to it
    sigma_rad: float = 0.0  # of one angle, where poses are measured
    typed: bool = False  # by a person, when a run asks for it


@dataclass(frozen=True, slots=True)
class Air:
    """The air that the light went through, as the device knows it."""

    temperature_c: float
    pressure_pa: float
    humidity_percent: float


@dataclass(frozen=True, slots=True)
class PointReading:
    """One point in the device's own frame.

    ``station`` counts where the device stands: another station is another frame, and readings of two stations
    are never used together as if they were of one.
    """

    position_m: tuple[float, float, float]
    sigma_m: tuple[float, float, float]  # standard uncertainty per axis
    taken_at_s: float  # host monotonic clock
    station: int
    air: Air | None = None
    covariance_m2: tuple[float, float, float] = (0.0, 0.0, 0.0)  # between x and y, x and z, y and z
    raw: str = ""  # hex of the wire form, or the text a person gave


@dataclass(frozen=True, slots=True)
class PoseReading:
    """One pose of a probe in the device's own frame; ``station`` as for a point."""

    station_probe: Pose
    sigma_m: tuple[float, float, float]
    sigma_rad: tuple[float, float, float]  # about the station's x, y, z
    taken_at_s: float  # host monotonic clock
    station: int
    air: Air | None = None
    raw: str = ""


class Tracker(Device, Protocol):
    """A laser tracker, or whatever measures places. Each sentence is a test in tests/wire/contract_tracker.py.

    A reading is fresh: taken after the call began. It is in metres in the frame of its station, finite, with its
    uncertainty. A device that was moved gives no reading under the old station's number. A second measurement
    during one raises BusyError at once. A cancelled measurement leaves the device usable.
    """

    @property
    def capabilities(self) -> TrackerCapabilities: ...
    async def measure_point(self) -> PointReading: ...


class MeasuresPoses(Protocol):
    """Trackers with capabilities.measures_poses."""

    async def measure_pose(self) -> PoseReading: ...
