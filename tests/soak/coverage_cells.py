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
    Arm,
    Calibration,
    Noise,
    Score,
    apart,
    at_pin,
    at_plane,
    planes,
    shifted,
    small_motion,
    some,
)


@dataclass(frozen=True, eq=False)
class _Seen:
    """What one device saw of the tip, and where and how it truly is."""

    device: CellDevice
    rows: CellObservations
    place: Array  # (4, 4)
    numbers: tuple[float, float, float] = (0.0, 1.0, 0.0)  # zero, scale, radius


@dataclass(frozen=True, slots=True)
class _Draw:
    """The dice of one calibration, and whether its deviation is to be found."""

    dice: np.random.Generator
    found: bool


_EXACT = np.array([[0.0, 1.0, 0.0]])
_WIRE = {"zero_m": DeviceScalar(0.0, PRIORS.wire_zero_m), "scale": DeviceScalar(1.0, PRIORS.wire_scale)}


def pin(dice: np.random.Generator, found: bool) -> Score:
    """The tip on pins: two of unknown place, one known to a tenth of a millimetre."""
    arm, noise, seen = Arm.drawn(dice), Noise.drawn(dice, found), []
    for number, expected in enumerate(PINS):
        known = number == 2
        spot = expected + 1e-4 * dice.standard_normal(3) * known
        joints = some(at_pin(number), dice, 8)
        offsets = arm.tips(joints) - spot + noise(len(joints), 3)
        place = FramePrior.from_point(expected, 1e-4) if known else FramePrior.point_without_prior()
        rows = PinTouches(joints, offsets, *noise.stated(len(joints)))
        seen.append(_Seen(CellDevice(f"pin {number + 1}", (place,)), rows, shifted(spot)))
    return _in_cell(arm, seen, dice, found)


def plane(dice: np.random.Generator, found: bool) -> Score:
    """A dial gauge on three planes of unknown place."""
    arm, noise, seen = Arm.drawn(dice), Noise.drawn(dice, found), []
    for number, place in enumerate(planes()):
        joints = some(at_plane(number), dice, 25)
        heights = (arm.tips(joints) - place[:3, 3]) @ place[:3, 2] + noise(len(joints))
        device = CellDevice(f"plane {number + 1}", (FramePrior.without_prior(place @ small_motion(dice)),))
        seen.append(_Seen(device, PlaneContacts(joints, heights, *noise.stated(len(joints))), place))
    return _in_cell(arm, seen, dice, found)


def sphere(dice: np.random.Generator, found: bool) -> Score:
    """The tip all over two balls of unknown place, whose radius is known to ten micrometres."""
    arm, noise, seen = Arm.drawn(dice), Noise.drawn(dice, found), []
    for number, centre in enumerate(PINS[:2]):
        larger = 1e-5 * float(dice.standard_normal())
        joints = some(at_pin(number, 0.05), dice, 30)
        radii = np.linalg.norm(arm.tips(joints) - centre, axis=1) - larger + noise(len(joints))
        rough = FramePrior.point_without_prior(centre + 0.01 * dice.standard_normal(3))
        device = CellDevice(f"ball {number + 1}", (rough,), {"radius_m": DeviceScalar(0.0, 1e-5)})
        rows = SphereContacts(joints, radii, *noise.stated(len(joints)))
        seen.append(_Seen(device, rows, shifted(centre), (0.0, 1.0, larger)))
    return _in_cell(arm, seen, dice, found)


def bar(dice: np.random.Generator, found: bool) -> Score:
    """Distances between two places of the tip, by a ballbar whose zero is known to twenty micrometres."""
    arm, noise = Arm.drawn(dice), Noise.drawn(dice, found)
    zero = 2e-5 * float(dice.standard_normal())
    first, second = arm.joints(dice, 60), arm.joints(dice, 60)
    lengths = np.linalg.norm(arm.tips(first) - arm.tips(second), axis=1) + zero + noise(len(first))
    rows = BarLengths(first, lengths, *noise.stated(len(first)), second)
    device = CellDevice("bar", (FramePrior.from_pose(np.eye(4)),), {"zero_m": DeviceScalar(0.0, 2e-5)})
    return _in_cell(arm, [_Seen(device, rows, np.eye(4), (zero, 1.0, 0.0))], dice, found)


