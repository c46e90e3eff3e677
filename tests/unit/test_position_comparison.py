"""What a controller shows of its zero against its last look: nothing that was not compared is called unchanged."""

import errno
from pathlib import Path
from typing import Any

import pytest

from cellcal.calibration.mastering.position_record import ShownValue
from cellcal.drivers.interfaces import (
    Alarm,
    AlarmKind,
    Condition,
    PositionHistory,
    Readiness,
    RobotCapabilities,
)
from cellcal.service.record.proved_cures import ProvedCure
from cellcal.service.record.shown_positions import KeptPosition, KeptPositions
from cellcal.service.watching.nightly_look import _accept_shown, _describe_look
from cellcal.service.watching.position_comparison import PositionComparison, ZeroReference

CURE = ProvedCure("r1", (ShownValue("zero", "2.5", 0, is_zero=True),))


class ShowingArm:
    """Only what the comparison asks for."""

    name = "arm"
    capabilities = RobotCapabilities(axes=1, shows_position_data=True, keeps_position_history=True)

    def __init__(self) -> None:
        self.shown: tuple[ShownValue, ...] = (ShownValue("zero", "1.50", 0, is_zero=True),)
        self.history = PositionHistory((), ("1",), is_whole=True)

    async def read_condition(self) -> Condition:
        return Condition(Readiness.READY)

    async def position_data(self) -> tuple[ShownValue, ...]:
        return self.shown

    async def position_history(self, since: tuple[str, ...]) -> PositionHistory:
        return self.history


async def look(
    arm: ShowingArm,
    folder: Path,
    serial: str = "A1",
    *,
    cure: ProvedCure | None = None,
    open_run: str = "",
    **options: Any,
) -> Any:
    comparison = PositionComparison(
        KeptPositions(folder), serial, lambda: ZeroReference(None, cure, open_run)
    )
    return await comparison.look(arm, **options)  # type: ignore[arg-type]


async def test_a_datum_that_is_not_shown_is_not_called_unchanged_and_not_forgotten(tmp_path: Path) -> None:
    arm = ShowingArm()
    assert (await look(arm, tmp_path)).compared_with == ""
    arm.shown = ()
    found = await look(arm, tmp_path)
    assert "zero" in found.gap
    arm.shown = (ShownValue("zero", "1.6", 0, is_zero=True),)
    assert "1.50, 1.6" in (await look(arm, tmp_path)).trouble[0]
    arm.shown = (ShownValue("zero", "1.500", 0, is_zero=True),)
    assert (await look(arm, tmp_path)).trouble is None


