"""Who is asked whether to write sees the verdict; what fails is written on an engineer's word only."""

import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest

from cellcal.calibration.geometry import Pose
from cellcal.drivers.interfaces import Answer, Instruction
from cellcal.procedures.accuracy_limits import ToolLimits
from cellcal.procedures.catalogue import CATALOGUE
from cellcal.procedures.motion.active_frames import is_same_pose
from cellcal.procedures.run import RefusalError, Run
from cellcal.service.record.journal_files import open_journal
from cellcal.service.record.run_outcome import RunVerdict
from cellcal.service.runs.journal_ledger import forget_from
from cellcal.service.runs.run_procedure import resume_procedure
from tests.procedures.certified_runs import HOW, cell_config, run_in
from tests.procedures.memory_ledgers import MemoryLedger
from tests.procedures.procedure_scenes import (
    ProcedureScene,
    moved_workpiece_scene,
    tool_pose,
    tool_touch_scene,
    user_frame_scene,
)
from tests.procedures.test_certificates import certificate_content, scatter_touches

OLD_TOOL = Pose((0.1, 0.02, 0.3), (0.0, 1.0, 0.0, 0.0))
REASON = "the customer has seen it"
STRICT = ToolLimits(tip_m=0.01, residual_m=1e-6, orientation_rad=0.1)  # a touch may be off by a micrometre


def scattering_touches() -> ProcedureScene:
    made = tool_touch_scene(max_touches=4, limits=STRICT)
    made.arm.tools[3] = OLD_TOOL
    scatter_touches(made, 0.0002)
    return made


def stray_point() -> ProcedureScene:
    made = moved_workpiece_scene()
    third = made.technician.does["touch_point_3"]

    def touch_beside() -> None:
        third()
        taught = made.arm.taught
        assert taught is not None
        x, y, z = taught.position_m
        made.arm.taught = Pose((x + 0.008, y + 0.008, z), taught.quaternion)

    made.technician.does["touch_point_3"] = touch_beside
    return made


FAILING: dict[str, tuple[Callable[[], ProcedureScene], str]] = {
    "six_point_tcp": (scattering_touches, "procedure.failed"),
    "frame_offset": (stray_point, "procedure.wrong_shape"),
}


def record_instructions(made: ProcedureScene) -> list[Instruction]:
    """Return a list that fills with all that the technician is asked."""
    instructions: list[Instruction] = []
    confirm = made.technician.confirm

    async def note_instruction(instruction: Instruction) -> Answer:
        instructions.append(instruction)
        return await confirm(instruction)

    made.technician.confirm = note_instruction  # type: ignore[method-assign]
    return instructions


async def run_procedure_of(name: str, made: ProcedureScene) -> object:
    return await CATALOGUE[name].procedure(Run(made.cell, MemoryLedger()), made.spec)


@pytest.mark.parametrize("name", sorted(FAILING))
async def test_what_fails_is_neither_offered_nor_written(name: str) -> None:
    scene, code = FAILING[name]
    made = scene()
    instructions = record_instructions(made)
    with pytest.raises(RefusalError) as refused:
        await run_procedure_of(name, made)
    assert refused.value.code == code
    assert refused.value.evidence is not None
    assert refused.value.remedy
    assert made.arm.writes == 0
    assert not [instruction.key for instruction in instructions if instruction.key.startswith("accept_")]


@pytest.mark.parametrize("name", sorted(FAILING))
async def test_an_engineer_may_order_the_write_and_that_is_recorded_twice(name: str) -> None:
    made = FAILING[name][0]()
    made.spec = replace(made.spec, write_anyway=REASON)
    instructions = record_instructions(made)
    result = await run_procedure_of(name, made)
    assert made.arm.writes == 1
    (instruction,) = [instruction for instruction in instructions if instruction.key.startswith("accept_")]
    assert "Verdict: FAIL" in instruction.text
    assert REASON in instruction.text
    judge = CATALOGUE[name].verdict
    assert judge is not None
    verdict = judge(made.spec, result)
    assert verdict.overall_decision == "fail"
    assert any(REASON in remark for remark in verdict.remarks)


