"""A mastering that was written and not confirmed is put back, or it is shown that it is in force."""

import asyncio
import json
from collections.abc import Awaitable, Callable
from dataclasses import replace
from pathlib import Path

import pytest

from cellcal.drivers.errors import MotionStoppedError, UnreachableError
from cellcal.drivers.interfaces import MasteringData
from cellcal.procedures.mastering_undo import MasteringUndo
from cellcal.procedures.motion.motion_gate import OffTargetError
from cellcal.procedures.progress import StepProgress
from cellcal.procedures.run_history import EventKind
from cellcal.service.cli.runs import runs, show
from cellcal.service.configuration.cell_file import CellConfig
from cellcal.service.record.journal_files import open_journal
from cellcal.service.record.run_outcome import RunOutcome, RunVerdict
from cellcal.service.record.run_store import RunStore
from cellcal.service.record.unconfirmed_mastering import (
    UnconfirmedMasteringError,
    unconfirmed_in_force,
    unconfirmed_masterings,
)
from cellcal.service.runs import mastering_rollback as put_back
from cellcal.service.runs.run_procedure import RunConditions, resume_procedure, run_procedure
from tests.procedures.certified_runs import HOW, cell_config
from tests.procedures.ideal_devices import IdealArm
from tests.procedures.procedure_scenes import ProcedureScene, calibration_scene, recovery_scene

SERIAL = "F-1"


