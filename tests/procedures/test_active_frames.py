"""Tool, user frame and payload are those that a run began with: before each move, in each capture, after a resume."""

import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest

from cellcal.calibration.geometry import Pose
from cellcal.drivers.interfaces import ActiveFrames, Instruction, ShownExternalAxis
from cellcal.procedures.cell import Cell
from cellcal.procedures.mastering_record import MasteringRecordSpec
from cellcal.procedures.motion.active_frames import (
    FramesChangedError,
    changes_text,
    cure_text,
    frame_changes,
    unread_frames,
)
from cellcal.procedures.motion.motion_gate import JogMove, jog_axis, move_along
from cellcal.procedures.progress import StepProgress
from cellcal.procedures.run import ReplayMismatchError
from cellcal.procedures.steps.capture import capture_still
from cellcal.procedures.steps.length import capture_length
from cellcal.procedures.steps.measure_point import measure_point
from cellcal.procedures.steps.place import visit_place
from cellcal.procedures.steps.teach import teach_pose
from cellcal.procedures.steps.write import write_and_read_back
from cellcal.service.configuration.motion_config import read_motion
from cellcal.service.record.journal import Journal
from cellcal.service.record.run_outcome import RunVerdict
from cellcal.service.record.run_store import RunStore
from cellcal.service.runs.run_procedure import RunConditions, resume_procedure, run_procedure
from cellcal.service.translation import Translations
from tests.procedures.ideal_devices import IdealArm
from tests.procedures.procedure_scenes import (
    ProcedureScene,
    healthy_scene,
    tool_touch_scene,
    user_frame_scene,
)
from tests.service.source_sentences import ROOT

HERE = (0.2, 0.1, -0.3, 0.4, 0.5, -0.6)
THERE = (0.5, 0.2, -0.2, 0.4, 0.6, -0.5)
TOOL = Pose((0.01, 0.0, 0.12))
QUICK = RunConditions(free_bytes=0, actor="anna")


@pytest.fixture
def journal(tmp_path: Path) -> Iterator[Journal]:
    with Journal.open_file(tmp_path / "journal.db") as opened:
        yield opened


def standing_scene() -> ProcedureScene:
    made = healthy_scene()
    made.arm.write_program(np.array(HERE))
    return made


def switch_tool(arm: IdealArm) -> None:
    arm.active_tool = 3


def edit_tool(arm: IdealArm) -> None:
    arm.tools[1] = TOOL


def select_frame(arm: IdealArm) -> None:
    arm.user_frame = 4


def change_payload(arm: IdealArm) -> None:
    arm.payload_kg = 1.8


HAPPENINGS = [
    (switch_tool, "tool 3 is active, and not tool 1", "Select tool 1 on the pendant again, then resume."),
    (
        edit_tool,
        r"tool 1 is at x 10.000, y 0.000, z 120.000 mm .*, and not at x 0.000, y 0.000, z 0.000 mm",
        "Set tool 1",
    ),
    (
        select_frame,
        "user frame 4 is active, and not user frame 0",
        "Select user frame 0 on the pendant again",
    ),
    (
        change_payload,
        "the payload is 1.800 kg, and not 1.500 kg",
        "Set the payload to 1.500 kg on the pendant again",
    ),
]


@pytest.mark.parametrize(("happens", "says", "undo"), HAPPENINGS)
async def test_no_move_with_a_foreign_tool(happens: Callable[[IdealArm], None], says: str, undo: str) -> None:
    made = standing_scene()
    await move_along(made.cell, [THERE], 0.1)
    happens(made.arm)
    with pytest.raises(FramesChangedError, match=says) as refused:
        await move_along(made.cell, [HERE], 0.1)
    assert refused.value.remedy.startswith(undo)
    with pytest.raises(FramesChangedError, match=says):
        await jog_axis(made.cell, JogMove(2, 0.05, 0.03))
    assert made.arm.moves == ["move"]


