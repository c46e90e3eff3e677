"""One look at night, over the wire: a zero that changed, and a position that was lost and is back, by their traces."""

from collections.abc import AsyncIterator
from dataclasses import replace
from errno import ENOSPC
from pathlib import Path
from typing import Any

import pytest

from cellcal.service.configuration.cell_file import CellConfig
from cellcal.service.demo.fake_cell_client import FakeCellClient
from cellcal.service.exit_codes import ExitCode
from cellcal.service.record.shown_positions import KeptPositions
from cellcal.service.watching.nightly_look import LookedAtRobot, look_at_cell, night_exit_code
from tests.wire.driver_cases import open_retrying
from tests.wire.robot_cases import ROBOTS, open_at_home

CASES = {case.name: case for case in ROBOTS.values()}
Faults = tuple[tuple[str, dict[str, Any]], ...]


class Nights:
    """Looks at one robot night after night, as a timer does; each night is a new connection."""

    def __init__(self, config: CellConfig, name: str, folder: Path) -> None:
        entries = tuple(entry for entry in config.robots if entry.name == name)
        kept = config.cell.model_copy(update={"data_dir": folder})
        self._config, self.name = replace(config, robots=entries, cell=kept), name

    def at(self, address: str) -> "Nights":
        """Return looks at another address, which keep what these keep."""
        entries = tuple(entry.model_copy(update={"address": address}) for entry in self._config.robots)
        return Nights(replace(self._config, robots=entries), self.name, self._config.cell.data_dir)

    async def look(self, *, accept: bool = False) -> LookedAtRobot:
        accepted = frozenset({self.name} if accept else ())
        (found,) = await look_at_cell(self._config, accept=accepted, report=lambda _: None)
        return found


async def heal(config: CellConfig, fake_client: FakeCellClient, name: str) -> None:
    async with open_retrying(config.robot_named(name)) as robot:
        await CASES[name].heal(fake_client, robot)


@pytest.fixture(params=["abb", "abb_7", "motoman", "kuka", "ur"])
async def nights(
    request: pytest.FixtureRequest, cell: CellConfig, fake_client: FakeCellClient, tmp_path: Path
) -> AsyncIterator[Nights]:
    """A healthy robot that was looked at twice."""
    async with open_at_home(CASES[request.param], cell, fake_client):
        pass
    found = Nights(cell, request.param, tmp_path)
    first, second = await found.look(), await found.look()
    assert (first.state, second.state) == ("not compared", "unchanged"), (first, second)
    assert "first time" in first.sentence
    yield found
    await heal(cell, fake_client, request.param)


@pytest.fixture
async def inject(nights: Nights, fake_client: FakeCellClient) -> Any:
    async def inject_all(faults: Faults) -> None:
        for fault, parameters in faults:
            await fake_client.inject_fault(fault, device=nights.name, **parameters)

    return inject_all


LOST_AND_BACK: dict[str, Faults] = {
    "abb": (("counters_lost", {"axes": "2"}), ("update_counter", {"axis": "2"})),
    "motoman": (("battery_loss", {"axes": "U"}), ("type_absolute_data", {"axis": "U"}), ("reset_alarm", {})),
}
LOST_AND_BACK["abb_7"] = LOST_AND_BACK["abb"]
ANOTHER_ZERO: dict[str, tuple[Faults, str]] = {
    "abb": ((("fine_calibrate", {"axis": "2"}),), "cal_offset 2"),
    "motoman": ((("make_home", {"axis": "U"}),), "ABSO.DAT 3"),
    "kuka": ((("mastering_angle", {"axis": "A3", "deg": 0.5}),), "$MAMES 3"),
}


@pytest.mark.parametrize("nights", ["abb", "abb_7", "motoman"], indirect=True)
async def test_a_position_that_was_lost_and_is_back_is_told_every_night_until_it_is_accepted(
    nights: Nights, inject: Any
) -> None:
    await inject(LOST_AND_BACK[nights.name])
    for _ in range(2):
        found = await nights.look()
        assert found.state == "changed", found
        assert ("20032" if "abb" in nights.name else "4107") in found.sentence
        assert night_exit_code([found]) is ExitCode.OUT_OF_TOLERANCE
    for answer in ("a person has judged this to be right", "nothing to answer"):
        found = await nights.look(accept=True)
        assert (found.state, answer in found.sentence) == ("unchanged", True), found
    assert "--accept" not in (await nights.look()).sentence


@pytest.mark.parametrize("nights", ANOTHER_ZERO, indirect=True)
async def test_another_zero_is_told_until_it_is_accepted(nights: Nights, inject: Any) -> None:
    faults, datum = ANOTHER_ZERO[nights.name]
    await inject(faults)
    for _ in range(2):
        found = await nights.look()
        assert found.state == "changed", found
        assert datum in found.sentence
    assert (await nights.look(accept=True)).state == "unchanged"


