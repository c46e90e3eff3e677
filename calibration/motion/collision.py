"""Whether postures keep their distance: arm against itself, against what stands in the cell, and the draw-wire.

The arm is a set of capsules along its links, the cell a few boxes, spheres and planes: shapes whose distances
are exact and computed for all postures at once. What such a check does not see, it says (`not_checked`).
This is a check of a plan, not a safety function.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from cellcal.calibration.arm.joint_kinds import drawn_range
from cellcal.calibration.arm.kinematics import RobotModel, chain_frames
from cellcal.calibration.errors import CalibrationError
from cellcal.calibration.geometry import Array
from cellcal.calibration.message import make_message
from cellcal.calibration.motion.capsule_distance import (
    Segment,
    box_distance,
    pair_distances,
    plane_distance,
    segment_distance,
)
from cellcal.calibration.motion.cell_shapes import (
    CellShape,
    LinkCapsule,
    Obstacle,
    Place,
    PlaneObstacle,
    SphereObstacle,
)
from cellcal.calibration.motion.motion_check import WirePath
from cellcal.calibration.motion.motion_quantities import LimitExcess
from cellcal.calibration.motion.position_uncertainty import AxisUncertainty, PositionUncertainty
from cellcal.calibration.motion.wire_uncertainty import wire_approaches

_ALWAYS = 0.9  # of random postures: a pair that touches so often is touching by construction
_TRIALS = 400
_LARGEST_STEP_M = 5e-3  # of any point of the arm, between two looks at a way
_CHUNK = 8192


@dataclass(frozen=True, slots=True)
class ShapeContact:
    """The narrowest place of one posture; clearance below the margin is a contact."""

    posture: int
    first: str
    second: str
    clearance_m: float


@dataclass(frozen=True, eq=False)
class CollisionCheck:
    """Checks postures and ways of one arm in one cell."""

    model: RobotModel
    shape: CellShape
    touching: frozenset[tuple[int, int]] = field(default_factory=frozenset)  # pairs of links left out

    @classmethod
    def from_model(cls, model: RobotModel, shape: CellShape, *, seed: int = 1) -> "CollisionCheck":
        """Find the pairs of links that touch by construction, from random postures, and leave them out."""
        if any(not 0 <= capsule.link <= model.axis_count for capsule in shape.arm):
            raise CalibrationError(
                make_message(
                    "{model_name} has links 0 to {axis_count}",
                    model_name=model.label,
                    axis_count=model.axis_count,
                )
            )
        generator = np.random.default_rng(seed)
        low, high = drawn_range(model)
        segments = _link_segments(model, shape.arm, generator.uniform(low, high, (_TRIALS, model.axis_count)))
        near: dict[tuple[int, int], NDArray[np.bool_]] = {}
        for i, j in _capsule_pairs(shape.arm, frozenset()):
            links = _link_pair(shape.arm, i, j)
            close = _bar_clearance(shape.arm, segments, i, j) < shape.margin_m
            near[links] = near.get(links, np.zeros(_TRIALS, dtype=bool)) | close
        touching = frozenset(links for links, close in near.items() if close.mean() > _ALWAYS)
        if shape.assumed and model.sliding is not None:  # how a slide's guide is built is unknown
            slides = np.flatnonzero(model.sliding)
            touching |= {(i, j) for i, j in near if ((slides >= i) & (slides < j)).any()}
        return cls(model, shape, touching)

    @property
    def not_checked(self) -> tuple[str, ...]:
        """The limits of this check, in sentences for the person who approves a move."""
        words = [*self.shape.assumed]
        names = {capsule.link: capsule.name for capsule in self.shape.arm}
        words += [
            make_message(
                "touching by construction, so not checked: {one_shape} and {other_shape}",
                one_shape=names[i],
                other_shape=names[j],
            )
            for i, j in sorted(self.touching)
        ]
        words.append("links that share a joint are not checked against each other")
        if not self.shape.obstacles:
            words.append("no obstacles known: path not checked for collisions with the cell")
        if self.shape.wire is None:
            words.append("the draw-wire is not part of this plan")
        words.append("cables, hoses and people are not known")
        return tuple(words)

    def is_free(self, joints_rad: Array) -> NDArray[np.bool_]:
        """Return (N,): which postures keep every distance. Numbers that are not finite are not free."""
        return np.asarray(self._least_clearance(joints_rad) >= 0.0)

    def narrowest_contacts(self, joints_rad: Array) -> tuple[ShapeContact, ...]:
        """Return the narrowest place of each posture, measured against the margin that holds there.

        Raises
        ------
        CalibrationError
            Joint angles that are not finite.
        """
        joints = np.asarray(joints_rad, dtype=float)
        best = np.full(len(joints), np.inf)
        found = [("", "", float("inf"))] * len(joints)
        for first, second, clearance, margin in self._pair_clearances(joints):
            closer = clearance - margin < best
            best = np.where(closer, clearance - margin, best)
            for i in np.flatnonzero(closer):
                found[i] = (first, second, float(clearance[i]))
        return tuple(ShapeContact(i, *item) for i, item in enumerate(found))

    def compute_clearances(
        self, joints_rad: Array, position_uncertainty: PositionUncertainty | None = None
    ) -> LimitExcess:
        """Return the clearance of every pair of shapes in every posture, against what it must be.

        With a doubt about the posture each margin grows by as much as the two shapes may be nearer than computed.

        Raises
        ------
        CalibrationError
            Joint angles that are not finite.
        """
        joints = np.asarray(joints_rad, dtype=float)
        pairs = list(self._pair_clearances(joints))
        found = np.array([clearance for _, _, clearance, _ in pairs]).T.reshape(len(joints), len(pairs))
        limit = np.broadcast_to(np.array([margin for *_, margin in pairs]), found.shape)
        more = (
            None if position_uncertainty is None else self._pair_uncertainties(joints, position_uncertainty)
        )
        limit = limit if more is None else limit + more
        return LimitExcess("clearance", found, limit, limit - found, "m", self._quantity_names, more)

    def _pair_uncertainties(self, joints: Array, of_posture: PositionUncertainty) -> Array:
        """Return (N, Q), pairs as ``_pair_clearances``: by how much each pair may be nearer than computed [m]."""
        shape, arm = self.shape, self.shape.arm
        segments = _link_segments(self.model, arm, joints)
        axis_uncertainty = AxisUncertainty.from_joints(self.model, joints, of_posture.bodies_rad)
        seen_from = [
            axis_uncertainty.displacements_from_links(ends, capsule.link)
            for capsule, ends in zip(arm, segments, strict=True)
        ]
        columns = []
        for i, j in self._checked_pairs:
            near, far = sorted((i, j), key=lambda k: arm[k].link)
            columns.append(seen_from[far][arm[near].link])
        for item in shape.obstacles:
            columns += [
                seen_part[0]
                for capsule, seen_part in zip(arm, seen_from, strict=True)
                if capsule.link >= 1 and not _is_floor_of(item, capsule)
            ]
        if shape.wire is not None:
            wire = _wire_segment(self.model, shape.wire, joints)
            axis_uncertainty = AxisUncertainty.from_joints(self.model, joints, of_posture.wire_rad)
            beside = [k for k, capsule in enumerate(arm) if capsule.link < self.model.axis_count]
            bars = [(segments[k], arm[k].link) for k in beside]
            columns += [*wire_approaches(axis_uncertainty, wire, bars)]
        return np.array(columns).T.reshape(len(joints), len(columns))

    def piece_count(self, start_rad: Array, stop_rad: Array) -> int:
        """Return into how many pieces a way must be cut for no point of the arm to move more than 5 mm."""
        turns = np.abs(self.model.joint_coupling @ (stop_rad - start_rad))
        return int(np.ceil(turns @ self._joint_levers() / _LARGEST_STEP_M)) + 1

    def is_path_free(self, waypoints_rad: Array) -> NDArray[np.bool_]:
        """Return (W - 1,): which joint moves from one waypoint to the next keep every distance on their way.

        No point of the arm moves more than 5 mm between two looks.
        """
        waypoints = np.asarray(waypoints_rad, dtype=float)
        free = np.zeros(max(len(waypoints) - 1, 0), dtype=bool)
        for i, (start, stop) in enumerate(pairwise(waypoints)):
            if not np.isfinite([*start, *stop]).all():
                continue
            steps = self.piece_count(start, stop)
            share = np.linspace(0.0, 1.0, steps + 1)[:, None]
            free[i] = bool(self.is_free(start + share * (stop - start)).all())
        return free

    def _least_clearance(self, joints_rad: Array) -> Array:
        """Return (N,) the least clearance beyond its margin; minus infinity where joints are not finite."""
        joints = np.atleast_2d(np.asarray(joints_rad, dtype=float))
        finite = np.isfinite(joints).all(axis=1)
        excess = np.full(len(joints), -np.inf)
        rows = np.flatnonzero(finite)
        for start in range(0, len(rows), _CHUNK):
            some = rows[start : start + _CHUNK]
            least = np.full(len(some), np.inf)
            for _, _, clearance, margin in self._pair_clearances(joints[some]):
                np.minimum(least, clearance - margin, out=least)
            excess[some] = least
        return excess

    def _pair_clearances(self, joints: Array) -> Iterator[tuple[str, str, Array, float]]:
        """Yield, for each pair of shapes, its names, clearances (N,) and the margin that it must keep."""
        shape, arm = self.shape, self.shape.arm
        segments = _link_segments(self.model, arm, joints)
        pairs = [(segments[i], segments[j]) for i, j in self._checked_pairs]
        for (i, j), apart in zip(self._checked_pairs, pair_distances(pairs, len(joints)), strict=True):
            yield arm[i].name, arm[j].name, apart - (arm[i].radius_m + arm[j].radius_m), shape.margin_m
        for item in shape.obstacles:
            for capsule, segment in zip(arm, segments, strict=True):
                if capsule.link >= 1 and not _is_floor_of(item, capsule):
                    clearance = _obstacle_distance(item, segment) - capsule.radius_m
                    yield capsule.name, item.name, clearance, shape.margin_m
        if shape.wire is not None:
            wire = _wire_segment(self.model, shape.wire, joints)
            beside = [k for k, capsule in enumerate(arm) if capsule.link < self.model.axis_count]
            wire_apart = pair_distances([(wire, segments[k]) for k in beside], len(joints))
            for k, apart in zip(beside, wire_apart, strict=True):
                yield arm[k].name, "draw-wire", apart - arm[k].radius_m, shape.wire_margin_m

    @cached_property
    def _quantity_names(self) -> tuple[str, ...]:
        """What each pair's clearance is called: the same in every posture."""
        return tuple(
            make_message("clearance of {first} and {second}", first=first, second=second)
            for first, second, _, _ in self._pair_clearances(np.zeros((1, self.model.axis_count)))
        )

    @cached_property
    def _checked_pairs(self) -> list[tuple[int, int]]:
        return list(_capsule_pairs(self.shape.arm, self.touching))

    def _joint_levers(self) -> Array:
        """Return (n,): how far from each joint any point of the arm can be [m]."""
        lengths = np.linalg.norm(self.model.placements[1:, :3, 3], axis=1)
        slides = self.model.sliding
        if slides is not None:
            ends = np.maximum(np.abs(self.model.lower_rad), np.abs(self.model.upper_rad))
            lengths = lengths + np.where(slides, ends, 0.0)
        beyond = np.cumsum(lengths[::-1])[::-1]
        beside = [
            capsule.radius_m
            + max(float(np.linalg.norm(end)) for end in (capsule.start_m, capsule.end_m))
            - (lengths[capsule.link - 1] if 0 < capsule.link < self.model.axis_count else 0.0)
            for capsule in self.shape.arm
        ]
        thick = max([0.0, *beside])
        levers = beyond + thick
        return np.asarray(levers if slides is None else np.where(slides, 1.0, levers), dtype=np.float64)