async def test_a_switch_between_two_corners_stops_before_the_second() -> None:
    made = standing_scene()
    move = made.arm.move_joints

    async def switch_during_move(target: tuple[float, ...], *, speed_rad_s: float) -> None:
        await move(target, speed_rad_s=speed_rad_s)
        switch_tool(made.arm)

    made.arm.move_joints = switch_during_move  # type: ignore[assignment,method-assign]
    with pytest.raises(FramesChangedError):
        await move_along(made.cell, [THERE, HERE], 0.1)
    assert made.arm.moves == ["move"]


@pytest.mark.parametrize(
    "captured",
    [
        lambda cell: capture_still(cell, "here", 1, 4),
        lambda cell: capture_length(cell, "here", 1),
        lambda cell: measure_point(cell, "here"),
        lambda cell: teach_pose(cell, Instruction("touch", "Touch.")),
        lambda cell: visit_place(cell, ("seat", 0, "seat"), 1e-4, 1e-4, 4),
    ],
    ids=["wire", "length", "point", "taught", "seat"],
)
async def test_no_capture_with_a_foreign_tool(captured: Callable[[Cell], object]) -> None:
    made = standing_scene()
    await captured(made.cell)  # type: ignore[misc]
    switch_tool(made.arm)
    with pytest.raises(FramesChangedError, match="tool 3 is active, and not tool 1"):
        await captured(made.cell)  # type: ignore[misc]
    made.arm.active_tool = 1
    await captured(made.cell)  # type: ignore[misc]


async def test_our_own_write_of_the_active_tool_is_no_foreign_tool() -> None:
    made = standing_scene()
    await move_along(made.cell, [THERE], 0.1)
    await write_and_read_back(made.cell, 1, TOOL)
    await move_along(made.cell, [HERE], 0.1)
    await write_and_read_back(made.cell, 5, TOOL)  # another one than the active one
    made.arm.tools[1] = Pose((0.0, 0.0, 0.2))
    with pytest.raises(FramesChangedError):
        await move_along(made.cell, [THERE], 0.1)


async def test_a_robot_that_cannot_tell_is_moved() -> None:
    made = standing_scene()
    made.cell = replace(made.cell, frames=None)
    await move_along(made.cell, [THERE], 0.1)
    switch_tool(made.arm)
    await move_along(made.cell, [HERE], 0.1)
    assert made.arm.moves == ["move", "move"]


@dataclass
class SwitchesToolAtStep:
    """Switches the tool when a step begins, once."""

    arm: IdealArm
    step: str
    done: bool = False

    def __call__(self, progress: StepProgress) -> None:
        if not self.done and progress.kind == "started" and progress.step == self.step:
            self.done, self.arm.active_tool = True, 3


async def test_a_switch_in_a_run_is_refused_and_the_points_are_kept(journal: Journal) -> None:
    made = healthy_scene(MasteringRecordSpec(poses=16, samples=2))
    how = replace(QUICK, on_event=SwitchesToolAtStep(made.arm, "capture 5"))
    outcome = await run_procedure(made.cell, "mastering_record", made.spec, journal, how=how)
    assert outcome.verdict is RunVerdict.CELL_FAILED
    assert (outcome.code, outcome.remedy) == (
        "procedure.frames_changed",
        "Select tool 1 on the pendant again, then resume.",
    )
    findings = RunStore(journal).find_run(outcome.run_id).past.findings
    assert "capture 4" in [finding.step for finding in findings]
    with pytest.raises(ReplayMismatchError, match="tool 3 is active, and not tool 1") as refused:
        await resume_procedure(made.cell, outcome.run_id, journal, how=QUICK)
    assert refused.value.remedy == "Select tool 1 on the pendant again, then resume."
    made.arm.active_tool = 1
    passed = await resume_procedure(made.cell, outcome.run_id, journal, how=QUICK)
    assert passed.verdict is RunVerdict.PASSED
    assert RunStore(journal).find_run(outcome.run_id).past.findings[: len(findings)] == findings