@pytest.mark.parametrize("nights", ["abb", "abb_7"], indirect=True)
async def test_a_loss_is_found_behind_a_day_of_other_entries(nights: Nights, inject: Any) -> None:
    await inject((*LOST_AND_BACK[nights.name], ("events_logged", {"count": 230})))
    assert "20032" in (await nights.look()).sentence
    await nights.look(accept=True)
    await inject((("events_logged", {"count": 130}),))
    assert (await nights.look()).state == "unchanged"


@pytest.mark.parametrize("nights", ["abb", "abb_7"], indirect=True)
async def test_a_log_that_was_cleared_is_said_once_and_what_it_holds_is_new(
    nights: Nights, inject: Any
) -> None:
    await inject((("events_logged", {"count": 3}),))
    await nights.look()
    await inject((("log_cleared", {}), ("events_logged", {"count": 2})))
    found = await nights.look()
    assert found.state == "not compared"
    assert "does not reach back" in found.sentence
    assert (await nights.look()).state == "unchanged"
    await inject((("log_cleared", {}), *LOST_AND_BACK[nights.name]))
    assert "20032" in (await nights.look()).sentence


@pytest.mark.parametrize("nights", ["abb", "motoman", "kuka"], indirect=True)
async def test_a_lost_position_is_told_as_such(nights: Nights, inject: Any) -> None:
    await inject(
        {"kuka": (("mastering_lost", {"axes": "A2"}),)}.get(nights.name) or LOST_AND_BACK[nights.name][:1]
    )
    for accept in (False, True):
        found = await nights.look(accept=accept)
        assert found.state == "position lost"
        assert ("nothing was accepted" in found.sentence) is accept
        assert night_exit_code([found]) is ExitCode.OUT_OF_TOLERANCE


@pytest.mark.parametrize("nights", ["kuka"], indirect=True)
async def test_a_loss_that_cannot_be_kept_says_so(
    nights: Nights, inject: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(*_: object) -> None:
        raise OSError(ENOSPC, "No space left on device")

    await inject((("mastering_lost", {"axes": "A2"}),))
    monkeypatch.setattr(KeptPositions, "save", refuse)
    found = await nights.look()
    assert found.state == "position lost"
    assert "what it shows cannot be kept: No space left on device" in found.sentence


async def test_a_robot_out_of_reach_is_no_change(nights: Nights) -> None:
    found = await nights.at("127.0.77.1").look()
    assert found.state == "not read"
    assert night_exit_code([found]) is ExitCode.UNREACHABLE
    assert (await nights.look()).state == "unchanged"


@pytest.fixture(params=["rmi", "any_maker"])
async def blind_nights(
    request: pytest.FixtureRequest, cell: CellConfig, fake_client: FakeCellClient, tmp_path: Path
) -> AsyncIterator[Nights]:
    """A healthy robot whose link shows nothing of its zero."""
    async with open_at_home(CASES[request.param], cell, fake_client):
        pass
    yield Nights(cell, request.param, tmp_path)
    await heal(cell, fake_client, request.param)


async def test_a_link_that_shows_no_zero_is_called_so_each_night_until_that_is_accepted(
    blind_nights: Nights,
) -> None:
    for _ in range(2):
        found = await blind_nights.look()
        assert (found.state, night_exit_code([found])) == ("not compared", ExitCode.REFUSED), found
        assert "--accept" in found.sentence
    for accept in (True, False):
        found = await blind_nights.look(accept=accept)
        assert (found.state, night_exit_code([found])) == ("nothing shown", ExitCode.PASS), found
        assert "shows nothing of its zero" in found.sentence
    found = await blind_nights.at("127.0.77.1").look()
    assert night_exit_code([found]) is ExitCode.UNREACHABLE


@pytest.mark.parametrize("blind_nights", ["rmi"], indirect=True)
async def test_a_loss_that_the_controller_shows_no_more_is_told_until_it_is_accepted(
    blind_nights: Nights, fake_client: FakeCellClient
) -> None:
    await blind_nights.look(accept=True)
    await fake_client.inject_fault("alarm", device="rmi")
    assert (await blind_nights.look()).state == "position lost"
    await fake_client.inject_fault("clear_alarms", device="rmi")
    for _ in range(2):
        found = await blind_nights.look()
        assert (found.state, night_exit_code([found])) == ("changed", ExitCode.OUT_OF_TOLERANCE), found
        assert "SRVO-062" in found.sentence
    assert (await blind_nights.look(accept=True)).state == "nothing shown"
    assert (await blind_nights.look()).state == "nothing shown"
