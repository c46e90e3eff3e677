"""Lost turns seen at places that stay: touched points, a keyed seat, a target that an instrument sees.

A place measured while the robot was healthy and again after the loss needs no coordinates: that it is the same
place is the observation. What both visits share, such as link errors and an unknown tip, falls out as far as the
postures are alike, and stays in the covariance as far as they are not.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from cellcal.calibration.arm.kinematics import RobotModel
from cellcal.calibration.errors import CalibrationError, DegenerateDataError
from cellcal.calibration.geometry import Array, log_rotation
from cellcal.calibration.mastering.counts import DriveTrain, PlaceCapture, RecoveryKit
from cellcal.calibration.mastering.turn_hypotheses import Equipment, LocalResiduals, bent_links
from cellcal.calibration.message import make_message
from cellcal.calibration.registration import best_fit_transform
from cellcal.calibration.wires.model import with_geometry

_NEAR_M, _NEAR_RAD = (
    0.02,
    0.02,
)  # how far the nominal arm may be wrong about a place, or about an instrument's
_LARGEST_KNOCK_M = 0.005  # how far a knock may have moved a tip
_TIP_CHANGED_M = 0.0015  # … and how far it may be from where it was without one
_TIP = "the tip"
_MOVED_SIGMAS = 6.0  # between fixed targets, then and now
_STEP = 1e-6  # of the differences; errors of second order stay below 1e-9
_FLEX_RANGE_RAD = 0.6
_HALF_TURN_RAD = 3.0


@dataclass(frozen=True, eq=False, slots=True)
class _ArmPoses:
    """Tips (N, 3) and attitudes (N, 3, 3) of the arm at N postures."""

    tips: Array
    rotations: Array

    def __sub__(self, other: "_ArmPoses") -> Array:
        """Return how far this is from the other, as rows (N, 6): way [m], rotation vector [rad]."""
        turned = self.rotations @ np.swapaxes(other.rotations, 1, 2)
        return np.hstack([self.tips - other.tips, _rotation_vectors(turned)])


class PlaceProblem:
    """Captures of a robot with lost counts at places that it visited while it was healthy."""

    def __init__(
        self,
        model: RobotModel,
        kit: RecoveryKit,
        robot: tuple[DriveTrain, tuple[int, ...]],
        captures: Sequence[PlaceCapture],
    ) -> None:
        drive, zero = robot
        numbers = {capture.place for capture in captures}
        reference_places = [
            place for place in kit.places if place.place in numbers or place.kind in ("target", "nest")
        ]
        if unknown := numbers - {place.place for place in reference_places}:
            raise CalibrationError(
                make_message("the record does not know the places {places}", places=sorted(unknown))
            )
        if any(len(c.counts) != model.axis_count for c in (*reference_places, *captures)):
            raise CalibrationError(
                make_message(
                    "every capture needs the counts of all {axis_count} motors", axis_count=model.axis_count
                )
            )
        self._model, self._kit, self._healthy = model, kit, len(reference_places)
        # fixed targets tell where the instrument stands, whatever turns were lost: given like the record
        self._all_captures = (*reference_places, *(c for c in captures if c.kind == "nest"))
        self._now = tuple(c for c in captures if c.kind != "nest")
        self._per_turn = drive.radians_per_turn()
        self._then_joints = _capture_joints(drive, zero, self._all_captures, model.axis_count)
        self._read_joints = _capture_joints(drive, zero, self._now, model.axis_count)
        self.capture_count = len(self._now)
        self._stations = self._registered_stations()

    def model_values(self, turns: Array) -> Array:
        """Return what is modelled (m,): tips and attitudes of the arm, zero for a nest."""
        arm = self._arm_poses(self._joints_now(turns))
        return self._pick_rows(self._now, arm - self._arm_poses(self._read_joints))

    def linearise_at(self, turns: Array) -> LocalResiduals:
        """Look at the captures as if the motors had lost these turns (n,)."""
        joints = np.vstack([self._then_joints, self._joints_now(turns)])
        every = (*self._all_captures, *self._now)
        misfit, columns, sigmas = self._place_misfit(joints), *self._unknown_columns(joints)
        by_joint = self._by_joint(joints)
        weighted = columns * sigmas
        total = weighted @ weighted.T + self._capture_scatter(joints, by_joint)
        first = len(self._pick_rows(self._all_captures, np.zeros((len(self._all_captures), 6))))
        gain = total[first:, :first] @ np.linalg.inv(total[:first, :first])
        conditioned = total[first:, first:] - gain @ total[:first, first:]
        rows = self._capture_rows(self._now)
        geometry = columns[first:, 3 : 3 + self._model_errors()]
        return LocalResiduals(
            turns=turns,
            joints_rad=joints[len(self._all_captures) :],
            values=self.model_values(turns),
            residuals=-(misfit[first:] - gain @ misfit[:first]),
            by_turn=_stack_rows(every[len(self._all_captures) :], by_joint[len(self._all_captures) :])
            @ self._per_turn,
            scatter=(conditioned + conditioned.T) / 2.0,
            parts={
                _TIP: columns[first:, :3] * _LARGEST_KNOCK_M,
                **bent_links(geometry, self._model.axis_count),
            },
            rows=rows,
            equipment=Equipment(_TIP, (_TIP,), columns[first:, :3] * _TIP_CHANGED_M, ()),
        )

    def _joints_now(self, turns: Array) -> Array:
        joints: Array = self._read_joints + turns @ self._per_turn.T
        return joints

    def _arm_poses(self, joints: Array, tip: Array | None = None, errors: Array | None = None) -> _ArmPoses:
        model = self._model if errors is None else with_geometry(self._model, errors)
        frames = model.base_flange(joints)
        at = np.array(self._kit.tip_in_flange_m) if tip is None else tip
        return _ArmPoses(frames[:, :3, 3] + frames[:, :3, :3] @ at, frames[:, :3, :3])

    def _model_errors(self) -> int:
        return 5 * self._model.axis_count if self._model.dh is not None else 6 * (self._model.axis_count + 1)

    def _by_joint(self, joints: Array) -> Array:
        """Return (N, 6, n): tip and attitude by joint, central differences."""
        axes = self._model.axis_count
        ways = [
            self._arm_poses(joints + _STEP * e) - self._arm_poses(joints - _STEP * e) for e in np.eye(axes)
        ]
        by_joint: Array = np.stack(ways, axis=2) / (2.0 * _STEP)
        arms = np.array([capture.kind != "nest" for capture in (*self._all_captures, *self._now)])
        derivatives: Array = by_joint * arms[:, None, None]
        return derivatives

    def _unknown_columns(self, joints: Array) -> tuple[Array, Array]:
        """Return columns (m, p) of tip, geometry, places and stations, and their deviations (p,)."""
        kit, every = self._kit, (*self._all_captures, *self._now)
        tip = np.array(kit.tip_in_flange_m)
        arms = np.array([capture.kind != "nest" for capture in every])[:, None]
        columns, sigmas = [], []
        for e in np.eye(3):
            way = self._arm_poses(joints, tip + _STEP * e) - self._arm_poses(joints, tip - _STEP * e)
            columns.append(self._pick_rows(every, way * arms / (2.0 * _STEP)))
            sigmas.append(kit.sigma_tip_m)
        count = self._model_errors()
        for k, e in enumerate(np.eye(count)):
            way = self._arm_poses(joints, None, _STEP * e) - self._arm_poses(joints, None, -_STEP * e)
            columns.append(self._pick_rows(every, way * arms / (2.0 * _STEP)))
            angle = k % 5 in (0, 3, 4) if self._model.dh is not None else k % 6 > 2
            sigmas.append(kit.sigma_angle_rad if angle else kit.sigma_length_m)
        places, place_sigmas = self._place_columns(every)
        stations = self._station_columns(every)
        return np.column_stack([*columns, *places, *stations]), np.array(
            [*sigmas, *place_sigmas, *([_NEAR_M] * 3 + [_NEAR_RAD] * 3) * (len(stations) // 6)]
        )

    def _place_columns(self, every: Sequence[PlaceCapture]) -> tuple[list[Array], list[float]]:
        columns, sigmas = [], []
        for number in sorted({c.place for c in every if c.kind != "target"}):
            mine = np.array([c.place == number and c.kind != "target" for c in every])
            seat = any(c.kind == "seat" for c, yes in zip(every, mine, strict=True) if yes)
            for k in range(6 if seat else 3):
                signs = np.array([1.0 if c.kind == "nest" else -1.0 for c in every])
                way = np.zeros((len(every), 6))
                way[mine, k] = signs[mine]
                columns.append(self._pick_rows(every, way))
                sigmas.append(_NEAR_M if k < 3 else _NEAR_RAD)
        return columns, sigmas

    def _station_columns(self, every: Sequence[PlaceCapture]) -> list[Array]:
        """Return six columns for where the instrument stood then, and six for where it stands now."""
        if all(c.seen_m is None for c in every):
            return []
        columns = []
        for session in (0, 1):
            mine = [c.seen_m is not None and int(k >= self._healthy) == session for k, c in enumerate(every)]
            positions = np.array([self._seen_in_base(c, session) if yes else np.zeros(3)
                             for c, yes in zip(every, mine, strict=True)])  # fmt: skip
            for k in range(6):
                way = np.zeros((len(every), 6))
                way[:, :3] = -np.eye(3)[k] if k < 3 else -np.cross(np.eye(3)[k - 3], positions)
                columns.append(self._pick_rows(every, way * np.array(mine)[:, None]))
        return columns

    def _seen_in_base(self, capture: PlaceCapture, session: int) -> Array:
        station = self._stations[session]
        position: Array = station[:3, :3] @ np.array(capture.seen_m) + station[:3, 3]
        return position

    def _place_misfit(self, joints: Array) -> Array:
        """Return the arm minus its place (m,), places and stations taken as the record has them."""
        every, first = (*self._all_captures, *self._now), self._healthy
        arm, then = self._arm_poses(joints), self._arm_poses(self._then_joints)
        index = {c.place: k for k, c in enumerate(self._all_captures[: self._healthy])}
        ways = np.zeros((len(every), 6))
        for k, capture in enumerate(every):
            session = int(k >= first)
            if capture.kind == "nest":
                place = self._seen_in_base(self._all_captures[index[capture.place]], 0)
                ways[k, :3] = place - self._seen_in_base(capture, session)
            elif capture.kind == "target":
                ways[k, :3] = arm.tips[k] - self._seen_in_base(capture, session)
            else:
                home = index[capture.place]
                mine = _ArmPoses(arm.tips[k : k + 1], arm.rotations[k : k + 1])
                ways[k] = (mine - _ArmPoses(then.tips[home : home + 1], then.rotations[home : home + 1]))[0]
        return self._pick_rows(every, ways)

    def _capture_scatter(self, joints: Array, by_joint: Array) -> Array:
        """Return what is drawn anew at every capture, and what sag shares between postures that are alike."""
        kit, every = self._kit, (*self._all_captures, *self._now)
        rows = _stack_rows(every, by_joint)
        of = np.repeat(np.arange(len(every)), [s.stop - s.start for s in self._capture_rows(every)])
        gaps = joints[:, None, :] - joints[None, :, :]
        alike = np.exp(-np.einsum("abj,abj->ab", gaps, gaps) / (2.0 * _FLEX_RANGE_RAD**2))
        lever = rows @ rows.T
        same = of[:, None] == of[None, :]
        noise = [
            s for c in every for s in ([c.sigma_m] * 3 + [c.sigma_rad] * 3)[: 6 if c.kind == "seat" else 3]
        ]
        scatter: Array = lever * (
            kit.sigma_flex_rad**2 * alike[np.ix_(of, of)] + kit.sigma_joint_rad**2 * same
        )
        scatter += np.diag(np.square(noise))
        return scatter

    def _registered_stations(self) -> tuple[Array, Array]:
        """Return where the instrument stood then and stands now, as well as plain registration tells."""
        healthy_captures = self._all_captures[: self._healthy]
        targets = [k for k, c in enumerate(healthy_captures) if c.kind == "target"]
        if not targets:
            return np.eye(4), np.eye(4)
        tips = self._arm_poses(self._then_joints).tips[targets]
        then = best_fit_transform(
            [_seen_position(healthy_captures[k]) for k in targets], tips.tolist()
        ).target_source.to_matrix()
        nests = {c.place: c for c in healthy_captures if c.kind == "nest"}
        pairs = [(c, nests[c.place]) for c in self._all_captures[self._healthy :]]
        if len(pairs) < 3:
            raise DegenerateDataError(
                make_message(
                    "{count} fixed targets do not tell where the instrument stands now", count=len(pairs)
                ),
                remedy="Measure at least three fixed targets of the record again, before the arm's own.",
            )
        moved = best_fit_transform(
            [_seen_position(now) for now, _ in pairs], [_seen_position(was) for _, was in pairs]
        )
        sigma_m = max(c.sigma_m for pair in pairs for c in pair)
        if moved.max_m > _MOVED_SIGMAS * sigma_m:
            raise DegenerateDataError(
                make_message(
                    "the fixed targets are up to {away_mm:.2f} mm from where they were to each other",
                    away_mm=1e3 * moved.max_m,
                ),
                remedy="See that every target sits in its own nest; leave out a nest that was moved.",
            )
        return then, then @ moved.target_source.to_matrix()

    def _capture_rows(self, captures: Sequence[PlaceCapture]) -> tuple[slice, ...]:
        ends = np.cumsum([0, *(6 if c.kind == "seat" else 3 for c in captures)])
        return tuple(slice(int(a), int(b)) for a, b in pairwise(ends))

    def _pick_rows(self, captures: Sequence[PlaceCapture], ways: Array) -> Array:
        """Return the rows that count of (N, 6): all six of a seat, the place alone of the others."""
        keep = np.array([[True] * 3 + [c.kind == "seat"] * 3 for c in captures], dtype=bool).reshape(-1, 6)
        picked: Array = ways[keep]
        return picked


def _rotation_vectors(rotations: Array) -> Array:
    """Return the rotation vectors (N, 3) of N rotations (N, 3, 3); of those by almost a half turn one by one."""
    skew = rotations - np.swapaxes(rotations, 1, 2)
    doubled = np.stack([skew[:, 2, 1], skew[:, 0, 2], skew[:, 1, 0]], axis=1)
    sine, cosine = (
        np.linalg.norm(doubled, axis=1) / 2.0,
        (np.trace(rotations, axis1=1, axis2=2) - 1.0) / 2.0,
    )
    angle = np.arctan2(sine, cosine)
    vectors: Array = doubled / 2.0 * (angle / np.maximum(sine, 1e-300))[:, None]
    small = sine < 1e-12
    vectors[small] = doubled[small] / 2.0
    for k in np.flatnonzero(angle > _HALF_TURN_RAD):
        vectors[k] = log_rotation(rotations[k])
    return vectors


def _seen_position(capture: PlaceCapture) -> tuple[float, float, float]:
    if capture.seen_m is None:
        raise CalibrationError(
            make_message("capture {label!r} does not say where its target was seen", label=capture.label)
        )
    return capture.seen_m


def _stack_rows(captures: Sequence[PlaceCapture], by_joint: Array) -> Array:
    keep = np.array([[True] * 3 + [c.kind == "seat"] * 3 for c in captures], dtype=bool)
    rows: Array = by_joint[keep]
    return rows


def _capture_joints(
    drive: DriveTrain, zero: tuple[int, ...], captures: Sequence[PlaceCapture], axes: int
) -> Array:
    counts = np.array([c.counts for c in captures], dtype=float).reshape(-1, axes)
    return drive.to_joints(counts, np.array(zero))
