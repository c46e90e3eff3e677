"""A serial number that a damaged answer spoilt is no other robot; one that is told again is."""

import asyncio
from contextlib import asynccontextmanager
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from cellcal.drivers.errors import WrongDeviceError
from cellcal.service.watching import follow
from cellcal.service.watching.follow import RobotListener, follow_robot
from cellcal.service.watching.watch import PositionLoss


class ScriptedRobot:
    """A robot whose connections end in what the script says; then the watch is ended."""

    def __init__(self, *serials: str) -> None:
        self.name, self.serial = "arm", "F-1"
        self._serials = list(serials)

    @asynccontextmanager
    async def open(self) -> Any:
        if not self._serials:
            raise asyncio.CancelledError
        raise WrongDeviceError("arm", f"the robot has the serial number {self._serials.pop(0)}.")
        yield


@pytest.mark.parametrize(
    ("serials", "losses"),
    [(["F-9"], 0), (["F-9", "F-4", "F-9"], 0), (["F-9", "F-9"], 1), (["F-9", "F-9", "F-9", "F-9"], 1)],
)
async def test_another_serial_number_is_a_loss_once_it_is_told_twice(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, serials: list[str], losses: int
) -> None:
    monkeypatch.setattr(follow, "_RETRY_S", 0.0)
    found: list[PositionLoss] = []
    lines: list[str] = []

    async def on_loss(loss: PositionLoss) -> None:
        found.append(loss)

    config = SimpleNamespace(cell=SimpleNamespace(data_dir=tmp_path), watch=SimpleNamespace(period_s=0.1))
    watches: Any = SimpleNamespace(config=config, on_loss=on_loss)
    with pytest.raises(asyncio.CancelledError):
        await follow_robot(watches, ScriptedRobot(*serials), RobotListener(lines.append))
    assert len(found) == losses
    assert lines  # each suspicion is named at once
