"""The alarm history of a Yaskawa: what came behind the places that are known, whatever its clock did."""

import random
import struct
from types import SimpleNamespace
from typing import Any

import pytest

from cellcal.drivers.interfaces import AlarmKind
from cellcal.drivers.yaskawa.alarm_history import read_position_history
from cellcal.drivers.yaskawa.hses_frames import HsesRequest

LOST, OTHER = (4107, "OUT OF RANGE(ABSO DATA)"), (4320, "OVERLOAD(CONTINUE)")


class History:
    """A controller's list of minor alarms, newest first; the major ones are empty."""

    device, trace = "motoman", SimpleNamespace(last_received=str)

    def __init__(self) -> None:
        self.entries: list[tuple[int, str, str]] = []

    def note(self, alarm: tuple[int, str], stamp: str) -> None:
        self.entries.insert(0, (alarm[0], stamp, alarm[1]))
        del self.entries[100:]

    async def ask(self, request: HsesRequest) -> bytes:
        place = request.instance - 1001
        if not 0 <= place < len(self.entries):
            return bytes(60)
        code, stamp, text = self.entries[place]
        return struct.pack("<III16s32s", code, 0, 1, stamp.encode(), text.encode())


async def read(link: History, since: tuple[str, ...]) -> Any:
    return await read_position_history(link, since)  # type: ignore[arg-type]


@pytest.mark.parametrize("seed", range(40))
async def test_each_loss_is_found_once_though_the_clock_repeats_itself(seed: int) -> None:
    rng, link = random.Random(seed), History()
    for _ in range(rng.randrange(5)):
        link.note(rng.choice((LOST, OTHER)), "2000/01/01 00:00")
    marks = (await read(link, ())).marks
    for _ in range(12):
        added = [rng.choice((LOST, OTHER, OTHER)) for _ in range(rng.randrange(4))]
        for alarm in added:
            link.note(alarm, f"2000/01/01 00:0{rng.randrange(6)}")
        history = await read(link, marks)
        assert history.is_whole
        found = [alarm for alarm in history.alarms if alarm.kind is AlarmKind.TURNS]
        assert bool(found) or LOST not in added
        marks = history.marks


async def test_a_list_that_ran_over_is_not_whole() -> None:
    link = History()
    for minute in range(9):
        link.note(OTHER, f"2026/11/28 10:0{minute}")
    marks = (await read(link, ())).marks
    for k in range(120):
        link.note(OTHER, f"2026/11/28 1{k % 10}:{k % 60:02d}")
    assert not (await read(link, marks)).is_whole
