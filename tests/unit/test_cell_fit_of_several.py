"""Several targets, devices and robots in one fit: what that shows, what stays hidden, and what must not matter."""

from dataclasses import replace

import numpy as np
import pytest

from cellcal.calibration.arm.kinematics import DhTable, RobotModel
from cellcal.calibration.cells.cell import (
    CalibrationCell,
    CellDevice,
    CellRobot,
    CellSeries,
    CellTarget,
    CellTool,
)
from cellcal.calibration.cells.frame_priors import FramePrior
from cellcal.calibration.cells.identify import fit_cell
from cellcal.calibration.cells.levels import CellOptions, group_cell_rows
from cellcal.calibration.cells.prediction import frame_between, target_positions, tip_covariance
from cellcal.calibration.cells.state import CellFrames
from cellcal.calibration.geometry import (
    exp_rotation,
    exp_twist,
    homogeneous_matrix,
    inverse_transform,
    log_transform,
)
from cellcal.calibration.identification.parameters import (
    FRAMES,
    GEOMETRY,
    OFFSETS,
    ArmState,
    Priors,
    nominal_state,
)
from tests.unit.helpers.simulated_arm import random_joints
from tests.unit.helpers.simulated_cell import REFLECTORS, TOOL, TRACKER, SimulatedWorld

ANCHOR, OTHER_ANCHOR = np.array([0.9, -0.7, -0.4]), np.array([-0.8, 0.9, 0.1])
PLANE = homogeneous_matrix(exp_rotation(np.array([0.1, -0.05, 0.0])), np.array([0.5, 0.2, 0.1]))
MATE = exp_twist(np.array([1.8, 0.4, 0.1, 0.02, -0.01, 2.0]))
BALL, PIN = np.array([0.4, 0.5, 0.3]), np.array([0.6, 0.3, 0.2])
BARE = CellOptions(level=GEOMETRY, judge=False)
OFFSETS_ONLY = CellOptions(level=OFFSETS, judge=False)


def one_arm(world, series, devices, *, tool=None, targets=(), **robot):
    return CalibrationCell(
        [CellRobot("arm", world.model, **robot)], [CellTool("tip", "arm", tool)], devices, series, targets
    )


def reflector_rows(world, count=30):
    targets = [CellTarget(f"smr {i}", "tip", FramePrior.from_point(at)) for i, at in enumerate(REFLECTORS)]
    series = [
        CellSeries(f"rows {i}", "tracker", f"smr {i}", world.point_rows(count, offset=at))
        for i, at in enumerate(REFLECTORS)
    ]
    return targets, series


def unknown_names(found):
    return {item.parameter: item for item in found.not_identified}


def squared_mahalanobis(found):
    """Return d' C^-1 d of a small motion between a found frame and the truth."""
    error, covariance = found
    return float(error @ np.linalg.solve(covariance, error))


def test_three_reflectors_of_known_places_give_the_whole_tool_frame():
    distances = []
    for seed in range(4):
        world = SimulatedWorld(seed=seed, perfect=True)
        targets, series = reflector_rows(world)
        found = fit_cell(
            one_arm(world, series, [CellDevice("tracker")], targets=targets),
            CellOptions(level=FRAMES, judge=False),
        )
        fit = found.robust.fit
        rows = [i for i, p in enumerate(fit.layout.parameters) if p.role == "tool"]
        assert len(rows) == 6
        error = log_transform(inverse_transform(TOOL) @ found.state.places[1])
        assert np.abs(error[:3]).max() < 1e-4
        assert np.abs(error[3:]).max() < 1e-3
        distances.append(squared_mahalanobis((error, fit.covariance[np.ix_(rows, rows)])))
        assert not any(name.startswith("tool") for name in unknown_names(found))
    assert 2.0 < np.mean(distances) < 12.0  # six are expected


def test_one_reflector_gives_a_place_and_the_rest_is_named():
    world = SimulatedWorld(seed=2)
    cell = one_arm(
        world,
        [CellSeries("rows", "tracker", "tip", world.point_rows(50))],
        [CellDevice("tracker")],
        tool=FramePrior.without_prior(),
    )
    lost = unknown_names(fit_cell(cell, BARE))
    assert {"tool rx", "tool ry", "tool rz"} <= set(lost)
    assert not {"tool x", "tool y", "tool z"} & set(lost)
    assert "three targets" in lost["tool rx"].cure