def guided(dice: np.random.Generator, found: bool) -> Score:
    """Lengths of a wire over the round lip of its exit: radius known to 0.1 mm, direction to three degrees."""
    arm, noise = Arm.drawn(dice), Noise.drawn(dice, found)
    zero, scale = _wire_errors(dice)
    radius = 4e-3 + 1e-4 * float(dice.standard_normal())
    place = homogeneous_matrix(exp_rotation(np.array([0.2, -0.7, 0.0])), ANCHOR)
    joints = arm.joints(dice, 60)
    tips = (arm.tips(joints) - place[:3, 3]) @ place[:3, :3]
    across, height = np.hypot(tips[:, 0], tips[:, 1]), tips[:, 2]
    # From the middle of the lip's circle: the way to the tip, and the angle between it and the free wire.
    way, aside = np.hypot(across - radius, height), np.arctan2(height, across - radius)
    turn = np.pi - aside - np.arccos(radius / way)
    lengths = zero + scale * (np.sqrt(way**2 - radius**2) + radius * turn) + noise(len(joints))
    tilt = 0.05 * dice.standard_normal(3) * [1.0, 1.0, 0.0]
    rough = place @ homogeneous_matrix(exp_rotation(-tilt), 0.01 * dice.standard_normal(3))
    known = {**_WIRE, "radius_m": DeviceScalar(4e-3, 1e-4)}
    device = CellDevice(
        "guided wire", (FramePrior(rough, np.array([*(np.inf,) * 3, 0.05, 0.05, 0.0])),), known
    )
    rows = GuidedLengthObservations(joints, lengths, *noise.stated(len(joints)))
    return _in_cell(arm, [_Seen(device, rows, place, (zero, scale, radius))], dice, found)


def targets(dice: np.random.Generator, found: bool) -> Score:
    """Three reflectors of one plate, by a tracker."""
    arm, noise = Arm.drawn(dice), Noise.drawn(dice, found)
    plate = np.array([[0.0, 0.0, 0.0], [0.1, 0.0, 0.02], [0.0, 0.12, 0.0]])
    mounted = homogeneous_matrix(exp_rotation(np.array([0.3, -0.2, 0.4])), TIP)
    series = []
    for spot in plate:
        joints = arm.joints(dice, 8)
        there = inverse_transform(TRACKER) @ arm.real.base_flange(joints) @ mounted @ shifted(spot)
        seen = there[:, :3, 3] + noise(len(joints), 3)
        series.append(PointObservations(joints, seen, *noise.stated(len(joints))))
    names = [f"reflector {number + 1}" for number in range(len(plate))]
    known = [CellTarget(n, "tool", FramePrior.from_point(p)) for n, p in zip(names, plate, strict=True)]
    cell = CalibrationCell(
        [CellRobot("robot", arm.model)],
        [CellTool("tool", "robot", FramePrior.without_prior())],
        [CellDevice("tracker")],
        [CellSeries(name, "tracker", name, rows) for name, rows in zip(names, series, strict=True)],
        known,
    )
    places = {("tool", "tool"): mounted, ("device", "tracker"): TRACKER}
    places |= {("target", n): shifted(p) for n, p in zip(names, plate, strict=True)}
    return _cell_score(cell, [arm], places, _EXACT[:1], _Draw(dice, found))


def devices(dice: np.random.Generator, found: bool) -> Score:
    """A tracker, a draw-wire and a pin at one robot."""
    arm, noise = Arm.drawn(dice), Noise.drawn(dice, found)
    zero, scale = _wire_errors(dice)
    joints = [arm.joints(dice, 10), arm.joints(dice, 24), some(at_pin(0), dice, 8)]
    points = (inverse_transform(TRACKER) @ arm.real.base_flange(joints[0]) @ TOOL)[:, :3, 3] + noise(10, 3)
    lengths = zero + scale * np.linalg.norm(arm.tips(joints[1]) - ANCHOR, axis=1) + noise(24)
    offsets = arm.tips(joints[2]) - PINS[0] + noise(8, 3)
    wire = CellDevice("wire", (FramePrior.point_without_prior(),), _WIRE)
    seen = [
        _Seen(CellDevice("tracker"), PointObservations(joints[0], points, *noise.stated(10)), TRACKER),
        _Seen(
            wire,
            LengthObservations(joints[1], lengths, *noise.stated(24)),
            shifted(ANCHOR),
            (zero, scale, 0.0),
        ),
        _Seen(
            CellDevice("pin", (FramePrior.point_without_prior(),)),
            PinTouches(joints[2], offsets, *noise.stated(8)),
            shifted(PINS[0]),
        ),
    ]
    return _in_cell(arm, seen, dice, found)