@pytest.fixture(autouse=True)
def _no_pause(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(put_back, "PAUSE_S", 0.0)


class _ArmWithEvent(IdealArm):
    """An ideal arm to which something happens on its first way after a mastering was written."""

    happens: Callable[[], Awaitable[None]] | None = None
    deaf = False

    async def _travel_by(self, delta: object, name: str) -> None:
        if self.data.mastered and name == "move" and self.happens is not None:
            happens, self.happens = self.happens, None
            await happens()
        await super()._travel_by(delta, name)  # type: ignore[arg-type]

    async def read_mastering(self) -> MasteringData:
        self._check_reachable()
        return await super().read_mastering()

    async def restore_mastering(self, data: MasteringData) -> MasteringData:
        self._check_reachable()
        return await super().restore_mastering(data)

    async def write_mastering(self, counts_at_zero: tuple[int, ...]) -> MasteringData:
        self._check_reachable()
        return await super().write_mastering(counts_at_zero)

    async def stop(self) -> None:
        self._check_reachable()
        await super().stop()

    def _check_reachable(self) -> None:
        if self.deaf:
            raise UnreachableError(self.name, "it does not answer", remedy="Look at the cable.")


async def _scene_with_event() -> tuple[ProcedureScene, _ArmWithEvent]:
    made = await recovery_scene()
    made.arm.__class__ = _ArmWithEvent
    arm = made.arm
    assert isinstance(arm, _ArmWithEvent)
    made.technician.refuses = {"retry"}
    return made, arm


async def _start_run(
    config: CellConfig, made: ProcedureScene, name: str = "mastering_recovery", how: RunConditions = HOW
) -> RunOutcome:
    with open_journal(config) as journal:
        cell = RunStore(journal).with_history(replace(made.cell, config_sha256=config.sha256), SERIAL)
        spec = made.spec if name == "mastering_recovery" else MasteringUndo()
        return await run_procedure(replace(cell, record=made.cell.record), name, spec, journal, how=how)


async def _go_on(config: CellConfig, made: ProcedureScene, run_id: str) -> RunOutcome:
    with open_journal(config) as journal:
        return await resume_procedure(
            replace(made.cell, config_sha256=config.sha256), run_id, journal, how=HOW
        )


def _pending_runs(config: CellConfig) -> tuple[str, ...]:
    with open_journal(config) as journal:
        return tuple(one.of_run for one in unconfirmed_masterings(journal.list_events(), SERIAL))


def _only_run(config: CellConfig) -> str:
    with open_journal(config) as journal:
        return RunStore(journal).list_runs()[-1].run_id


async def _stands_off() -> None:
    raise OffTargetError("axis 1 ended 2.000 deg from its target")


async def _emergency_stop() -> None:
    raise MotionStoppedError("arm", "emergency stop", remedy="Release it.")


@pytest.mark.parametrize("happens", [_stands_off, _emergency_stop])
async def test_a_failure_after_the_write_puts_the_old_data_back_and_a_resume_ends_alike(
    tmp_path: Path, happens: Callable[[], Awaitable[None]]
) -> None:
    config = cell_config(tmp_path)
    made, arm = await _scene_with_event()
    before, arm.happens = arm.data, happens
    ended = await _start_run(config, made)
    assert ended.verdict is RunVerdict.CELL_FAILED or ended.verdict is RunVerdict.REFUSED
    assert arm.data == before
    assert "the old data were put back" in ended.remedy
    assert _pending_runs(config) == ()
    again = await _go_on(config, made, ended.run_id)
    assert again.verdict is RunVerdict.PASSED
    assert arm.data == MasteringData(_zero_as_counted(arm), mastered=True)
    assert _pending_runs(config) == ()


async def test_a_cancel_after_the_write_puts_the_old_data_back(tmp_path: Path) -> None:
    config = cell_config(tmp_path)
    made, arm = await _scene_with_event()
    before = arm.data

    def on_event(progress: StepProgress) -> None:
        if progress.kind == "started" and progress.step == "go to final check 1":
            task.cancel()
            task.cancel()

    task = asyncio.create_task(_start_run(config, made, how=replace(HOW, on_event=on_event)))
    with pytest.raises(asyncio.CancelledError):
        await task
    assert arm.data == before
    with open_journal(config) as journal:
        run_id = _only_run(config)
        kinds = [event.kind for event in journal.list_events(run_id)]
        assert kinds[-2:] == [EventKind.UNDONE, EventKind.ENDED]
        assert journal.list_events(run_id)[-1].body.count("the old data were put back") == 1
    assert (await _go_on(config, made, run_id)).verdict is RunVerdict.PASSED


async def test_a_no_before_the_confirmation_puts_the_old_data_back_also_after_a_crash(tmp_path: Path) -> None:
    config = cell_config(tmp_path)
    made, arm = await _scene_with_event()
    before = arm.data
    run_id = await _killed_after_the_write(config, made, arm)
    assert arm.data != before
    assert _pending_runs(config) == (run_id,)
    made.technician.refuses = {"may_move"}
    declined = await _go_on(config, made, run_id)
    assert (declined.verdict, arm.data) == (RunVerdict.DECLINED, before)
    assert _pending_runs(config) == ()


async def test_a_crash_between_write_and_confirmation_is_confirmed_by_the_resume(tmp_path: Path) -> None:
    config = cell_config(tmp_path)
    made, arm = await _scene_with_event()
    run_id = await _killed_after_the_write(config, made, arm)
    writes = arm.writes
    passed = await _go_on(config, made, run_id)
    assert (passed.verdict, arm.writes) == (RunVerdict.PASSED, writes)
    assert _pending_runs(config) == ()


async def test_while_it_is_unconfirmed_nothing_else_starts_by_it_until_it_is_undone(tmp_path: Path) -> None:
    config = cell_config(tmp_path)
    made, arm = await _scene_with_event()
    before = arm.data
    run_id = await _killed_after_the_write(config, made, arm)
    other = calibration_scene()
    other.cell = replace(other.cell, robot=arm, mastering=arm)
    cell = replace(other.cell, config_sha256=config.sha256)
    with open_journal(config) as journal:
        with pytest.raises(UnconfirmedMasteringError, match=run_id):
            await run_procedure(cell, "robot_calibration", other.spec, journal, how=HOW)
        assert len(RunStore(journal).list_runs()) == 1
    assert (await _start_run(config, made, "mastering_undo")).verdict is RunVerdict.PASSED
    assert arm.data == before
    assert _pending_runs(config) == ()


async def test_the_list_of_runs_says_which_mastering_is_not_confirmed(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    config = cell_config(tmp_path)
    made, arm = await _scene_with_event()
    run_id = await _killed_after_the_write(config, made, arm)
    assert runs(cell=config.path) == 0
    assert f"the mastering that {run_id} wrote is not confirmed" in " ".join(capsys.readouterr().out.split())
    assert show(run_id, cell=config.path, as_json=True) == 0
    assert json.loads(capsys.readouterr().out)["unconfirmed"] is True
    assert (await _go_on(config, made, run_id)).verdict is RunVerdict.PASSED
    assert runs(cell=config.path, as_json=True) == 0
    assert json.loads(capsys.readouterr().out)["unconfirmed"] == []


async def test_an_unreachable_robot_is_reported_and_journalled_and_put_right_later(tmp_path: Path) -> None:
    config = cell_config(tmp_path)
    made, arm = await _scene_with_event()
    before = arm.data

    async def link_lost() -> None:
        arm.deaf = True
        arm._check_reachable()

    arm.happens = link_lost
    ended = await _start_run(config, made)
    assert ended.verdict is RunVerdict.CELL_FAILED
    assert "NOT confirmed" in ended.remedy
    assert arm.data != before
    assert _pending_runs(config) == (ended.run_id,)
    with open_journal(config) as journal:
        assert [e.kind for e in journal.list_events(ended.run_id)][-3:] == [
            EventKind.INTENT,
            EventKind.FAILED,
            EventKind.ENDED,
        ]
    arm.deaf = False
    assert (await _go_on(config, made, ended.run_id)).verdict is RunVerdict.PASSED
    assert _pending_runs(config) == ()


async def test_what_another_hand_mastered_meanwhile_is_left_alone(tmp_path: Path) -> None:
    config = cell_config(tmp_path)
    made, arm = await _scene_with_event()
    by_hand = MasteringData(tuple(count + 77 for count in arm.data.counts_at_zero), mastered=True)

    async def master_elsewhere() -> None:
        arm.data = by_hand
        await _stands_off()

    arm.happens = master_elsewhere
    ended = await _start_run(config, made)
    assert arm.data == by_hand
    assert "NOT confirmed" in ended.remedy
    changed = await _go_on(config, made, ended.run_id)
    assert (changed.code, arm.data) == ("procedure.mastering_changed", by_hand)
    with open_journal(config) as journal:  # and no reason for a refusal: it is not in force
        assert await unconfirmed_in_force(made.cell, journal.list_events(), SERIAL) is None


def _zero_as_counted(arm: IdealArm) -> tuple[int, ...]:
    lost = zip(arm.true_zero, arm.lost_turns, arm.drive.counts_per_turn, strict=True)
    return tuple(zero - turns * per_turn for zero, turns, per_turn in lost)


async def _killed_after_the_write(config: CellConfig, made: ProcedureScene, arm: _ArmWithEvent) -> str:
    """Run until the first way after the write, and lose the process there: its clean-up does not happen."""

    class _KilledError(BaseException):
        pass

    async def raise_killed() -> None:
        raise _KilledError

    arm.happens = raise_killed
    with pytest.raises(_KilledError):
        await _start_run(config, made)
    return _only_run(config)
