"""Where the frames of a cell are, roughly: one series after the other places what it shows, from what is placed."""

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from cellcal.calibration.arm.kinematics import RobotModel
from cellcal.calibration.cells.cell import CellSeries
from cellcal.calibration.cells.contact_observations import PinTouches, PlaneContacts, SphereContacts
from cellcal.calibration.cells.state import NOWHERE, CellFrames, FrameRoute
from cellcal.calibration.errors import CalibrationError, DegenerateDataError
from cellcal.calibration.geometry import (
    Array,
    homogeneous_matrix,
    inverse_transform,
    mean_rotation,
    nearest_rotation,
)
from cellcal.calibration.identification.estimator import FitProblem, estimate_arm
from cellcal.calibration.identification.first_guess import base_and_tool, first_guess, locate_anchors
from cellcal.calibration.identification.layouts import make_layout
from cellcal.calibration.identification.observations import (
    LengthObservations,
    PointObservations,
    PoseObservations,
    Rows,
)
from cellcal.calibration.identification.parameters import FRAMES
from cellcal.calibration.message import make_message

_MOST_ROWS = 100
_STEPS = 12
_FLAT = 1e-3
_FEWEST_WITHOUT_TOOL = {"point": 4, "pose": 3, "pin": 3, "length": 8, "guided length": 8, "sphere": 8}
_FEWEST_WITH_TOOL = {
    "point": 3,
    "pose": 3,
    "pin": 1,
    "length": 4,
    "guided length": 4,
    "sphere": 4,
    "plane": 3,
}


def first_places(frames: CellFrames) -> Array:
    """Return a start for every frame of a cell (M, 4, 4).

    Full poses are asked first, then points, lengths, pins, balls and planes: each kind can place less by itself. A
    plane needs to know the tool; a bar places nothing.

    Raises
    ------
    DegenerateDataError
        A frame that no series shows well enough to begin with, and for which no rough place is given.
    """
    guess = _FrameGuess(frames)
    while any(advance(guess, sight) for advance, sight in _order_views(guess)) or guess.settle_frames():
        pass
    for number, slot in enumerate(frames.slots):
        if number not in guess.places:
            what = (
                "place of the tool (within 50 mm)" if slot.role == "tool" else "place (within 0.2 m, 20 deg)"
            )
            raise DegenerateDataError(
                make_message("the series do not tell where to begin looking for {name!r}.", name=slot.name),
                remedy=make_message(
                    "Give a rough {what} as `Place.unknown(...)`, or measure more rows that show it.",
                    what=what,
                ),
            )
    return np.array([guess.places[number] for number in range(len(frames.slots))])


@dataclass(frozen=True, eq=False)
class _SeriesView:
    """The rows of one series on one mounting."""

    series: CellSeries
    route: FrameRoute
    model: RobotModel
    flange: Array  # (N, 4, 4)
    rows: Rows

    @property
    def flange_rotations(self) -> Array:
        return self.flange[:, :3, :3]

    def tip_positions(self, tip: Array) -> Array:
        tips: Array = self.flange_rotations @ tip + self.flange[:, :3, 3]
        return tips

    def has_enough_rows(self, *, tool_known: bool) -> bool:
        fewest = _FEWEST_WITH_TOOL if tool_known else _FEWEST_WITHOUT_TOOL
        kind = self.series.observations.kind
        return kind in fewest and len(self.rows) >= fewest[kind]


