"""Simulated calibrations of cells, as `fit_cell` does them: contacts, bars, several targets, devices and robots."""

from dataclasses import dataclass, replace

import numpy as np

from cellcal.calibration.cells.cell import (
    CalibrationCell,
    CellDevice,
    CellRobot,
    CellSeries,
    CellTarget,
    CellTool,
    DeviceScalar,
)
from cellcal.calibration.cells.contact_observations import (
    BarLengths,
    CellObservations,
    GuidedLengthObservations,
    PinTouches,
    PlaneContacts,
    SphereContacts,
)
from cellcal.calibration.cells.estimate import CellFit, estimate_cell
from cellcal.calibration.cells.first_guess import first_places
from cellcal.calibration.cells.frame_priors import FramePrior
from cellcal.calibration.cells.prediction import target_positions, tip_covariance
from cellcal.calibration.cells.robust import fit_cell_robustly
from cellcal.calibration.cells.state import CellFrames, CellLayout, CellState, cell_layout
from cellcal.calibration.cells.system import CellProblem
from cellcal.calibration.geometry import Array, exp_rotation, exp_twist, homogeneous_matrix, inverse_transform
from cellcal.calibration.identification.observations import LengthObservations, PointObservations
from cellcal.calibration.identification.parameters import FRAMES, GEOMETRY
from cellcal.calibration.uncertainty import coverage_factor
from tests.soak.coverage_arms import (
    ANCHOR,
    CHECKED,
    PINS,
    PRIORS,
    TIP,
    TOOL,
    TRACKER,
    Calibration,
    CalibrationScore,
    DrawnArm,
    DrawnNoise,
    at_pin,
    at_plane,
    pick_rows,
    plane_poses,
    shifted_pose,
    small_difference,
    small_motion,
)


@dataclass(frozen=True, eq=False)
class _DeviceRows:
    """What one device saw of the tip, and where and how it truly is."""

    device: CellDevice
    rows: CellObservations
    place: Array  # (4, 4)
    numbers: tuple[float, float, float] = (0.0, 1.0, 0.0)  # zero, scale, radius


@dataclass(frozen=True, slots=True)
class _CalibrationDraw:
    """The dice of one calibration, and whether its deviation is to be found."""

    rng: np.random.Generator
    found: bool


_EXACT = np.array([[0.0, 1.0, 0.0]])
_WIRE = {"zero_m": DeviceScalar(0.0, PRIORS.wire_zero_m), "scale": DeviceScalar(1.0, PRIORS.wire_scale)}


def pin(rng: np.random.Generator, found: bool) -> CalibrationScore:
    """The tip on pins: two of unknown place, one known to a tenth of a millimetre."""
    arm, noise, device_rows = DrawnArm.draw(rng), DrawnNoise.draw(rng, found), []
    for number, expected in enumerate(PINS):
        is_known = number == 2
        spot = expected + 1e-4 * rng.standard_normal(3) * is_known
        joints = pick_rows(at_pin(number), rng, 8)
        offsets = arm.true_tips(joints) - spot + noise(len(joints), 3)
        place = FramePrior.from_point(expected, 1e-4) if is_known else FramePrior.point_without_prior()
        rows = PinTouches(joints, offsets, *noise.stated_rows(len(joints)))
        device_rows.append(_DeviceRows(CellDevice(f"pin {number + 1}", (place,)), rows, shifted_pose(spot)))
    return _score_in_cell(arm, device_rows, rng, found)


def plane(rng: np.random.Generator, found: bool) -> CalibrationScore:
    """A dial gauge on three planes of unknown place."""
    arm, noise, device_rows = DrawnArm.draw(rng), DrawnNoise.draw(rng, found), []
    for number, place in enumerate(plane_poses()):
        joints = pick_rows(at_plane(number), rng, 25)
        heights = (arm.true_tips(joints) - place[:3, 3]) @ place[:3, 2] + noise(len(joints))
        device = CellDevice(f"plane {number + 1}", (FramePrior.without_prior(place @ small_motion(rng)),))
        device_rows.append(
            _DeviceRows(device, PlaneContacts(joints, heights, *noise.stated_rows(len(joints))), place)
        )
    return _score_in_cell(arm, device_rows, rng, found)