async def test_what_was_active_is_taken_when_the_run_begins_not_at_its_first_move(journal: Journal) -> None:
    made = user_frame_scene()
    made.technician.does["pointer_is_mounted"] = lambda: switch_tool(made.arm)
    outcome = await run_procedure(made.cell, "three_point_frame", made.spec, journal, how=QUICK)
    assert (outcome.verdict, outcome.code) == (RunVerdict.CELL_FAILED, "procedure.frames_changed")


async def test_a_procedure_may_teach_the_active_tool_and_be_resumed_afterwards(journal: Journal) -> None:
    made = tool_touch_scene()
    made.arm.active_tool = made.spec.tool_number
    write = made.arm.write_tool_frame

    async def interrupt_write(number: int, flange_tool: Pose) -> Pose:
        await write(number, flange_tool)
        made.arm.write_tool_frame = write  # type: ignore[method-assign]
        raise FramesChangedError("the cable was cut after the write")

    made.arm.write_tool_frame = interrupt_write  # type: ignore[method-assign]
    outcome = await run_procedure(made.cell, "six_point_tcp", made.spec, journal, how=QUICK)
    assert outcome.reason == "the cable was cut after the write"
    assert (
        await resume_procedure(made.cell, outcome.run_id, journal, how=QUICK)
    ).verdict is RunVerdict.PASSED


async def test_a_run_from_before_the_robot_could_be_asked_goes_on(journal: Journal) -> None:
    made = user_frame_scene()
    made.technician.refuses = {"accept_frame"}
    blind = replace(made.cell, frames=None)
    outcome = await run_procedure(blind, "three_point_frame", made.spec, journal, how=QUICK)
    made.technician.refuses = set()
    resumed = await resume_procedure(made.cell, outcome.run_id, journal, how=QUICK)
    assert resumed.verdict is RunVerdict.PASSED


@pytest.mark.parametrize("blind", [False, True])
async def test_a_certificate_says_what_the_robot_does_not_tell(journal: Journal, blind: bool) -> None:
    made = user_frame_scene()
    made.arm.payload_kg = None
    cell = replace(made.cell, frames=None if blind else made.arm)
    outcome = await run_procedure(cell, "three_point_frame", made.spec, journal, how=QUICK)
    untold = ("the tool", "the user frame", "the payload") if blind else ("the payload",)
    expected_lines = [
        f"Whether {what} was changed on the controller during the run: this robot does not tell it."
        for what in untold
    ]
    assert [line for line in outcome.judgement["not_verified"] if "does not tell" in line] == expected_lines


def test_only_what_both_tell_is_compared() -> None:
    expected_frames = ActiveFrames(3, TOOL, 0, 1.5)
    assert (
        frame_changes(expected_frames, expected_frames)
        == frame_changes(expected_frames, ActiveFrames())
        == frame_changes(ActiveFrames(), expected_frames)
        == ()
    )
    assert frame_changes(expected_frames, replace(expected_frames, payload_kg=1.5004)) == ()
    both = frame_changes(expected_frames, ActiveFrames(5, Pose((0.0, 0.0, 0.0)), 2, 1.5))
    assert (
        changes_text(both) == "tool 5 is active, and not tool 3; user frame 2 is active, and not user frame 0"
    )
    assert cure_text(both) == (
        "Do all of this, then resume: select tool 3 on the pendant again; select user frame 0 on the pendant again."
    )
    nameless = frame_changes(
        replace(expected_frames, tool_number=None), ActiveFrames(None, Pose((0.0, 0.0, 0.1)))
    )
    assert changes_text(nameless).startswith("the active tool is at x 0.000, y 0.000, z 100.000 mm")
    assert unread_frames(expected_frames) == ()
    assert unread_frames(replace(expected_frames, tool_number=None)) == ()


