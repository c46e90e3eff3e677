"""The plan that a recovery is compared with: evenly drawn poses, as sure of the least known motor."""

import numpy as np

from cellcal.calibration.mastering.drawn_walk import drawn_walk
from cellcal.calibration.mastering.pose_design import candidate_joints, predict_turns
from cellcal.procedures.motion.lost_plans import compare_drawn
from cellcal.procedures.motion.plans import MotionBounds, motion_limits
from cellcal.procedures.steps.mastering import read_motors
from tests.procedures.procedure_scenes import healthy_scene, record_of


async def test_more_captures_of_ones_own_ask_for_more_drawn_ones() -> None:
    record, made = await record_of(healthy_scene()), healthy_scene()
    state, room = await read_motors(made.cell), MotionBounds()
    model, limits = made.arm.model, motion_limits(state, record.drive, room)
    hook = record.wire_lengths()[1].hook_in_flange_m
    here = np.zeros(6)
    own = candidate_joints(model, limits, 24, seed=11, hook_in_flange_m=hook)
    few, many = (drawn_walk(model, record, limits, here, own[:count]) for count in (8, 24))
    assert few.drawn_captures is not None
    assert many.drawn_captures is not None
    assert 4 <= few.drawn_captures <= 16  # one's own are evenly drawn, too: about as many
    assert 16 <= many.drawn_captures <= 36
    assert few.drawn_travel_rad < many.drawn_travel_rad
    assert many.travel_rad > few.travel_rad > 0.0
    worst = predict_turns(model, record, own[:8])[1].max()
    assert predict_turns(model, record, own)[1].max() < worst

    walked = tuple(tuple(float(q) for q in row) for row in own[:8])
    assert compare_drawn(record, state, room, walked) is not None
    assert compare_drawn(record, state, room, ()) is None  # a memory alone was lost: there is no walk
