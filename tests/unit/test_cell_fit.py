"""One fit takes every kind of observation, and finds what was hidden within what it says it knows."""

import re
from dataclasses import replace

import numpy as np
import pytest

from cellcal.calibration.cells.cell import (
    CalibrationCell,
    CellDevice,
    CellRobot,
    CellSeries,
    CellTarget,
    CellTool,
    DeviceScalar,
)
from cellcal.calibration.cells.first_guess import first_places
from cellcal.calibration.cells.frame_priors import FramePrior
from cellcal.calibration.cells.identify import fit_cell
from cellcal.calibration.cells.levels import CellOptions
from cellcal.calibration.cells.prediction import target_positions, tip_covariance
from cellcal.calibration.cells.state import CellFrames, cell_layout
from cellcal.calibration.cells.system import CellProblem, series_residuals, whole_columns
from cellcal.calibration.geometry import exp_rotation, exp_twist, homogeneous_matrix, inverse_transform
from cellcal.calibration.identification.identify import identify_arm
from cellcal.calibration.identification.observations import with_mounting
from cellcal.calibration.identification.parameters import GEOMETRY, GRAVITY, Priors
from cellcal.calibration.identification.selection import IdentificationOptions, terms_of_level
from tests.unit.helpers.simulated_arm import tracker_points, tracker_poses, wire_lengths
from tests.unit.helpers.simulated_cell import REFLECTORS, TRACKER, SimulatedWorld, shortest_wire

ANCHOR, OTHER_ANCHOR = np.array([0.9, -0.7, -0.4]), np.array([-0.8, 0.9, 0.1])
EXIT = homogeneous_matrix(exp_rotation(np.array([0.5, 0.3, 0.0])), ANCHOR)
PLANE = homogeneous_matrix(exp_rotation(np.array([0.1, -0.05, 0.0])), np.array([0.5, 0.2, 0.1]))
BALL, PIN, OTHER_PIN = np.array([0.4, 0.5, 0.3]), np.array([0.6, 0.3, 0.2]), np.array([-0.6, 0.4, 0.3])
SURE = {"sigma_m": 1e-5, "sigma_rad": 1e-5}
ROUGH_TOOL = FramePrior.point_without_prior((0.04, -0.03, 0.11))
BARE = CellOptions(level=GEOMETRY, judge=False)


def one_arm(world, series, devices, *, tool=None, targets=(), **robot):
    return CalibrationCell(
        [CellRobot("arm", world.model, **robot)], [CellTool("tip", "arm", tool)], devices, series, targets
    )


def normalized_error(world, found, *, target="tip", offset=(0.0, 0.0, 0.0), seen_from=None, frame=None):
    """Return mean e' C^-1 e / 3 of predicted places in new postures: about one if the covariance tells the truth."""
    joints = np.random.default_rng(77).uniform(-1.8, 1.8, (80, world.model.axis_count))
    truth = inverse_transform(np.eye(4) if frame is None else frame) @ world.flange_frames(joints, offset)
    fit = found.robust.fit
    error = target_positions(fit, target, joints, seen_from=seen_from) - truth[:, :3, 3]
    covariance = tip_covariance(fit, target, joints, seen_from=seen_from)
    return float(np.mean(np.einsum("ni,nij,nj->n", error, np.linalg.inv(covariance), error)) / 3)


