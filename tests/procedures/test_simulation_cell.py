"""Simulated cells through the engine: every part ends in a result, a verdict, a certificate and files."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from pydantic_core import to_jsonable_python

from cellcal.calibration.errors import CalibrationError
from cellcal.procedures.simulation_cell import (
    DEFINITION,
    CalibratedPart,
    CalibratedRobot,
    SimulationCell,
    calibrate_part,
)
from cellcal.procedures.verdict import ProcedureVerdict
from cellcal.service.certificates.certificate import issue_certificate
from cellcal.service.cli.app import run_command_line
from cellcal.service.exit_codes import ExitCode
from cellcal.service.record.run_outcome import RunVerdict as End
from tests.procedures.certified_runs import cell_config, run_in
from tests.procedures.procedure_scenes import ProcedureScene, healthy_scene
from tests.unit.helpers.tag_paths import FIXTURE_BASE, robot_tags, two_paths


def robot_scene(**more: object) -> ProcedureScene:
    tags = robot_tags()
    spec = SimulationCell("robot", tags.robot, tags.device)
    return healthy_scene(replace(spec, **more))  # type: ignore[arg-type]


def judge_part(spec: SimulationCell, found: CalibratedPart) -> ProcedureVerdict:
    assert DEFINITION.verdict is not None
    verdict: ProcedureVerdict = DEFINITION.verdict(spec, found)
    return verdict


async def test_a_robot_by_the_cells_own_model_is_certified_and_exported(tmp_path: Path) -> None:
    config, made = cell_config(tmp_path), robot_scene()
    outcome = await run_in(config, made, "simulation_cell")
    assert outcome.verdict is End.PASSED
    found = outcome.result.found
    assert isinstance(found, CalibratedRobot)
    assert found.found.model == "fanuc_m6ib"
    text = issue_certificate(config, outcome.run_id).text_path.read_text()
    assert "J1 offset: hidden behind" in " ".join(text.split())
    words = ["simulate-cell", "export", "last", "--cell", str(config.path), "--out", str(tmp_path / "out")]
    assert run_command_line(words) == ExitCode.PASS
    assert (tmp_path / "out" / "robot.urdf").read_text() == found.description
    assert made.arm.moves == []
    assert made.arm.writes == 0


async def test_a_declined_result_ends_without_one(tmp_path: Path) -> None:
    made = robot_scene()
    made.technician.refuses = {"accept_part"}
    outcome = await run_in(cell_config(tmp_path), made, "simulation_cell")
    assert outcome.verdict is not End.PASSED
    assert outcome.result is None


async def test_without_a_cell_it_is_the_same(tmp_path: Path) -> None:
    spec = replace(robot_scene().spec, model="fanuc_m6ib")
    outcome = await run_in(cell_config(tmp_path), healthy_scene(spec), "simulation_cell")
    assert to_jsonable_python(calibrate_part(spec)) == to_jsonable_python(outcome.result)
    with pytest.raises(CalibrationError, match="which robot"):
        calibrate_part(replace(spec, model=""))


def test_before_and_after_stand_in_the_verdict() -> None:
    spec = replace(robot_scene().spec, model="fanuc_m6ib")
    verdict = judge_part(spec, calibrate_part(spec))
    (change,) = [change for change in verdict.changes if change.unit == "m"]
    assert change.before is not None
    assert change.after is not None
    assert change.before > 5 * change.after
    base = SimulationCell("base", *two_paths(FIXTURE_BASE), sigma_m=1e-4)
    placed = judge_part(base, calibrate_part(base))
    assert placed.overall_decision == "pass"
    assert any("as stated" in line for line in placed.not_verified)
    assert placed.changes[0].before is None


def test_a_robot_whose_tags_show_no_error_is_not_reported_as_improved() -> None:
    tags = robot_tags()
    joints = np.array(tags.robot.joints_rad)
    random = np.random.default_rng(3)
    measured_positions = tags.model.tip_positions(joints, np.array([0.0, 0.0, 0.1])) + random.normal(
        scale=1e-4, size=(30, 3)
    )
    measured = replace(
        tags.device, positions_m=tuple((float(x), float(y), float(z)) for x, y, z in measured_positions)
    )
    spec = SimulationCell("robot", tags.robot, measured, model="fanuc_m6ib")
    found = calibrate_part(spec)
    assert isinstance(found.found, CalibratedRobot)
    better = [
        figure for figure in judge_part(spec, found).characteristics if "better than before" in figure.name
    ]
    assert (better[0].decision == "pass") == found.found.found.is_better