@pytest.mark.parametrize(
    ("name", "scene", "word"),
    [
        ("six_point_tcp", tool_touch_scene, "PASS"),
        ("three_point_frame", user_frame_scene, "UNDECIDED"),
        ("frame_offset", moved_workpiece_scene, "PASS"),
    ],
)
async def test_the_verdict_and_its_rule_are_seen_before_the_write(
    name: str, scene: Callable[[], ProcedureScene], word: str
) -> None:
    made = scene()
    instructions = record_instructions(made)
    made.technician.does |= {
        key: lambda: seen_writes.append(made.arm.writes)
        for key in ("accept_tool", "accept_frame", "accept_offset")
    }
    seen_writes: list[int] = []
    await run_procedure_of(name, made)
    (instruction,) = [instruction for instruction in instructions if instruction.key.startswith("accept_")]
    assert f"Verdict: {word}" in instruction.text
    assert "Rule: PASS if" in instruction.text
    assert (seen_writes, made.arm.writes) == ([0], 1)


@pytest.mark.parametrize(
    ("name", "scene", "put"),
    [
        ("six_point_tcp", tool_touch_scene, lambda made: made.arm.tools.update({3: OLD_TOOL})),
        ("three_point_frame", user_frame_scene, lambda made: made.arm.frames.update({2: OLD_TOOL})),
        ("frame_offset", lambda: moved_workpiece_scene(OLD_TOOL), lambda made: None),
    ],
)
async def test_the_frame_that_was_there_stands_in_the_certificate(
    name: str, scene: Callable[[], ProcedureScene], put: Callable[[ProcedureScene], None], tmp_path: Path
) -> None:
    config, made = cell_config(tmp_path), scene()
    put(made)
    outcome = await run_in(config, made, name)
    assert outcome.verdict is RunVerdict.PASSED
    content = certificate_content(config)
    before = {change["name"]: change["before"] for change in content["verdict"]["changes"]}
    assert [before[f"origin {axis}"] for axis in "xyz"] == list(OLD_TOOL.position_m)
    after = {change["name"]: change["after"] for change in content["verdict"]["changes"]}
    assert 0.0 < after["turned by"] <= math.pi
    first = content["points"][0]
    assert first["step"].startswith("read the ")
    assert first["value"]["quaternion"] == list(OLD_TOOL.quaternion)  # read before anything was touched


async def test_a_failed_run_goes_on_from_the_doubtful_step(tmp_path: Path) -> None:
    config, made = cell_config(tmp_path), scattering_touches()
    outcome = await run_in(config, made, "six_point_tcp")
    assert outcome.verdict is not RunVerdict.PASSED
    assert "--from" in outcome.remedy
    assert made.arm.writes == 0
    made.technician.does = {key: undisturbed_touch(made, key) for key in tool_touch_scene().technician.does}
    with open_journal(config) as journal:
        forget_from(journal, outcome.run_id, "touch the pin", actor="bert")
        cell = replace(made.cell, config_sha256=config.sha256)
        assert (await resume_procedure(cell, outcome.run_id, journal, how=HOW)).verdict is RunVerdict.PASSED
    assert is_same_pose(made.arm.tools[3], tool_pose())
    assert certificate_content(config)["verdict"]["changes"][0]["before"] == OLD_TOOL.position_m[0]


def undisturbed_touch(made: ProcedureScene, key: str) -> Callable[[], None]:
    """Return hands that put the arm where those of an undisturbed scene do."""
    other = tool_touch_scene()

    def touch_undisturbed() -> None:
        other.technician.does[key]()
        made.arm.taught = other.arm.taught

    return touch_undisturbed


async def test_what_is_undecided_is_written_on_an_engineers_word_only() -> None:
    made = moved_workpiece_scene()
    made.spec = replace(made.spec, origin_u_m=1e-9)
    with pytest.raises(RefusalError) as refused:
        await run_procedure_of("frame_offset", made)
    assert refused.value.code == "procedure.undecided"
    assert made.arm.writes == 0
    made.spec = replace(made.spec, write_anyway=REASON)
    instructions = record_instructions(made)
    await run_procedure_of("frame_offset", made)
    (instruction,) = [instruction for instruction in instructions if instruction.key == "accept_offset"]
    assert "Verdict: UNDECIDED" in instruction.text
    assert REASON in instruction.text
    assert made.arm.writes == 1