def test_independent_points_of_one_flange_are_found_each():
    world = SimulatedWorld(seed=3)
    tools = [CellTool(f"point {i}", "arm") for i in range(3)]
    series = [
        CellSeries(f"rows {i}", "tracker", f"point {i}", world.point_rows(25, offset=at))
        for i, at in enumerate(REFLECTORS)
    ]
    cell = CalibrationCell([CellRobot("arm", world.model)], tools, [CellDevice("tracker")], series)
    found = fit_cell(cell, BARE)
    joints = world.draw_joints(50)
    for i, at in enumerate(REFLECTORS):
        place = target_positions(found.robust.fit, f"point {i}", joints, seen_from="tracker")
        truth = (inverse_transform(TRACKER) @ world.flange_frames(joints, at))[:, :3, 3]
        assert np.sqrt(np.mean((place - truth) ** 2)) < 5e-5


def test_two_robots_that_one_tracker_sees_know_where_they_stand():
    distances = []
    for seed in range(5):
        arm, mate = SimulatedWorld(seed=seed), SimulatedWorld("abb_irb120", seed=seed + 50, base=MATE)
        cell = CalibrationCell(
            [CellRobot("arm", arm.model), CellRobot("mate", mate.model)],
            [CellTool("tip", "arm"), CellTool("probe", "mate")],
            [CellDevice("tracker")],
            [
                CellSeries("one", "tracker", "tip", arm.point_rows(60)),
                CellSeries("two", "tracker", "probe", mate.point_rows(60)),
            ],
        )
        found = fit_cell(cell, BARE)
        between = frame_between(found.robust.fit, "arm", "mate")
        distances.append(
            squared_mahalanobis((log_transform(inverse_transform(between.pose) @ MATE), between.covariance))
        )
        back = frame_between(found.robust.fit, "mate", "arm")
        assert np.allclose(back.pose @ between.pose, np.eye(4), atol=1e-12)
        lost = unknown_names(found)
        assert "tracker" in lost["arm J1 offset"].partner
        assert "about z of the base of arm" in lost["arm J1 offset"].partner
        assert "base frame" in lost["mate J1 offset"].cure
        tracked = target_positions(found.robust.fit, "probe", mate.draw_joints(30), seen_from="tracker")
        assert np.isfinite(tracked).all()
    # Errors drawn are smaller than the priors of J1 expect.
    assert 0.1 < np.mean(distances) / 6 < 1.8


def test_two_robots_that_touch_the_same_pins_know_where_they_stand():
    pins = np.array([[0.9, 0.2, 0.3], [0.9, -0.3, 0.4], [1.0, 0.1, 0.7], [0.8, 0.3, 0.6]])
    opposite = homogeneous_matrix(exp_rotation(np.array([0.0, 0.0, 2.8])), np.array([1.5, 0.2, 0.1]))
    arm, mate = SimulatedWorld(seed=3, perfect=True), SimulatedWorld(seed=4, base=opposite, perfect=True)
    series = [
        CellSeries(f"{name} {i}", f"pin {i}", target, world.at_pin(pin, 6))
        for name, target, world in (("arm", "tip", arm), ("mate", "probe", mate))
        for i, pin in enumerate(pins)
    ]
    cell = CalibrationCell(
        [CellRobot("arm", arm.model), CellRobot("mate", mate.model)],
        [CellTool("tip", "arm"), CellTool("probe", "mate")],
        [CellDevice(f"pin {i}") for i in range(len(pins))],
        series,
    )
    found = fit_cell(cell, CellOptions(level=FRAMES, judge=False))
    between = frame_between(found.robust.fit, "arm", "mate")
    error = log_transform(inverse_transform(between.pose) @ opposite)
    assert np.abs(error[:3]).max() < 1e-3
    assert squared_mahalanobis((error, between.covariance)) < 20