def sphere(rng: np.random.Generator, found: bool) -> CalibrationScore:
    """The tip all over two balls of unknown place, whose radius is known to ten micrometres."""
    arm, noise, device_rows = DrawnArm.draw(rng), DrawnNoise.draw(rng, found), []
    for number, centre in enumerate(PINS[:2]):
        larger = 1e-5 * float(rng.standard_normal())
        joints = pick_rows(at_pin(number, 0.05), rng, 30)
        radii = np.linalg.norm(arm.true_tips(joints) - centre, axis=1) - larger + noise(len(joints))
        rough = FramePrior.point_without_prior(centre + 0.01 * rng.standard_normal(3))
        device = CellDevice(f"ball {number + 1}", (rough,), {"radius_m": DeviceScalar(0.0, 1e-5)})
        rows = SphereContacts(joints, radii, *noise.stated_rows(len(joints)))
        device_rows.append(_DeviceRows(device, rows, shifted_pose(centre), (0.0, 1.0, larger)))
    return _score_in_cell(arm, device_rows, rng, found)


def bar(rng: np.random.Generator, found: bool) -> CalibrationScore:
    """Distances between two places of the tip, by a ballbar whose zero is known to twenty micrometres."""
    arm, noise = DrawnArm.draw(rng), DrawnNoise.draw(rng, found)
    zero = 2e-5 * float(rng.standard_normal())
    first, second = arm.draw_joints(rng, 60), arm.draw_joints(rng, 60)
    lengths = np.linalg.norm(arm.true_tips(first) - arm.true_tips(second), axis=1) + zero + noise(len(first))
    rows = BarLengths(first, lengths, *noise.stated_rows(len(first)), second)
    device = CellDevice("bar", (FramePrior.from_pose(np.eye(4)),), {"zero_m": DeviceScalar(0.0, 2e-5)})
    return _score_in_cell(arm, [_DeviceRows(device, rows, np.eye(4), (zero, 1.0, 0.0))], rng, found)


def guided(rng: np.random.Generator, found: bool) -> CalibrationScore:
    """Lengths of a wire over the round lip of its exit: radius known to 0.1 mm, direction to three degrees."""
    arm, noise = DrawnArm.draw(rng), DrawnNoise.draw(rng, found)
    zero, scale = _wire_errors(rng)
    radius = 4e-3 + 1e-4 * float(rng.standard_normal())
    place = homogeneous_matrix(exp_rotation(np.array([0.2, -0.7, 0.0])), ANCHOR)
    joints = arm.draw_joints(rng, 60)
    tips = (arm.true_tips(joints) - place[:3, 3]) @ place[:3, :3]
    across, height = np.hypot(tips[:, 0], tips[:, 1]), tips[:, 2]
    # From the middle of the lip's circle: the way to the tip, and the angle between it and the free wire.
    way, aside = np.hypot(across - radius, height), np.arctan2(height, across - radius)
    turn = np.pi - aside - np.arccos(radius / way)
    lengths = zero + scale * (np.sqrt(way**2 - radius**2) + radius * turn) + noise(len(joints))
    tilt = 0.05 * rng.standard_normal(3) * [1.0, 1.0, 0.0]
    rough = place @ homogeneous_matrix(exp_rotation(-tilt), 0.01 * rng.standard_normal(3))
    wire_values = {**_WIRE, "radius_m": DeviceScalar(4e-3, 1e-4)}
    device = CellDevice(
        "guided wire", (FramePrior(rough, np.array([*(np.inf,) * 3, 0.05, 0.05, 0.0])),), wire_values
    )
    rows = GuidedLengthObservations(joints, lengths, *noise.stated_rows(len(joints)))
    return _score_in_cell(arm, [_DeviceRows(device, rows, place, (zero, scale, radius))], rng, found)


