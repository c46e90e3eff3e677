"""A fixture and a tool, measured with the real drivers over sockets, on a cell that hides its errors."""

import json
from pathlib import Path
from typing import Any

import numpy as np

from cellcal.calibration.geometry import Pose, log_transform
from cellcal.calibration.points.alignment import read_alignments
from cellcal.service.cli.alignments import export as export_alignments
from cellcal.service.cli.alignments import show as show_alignments
from cellcal.service.configuration.cell_file import CellConfig, read_cell_file
from cellcal.service.demo.fake_cell import free_address, running_fakes, write_cell_file
from cellcal.service.demo.simulated_technician import SimulatedTechnician
from cellcal.service.record.journal import Journal
from cellcal.service.record.journal_files import open_journal
from cellcal.service.record.run_outcome import RunOutcome, RunVerdict
from cellcal.service.record.run_store import RunStore
from cellcal.service.runs.open_cell import open_cell, with_robot_history
from cellcal.service.runs.run_procedure import run_procedure
from cellcal.service.runs.settings import build_spec
from tests.chance import FAR_OUTSIDE

POINTS = [[-0.35, -0.45, 0.0], [0.35, -0.45, 0.0], [-0.35, 0.45, 0.0], [0.35, 0.45, 0.25]]
TARGETS = [[0.0, 0.0, 0.0], [0.16, 0.0, -0.05], [0.0, 0.16, -0.05]]
FURNITURE = f"""
[fake.fixture]
points_mm = {json.dumps([[1e3 * v for v in point] for point in POINTS])}
seen_from = {{ fanuc = [850.0, 0.0, -200.0, 0.0, 0.0, 0.0] }}

[fake.end_effector]
targets_mm = {json.dumps([[1e3 * v for v in point] for point in TARGETS])}
flange_tool = [0.0, 0.0, 200.0, 0.0, 0.0, 0.0]
"""
ALIGNMENT: dict[str, Any] = {
    "fixture": "table",
    "points_in_fixture_m": POINTS,
    "rough_base_fixture": {"position_m": [0.85, 0.0, -0.2]},
    "limits": {"origin_m": 0.0002, "angle_rad": 0.00035},
}
TOOL: dict[str, Any] = {
    "tool_number": 4,
    "points_in_tool_m": TARGETS,
    "rough_flange_tool": {"position_m": [0.0, 0.0, 0.2]},
}


async def _run_procedure(
    config: CellConfig, cell: Any, journal: Journal, name: str, settings: dict[str, Any]
) -> RunOutcome:
    # a technician with the pendant: the last pose of a record may lie where the assumed arm touches itself
    await cell.robot.move_joints((0.0,) * 6, speed_rad_s=0.4)
    cell_with_history = await with_robot_history(cell, journal)
    return await run_procedure(cell_with_history, name, build_spec(config, "fanuc", name, settings), journal)


def _pose_errors(found: Pose, truth: list[list[float]]) -> tuple[float, float]:
    twist = log_transform(np.linalg.inv(found.to_matrix()) @ np.array(truth))
    return float(np.linalg.norm(twist[:3])), float(np.linalg.norm(twist[3:]))


async def test_a_fixture_and_a_tool_are_found_within_their_uncertainty_over_sockets(tmp_path: Path) -> None:
    with free_address() as address:
        path = write_cell_file(tmp_path, address, seed=3, time_factor=1500.0)
    path.write_text(path.read_text(encoding="utf-8") + FURNITURE, encoding="utf-8")
    config = read_cell_file(path)
    async with running_fakes(path) as fake_client:
        with open_journal(config) as journal:
            async with open_cell(config, SimulatedTechnician(fake_client, lambda _: None), "fanuc") as cell:
                record = await _run_procedure(config, cell, journal, "mastering_record", {})
                aligned = await _run_procedure(config, cell, journal, "fixture_alignment", ALIGNMENT)
                await fake_client.inject_fault("wire_home")
                tool = await _run_procedure(config, cell, journal, "end_effector_points", TOOL)
                truth = (await fake_client.read_truth())["gauges"]["wire"]
            stored = RunStore(journal).list_alignments()
    assert (show_alignments(cell=path), export_alignments(cell=path, out=tmp_path / "table.aln")) == (0, 0)
    assert read_alignments((tmp_path / "table.aln").read_text(encoding="utf-8")) == stored
    assert [outcome.verdict for outcome in (record, aligned, tool)] == [RunVerdict.PASSED] * 3
    assert [alignment.fixture for alignment in stored] == ["table"]
    placed = aligned.result.placed
    origin_m, angle_rad = _pose_errors(placed.outer_inner, truth["fixture_in_base"])
    assert origin_m <= FAR_OUTSIDE * placed.origin_u_m
    assert angle_rad <= FAR_OUTSIDE * placed.angle_u_rad
    assert placed.origin_u_m <= 0.0002
    tip_m, turn_rad = _pose_errors(tool.result.flange_tool, truth["tool_in_flange"])
    assert tip_m <= FAR_OUTSIDE * tool.result.tip_u_m
    assert turn_rad <= FAR_OUTSIDE * tool.result.angle_u_rad
    assert tool.result.tip_u_m <= 0.0004