def test_the_world_may_be_the_tracker_s_frame():
    world = SimulatedWorld(seed=14, base=inverse_transform(TRACKER))
    cell = one_arm(
        world,
        [CellSeries("rows", "tracker", "tip", world.point_rows(50, device=np.eye(4)))],
        [CellDevice("tracker", (FramePrior.from_pose(np.eye(4)),))],
        base=FramePrior.without_prior(),
    )
    found = fit_cell(cell, BARE)
    joints = world.draw_joints(40)
    places = target_positions(found.robust.fit, "tip", joints, seen_from="")
    assert np.sqrt(np.mean((places - world.tip_positions(joints)) ** 2)) < 5e-5


def test_an_anchor_recorded_in_the_base_shows_j1():
    world = SimulatedWorld(seed=4)
    points = CellSeries("rows", "tracker", "tip", world.point_rows(60))
    nest = CellSeries("nest", "nest", "tip", world.at_pin(PIN, 10))
    without = fit_cell(one_arm(world, [points], [CellDevice("tracker")]), OFFSETS_ONLY)
    assert "rotation of device 'tracker' about z of the base" in unknown_names(without)["J1 offset"].partner
    recorded = CellDevice("nest", (FramePrior.from_point(PIN, 5e-5),))
    found = fit_cell(one_arm(world, [points, nest], [CellDevice("tracker"), recorded]), OFFSETS_ONLY)
    assert "J1 offset" not in unknown_names(found)
    joints = world.draw_joints(20)
    loose = np.trace(tip_covariance(without.robust.fit, "tip", joints), axis1=1, axis2=2)
    tied = np.trace(tip_covariance(found.robust.fit, "tip", joints), axis1=1, axis2=2)
    assert (tied < 0.1 * loose).all()


def test_a_target_on_the_last_axis_hides_j6():
    on_axis = SimulatedWorld(seed=5, tool=homogeneous_matrix(np.eye(3), np.array([0.0, 0.0, 0.15])))
    off_axis = SimulatedWorld(seed=5)
    for world, hidden in ((on_axis, True), (off_axis, False)):
        cell = one_arm(
            world,
            [CellSeries("rows", "tracker", "tip", world.point_rows(60))],
            [CellDevice("tracker", (FramePrior.from_pose(TRACKER),))],
            tool=FramePrior.from_pose(world.tool),
        )
        lost = unknown_names(fit_cell(cell, OFFSETS_ONLY))
        assert ("J6 offset" in lost) == hidden
        assert "J1 offset" not in lost
    free_tool = replace(cell, tools=[CellTool("tip", "arm")])
    lost = unknown_names(fit_cell(free_tool, OFFSETS_ONLY))
    assert lost["J6 offset"].partner.startswith("place of the tool")
    assert "target off the last axis" in lost["J6 offset"].cure


def test_plane_ball_bar_wires_and_tracker_in_one_fit_predict_better_than_any_alone():
    world = SimulatedWorld(seed=6)
    series = [
        CellSeries("points", "tracker", "tip", world.point_rows(25)),
        CellSeries("one", "one", "tip", world.length_rows(ANCHOR, 30)),
        CellSeries("two", "two", "tip", world.length_rows(OTHER_ANCHOR, 30)),
        CellSeries("plane", "plane", "tip", world.at_plane(PLANE, 25)),
        CellSeries("ball", "ball", "tip", world.at_sphere(BALL, 0.3, 25)),
        CellSeries("pin", "pin", "tip", world.at_pin(PIN, 12)),
        CellSeries("bar", "bar", "tip", world.bar_rows(count=30)),
    ]
    devices = [
        CellDevice("tracker", (FramePrior.from_pose(TRACKER, 1e-5, 1e-5),)),
        *(CellDevice(name) for name in ("one", "two", "plane", "ball", "pin", "bar")),
    ]
    joints = world.draw_joints(100)
    sizes = []
    for some in (series[:1], series):
        found = fit_cell(
            one_arm(world, some, [d for d in devices if d.name in {s.device for s in some}]), BARE
        )
        error = target_positions(found.robust.fit, "tip", joints) - world.tip_positions(joints)
        covariance = tip_covariance(found.robust.fit, "tip", joints)
        sizes.append(np.sqrt(np.trace(covariance, axis1=1, axis2=2).mean()))
        assert np.sqrt(np.mean(np.sum(error**2, axis=1))) < 2 * sizes[-1]
    assert sizes[1] < 0.7 * sizes[0]
    assert all(result.scale[0] == pytest.approx(1.0, abs=0.45) for result in found.robust.series)