def robots(dice: np.random.Generator, found: bool) -> Score:
    """Two robots, seen by one tracker."""
    arms, noise = [Arm.drawn(dice), Arm.drawn(dice)], Noise.drawn(dice, found)
    bases = [np.eye(4), exp_twist(np.array([1.5, 0.4, 0.05, 0.02, -0.01, 2.5]))]
    series = []
    for number, (arm, base) in enumerate(zip(arms, bases, strict=True)):
        joints = arm.joints(dice, 20)
        seen = (inverse_transform(TRACKER) @ base @ arm.real.base_flange(joints) @ TOOL)[:, :3, 3]
        rows = PointObservations(joints, seen + noise(len(joints), 3), *noise.stated(len(joints)))
        series.append(CellSeries(f"series {number + 1}", "tracker", f"tool {number + 1}", rows))
    cell = CalibrationCell(
        [CellRobot("robot 1", arms[0].model), CellRobot("robot 2", arms[1].model)],
        [CellTool(f"tool {n}", f"robot {n}", FramePrior.point_without_prior()) for n in (1, 2)],
        [CellDevice("tracker")],
        series,
    )
    places = {("tool", "tool 1"): TOOL, ("tool", "tool 2"): TOOL, ("device", "tracker"): TRACKER}
    places |= {("base", f"robot {n}"): base for n, base in enumerate(bases, 1)}
    return _cell_score(cell, arms, places, _EXACT[:1], _Draw(dice, found))


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


def _wire_errors(dice: np.random.Generator) -> tuple[float, float]:
    """Return zero [m] and scale of a wire, as the priors expect them."""
    return PRIORS.wire_zero_m * float(dice.standard_normal()), 1.0 + PRIORS.wire_scale * float(
        dice.standard_normal()
    )


def _in_cell(arm: Arm, seen: list[_Seen], dice: np.random.Generator, found: bool) -> Score:
    """Fit the rows of several devices that look at the same tip, and score."""
    cell = CalibrationCell(
        [CellRobot("robot", arm.model)],
        [CellTool("tool", "robot", FramePrior.point_without_prior(TIP + 0.005 * dice.standard_normal(3)))],
        [each.device for each in seen],
        [CellSeries(each.device.name, each.device.name, "tool", each.rows) for each in seen],
    )
    known = {("device", each.device.name): each.place for each in seen}
    numbers = np.array([each.numbers for each in seen])
    return _cell_score(cell, [arm], {("tool", "tool"): TOOL, **known}, numbers, _Draw(dice, found))


def _cell_score(
    cell: CalibrationCell, arms: list[Arm], places: dict[tuple[str, str], Array], numbers: Array, draw: _Draw
) -> Score:
    """Fit, and compare every frame, number, arm and predicted tip with the truth."""
    frames = CellFrames.from_cell(cell)
    fit, factor = _fit_cell(frames, draw.found)
    layout, answer = fit.layout, fit.state
    true_places = answer.places.copy()
    for key, place in places.items():
        true_places[frames.names[key]] = place
    geometry = tuple(replace(mine, geometry=arm.errors) for mine, arm in zip(answer.arms, arms, strict=True))
    truth = CellState(geometry, true_places, numbers)
    told = _deviations(layout, answer, truth)
    scored = np.isfinite(told)
    sigma = np.sqrt(np.diag(fit.covariance))
    names = [parameter.name for parameter in layout.parameters]
    tips = [
        _cell_tips(fit, arm, cell.tools[number].name, true_places, draw.dice)
        for number, arm in enumerate(arms)
    ]
    return Score(
        tuple(name for name, wanted in zip(names, scored, strict=True) if wanted),
        (told / sigma)[scored],
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


def _deviations(layout: CellLayout, answer: CellState, truth: CellState) -> Array:
    """Return truth minus answer of every free unknown, NaN for planes and exits: other frames there are as true."""
    off = layout.prior_deviations(truth) - layout.prior_deviations(answer)
    for number, slot in enumerate(layout.frames.slots):
        off_here = apart(answer.places[number], truth.places[number])
        if slot.name.startswith(("plane", "guided wire")):
            off_here[:] = np.nan
        for i, whole in enumerate(layout.free):
            if 6 * number <= whole < 6 * number + 6:
                off[i] = off_here[whole - 6 * number]
    return off


def _cell_tips(fit: CellFit, arm: Arm, tool: str, places: Array, dice: np.random.Generator) -> Array:
    """Score the tip in the robot's base."""
    joints = dice.uniform(-1.2, 1.2, (CHECKED, arm.model.axis_count))
    there = arm.real.base_flange(joints) @ places[fit.layout.frames.names["tool", tool]]
    spread = np.sqrt(np.diagonal(tip_covariance(fit, tool, joints), axis1=1, axis2=2))
    return ((there[:, :3, 3] - target_positions(fit, tool, joints)) / spread).reshape(-1)