def targets(rng: np.random.Generator, found: bool) -> CalibrationScore:
    """Three reflectors of one plate, by a tracker."""
    arm, noise = DrawnArm.draw(rng), DrawnNoise.draw(rng, found)
    plate = np.array([[0.0, 0.0, 0.0], [0.1, 0.0, 0.02], [0.0, 0.12, 0.0]])
    mounted = homogeneous_matrix(exp_rotation(np.array([0.3, -0.2, 0.4])), TIP)
    series = []
    for spot in plate:
        joints = arm.draw_joints(rng, 8)
        there = inverse_transform(TRACKER) @ arm.real.base_flange(joints) @ mounted @ shifted_pose(spot)
        measured_m = there[:, :3, 3] + noise(len(joints), 3)
        series.append(PointObservations(joints, measured_m, *noise.stated_rows(len(joints))))
    names = [f"reflector {number + 1}" for number in range(len(plate))]
    target_priors = [
        CellTarget(n, "tool", FramePrior.from_point(p)) for n, p in zip(names, plate, strict=True)
    ]
    cell = CalibrationCell(
        [CellRobot("robot", arm.model)],
        [CellTool("tool", "robot", FramePrior.without_prior())],
        [CellDevice("tracker")],
        [CellSeries(name, "tracker", name, rows) for name, rows in zip(names, series, strict=True)],
        target_priors,
    )
    places = {("tool", "tool"): mounted, ("device", "tracker"): TRACKER}
    places |= {("target", n): shifted_pose(p) for n, p in zip(names, plate, strict=True)}
    return _cell_score(cell, [arm], places, _EXACT[:1], _CalibrationDraw(rng, found))


def devices(rng: np.random.Generator, found: bool) -> CalibrationScore:
    """A tracker, a draw-wire and a pin at one robot."""
    arm, noise = DrawnArm.draw(rng), DrawnNoise.draw(rng, found)
    zero, scale = _wire_errors(rng)
    joints = [arm.draw_joints(rng, 10), arm.draw_joints(rng, 24), pick_rows(at_pin(0), rng, 8)]
    points = (inverse_transform(TRACKER) @ arm.real.base_flange(joints[0]) @ TOOL)[:, :3, 3] + noise(10, 3)
    lengths = zero + scale * np.linalg.norm(arm.true_tips(joints[1]) - ANCHOR, axis=1) + noise(24)
    offsets = arm.true_tips(joints[2]) - PINS[0] + noise(8, 3)
    wire = CellDevice("wire", (FramePrior.point_without_prior(),), _WIRE)
    device_rows = [
        _DeviceRows(
            CellDevice("tracker"), PointObservations(joints[0], points, *noise.stated_rows(10)), TRACKER
        ),
        _DeviceRows(
            wire,
            LengthObservations(joints[1], lengths, *noise.stated_rows(24)),
            shifted_pose(ANCHOR),
            (zero, scale, 0.0),
        ),
        _DeviceRows(
            CellDevice("pin", (FramePrior.point_without_prior(),)),
            PinTouches(joints[2], offsets, *noise.stated_rows(8)),
            shifted_pose(PINS[0]),
        ),
    ]
    return _score_in_cell(arm, device_rows, rng, found)


def robots(rng: np.random.Generator, found: bool) -> CalibrationScore:
    """Two robots, seen by one tracker."""
    arms, noise = [DrawnArm.draw(rng), DrawnArm.draw(rng)], DrawnNoise.draw(rng, found)
    bases = [np.eye(4), exp_twist(np.array([1.5, 0.4, 0.05, 0.02, -0.01, 2.5]))]
    series = []
    for number, (arm, base) in enumerate(zip(arms, bases, strict=True)):
        joints = arm.draw_joints(rng, 20)
        measured_m = (inverse_transform(TRACKER) @ base @ arm.real.base_flange(joints) @ TOOL)[:, :3, 3]
        rows = PointObservations(joints, measured_m + noise(len(joints), 3), *noise.stated_rows(len(joints)))
        series.append(CellSeries(f"series {number + 1}", "tracker", f"tool {number + 1}", rows))
    cell = CalibrationCell(
        [CellRobot("robot 1", arms[0].model), CellRobot("robot 2", arms[1].model)],
        [CellTool(f"tool {n}", f"robot {n}", FramePrior.point_without_prior()) for n in (1, 2)],
        [CellDevice("tracker")],
        series,
    )
    places = {("tool", "tool 1"): TOOL, ("tool", "tool 2"): TOOL, ("device", "tracker"): TRACKER}
    places |= {("base", f"robot {n}"): base for n, base in enumerate(bases, 1)}
    return _cell_score(cell, arms, places, _EXACT[:1], _CalibrationDraw(rng, found))


KINDS: dict[str, Calibration] = {
    "pin": pin,
    "plane": plane,
    "sphere": sphere,
    "bar": bar,
    "guided": guided,
    "targets": targets,
    "devices": devices,
    "robots": robots,
}