def test_an_arm_that_was_known_before_needs_few_points_for_new_offsets():
    world = SimulatedWorld(seed=8)
    earlier = ArmState(world.model, world.errors, (), np.zeros(0), np.eye(4), ())
    world.real = world.real.with_dh_errors(np.array([[0, 0, 0, 0, 0], [0.02, 0, 0, 0, 0], *[[0] * 5] * 4]))
    cell = one_arm(
        world,
        [CellSeries("rows", "tracker", "tip", world.point_rows(7))],
        [CellDevice("tracker", (FramePrior.from_pose(TRACKER),))],
        tool=FramePrior.from_pose(world.tool),
        previous=earlier,
    )
    wide = Priors(offset_rad=0.1)
    found = fit_cell(cell, CellOptions(level=GEOMETRY, judge=False, free=("offsets",), priors=wide))
    moved = found.state.arms[0].geometry - world.errors
    assert {p.name for p in found.robust.fit.layout.parameters} == {f"J{i} offset" for i in range(1, 7)}
    assert moved[1, 0] == pytest.approx(0.02, abs=2e-4)
    assert np.abs(moved[:, 1:]).max() == 0.0


def test_the_level_is_chosen_by_rows_of_all_series_and_judged_without_them():
    world = SimulatedWorld(seed=9)
    series = [
        CellSeries("points", "tracker", "tip", world.point_rows(24)),
        CellSeries("pulled", "wire", "tip", world.length_rows(ANCHOR, 24)),
        CellSeries("pin", "pin", "tip", world.at_pin(PIN, 4)),
    ]
    cell = one_arm(world, series, [CellDevice("tracker"), CellDevice("wire"), CellDevice("pin")])
    found = fit_cell(cell, CellOptions(folds=3))
    assert found.level >= GEOMETRY
    points, pulled, pin = found.series
    assert points.after_errors.n == pulled.after_errors.n == 24
    assert pin.after_errors.n == 0  # too short to spare a row
    assert points.before_errors.rmse_m > 5 * points.after_errors.rmse_m
    assert points.after_errors.rmse_m > points.fit_errors.rmse_m


def test_series_at_the_same_stops_are_held_out_together():
    world = SimulatedWorld(seed=10)
    points = world.point_rows(30)
    lengths = world.length_rows(ANCHOR, 30)
    lengths = replace(lengths, joints_rad=points.joints_rad)
    cell = one_arm(
        world,
        [CellSeries("points", "tracker", "tip", points), CellSeries("pulled", "wire", "tip", lengths)],
        [CellDevice("tracker"), CellDevice("wire")],
    )
    groups = group_cell_rows(CellFrames.from_cell(cell))
    assert (groups[:30] == groups[30:]).all()


def test_rows_that_go_together_widen_what_is_stated():
    world = SimulatedWorld(seed=15)
    points = world.point_rows(60)
    stops = np.arange(60) // 6
    shared = 2e-4 * np.random.default_rng(2).standard_normal((10, 3))[stops]
    sizes = []
    for drift in (0.0, 1.0):
        drifting = replace(points, positions_m=points.positions_m + drift * shared)
        series = CellSeries("rows", "tracker", "tip", drifting, groups=stops)
        found = fit_cell(
            one_arm(world, [series], [CellDevice("tracker", (FramePrior.from_pose(TRACKER),))]), BARE
        )
        sizes.append(found.robust.degrees_of_freedom)
        assert bool(found.group_effects) == bool(drift)
    assert found.group_effects[0].startswith("rows: residuals go together")
    assert sizes[1] < 0.5 * sizes[0]