def whole_cell(world, other):
    """Return a cell with every kind, two robots, two mountings, a target aside, correlated rows and priors."""
    points = world.point_rows(8)
    points = with_mounting(points, np.arange(8) % 2)
    aside = CellTarget("aside", "tip", FramePrior.from_point(REFLECTORS[1], 1e-4))
    covariance = np.tile(np.diag([1.0, 4.0, 9.0]) + 0.5, (6, 1, 1)) * world.sigma_m**2
    frame_sigmas = {"sigma_m": 0.01, "sigma_rad": 0.01}
    series = [
        CellSeries("points", "tracker", "tip", points),
        CellSeries("aside", "tracker", "aside", world.point_rows(6, offset=REFLECTORS[1]), covariance),
        CellSeries("poses", "camera", "tip", world.pose_rows(6)),
        CellSeries("lengths", "wire", "aside", world.length_rows(ANCHOR, 6, offset=REFLECTORS[1])),
        CellSeries("guided", "guide", "tip", world.guided_lengths(EXIT, 0.02, 6)),
        CellSeries("plane", "plane", "tip", world.at_plane(PLANE, 6, height=0.005)),
        CellSeries("ball", "ball", "tip", world.at_sphere(BALL, 0.3, 6)),
        CellSeries("pin", "pin", "tip", world.at_pin(PIN, 6)),
        CellSeries("bar", "bar", "aside", world.bar_rows(count=6)),
        CellSeries("second", "tracker", "probe", other.point_rows(6)),
    ]
    devices = [
        CellDevice(
            "tracker", (FramePrior.without_prior(TRACKER), FramePrior.from_pose(TRACKER, **frame_sigmas))
        ),
        CellDevice("camera", (FramePrior.without_prior(TRACKER),)),
        CellDevice("wire", (FramePrior.from_point(ANCHOR, 0.01),)),
        CellDevice(
            "guide", (FramePrior.from_pose(EXIT, **frame_sigmas),), {"radius_m": DeviceScalar(0.02, 0.01)}
        ),
        CellDevice("plane", (FramePrior.without_prior(PLANE),)),
        CellDevice("ball", (FramePrior.point_without_prior(BALL),), {"radius_m": DeviceScalar(0.0, np.inf)}),
        CellDevice("pin", (FramePrior.point_without_prior(PIN),)),
        CellDevice("bar", scalars={"scale": DeviceScalar(1.0, 1e-3), "zero_m": DeviceScalar(0.0, 1e-3)}),
    ]
    robots = [
        CellRobot("arm", world.model),
        CellRobot("mate", other.model, FramePrior.without_prior(other.base)),
    ]
    tools = [
        CellTool("tip", "arm", FramePrior.without_prior(world.tool)),
        CellTool("probe", "mate", FramePrior.without_prior()),
    ]
    return CalibrationCell(robots, tools, devices, series, [aside])


def test_derivatives_by_every_unknown_agree_with_finite_differences():
    world = SimulatedWorld(seed=3, exact=True)
    other = SimulatedWorld(
        "abb_irb120", seed=4, exact=True, base=exp_twist(np.array([1.8, 0.4, 0.1, 0.0, 0.0, 2.0]))
    )
    frames = CellFrames.from_cell(whole_cell(world, other))
    wide = np.linspace(-1, 1, 60)[:, None]
    terms = [terms_of_level(w.model, wide * np.ones(w.model.axis_count), GRAVITY) for w in (world, other)]
    layout = cell_layout(frames, GRAVITY, terms, Priors())
    rng = np.random.default_rng(0)
    start = replace(layout.expected, places=first_places(frames))
    state = layout.apply_step(
        start, 2e-3 * rng.standard_normal(len(layout)) * np.minimum(layout.prior_sigmas, 1.0)
    )
    problem, step = CellProblem.from_frames(frames, state), 1e-6
    for series in problem.series:
        columns, residuals = whole_columns(layout, state, series)
        assert np.allclose(residuals, series_residuals(series, state))
        slopes = np.empty_like(columns)
        for i, change in enumerate(step * np.eye(len(layout))):
            back, there = (
                series_residuals(series, layout.apply_step(state, sign * change)) for sign in (-1, 1)
            )
            slopes[i] = (back - there) / (2 * step)
        # Attitudes are off by milliradians, so that their rotation vectors do not turn quite one to one.
        near = 2e-2 if series.observations.kind == "pose" else 2e-5
        assert np.abs(columns - slopes).max() < near * np.abs(slopes).max(), series.name
        assert np.abs(slopes).max() > 0


