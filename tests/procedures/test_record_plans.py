"""The plan of a mastering record, from postures at which it was once refused on a healthy robot."""

from dataclasses import replace

import pytest

from cellcal.procedures.forecast import Knowledge
from cellcal.procedures.motion.plans import plan_kit
from cellcal.procedures.recovery.mastering_forecasts import state_of
from cellcal.service.configuration.cell_file import read_cell_file
from cellcal.service.demo.fake_cell import write_cell_file
from cellcal.service.runs.run_preview import build_spec, offline_cell_with_history

NARROW = (2.67324, -0.84632, 1.10800, -0.79423, -1.31765, -1.60758)  # few straight ways lead away from here
BESIDE_THE_WIRE = (-1.69987, 2.00439, 1.36785, -2.54081, -1.67554, 1.19386)  # a leg by the flange's axis


@pytest.mark.parametrize(("stood_rad", "seed"), [(NARROW, 1006), (BESIDE_THE_WIRE, 1165)])
def test_a_record_is_planned_from_where_the_last_one_ended(tmp_path, stood_rad, seed):
    config = read_cell_file(write_cell_file(tmp_path, "127.0.0.1", seed=3, time_factor=1.0))
    cell = offline_cell_with_history(config, None)
    spec = build_spec(config, cell.robot.name, "mastering_record", {})
    knowledge = Knowledge(cell.model, cell.gauge_setup, cell.gauge.capabilities, limits=cell.limits)
    state = replace(state_of(knowledge), joints_rad=stood_rad)
    assert len(plan_kit(state, spec.room, spec.poses, seed).poses_rad) >= 24
