"""[[tracker]] driver = "laser_tracker" in cell.toml. The model is the factory."""

from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from typing import Literal

from pydantic import BaseModel, ConfigDict, Field

from cellcal.drivers.interfaces import TrackerCapabilities
from cellcal.drivers.laser_tracker.link import EmsconLink
from cellcal.drivers.laser_tracker.readings import TrackerLimits
from cellcal.drivers.laser_tracker.tracker import LaserTracker, TrackerOptions
from cellcal.drivers.wire.device_connection import connection_to


class LaserTrackerConfig(BaseModel):
    """How to reach a tracker's emScon server, where it stands, and how good it is."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    driver: Literal["laser_tracker"]
    name: str = Field(min_length=1, max_length=64)
    address: str = Field(min_length=1)
    port: int = Field(default=700, ge=1, le=65535)
    serial: int = Field(ge=0, lt=2**31)
    station: int = Field(default=1, ge=1)
    sigma_m: float = Field(default=15e-6, ge=1e-7, le=0.01)
    sigma_per_m: float = Field(default=6e-6, ge=0, le=1e-3)
    sigma_rad: float = Field(default=5e-5, ge=1e-7, le=0.1)
    range_m: float = Field(default=40.0, gt=0, le=500)
    steady_m: float = Field(default=5e-4, gt=0, le=0.1)
    measures_poses: bool = False
    reflector: int | None = None
    search_distance_m: float = Field(default=0.0, ge=0, le=500)
    initialise: bool = True
    deadline_s: float = Field(default=2.0, gt=0, le=60)
    measure_deadline_s: float = Field(default=15.0, gt=0, le=600)
    initialise_deadline_s: float = Field(default=180.0, gt=0, le=1800)

    @property
    def capabilities(self) -> TrackerCapabilities:
        """The instrument's capabilities, known before it is reached."""
        return TrackerCapabilities(
            self.measures_poses, self.range_m, self.sigma_m, self.sigma_per_m, self.sigma_rad
        )

    @asynccontextmanager
    async def open(self) -> AsyncIterator[LaserTracker]:
        """Connect, check the serial number, and disconnect at the end."""
        link = EmsconLink(self.name, self.address, self.port, self.deadline_s)
        tracker = LaserTracker(link, self._tracker_options())
        async with connection_to(tracker):
            yield tracker

    def _tracker_options(self) -> TrackerOptions:
        limits = TrackerLimits(self.range_m, self.sigma_m, self.sigma_per_m, self.sigma_rad, self.steady_m)
        return TrackerOptions(
            self.serial,
            self.station,
            self.reflector,
            self.search_distance_m,
            self.initialise,
            self.measures_poses,
            self.measure_deadline_s,
            self.initialise_deadline_s,
            limits,
        )