def test_the_prior_of_a_turned_place_is_differentiated_exactly():
    world = SimulatedWorld(seed=3, exact=True)
    device = CellDevice("tracker", (FramePrior.from_pose(TRACKER, 0.1, 0.5),))
    frames = CellFrames.from_cell(
        one_arm(world, [CellSeries("points", "tracker", "tip", world.point_rows(6))], [device])
    )
    layout = cell_layout(frames, GEOMETRY, [()], Priors())
    start = replace(layout.expected, places=first_places(frames))
    away = np.random.default_rng(1).standard_normal(len(layout)) * np.minimum(layout.prior_sigmas, 0.5)
    state = layout.apply_step(start, away)
    _, gradient, cost = layout.prior_equations(state)
    for i, change in enumerate(1e-6 * np.eye(len(layout))):
        there = layout.prior_equations(layout.apply_step(state, change))[2]
        back = layout.prior_equations(layout.apply_step(state, -change))[2]
        assert (there - back) / 2e-6 * layout.prior_sigmas[i] / -2 == pytest.approx(
            gradient[i], abs=1e-4 * (1 + cost)
        )


@pytest.mark.parametrize("simulate", [tracker_points, tracker_poses, wire_lengths])
def test_a_cell_of_one_series_is_what_identify_says(simulate):
    simulated = simulate(count=60)
    options = IdentificationOptions(level=GEOMETRY, judge=False, find_breaks=False)
    alone = identify_arm(simulated.model, simulated.observations, options=options)
    cell = CalibrationCell(
        [CellRobot("arm", simulated.model)],
        [CellTool("tip", "arm")],
        [CellDevice("it")],
        [CellSeries("rows", "it", "tip", simulated.observations)],
    )
    found = fit_cell(cell, BARE)
    fits = found.robust.fit, alone.robust.fit
    names, others = ([p.name for p in fit.layout.parameters] for fit in fits)
    wider = []
    for name in (name for name in names if name.startswith("J")):
        mine, theirs = names.index(name), others.index(name)
        first, second = (np.sqrt(fit.covariance[i, i]) for fit, i in zip(fits, (mine, theirs), strict=True))
        wider.append(first / second)
        assert abs(fits[0].deviations[mine] - fits[1].deviations[theirs]) < 0.01 * second
    # Rows of one group may widen all that the data tell, and never what the priors do.
    assert max(wider) < 1.01
    tight_ratios = [ratio for ratio in wider if ratio < 0.99]
    assert not tight_ratios or min(tight_ratios) > 0.8
    assert {u.parameter for u in found.not_identified if u.parameter.startswith("J")} == {
        u.parameter for u in alone.not_identified if u.parameter.startswith("J")
    }


def test_a_cell_of_one_series_chooses_the_level_that_identify_chooses():
    simulated = tracker_points(count=60)
    alone = identify_arm(
        simulated.model, simulated.observations, options=IdentificationOptions(judge=False, find_breaks=False)
    )
    cell = CalibrationCell(
        [CellRobot("arm", simulated.model)],
        [CellTool("tip", "arm")],
        [CellDevice("it")],
        [CellSeries("rows", "it", "tip", simulated.observations)],
    )
    found = fit_cell(cell, CellOptions(judge=False))
    assert found.level == alone.level
    level_lines = [
        [float(word) for word in re.findall(r"[0-9.]+(?= mm)", " ".join(r))]
        for r in hidden_reasons(found, alone)
    ]
    assert level_lines[0] == pytest.approx(level_lines[1], rel=0.02, abs=0.002)


def hidden_reasons(*found):
    return [each.level_reasons for each in found]