async def test_on_a_disk_that_refuses_nothing_is_called_kept_or_accepted(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(_kept: KeptPositions, _baseline: KeptPosition) -> None:
        raise OSError(errno.EROFS, "Read-only file system")

    monkeypatch.setattr(KeptPositions, "save", refuse)
    arm, memory = ShowingArm(), KeptPositions(tmp_path)
    said: list[str] = []
    comparison = PositionComparison(memory, "A1", ZeroReference, warn=said.append)
    found = await comparison.look(arm, accept=True)  # type: ignore[arg-type]
    assert (found.is_kept, found.accepted_utc, found.compared_with) == (False, "", "")
    assert said == ["arm: what it shows cannot be kept: Read-only file system."]
    state, text = _describe_look(arm, found)  # type: ignore[arg-type]
    assert (state, text) == ("not compared", "its zero was compared with nothing, and nothing is kept of it.")
    assert await _accept_shown(comparison, arm) == "--accept: nothing was accepted, for it cannot be kept."  # type: ignore[arg-type]


async def test_another_robot_is_not_compared_with_the_one_before(tmp_path: Path) -> None:
    arm = ShowingArm()
    await look(arm, tmp_path)
    arm.shown = (ShownValue("zero", "2", 0, is_zero=True),)
    found = await look(arm, tmp_path, serial="B2")
    assert (found.compared_with, found.trouble) == ("", None)


async def test_a_robot_that_shows_no_datum_is_compared_by_its_log_alone(tmp_path: Path) -> None:
    arm = ShowingArm()
    arm.shown = ()
    await look(arm, tmp_path)
    assert "log alone" in (await look(arm, tmp_path)).compared_with


async def test_only_a_lost_position_in_the_log_is_told(tmp_path: Path) -> None:
    arm = ShowingArm()
    await look(arm, tmp_path)
    for kind, is_told in ((AlarmKind.BATTERY_LOW, False), (AlarmKind.TURNS, True)):
        arm.history = PositionHistory((Alarm("7", "x", None, kind),), ("2",), is_whole=True)
        assert ((await look(arm, tmp_path)).trouble is not None) is is_told


async def test_a_cure_that_was_proved_ends_what_the_log_and_the_zero_tell(tmp_path: Path) -> None:
    arm = ShowingArm()
    await look(arm, tmp_path)
    arm.history = PositionHistory((Alarm("7", "x", None, AlarmKind.TURNS),), ("2",), is_whole=True)
    arm.shown = (ShownValue("zero", "2.5", 0, is_zero=True),)
    assert (await look(arm, tmp_path)).trouble is not None
    assert (await look(arm, tmp_path, cure=CURE)).trouble is None
    assert (await look(arm, tmp_path, cure=CURE)).trouble is not None  # the same log once more: a new loss
    arm.history = PositionHistory((), ("2",), is_whole=True)
    assert (await look(arm, tmp_path, cure=CURE)).trouble is None
    arm.shown = (ShownValue("zero", "1.5", 0, is_zero=True),)
    assert "2.5, 1.5" in (await look(arm, tmp_path, cure=CURE)).trouble[0]


async def test_what_changed_between_a_cure_and_the_first_look_is_told(tmp_path: Path) -> None:
    arm = ShowingArm()
    await look(arm, tmp_path)
    arm.shown = (ShownValue("zero", "2.6", 0, is_zero=True),)
    assert "2.5, 2.6" in (await look(arm, tmp_path, cure=CURE)).trouble[0]
    arm.shown = CURE.shown
    found = await look(arm, tmp_path, cure=CURE)
    assert (found.compared_with, found.trouble) == ("the cure r1", None)
    assert (await look(arm, tmp_path, cure=ProvedCure("r2"))).compared_with == ""


async def test_a_loss_that_was_seen_is_told_until_it_is_answered_although_nothing_shows_it(
    tmp_path: Path,
) -> None:
    arm = ShowingArm()
    alarm = Alarm("-", "not mastered", 2, AlarmKind.TURNS)
    condition = Condition(Readiness.POSITION_LOST, "not mastered: A3", alarms=(alarm,))
    for first_looks in (0, 1):
        folder = tmp_path / str(first_looks)
        folder.mkdir()
        for _ in range(first_looks):
            await look(arm, folder)
        PositionComparison(KeptPositions(folder), "A1", ZeroReference).note_loss("arm", condition)
        for _ in range(2):
            words, suspicion = (await look(arm, folder)).trouble
            assert "not mastered: A3" in words
            assert suspicion.axes == (3,)
        assert (await look(arm, folder, cure=ProvedCure("r1"))).trouble is None
        assert (await look(arm, folder, cure=ProvedCure("r1"))).trouble is None
        PositionComparison(KeptPositions(folder), "A1", ZeroReference).note_loss("arm", condition)
        assert (await look(arm, folder, accept=True)).trouble is None
        assert (await look(arm, folder)).trouble is None


async def test_a_cure_without_a_proof_is_told_until_a_person_accepts_it(tmp_path: Path) -> None:
    arm = ShowingArm()
    await look(arm, tmp_path)
    assert "r7" in (await look(arm, tmp_path, open_run="r7")).trouble[0]
    assert "r7" in (await look(arm, tmp_path, open_run="r7")).trouble[0]
    assert (await look(arm, tmp_path, open_run="r7", accept=True)).trouble is None
    assert (await look(arm, tmp_path, open_run="r7")).trouble is None
    assert "r8" in (await look(arm, tmp_path, open_run="r8")).trouble[0]


async def test_a_damaged_file_is_a_first_look(tmp_path: Path) -> None:
    arm = ShowingArm()
    await look(arm, tmp_path)
    for text in ("", "[]", '{"values": [[1]]}', "{", "null"):
        (tmp_path / "shown_position_arm.json").write_text(text)
        assert (await look(arm, tmp_path)).compared_with == ""
