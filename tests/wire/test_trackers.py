"""Runs the tracker's contract against everything that can be one."""

from collections.abc import AsyncIterator
from typing import Any

import pytest

from cellcal.fake_devices.laser_tracker.device import FakeLaserTracker as FakeTracker
from tests.wire.contract_tracker import TrackerContract
from tests.wire.tracker_cases import TRACKERS, TrackerCase, fake_tracker


@pytest.fixture
async def simulated_tracker() -> AsyncIterator[FakeTracker]:
    async with fake_tracker() as device:
        yield device


@pytest.fixture(params=TRACKERS, ids=lambda case: case.name)
async def tracker(request: pytest.FixtureRequest, simulated_tracker: FakeTracker) -> AsyncIterator[Any]:
    case: TrackerCase = request.param
    async with case.open(simulated_tracker) as device:
        yield device


class TestTrackers(TrackerContract):
    """All trackers."""