def cells_by_kind(world):
    """Return, by name, a cell of each kind with places known well enough to find the arm in its base."""
    device_prior = FramePrior.from_pose(TRACKER, **SURE)
    wires = [
        CellDevice(n, (FramePrior.from_point(a, 1e-5),)) for n, a in (("one", ANCHOR), ("two", OTHER_ANCHOR))
    ]
    second = CellSeries("two", "two", "tip", world.length_rows(OTHER_ANCHOR, 70, zero=4e-4, scale=1.0003))
    pins = [CellDevice(n, (FramePrior.from_point(p, 1e-5),)) for n, p in (("one", PIN), ("two", OTHER_PIN))]
    return {
        "points": lambda: (
            [CellSeries("s", "d", "tip", world.point_rows(60))],
            [CellDevice("d", (device_prior,))],
        ),
        "poses": lambda: (
            [CellSeries("s", "d", "tip", world.pose_rows(40))],
            [CellDevice("d", (device_prior,))],
        ),
        "two wires": lambda: (
            [CellSeries("one", "one", "tip", world.length_rows(ANCHOR, 70)), second],
            wires,
        ),
        "guided wire": lambda: (
            [CellSeries("s", "d", "tip", world.guided_lengths(EXIT, 0.01, 80)), second],
            [
                CellDevice("d", (FramePrior.from_pose(EXIT, **SURE),), {"radius_m": DeviceScalar(0.0, 0.05)}),
                *wires[1:],
            ],
        ),
        "pins": lambda: (
            [
                CellSeries("one", "one", "tip", world.at_pin(PIN, 14)),
                CellSeries("two", "two", "tip", world.at_pin(OTHER_PIN, 14)),
                CellSeries("new", "new", "tip", world.at_pin(BALL, 14)),
            ],
            [*pins, CellDevice("new")],
        ),
        "plane, ball and bar": lambda: (
            [
                CellSeries("plane", "plane", "tip", world.at_plane(PLANE, 50)),
                CellSeries("ball", "ball", "tip", world.at_sphere(BALL, 0.3, 50)),
                CellSeries("bar", "bar", "tip", world.bar_rows(count=60)),
            ],
            [
                CellDevice("plane", (FramePrior.from_pose(PLANE, **SURE),)),
                CellDevice("ball"),
                CellDevice("bar"),
            ],
        ),
    }


@pytest.mark.parametrize(
    "kind", ["points", "poses", "two wires", "guided wire", "pins", "plane, ball and bar"]
)
def test_each_kind_finds_the_arm_within_its_uncertainty(kind):
    surprises = []
    for seed in (1, 2, 3):
        world = SimulatedWorld(seed=seed)
        series, devices = cells_by_kind(world)[kind]()
        tool = ROUGH_TOOL if kind.startswith("plane") else None
        found = fit_cell(one_arm(world, series, devices, tool=tool), BARE)
        surprises.append(normalized_error(world, found))
        for result in found.robust.series:
            assert np.all((result.scale > 0.5) & (result.scale < 1.7))
    # Priors are wider than the errors drawn, where data do not speak: then errors are smaller than stated.
    assert 0.05 < np.mean(surprises) < 2.0


def test_a_wire_over_a_lip_is_as_long_as_the_shortest_way():
    world = SimulatedWorld(exact=True)
    guided_rows = world.guided_lengths(EXIT, 0.03, 20)
    tips = (inverse_transform(EXIT) @ world.flange_frames(guided_rows.joints_rad))[:, :3, 3]
    device = CellDevice("d", (FramePrior.from_pose(EXIT),), {"radius_m": DeviceScalar(0.03, 0.0)})
    tool = FramePrior.from_pose(world.tool)
    perfect = SimulatedWorld(exact=True, perfect=True)
    cell = one_arm(perfect, [CellSeries("s", "d", "tip", guided_rows)], [device], tool=tool)
    frames = CellFrames.from_cell(cell)
    expected = cell_layout(frames, GEOMETRY, [()], Priors()).expected
    arms = (replace(expected.arms[0], geometry=world.errors),)
    state = replace(expected, arms=arms, places=first_places(frames))
    residuals_m = (
        series_residuals(CellProblem.from_frames(frames, state).series[0], state) * guided_rows.sigma_m
    )
    assert np.abs(residuals_m).max() < 1e-9
    straight = np.linalg.norm(tips, axis=1)
    assert np.median(np.abs(guided_rows.lengths_m - straight)) > 1e-4
    # Straight ahead nothing bends the wire; at a right angle a quarter of the lip carries it.
    assert shortest_wire(0.0, 1.0, 0.03) == 1.0
    assert shortest_wire(1.03, 0.03, 0.03) == pytest.approx(1.0 + 0.03 * np.pi / 2, abs=1e-7)