@dataclass(eq=False)
class _FrameGuess:
    frames: CellFrames
    places: dict[int, Array] = field(default_factory=dict)
    targets: dict[tuple[int, int], Array] = field(default_factory=dict)  # in the flange, by tool and target
    turned: set[tuple[int, int]] = field(default_factory=set)  # whose attitude is known, too
    device_points: dict[tuple[int, int], Array] = field(
        default_factory=dict
    )  # points of devices in bases that are not placed

    def __post_init__(self) -> None:
        self.places = {i: s.place.pose for i, s in enumerate(self.frames.slots) if s.place.pose is not None}

    def tip_in_flange(self, route: FrameRoute) -> Array | None:
        """Return the target in the flange (3,), if it is known."""
        key = route.tool, route.target
        if route.tool not in self.places:
            return self.targets[key][:3, 3] if key in self.targets else None
        offset = np.eye(4) if route.target == NOWHERE else self.places[route.target]
        tip: Array = (self.places[route.tool] @ offset)[:3, 3]
        return tip

    def put_target(self, route: FrameRoute, target: Array, *, turned: bool = False) -> None:
        self.targets[route.tool, route.target] = target
        if turned:
            self.turned.add((route.tool, route.target))

    def put_device(self, route: FrameRoute, device_base: Array) -> bool:
        """Place the device or the base, whichever is missing while the other is there."""
        if route.base in self.places and route.device not in self.places:
            self.places[route.device] = self.places[route.base] @ inverse_transform(device_base)
        elif route.device in self.places and route.base not in self.places:
            self.places[route.base] = self.places[route.device] @ device_base
        else:
            return False
        return True

    def put_point(self, route: FrameRoute, in_base_m: Array, rotation: Array | None = None) -> bool:
        """Place a device whose own axes are the world's, or have this rotation in the base."""
        if route.base not in self.places:
            self.device_points[route.base, route.device] = in_base_m
            return True
        base = self.places[route.base]
        turn = np.eye(3) if rotation is None else base[:3, :3] @ rotation
        self.places[route.device] = homogeneous_matrix(turn, base[:3, :3] @ in_base_m + base[:3, 3])
        return True

    def is_used(self, route: FrameRoute, *, tip_known: bool) -> bool:
        """Return whether a point of a device has told already what it can."""
        if route.base not in self.places:
            return (route.base, route.device) in self.device_points
        return tip_known and route.device in self.places

    def settle_frames(self) -> bool:
        """Place what takes several series to place; return whether anything was."""
        return self._settle_bases() or self._settle_tools()

    def _settle_bases(self) -> bool:
        """Place every base in which three points of placed devices were found."""
        found = False
        for base in {base for base, _ in self.device_points if base not in self.places}:
            points = [
                (p, self.places[d])
                for (b, d), p in self.device_points.items()
                if b == base and d in self.places
            ]
            if len(points) > 2:
                here = np.array([point for point, _ in points])
                self.places[base] = _align_points(here, np.array([place[:3, 3] for _, place in points]))
                found = True
        return found

    def _settle_tools(self) -> bool:
        """Place every tool of which a target was found: by its attitude, by three targets, or unturned."""
        found = {tool for tool, _ in self.targets if tool not in self.places}
        for tool in found:
            poses_by_target = {target: pose for (its, target), pose in self.targets.items() if its == tool}
            offsets = {t: np.eye(4) if t == NOWHERE else self.places[t] for t in poses_by_target}
            whole = next((t for t in poses_by_target if (tool, t) in self.turned), None)
            if whole is not None:
                self.places[tool] = poses_by_target[whole] @ inverse_transform(offsets[whole])
                continue
            here = np.array([offsets[t][:3, 3] for t in poses_by_target])
            there = np.array([poses_by_target[t][:3, 3] for t in poses_by_target])
            self.places[tool] = (
                _align_points(here, there) if len(poses_by_target) > 2 else _align_unturned(here, there)
            )
        return bool(found)


