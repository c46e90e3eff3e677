"""Conducting a run: the journal, the lease, the header, and what each end is called."""

import asyncio
import fcntl
import json
import threading
from dataclasses import replace
from pathlib import Path

import pytest

from cellcal.drivers.errors import LOOK_FIRST, MotionStoppedError, UnreachableError
from cellcal.procedures.progress import StepProgress
from cellcal.procedures.run import NeedsUnmetError, ReplayMismatchError
from cellcal.procedures.run_history import EventKind
from cellcal.procedures.three_point_frame import FrameSetup
from cellcal.service.record.journal import Journal, StoreError
from cellcal.service.record.robot_lock import LeaseHeldError, acquire_lease, runs_under_way
from cellcal.service.record.run_outcome import RunVerdict
from cellcal.service.record.run_store import RunStore
from cellcal.service.runs.journal_ledger import forget_from
from cellcal.service.runs.run_procedure import RunConditions, resume_procedure, run_procedure
from tests.procedures.procedure_scenes import (
    ProcedureScene,
    recording_scene,
    recovery_scene,
    tool_touch_scene,
    user_frame_scene,
)

NAME = "three_point_frame"
HOW = RunConditions(free_bytes=0, actor="anna")


@pytest.fixture
def journal(tmp_path: Path):
    with Journal.open_file(tmp_path / "journal.db") as opened:
        yield opened


async def _start_interrupted(made: ProcedureScene, journal: Journal) -> str:
    """Start a run that the technician declines to finish."""
    made.technician.refuses = {"accept_frame"}
    outcome = await run_procedure(made.cell, NAME, made.spec, journal, how=HOW)
    assert outcome.verdict is RunVerdict.DECLINED
    made.technician.refuses = set()
    return outcome.run_id


async def test_a_passed_run_returns_its_result_and_keeps_it(journal: Journal) -> None:
    made = user_frame_scene()
    outcome = await run_procedure(made.cell, NAME, made.spec, journal, how=HOW)
    assert outcome.verdict is RunVerdict.PASSED
    assert isinstance(outcome.result, FrameSetup)
    view = RunStore(journal).find_run(outcome.run_id)
    assert (view.state, view.procedure, view.version) == ("passed", NAME, 3)
    stored_results = RunStore(journal).list_stored("user_frame", "F-1")
    assert [fact["subject"] for fact in stored_results] == ["2"]
    assert {event.actor for event in journal.list_events()} == {"anna"}


async def test_a_passed_run_is_answered_from_the_journal(journal: Journal) -> None:
    made = user_frame_scene()
    outcome = await run_procedure(made.cell, NAME, made.spec, journal, how=HOW)
    instruction_count, events = len(made.technician.instructions), len(journal.list_events())
    again = await resume_procedure(made.cell, outcome.run_id, journal, how=HOW)
    assert again == outcome
    assert (len(made.technician.instructions), len(journal.list_events())) == (instruction_count, events)


async def test_a_declined_run_is_resumed_without_touching_again(journal: Journal) -> None:
    made = user_frame_scene()
    run_id = await _start_interrupted(made, journal)
    made.technician.instructions.clear()
    outcome = await resume_procedure(made.cell, run_id, journal, how=HOW)
    assert outcome.verdict is RunVerdict.PASSED
    assert made.technician.instructions == ["pointer_is_mounted", "accept_frame", "may_move"]
    assert RunStore(journal).find_run(run_id).state == "passed"


@pytest.mark.parametrize(("answers", "begins"), [(False, LOOK_FIRST), (True, "Check the cable.")])
async def test_a_link_lost_in_mid_move_ends_with_what_is_not_known_of_the_arm(
    journal: Journal, monkeypatch: pytest.MonkeyPatch, answers: bool, begins: str
) -> None:
    made = recording_scene()

    lost = UnreachableError("arm", "the connection was lost.", remedy="Check the cable.")

    async def cannot_stop() -> None:
        raise lost

    def in_mid_move(count: int) -> None:
        if count == 3:
            raise lost

    made.arm.midway = in_mid_move
    made.technician.refuses = {"retry"}
    if not answers:
        monkeypatch.setattr(made.arm, "stop", cannot_stop)
    outcome = await run_procedure(made.cell, "mastering_record", made.spec, journal, how=HOW)
    assert (outcome.verdict, outcome.code) == (RunVerdict.CELL_FAILED, "device.unreachable")
    assert outcome.remedy.startswith(begins)
    assert outcome.remedy.endswith("Check the cable.")
    monkeypatch.undo()
    made.arm.midway, made.technician.refuses = None, set()
    moves = len(made.arm.moves)
    again = await resume_procedure(made.cell, outcome.run_id, journal, how=HOW)
    assert again.verdict is RunVerdict.PASSED
    assert "may_move" in made.technician.instructions  # a person has looked before it moves
    assert len(made.arm.moves) > moves