def _link_segments(model: RobotModel, arm: Sequence[LinkCapsule], joints: Array) -> list[Segment]:
    rotations, origins = chain_frames(model, joints)

    def place_point(link: int, point: Place) -> Array:
        return np.asarray(np.einsum("jin,i->jn", rotations[link], np.array(point)) + origins[link])

    return [(place_point(c.link, c.start_m), place_point(c.link, c.end_m)) for c in arm]


def _wire_segment(model: RobotModel, wire: WirePath, joints: Array) -> Segment:
    hook = model.tip_positions(joints, np.array(wire.hook_in_flange_m)).T
    return np.array(wire.anchor_in_base_m)[:, None], hook


def _capsule_pairs(
    arm: Sequence[LinkCapsule], touching: frozenset[tuple[int, int]]
) -> Iterator[tuple[int, int]]:
    """Yield pairs of capsules on links that neither share a joint nor touch by construction."""
    for j in range(len(arm)):
        for i in range(j):
            links = _link_pair(arm, i, j)
            if links[1] - links[0] > 1 and links not in touching:
                yield i, j


def _link_pair(arm: Sequence[LinkCapsule], i: int, j: int) -> tuple[int, int]:
    first, second = sorted((arm[i].link, arm[j].link))
    return first, second


def _bar_clearance(arm: Sequence[LinkCapsule], segments: Sequence[Segment], i: int, j: int) -> Array:
    return segment_distance(segments[i], segments[j]) - (arm[i].radius_m + arm[j].radius_m)


def _obstacle_distance(item: Obstacle, segment: Segment) -> Array:
    if isinstance(item, SphereObstacle):
        centre = np.array(item.centre_in_base_m)[:, None]
        return segment_distance(segment, (centre, centre)) - item.radius_m
    if isinstance(item, PlaneObstacle):
        return plane_distance(segment, np.array(item.point_in_base_m), np.array(item.normal_in_base))
    return box_distance(segment, item.base_box, np.array(item.size_m))


def _is_floor_of(item: Obstacle, capsule: LinkCapsule) -> bool:
    """Return whether this is the floor under the first link, which only turns about itself."""
    return isinstance(item, PlaneObstacle) and capsule.link == 1