def _wire_errors(rng: np.random.Generator) -> tuple[float, float]:
    """Return zero [m] and scale of a wire, as the priors expect them."""
    return PRIORS.wire_zero_m * float(rng.standard_normal()), 1.0 + PRIORS.wire_scale * float(
        rng.standard_normal()
    )


def _score_in_cell(
    arm: DrawnArm, device_rows: list[_DeviceRows], rng: np.random.Generator, found: bool
) -> CalibrationScore:
    """Fit the rows of several devices that look at the same tip, and score."""
    cell = CalibrationCell(
        [CellRobot("robot", arm.model)],
        [CellTool("tool", "robot", FramePrior.point_without_prior(TIP + 0.005 * rng.standard_normal(3)))],
        [each.device for each in device_rows],
        [CellSeries(each.device.name, each.device.name, "tool", each.rows) for each in device_rows],
    )
    true_places = {("device", each.device.name): each.place for each in device_rows}
    numbers = np.array([each.numbers for each in device_rows])
    return _cell_score(
        cell, [arm], {("tool", "tool"): TOOL, **true_places}, numbers, _CalibrationDraw(rng, found)
    )


def _cell_score(
    cell: CalibrationCell,
    arms: list[DrawnArm],
    places: dict[tuple[str, str], Array],
    numbers: Array,
    draw: _CalibrationDraw,
) -> CalibrationScore:
    """Fit, and compare every frame, number, arm and predicted tip with the truth."""
    frames = CellFrames.from_cell(cell)
    fit, factor = _fit_cell(frames, draw.found)
    layout, answer = fit.layout, fit.state
    true_places = answer.places.copy()
    for key, place in places.items():
        true_places[frames.names[key]] = place
    geometry = tuple(replace(mine, geometry=arm.errors) for mine, arm in zip(answer.arms, arms, strict=True))
    truth = CellState(geometry, true_places, numbers)
    deviations = _state_deviations(layout, answer, truth)
    scored = np.isfinite(deviations)
    sigma = np.sqrt(np.diag(fit.covariance))
    names = [parameter.name for parameter in layout.parameters]
    tips = [
        _cell_tips(fit, arm, cell.tools[number].name, true_places, draw.rng)
        for number, arm in enumerate(arms)
    ]
    return CalibrationScore(
        tuple(name for name, is_scored in zip(names, scored, strict=True) if is_scored),
        (deviations / sigma)[scored],
        np.concatenate(tips),
        factor,
    )


def _fit_cell(frames: CellFrames, found: bool) -> tuple[CellFit, float]:
    terms = [()] * len(frames.cell.robots)
    coarse = cell_layout(frames, FRAMES, terms, PRIORS)
    problem = CellProblem.from_frames(frames, coarse.expected)
    # As fit_cell does: rows that are taken at their stated deviations would bend the frames to fit the arm's errors.
    rough = fit_cell_robustly(
        coarse, replace(coarse.expected, places=first_places(frames)), problem
    ).fit.state
    layout = cell_layout(frames, GEOMETRY, terms, PRIORS)
    start = replace(layout.expected, places=rough.places)
    if not found:
        return estimate_cell(layout, start, problem), 2.0
    robust = fit_cell_robustly(layout, start, problem)
    return robust.fit, coverage_factor(robust.degrees_of_freedom)


def _state_deviations(layout: CellLayout, answer: CellState, truth: CellState) -> Array:
    """Return truth minus answer of every free unknown, NaN for planes and exits: other frames there are as true."""
    off = layout.prior_deviations(truth) - layout.prior_deviations(answer)
    for number, slot in enumerate(layout.frames.slots):
        off_here = small_difference(answer.places[number], truth.places[number])
        if slot.name.startswith(("plane", "guided wire")):
            off_here[:] = np.nan
        for i, whole in enumerate(layout.free):
            if 6 * number <= whole < 6 * number + 6:
                off[i] = off_here[whole - 6 * number]
    return off


def _cell_tips(fit: CellFit, arm: DrawnArm, tool: str, places: Array, rng: np.random.Generator) -> Array:
    """Score the tip in the robot's base."""
    joints = rng.uniform(-1.2, 1.2, (CHECKED, arm.model.axis_count))
    there = arm.real.base_flange(joints) @ places[fit.layout.frames.names["tool", tool]]
    spread = np.sqrt(np.diagonal(tip_covariance(fit, tool, joints), axis1=1, axis2=2))
    return ((there[:, :3, 3] - target_positions(fit, tool, joints)) / spread).reshape(-1)