async def test_no_run_begins_with_another_tool_than_the_cell_file_names(journal: Journal) -> None:
    made = user_frame_scene()
    cell = replace(made.cell, named_frames=ActiveFrames(3, payload_kg=1.5))
    with pytest.raises(
        FramesChangedError, match="the cell file names: tool 1 is active, and not tool 3"
    ) as refused:
        await run_procedure(cell, "three_point_frame", made.spec, journal, how=QUICK)
    assert refused.value.remedy == "Select tool 3 on the pendant again, then start again."
    assert journal.list_events() == []
    made.arm.active_tool = 3
    outcome = await run_procedure(cell, "three_point_frame", made.spec, journal, how=QUICK)
    assert outcome.verdict is RunVerdict.PASSED


async def test_frames_named_in_the_cell_file_must_be_reported_by_the_robot(journal: Journal) -> None:
    made = user_frame_scene()
    made.arm.payload_kg = None
    for each_cell in (made.cell, replace(made.cell, frames=None)):
        cell = replace(each_cell, named_frames=ActiveFrames(payload_kg=1.5))
        with pytest.raises(
            FramesChangedError, match=r"names payload_kg 1\.5, and this robot does not tell it"
        ):
            await run_procedure(cell, "three_point_frame", made.spec, journal, how=QUICK)


def test_the_cell_file_names_what_must_be_active() -> None:
    faults: list[tuple[str, str]] = []
    table = {"model": "fanuc_m6ib", "active": {"tool_number": 3, "user_frame_number": 0, "payload_kg": 2}}
    assert read_motion(table, "robot[0]", faults).active == ActiveFrames(3, None, 0, 2.0)
    assert read_motion({"model": "fanuc_m6ib"}, "robot[0]", faults).active == ActiveFrames()
    assert faults == []
    for bad in ({"tool": 3}, {"tool_number": -1}, {"payload_kg": float("nan")}, {"tool_number": 1.5}):
        faults.clear()
        assert (
            read_motion({"model": "fanuc_m6ib", "active": bad}, "robot[0]", faults).active == ActiveFrames()
        )
        assert [where for where, _ in faults] == [f"robot[0].active.{next(iter(bad))}"]


def test_a_rail_that_has_moved_is_a_difference_and_one_that_trembles_is_none() -> None:
    was = ActiveFrames(1, external_axes=(ShownExternalAxis("E1", 1200.0), ShownExternalAxis("E2", 0.0)))
    trembles = replace(was, external_axes=(ShownExternalAxis("E1", 1200.004), ShownExternalAxis("E2", 0.0)))
    moved = replace(was, external_axes=(ShownExternalAxis("E1", 1200.5), ShownExternalAxis("E2", 0.0)))
    assert frame_changes(was, trembles) == ()
    assert frame_changes(was, replace(was, external_axes=None)) == ()
    (change,) = frame_changes(was, moved)
    assert change[0] == "the external axis E1 stands at 1200.500, and not at 1200.000"
    assert cure_text([change]) == "Drive the external axis E1 back to 1200.000, then resume."


def test_what_differs_and_its_cure_are_told_in_the_reader_s_language() -> None:
    was = ActiveFrames(3, TOOL, 0, 1.5, (ShownExternalAxis("E1", 1200.0),))
    unnumbered = replace(was, tool_number=None)
    moved_tool = Pose((0.0, 0.0, 0.1))
    switched = [
        (was, replace(was, tool_number=5)),
        (was, replace(was, user_frame_number=2)),
        (was, replace(was, flange_tool=moved_tool)),
        (unnumbered, replace(unnumbered, flange_tool=moved_tool)),
        (was, replace(was, payload_kg=1.8)),
        (was, replace(was, external_axes=(ShownExternalAxis("E1", 1300.0),))),
        (was, replace(was, tool_number=5, user_frame_number=2, payload_kg=1.8)),
    ]
    german = Translations.read_tables("de", ROOT / "web/src/locales")
    english = re.compile(
        r"\b(the|tool|frame|payload|axis|again|then|pendant|active|resume|select|and|is)\b", re.I
    )
    for before, after in switched:
        changed = frame_changes(before, after)
        assert changed
        for text in (changes_text(changed), cure_text(changed)):
            assert english.search(text)
            assert not english.search(german.translate(text)), text
