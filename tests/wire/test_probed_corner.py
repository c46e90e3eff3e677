"""A corner felt through real drivers and sockets, by an arm with all that a world hides: inside U of the truth."""

from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path

import numpy as np
import pytest

from cellcal.calibration.arm.kinematics import load_model
from cellcal.calibration.geometry import inverse_transform, log_transform
from cellcal.drivers.operator.scripted import ScriptedOperator
from cellcal.procedures.accuracy_limits import FrameLimits
from cellcal.procedures.cell import Cell
from cellcal.procedures.probed_frame import DEFINITION, ProbedFrame, probed_frame
from cellcal.procedures.run import Run
from cellcal.procedures.steps.contact_errors import NoContactError
from cellcal.procedures.teaching.corner_places import CornerRules
from cellcal.service.configuration.cell_file import read_cell_file
from cellcal.service.demo.fake_cell_client import FakeCellClient
from cellcal.service.runs.open_cell import open_cell
from tests.procedures.memory_ledgers import MemoryLedger
from tests.procedures.probed_corner import corner_below, pose_offset
from tests.wire.probe_cell import HOME_RAD, TIP_MM, at_a_corner, true_corner

HOME = HOME_RAD["fanuc"]
YES = {"approve_move": "yes", "probe_at_corner": "yes", "accept_plan": "yes", "accept_frame": "yes"}
COARSE = FrameLimits(0.003, 0.012)  # an arm by its drawing
QUICK = CornerRules(corner="inside", clear_m=0.02, search_way_m=0.0025, repeats=1, measure_speed_m_s=0.0015)


TIP_M = tuple(value * 1e-3 for value in TIP_MM)
DRAWN = corner_below(load_model("fanuc_m6ib"), TIP_M, HOME, height_m=0.04)
SPEC = ProbedFrame(4, pose_offset(DRAWN, (4e-4, -3e-4, 2e-4), (2e-3, -1e-3, 2e-3)), QUICK, limits=COARSE)


@asynccontextmanager
async def at_home(folder: Path) -> AsyncIterator[tuple[Cell, FakeCellClient]]:
    """Open a cell whose probe stands above the corner."""
    with at_a_corner(folder, "fanuc", DRAWN, tip_sigma_mm=0.1) as (path, fake_client):
        async with open_cell(read_cell_file(path), ScriptedOperator(YES)) as cell:
            await fake_client.send_command("clear")
            await cell.robot.move_joints(HOME, speed_rad_s=0.3)
            yield cell, fake_client


async def test_a_corner_is_felt_inside_its_uncertainty(tmp_path: Path) -> None:
    async with at_home(tmp_path) as (cell, fake_client):
        setup = await probed_frame(Run(cell, MemoryLedger()), SPEC)
        true = true_corner(await fake_client.read_truth())
        off = log_transform(inverse_transform(true) @ setup.found.base_frame.to_matrix())
        origin_u, turn_u = setup.goal.expanded_uncertainties(setup.found.covariance_matrix())
        assert np.abs(off[:3]).max() <= origin_u, (off, origin_u)
        assert np.abs(off[3:]).max() <= turn_u, (off, turn_u)
        assert origin_u < COARSE.origin_m  # stated, and not so large that anything would do
        assert DEFINITION.verdict is not None
        assert DEFINITION.verdict(SPEC, setup).overall_decision == "pass", DEFINITION.verdict(
            SPEC, setup
        ).characteristics


async def test_a_face_that_is_missing_is_reported_and_the_arm_stands(tmp_path: Path) -> None:
    async with at_home(tmp_path) as (cell, fake_client):
        await fake_client.inject_fault("stuck_open", device="probe")
        with pytest.raises(NoContactError, match="touch the z face 1: no contact within"):
            await probed_frame(Run(cell, MemoryLedger()), SPEC)
        before, after = await cell.robot.read_joints(), await cell.robot.read_joints()
        assert before.joints_rad == pytest.approx(after.joints_rad, abs=1e-6)