async def test_a_redo_touches_again_from_that_step(journal: Journal) -> None:
    made = user_frame_scene()
    run_id = await _start_interrupted(made, journal)
    forget_from(journal, run_id, "touch a point on the y side")
    made.technician.instructions.clear()
    outcome = await resume_procedure(made.cell, run_id, journal, how=HOW)
    assert outcome.verdict is RunVerdict.PASSED
    assert made.technician.instructions[1:3] == ["touch_on_xy", "touch_above"]
    with pytest.raises(StoreError, match="no finding"):
        forget_from(journal, run_id, "touch the moon")


@pytest.mark.parametrize("difference", ["robot", "settings", "cell", "epoch", "gauge"])
async def test_a_run_is_not_continued_on_another_cell(journal: Journal, difference: str) -> None:
    made = user_frame_scene()
    run_id = await _start_interrupted(made, journal)
    if difference == "robot":
        made.arm.serial = "F-2"
    if difference == "settings":
        made.cell = replace(made.cell, config_sha256="other")
    if difference == "cell":
        made.cell = replace(made.cell, name="other")
    if difference == "epoch":
        made.arm.epoch += 1
    if difference == "gauge":
        made.wire.serial = "W-2"
    events = len(journal.list_events())
    with pytest.raises(ReplayMismatchError, match="cannot be continued"):
        await resume_procedure(made.cell, run_id, journal, how=HOW)
    assert len(journal.list_events()) == events


async def test_a_recovery_may_go_on_after_the_power_cycle_it_asked_for(journal: Journal) -> None:
    made = await recovery_scene()
    made.technician.refuses = {"accept_plan"}
    outcome = await run_procedure(made.cell, "mastering_recovery", made.spec, journal, how=HOW)
    assert outcome.verdict is RunVerdict.DECLINED  # two power cycles after its header was written
    made.technician.refuses = set()
    assert (await resume_procedure(made.cell, outcome.run_id, journal, how=HOW)).verdict is RunVerdict.PASSED


async def test_a_stored_record_serves_the_next_run(journal: Journal) -> None:
    made = recording_scene()
    outcome = await run_procedure(made.cell, "mastering_record", made.spec, journal, how=HOW)
    store = RunStore(journal)
    record = store.mastering_record("F-1")
    assert record == outcome.result.record
    assert store.mastering_record("F-2") is None
    store.put_mastering_record(replace(record, robot_serial="F-2"), actor="anna")
    imported = store.mastering_record("F-2")
    assert imported is not None
    assert imported.captures == record.captures


async def test_the_ends_have_their_names(journal: Journal) -> None:
    made = tool_touch_scene()
    made.spec = replace(made.spec, rms_limit_m=-1.0)
    outcome = await run_procedure(made.cell, "six_point_tcp", made.spec, journal, how=HOW)
    assert (outcome.verdict, outcome.code) == (RunVerdict.OUT_OF_TOLERANCE, "procedure.out_of_tolerance")

    made = await recovery_scene()
    made.cell = replace(made.cell, record=None)
    outcome = await run_procedure(made.cell, "mastering_recovery", made.spec, journal, how=HOW)
    assert (outcome.verdict, outcome.code) == (RunVerdict.REFUSED, "procedure.no_record")
    assert outcome.remedy

    made = recording_scene()

    async def raise_stopped(*_: object, **__: object) -> None:
        raise MotionStoppedError("arm", "emergency stop", remedy="Release it.")

    made.arm.move_joints = raise_stopped  # type: ignore[method-assign]
    outcome = await run_procedure(made.cell, "mastering_record", made.spec, journal, how=HOW)
    assert (outcome.verdict, outcome.code) == (RunVerdict.CELL_FAILED, "device.stopped")
    assert [view.state for view in RunStore(journal).list_runs()] == [
        "out_of_tolerance",
        "refused",
        "cell_failed",
    ]


async def test_a_refusal_carries_its_evidence_into_the_journal(journal: Journal) -> None:
    made = await recovery_scene()
    made.wire.anchor_in_base_m = (0.93, -0.69, -0.44)
    outcome = await run_procedure(made.cell, "mastering_recovery", made.spec, journal, how=HOW)
    assert (outcome.verdict, outcome.result.mode) == (RunVerdict.REFUSED, "geometry")
    assert RunStore(journal).find_run(outcome.run_id).result["mode"] == "geometry"


async def test_a_cancelled_run_says_so_and_can_be_resumed(journal: Journal) -> None:
    made = user_frame_scene()

    def cancel_at_step(progress: StepProgress) -> None:
        if progress.kind == "asked" and progress.step == "touch a point on x":
            task.cancel()

    how = replace(HOW, on_event=cancel_at_step)
    task = asyncio.create_task(run_procedure(made.cell, NAME, made.spec, journal, how=how))
    with pytest.raises(asyncio.CancelledError):
        await task
    (view,) = RunStore(journal).list_runs()
    assert view.state == "cancelled"
    assert made.arm.stops == 1
    assert (await resume_procedure(made.cell, view.run_id, journal, how=HOW)).verdict is RunVerdict.PASSED