def test_a_guide_s_radius_and_a_ball_s_are_found():
    world = SimulatedWorld(seed=5)
    placed_tracker = CellDevice("tracker", (FramePrior.from_pose(TRACKER, **SURE),))
    guide = CellDevice(
        "guide", (FramePrior.from_pose(EXIT, 1e-3, 1e-2),), {"radius_m": DeviceScalar(0.0, np.inf)}
    )
    ball = CellDevice("ball", scalars={"radius_m": DeviceScalar(0.0, np.inf)})
    touched = world.at_sphere(BALL, 0.25, 50)
    stated = replace(touched, radii_m=touched.radii_m - 0.002)
    series = [
        CellSeries("points", "tracker", "tip", world.point_rows(60)),
        CellSeries("guided", "guide", "tip", world.guided_lengths(EXIT, 0.02, 60)),
        CellSeries("ball", "ball", "tip", stated),
    ]
    found = fit_cell(one_arm(world, series, [placed_tracker, guide, ball]), BARE)
    names = [p.name for p in found.robust.fit.layout.parameters]
    for name, device, truth in (("guide radius", 1, 0.02), ("ball radius", 2, 0.002)):
        sigma = np.sqrt(found.robust.fit.covariance[names.index(name), names.index(name)])
        assert sigma < 1e-3
        assert abs(found.state.scalars[device, 2] - truth) < 3 * sigma


def test_rows_with_a_covariance_weigh_by_direction():
    world = SimulatedWorld(seed=6, exact=True)
    points = world.point_rows(60)
    spread = exp_rotation(np.array([0.4, 0.2, 0.1])) @ np.diag([1e-3, 2e-5, 2e-5])
    noise = np.random.default_rng(0).standard_normal((60, 3)) @ spread.T
    points = replace(points, positions_m=points.positions_m + noise, sigma_m=np.full(60, 6e-4))
    device = CellDevice("camera", (FramePrior.from_pose(TRACKER, **SURE),))
    covariance = np.tile(spread @ spread.T, (60, 1, 1))
    errors = []
    for row_covariance in (None, covariance):
        found = fit_cell(
            one_arm(world, [CellSeries("s", "camera", "tip", points, row_covariance)], [device]), BARE
        )
        joints = np.random.default_rng(5).uniform(-1.5, 1.5, (60, 6))
        away = target_positions(found.robust.fit, "tip", joints) - world.tip_positions(joints)
        errors.append(np.sqrt(np.mean(away**2)))
    assert found.robust.series[0].scale[0] == pytest.approx(1.0, abs=0.2)
    assert errors[1] < 0.5 * errors[0]
    assert 0.2 < normalized_error(world, found) < 3.0


def test_bad_rows_are_named_by_series_and_bend_nothing():
    world = SimulatedWorld(seed=7)
    points, lengths = world.point_rows(60), world.length_rows(ANCHOR, 60)
    points.positions_m[[4, 17]] += 5e-3
    lengths.lengths_m[[9, 33, 50]] -= 4e-3
    devices = [CellDevice("tracker", (FramePrior.from_pose(TRACKER, **SURE),)), CellDevice("wire")]
    series = [CellSeries("seen", "tracker", "tip", points), CellSeries("pulled", "wire", "tip", lengths)]
    found = fit_cell(one_arm(world, series, devices), BARE)
    named = {(row.series, row.row) for row in found.rejected}
    assert named == {("seen", 4), ("seen", 17), ("pulled", 9), ("pulled", 33), ("pulled", 50)}
    assert "mm" in found.rejected[0].reason
    assert normalized_error(world, found) < 3.0