def _order_views(guess: _FrameGuess) -> list[tuple[Callable[[_FrameGuess, _SeriesView], bool], _SeriesView]]:
    """Return what may be tried next, the most telling first."""
    ways: dict[str, Callable[[_FrameGuess, _SeriesView], bool]] = {
        "pose": _place_by_points,
        "point": _place_by_points,
        "length": _place_by_lengths,
        "guided length": _place_by_lengths,
        "pin": _place_by_pin,
        "sphere": _place_by_lengths,
        "plane": _place_by_plane,
    }
    kinds = list(ways)
    cell = guess.frames.cell
    ordered = sorted(
        (s for s in cell.series if s.observations.kind in ways),
        key=lambda s: kinds.index(s.observations.kind),
    )
    found = []
    for series in ordered:
        robot = cell.robot_of(series.target)
        model = robot.model if robot.previous is None else robot.previous.arm_model
        for mounting in range(len(cell.find_device(series.device).places)):
            rows = np.flatnonzero(series.observations.mounting == mounting)
            rows = rows[:: 1 + len(rows) // _MOST_ROWS]
            if len(rows):
                route = guess.frames.find_route(series.target, series.device, mounting)
                flange = model.base_flange(series.observations.joints_rad[rows])
                sight = _SeriesView(series, route, robot.model, flange, rows)
                found.append((ways[series.observations.kind], sight))
    return found


def _place_by_points(guess: _FrameGuess, sight: _SeriesView) -> bool:
    observations, route = sight.series.observations, sight.route
    assert isinstance(observations, PointObservations)
    positions, tip = observations.positions_m[sight.rows], guess.tip_in_flange(route)
    if tip is not None:
        missing = (route.base in guess.places) != (route.device in guess.places)
        if not (missing and sight.has_enough_rows(tool_known=True)):
            return False
        return guess.put_device(route, _align_points(sight.tip_positions(tip), positions))
    if route.base in guess.places and route.device in guess.places:
        device_base = inverse_transform(guess.places[route.device]) @ guess.places[route.base]
        found = _mean_tip(sight, _transform_points(inverse_transform(device_base), positions))
    elif sight.has_enough_rows(tool_known=False):
        device_base, found = base_and_tool(sight.flange, positions)
    else:
        return False
    if isinstance(observations, PoseObservations):
        turned = (
            np.swapaxes(device_base[:3, :3] @ sight.flange_rotations, 1, 2)
            @ observations.rotations[sight.rows]
        )
        found = homogeneous_matrix(mean_rotation(turned), found[:3, 3])
    guess.put_target(route, found, turned=isinstance(observations, PoseObservations))
    guess.put_device(route, device_base)
    return True


def _place_by_lengths(guess: _FrameGuess, sight: _SeriesView) -> bool:
    route, tip = sight.route, guess.tip_in_flange(sight.route)
    placed = route.device in guess.places and route.base in guess.places
    if guess.is_used(route, tip_known=tip is not None):
        return False
    if not sight.has_enough_rows(tool_known=placed or tip is not None):
        return False
    observations = sight.series.observations
    lengths = observations.radii_m if isinstance(observations, SphereContacts) else _lengths_of(observations)
    if placed:
        base_device = inverse_transform(guess.places[route.base]) @ guess.places[route.device]
        tip = _tip_by_lengths(sight, base_device[:3, 3], lengths[sight.rows])
        guess.put_target(route, homogeneous_matrix(np.eye(3), tip))
        return True
    if tip is None:
        anchor, tip = _anchor_and_tip(sight, lengths[sight.rows])
        guess.put_target(route, homogeneous_matrix(np.eye(3), tip))
    else:
        tips = sight.tip_positions(tip)
        anchor = min(
            locate_anchors(tips, lengths[sight.rows]),
            key=lambda a: float(np.sum((np.linalg.norm(tips - a, axis=1) - lengths[sight.rows]) ** 2)),
        )
    axis = (
        _frame_along(sight.tip_positions(tip).mean(axis=0) - anchor)
        if observations.kind == "guided length"
        else None
    )
    return guess.put_point(route, anchor, axis)


def _lengths_of(observations: object) -> Array:
    assert isinstance(observations, LengthObservations)
    return observations.lengths_m


def _anchor_and_tip(sight: _SeriesView, lengths_m: Array) -> tuple[Array, Array]:
    """Return anchor and tip of lengths with an unknown tool, from both sides of the postures."""
    once = np.zeros(len(sight.rows), dtype=np.intp)
    joints = sight.series.observations.joints_rad[sight.rows]
    rows = LengthObservations(joints, lengths_m, sight.series.observations.sigma_m[sight.rows], once)
    layout = make_layout(sight.model, "length", 1, level=FRAMES)
    fits = [
        estimate_arm(layout, start, FitProblem.from_observations(start, rows))
        for start in first_guess(sight.model, rows)
    ]
    best = min(fits, key=lambda fit: fit.cost).state
    return best.devices[0].anchor_in_base_m, best.flange_tool[:3, 3]


def _tip_by_lengths(sight: _SeriesView, anchor: Array, lengths_m: Array) -> Array:
    """Return the tip (3,) that fits lengths from a known anchor, from the flange on: tools are short."""
    tip = np.zeros(3)
    for _ in range(_STEPS):
        away = sight.tip_positions(tip) - anchor
        distance = np.linalg.norm(away, axis=1)
        slopes = np.einsum("nij,ni->nj", sight.flange_rotations, away / distance[:, None])
        tip = tip + np.linalg.lstsq(slopes, lengths_m - distance, rcond=_FLAT)[0]
    return tip


def _place_by_pin(guess: _FrameGuess, sight: _SeriesView) -> bool:
    observations, route, tip = sight.series.observations, sight.route, guess.tip_in_flange(sight.route)
    assert isinstance(observations, PinTouches)
    if guess.is_used(route, tip_known=tip is not None) or not sight.has_enough_rows(
        tool_known=tip is not None
    ):
        return False
    turn = guess.places[route.base][:3, :3] if route.base in guess.places else np.eye(3)
    aside = observations.positions_m[sight.rows] @ turn
    if tip is None:
        count = len(sight.rows)
        design = np.concatenate([sight.flange_rotations, np.tile(-np.eye(3), (count, 1, 1))], axis=2).reshape(
            -1, 6
        )
        tip = np.linalg.lstsq(design, (aside - sight.flange[:, :3, 3]).reshape(-1), rcond=None)[0][:3]
        guess.put_target(route, homogeneous_matrix(np.eye(3), tip))
    if route.device in guess.places and route.base in guess.places:
        return True
    return guess.put_point(route, (sight.tip_positions(tip) - aside).mean(axis=0))


def _place_by_plane(guess: _FrameGuess, sight: _SeriesView) -> bool:
    observations, route, tip = sight.series.observations, sight.route, guess.tip_in_flange(sight.route)
    assert isinstance(observations, PlaneContacts)
    if tip is None or route.device in guess.places or route.base not in guess.places:
        return False
    if not sight.has_enough_rows(tool_known=True):
        return False
    tips, heights = sight.tip_positions(tip), observations.heights_m[sight.rows]
    centre = tips.mean(axis=0)
    normal = np.linalg.svd(tips - centre, full_matrices=False)[2][2]
    up = normal if normal[2] >= 0 else -normal
    # Which side is up shows only where heights differ.
    along = (tips - centre) @ up
    if float(along @ (heights - heights.mean())) < -0.5 * float(np.sum((heights - heights.mean()) ** 2)):
        up = -up
    return guess.put_point(route, centre - heights.mean() * up, _frame_along(up))


def _mean_tip(sight: _SeriesView, in_base_m: Array) -> Array:
    away = in_base_m - sight.flange[:, :3, 3]
    return homogeneous_matrix(np.eye(3), np.einsum("nji,nj->i", sight.flange_rotations, away) / len(away))


def _transform_points(transform: Array, points: Array) -> Array:
    carried: Array = points @ transform[:3, :3].T + transform[:3, 3]
    return carried


def _align_points(source: Array, target: Array) -> Array:
    """Return the rigid transform (4, 4) that carries points (N, 3) nearest to others."""
    here, there = source.mean(axis=0), target.mean(axis=0)
    try:
        rotation = nearest_rotation((target - there).T @ (source - here))
    except CalibrationError as error:
        raise DegenerateDataError(
            "the places that shall tell where a frame is lie on one point or line.",
            remedy="Measure postures or targets that span a plane at least.",
        ) from error
    return homogeneous_matrix(rotation, there - rotation @ here)


def _align_unturned(source: Array, target: Array) -> Array:
    return homogeneous_matrix(np.eye(3), (target - source).mean(axis=0))


def _frame_along(direction: Array) -> Array:
    """Return a rotation whose z axis has this direction."""
    z = direction / np.linalg.norm(direction)
    x = np.cross(np.eye(3)[int(np.argmin(np.abs(z)))], z)
    x /= np.linalg.norm(x)
    return np.stack([x, np.cross(z, x), z], axis=1)