async def test_one_robot_takes_one_run_at_a_time(journal: Journal) -> None:
    made = user_frame_scene()
    with (
        acquire_lease(journal.path.parent / "leases", "F-1", "bert"),
        pytest.raises(LeaseHeldError, match="bert"),
    ):
        await run_procedure(made.cell, NAME, made.spec, journal, how=HOW)
    assert journal.list_events() == []
    assert (await run_procedure(made.cell, NAME, made.spec, journal, how=HOW)).verdict is RunVerdict.PASSED


async def test_a_run_of_another_process_is_seen_to_go_on_and_no_reader_is_in_its_way(
    journal: Journal,
) -> None:
    made, leases, states = user_frame_scene(), journal.path.parent / "leases", []

    def look(_progress: StepProgress) -> None:
        (view,) = RunStore(journal).list_runs()
        states.append(view.state_seen(runs_under_way(leases)))

    await run_procedure(made.cell, NAME, made.spec, journal, how=replace(HOW, on_event=look))
    assert "running" in states
    (view,) = RunStore(journal).list_runs()
    assert view.state_seen(runs_under_way(leases)) == "passed"
    assert runs_under_way(leases) == frozenset()
    with acquire_lease(leases, "F-1", "anna (run-1)"), acquire_lease(leases, "F-2", "bert (run (2))"):
        assert runs_under_way(leases) == {"run-1"}  # no run is called so
    looked = threading.Event()
    with (leases / "F-1.lock").open() as descriptor:
        fcntl.flock(descriptor, fcntl.LOCK_SH)  # a reader looks just now
        threading.Timer(0.02, lambda: (fcntl.flock(descriptor, fcntl.LOCK_UN), looked.set())).start()
        with acquire_lease(leases, "F-1", "anna (run-3)"):
            assert runs_under_way(leases) == {"run-3"}
        looked.wait()


async def test_a_cell_that_lacks_something_starts_nothing(journal: Journal) -> None:
    made = user_frame_scene()
    with pytest.raises(NeedsUnmetError):
        await run_procedure(replace(made.cell, user_frames=None), NAME, made.spec, journal, how=HOW)
    assert journal.list_events() == []


async def test_a_listener_that_fails_stops_nothing(
    journal: Journal, caplog: pytest.LogCaptureFixture
) -> None:
    made = user_frame_scene()

    def fail_listener(_: StepProgress) -> None:
        raise ValueError("screen")

    how = replace(HOW, on_event=fail_listener)
    outcome = await run_procedure(made.cell, NAME, made.spec, journal, how=how)
    assert outcome.verdict is RunVerdict.PASSED
    assert "a listener failed" in caplog.text


async def test_a_disk_that_fills_up_ends_the_run_with_the_points_safe(journal: Journal) -> None:
    made = user_frame_scene()

    def fill_disk() -> None:
        pages = journal._database.execute("PRAGMA page_count").fetchall()[0][0]
        journal._database.execute(f"PRAGMA max_page_count={pages}").fetchall()

    touch = made.technician.does["touch_on_xy"]
    made.technician.does["touch_on_xy"] = lambda: (touch(), fill_disk())
    outcome = await run_procedure(made.cell, NAME, made.spec, journal, how=HOW)
    assert (outcome.verdict, outcome.code) == (RunVerdict.CELL_FAILED, "store.full")
    assert "points are safe" in outcome.reason
    journal.close()
    made.technician.does["touch_on_xy"] = touch
    with Journal.open_file(journal.path) as reopened:
        (view,) = RunStore(reopened).list_runs()
        assert view.state == "interrupted"
        finished = await resume_procedure(made.cell, view.run_id, reopened, how=HOW)
    assert finished.verdict is RunVerdict.PASSED


async def test_a_full_disk_starts_no_run(journal: Journal) -> None:
    made = user_frame_scene()
    with pytest.raises(StoreError, match="MB"):
        await run_procedure(made.cell, NAME, made.spec, journal, how=replace(HOW, free_bytes=10**18))
    assert journal.list_events() == []


async def test_the_header_says_what_was_run_where(journal: Journal) -> None:
    made = user_frame_scene()
    outcome = await run_procedure(made.cell, NAME, made.spec, journal, how=HOW)
    first = journal.list_events(outcome.run_id)[0]
    header = json.loads(first.body)
    assert first.kind == EventKind.STARTED
    assert header["cell"]["encoder_epoch"] == 3
    assert [mark["identity"]["serial"] for mark in header["cell"]["devices"]] == ["F-1", "W-1", "T-1"]
    assert header["cell"]["config_sha256"] == "c0ffee"
    assert header["spec"]["frame_number"] == 2
    assert header["software"]