def mixed_cell(world, frame=None, *, order=None, mirrored=False):
    """Return a mixed cell with everything seen from another world, rows and series in another order."""
    frame = np.eye(4) if frame is None else frame
    points, lengths, pin = world.point_rows(40), world.length_rows(ANCHOR, 40), world.at_pin(PIN, 8)
    order = np.arange(40) if order is None else order
    # A pin's axes are those of the world: what the tip missed it by turns with the world.
    pin = replace(pin, positions_m=pin.positions_m @ frame[:3, :3].T)
    series = [
        CellSeries("points", "tracker", "tip", points.select_rows(order), groups=order // 4),
        CellSeries("pulled", "wire", "tip", lengths.select_rows(order), groups=20 + order // 4),
        CellSeries("pin", "pin", "tip", pin, groups=np.full(8, 50)),
    ]
    pin_there = frame[:3, :3] @ PIN + frame[:3, 3]
    return one_arm(
        world,
        series[::-1] if mirrored else series,
        [
            CellDevice("tracker"),
            CellDevice("wire"),
            CellDevice("pin", (FramePrior.from_point(pin_there, 1e-4),)),
        ],
        base=FramePrior.from_pose(frame),
    )


@pytest.mark.parametrize("change", ["world", "order"])
def test_neither_world_nor_order_of_rows_and_series_matters(change):
    usual = fit_cell(mixed_cell(SimulatedWorld(seed=21)), BARE)
    turn = exp_twist(np.array([3.0, -2.0, 1.0, 0.5, 2.0, -1.0]))
    order = np.random.default_rng(1).permutation(40)
    other = (
        mixed_cell(SimulatedWorld(seed=21), turn)
        if change == "world"
        else mixed_cell(SimulatedWorld(seed=21), order=order, mirrored=True)
    )
    found = fit_cell(other, BARE)
    joints = np.random.default_rng(2).uniform(-1.5, 1.5, (30, 6))
    first, second = (target_positions(f.robust.fit, "tip", joints) for f in (usual, found))
    assert np.abs(first - second).max() < 1e-7
    spreads = [tip_covariance(f.robust.fit, "tip", joints) for f in (usual, found)]
    assert np.allclose(*spreads, rtol=1e-3, atol=1e-13)


def test_the_unit_of_length_does_not_matter():
    world = SimulatedWorld(seed=12)
    joints, sigma = random_joints(world.model, np.random.default_rng(3), 40), 5e-5
    usual = mixed_cell(world)
    lengths = np.array([1.0, 1e3, 1e3, 1.0, 1.0])
    dh = DhTable.from_rows(world.model.dh.to_rows() * lengths)
    first = world.model.placements[0].copy()
    first[:3, 3] *= 1e3
    in_mm = RobotModel.from_dh(dh, base=first, name="in mm", joint_coupling=world.model.joint_coupling)
    series = []
    for each in usual.series:
        observations = each.observations
        named = {
            name: getattr(observations, name) * 1e3
            for name in ("positions_m", "lengths_m", "sigma_m")
            if hasattr(observations, name)
        }
        series.append(replace(each, observations=replace(observations, **named)))
    devices = [*usual.devices[:2], CellDevice("pin", (FramePrior.from_point(PIN * 1e3, 1e-4 * 1e3),))]
    usual_priors = Priors()
    priors = Priors(
        length_m=usual_priors.length_m * 1e3,
        wire_zero_m=usual_priors.wire_zero_m * 1e3,
        place_m=usual_priors.place_m * 1e3,
    )
    millimetres = CalibrationCell([CellRobot("arm", in_mm)], usual.tools, devices, series)
    found = [fit_cell(usual, BARE), fit_cell(millimetres, replace(BARE, priors=priors))]
    places = [target_positions(f.robust.fit, "tip", joints) for f in found]
    assert np.abs(places[1] / 1e3 - places[0]).max() < 0.02 * sigma


def test_a_model_without_a_table_is_fitted_by_twists():
    world = SimulatedWorld(seed=13)
    bare = replace(world.model, dh=None)
    cell = CalibrationCell(
        [CellRobot("arm", bare, previous=nominal_state(bare, ()))],
        [CellTool("tip", "arm")],
        [CellDevice("tracker", (FramePrior.from_pose(TRACKER, 1e-5, 1e-5),)), CellDevice("wire")],
        [
            CellSeries("rows", "tracker", "tip", world.point_rows(60)),
            CellSeries("l", "wire", "tip", world.length_rows(ANCHOR)),
        ],
    )
    found = fit_cell(cell, BARE)
    joints = world.draw_joints(50)
    error = target_positions(found.robust.fit, "tip", joints) - world.tip_positions(joints)
    assert np.sqrt(np.mean(np.sum(error**2, axis=1))) < 1.2e-4
