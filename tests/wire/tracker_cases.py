"""A fake tracker in this process, and everything that can answer as a tracker, for the contract and the faults."""

import asyncio
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from dataclasses import dataclass
from typing import Any

import numpy as np

from cellcal.drivers.file_import.config import FileTrackerConfig
from cellcal.drivers.interfaces import Answer, Instruction, Question
from cellcal.drivers.laser_tracker.config import LaserTrackerConfig
from cellcal.fake_devices.cell import FakeCell
from cellcal.fake_devices.laser_tracker.device import FakeLaserTracker as FakeTracker
from tests.machine_speed import stretched_s

SERIAL = 390793
TIME_FACTOR = 300.0


def tracker_document(**table: Any) -> dict[str, Any]:
    """Return a cell file with nothing but a tracker, whose target stands in the robot's base frame."""
    tracker = {"name": "at", "driver": "laser_tracker", "address": "127.0.0.1", "port": 0, "serial": SERIAL}
    return {
        "tracker": [{**tracker, "measures_poses": True, **table}],
        "fake": {"seed": 5, "time_factor": TIME_FACTOR},
    }


@asynccontextmanager
async def fake_tracker(**table: Any) -> AsyncIterator[FakeTracker]:
    """Play it."""
    async with FakeCell(tracker_document(**table)) as cell:
        fake = cell.trackers[0]
        assert isinstance(fake, FakeTracker)
        yield fake


def config_for(fake: FakeTracker, **changes: Any) -> LaserTrackerConfig:
    """Return how the driver reaches it."""
    tracker_table = {
        "driver": "laser_tracker",
        "name": "at",
        "address": "127.0.0.1",
        "port": fake.server.port,
        "serial": SERIAL,
        "station": 3,
        "measures_poses": True,
        "deadline_s": stretched_s(1.0),
        "measure_deadline_s": stretched_s(3.0),
    }
    return LaserTrackerConfig.model_validate({**tracker_table, **changes})


def believed_position(fake: FakeTracker) -> np.ndarray:
    """Return where the target is in the tracker's frame."""
    return np.array(fake.true_state()["target_m"])


def off_in_sigmas(reading: Any, fake: FakeTracker) -> float:
    """Return how many of its own sigmas a reading is away from the truth, in its worst coordinate."""
    return float(
        np.abs((np.array(reading.position_m) - believed_position(fake)) / np.array(reading.sigma_m)).max()
    )


class DisplayReader:
    """A technician at an instrument whose wire is closed: looks at the truth and types it, comma and all."""

    def __init__(self, fake: FakeTracker) -> None:
        self._fake = fake
        self.instructions: list[str] = []

    async def confirm(self, instruction: Instruction) -> Answer:
        return Answer("anna", instruction.key)

    async def ask_question(self, question: Question) -> Answer:
        self.instructions.append(question.text)
        for _ in range(5):
            await asyncio.sleep(0)  # others go on while a person types
        return Answer(
            "anna", " ".join(f"{1e3 * v:.4f}".replace(".", ",") for v in believed_position(self._fake))
        )


def typed_config() -> FileTrackerConfig:
    """Return an instrument that is read by a person."""
    return FileTrackerConfig(
        driver="file_import", name="at", instrument="Vantage", serial=str(SERIAL), source="typed", unit="mm",
        sigma_m=2e-5, range_m=40.0, station=3,
    )  # fmt: skip


@dataclass(frozen=True)
class TrackerCase:
    """One way to be a tracker."""

    name: str
    open: Callable[[FakeTracker], Any]


TRACKERS = (
    TrackerCase("laser_tracker", lambda fake: config_for(fake).open()),
    TrackerCase("file_import", lambda fake: typed_config().open(DisplayReader(fake))),
)
