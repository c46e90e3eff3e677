"""Pose accuracy and repeatability from attained poses, with the formulas of ISO 9283, before and after.

The text of ISO 9283:1998 was not at hand when this was written: the formulas and the test poses are the common
knowledge of the trade, and the repeatability was compared with a published analyser's. What is measured with
fewer cycles, another load or another speed carries `REDUCED_TITLE`, and no caller can change that.
"""

import math
from dataclasses import dataclass

import numpy as np

from cellcal.calibration.errors import CalibrationError
from cellcal.calibration.geometry import Array, log_rotation
from cellcal.calibration.message import make_message

Triple = tuple[float, float, float]

REDUCED_TITLE = "reduced test following ISO 9283, not a test to ISO 9283"
FULL_TITLE = "pose accuracy and repeatability following ISO 9283:1998"
FULL_CYCLES = 30
FULL_POSES = 5
SAME_POSE_RAD = math.radians(0.2)  # twice the coarsest step in which controllers write joint angles
_INSET = 0.1  # of the diagonal, from its corners
# Variance of l + 3 S times n / S^2 where distances follow Maxwell: 1 + 9 (kurtosis - 1) / 4 + 3 skewness.
_RP_VARIANCE = 1 + 9 * 2.1082 / 4 + 3 * 0.4857


@dataclass(frozen=True, slots=True)
class AccuracyConditions:
    """The conditions under which the robot was moved; all of it is printed beside the result."""

    load_share: float  # of the rated load
    speed_share: float  # of the rated speed
    warmed_up: bool
    one_direction: bool  # every pose approached from the same side


@dataclass(frozen=True, slots=True)
class PoseResult:
    """Accuracy and repeatability at one pose; turns are about the base's axes."""

    ap_m: float
    ap_parts_m: Triple  # mean attained minus commanded
    ap_sigma_m: float  # standard uncertainty of ap_m, from the scatter and the device
    rp_m: float
    rp_sigma_m: float
    cycles: int
    ap_turns_rad: Triple | None
    rp_turns_rad: Triple | None  # three standard deviations, to either side


@dataclass(frozen=True, slots=True)
class AccuracyTest:
    """All poses of a test. The totals are the worst pose's, because a robot is as good as its worst pose."""

    title: str
    poses: tuple[PoseResult, ...]
    cycles: int
    conditions: AccuracyConditions
    departures: tuple[str, ...]  # from the full test

    @property
    def ap_m(self) -> float:
        """The largest positional accuracy of any pose."""
        return max(pose.ap_m for pose in self.poses)

    @property
    def rp_m(self) -> float:
        """The largest positional repeatability of any pose."""
        return max(pose.rp_m for pose in self.poses)


@dataclass(frozen=True, eq=False)
class AttainedPoses:
    """The commanded poses, and those that an instrument saw, all in the base frame."""

    commanded_m: Array  # (P, 3)
    positions_m: Array  # (P, n, 3)
    joints_rad: Array  # (P, axes) commanded
    commanded_rotations: Array | None = None  # (P, 3, 3)
    rotations: Array | None = None  # (P, n, 3, 3)
    device_sigma_m: float = 0.0  # standard uncertainty of the instrument that does not average out

    def __post_init__(self) -> None:
        poses, cycles = np.shape(self.positions_m)[:2] if np.ndim(self.positions_m) == 3 else (0, 0)
        shapes = [(self.commanded_m, (poses, 3)), (self.positions_m, (poses, cycles, 3))]
        if (self.rotations is None) != (self.commanded_rotations is None):
            raise CalibrationError("attained turns need commanded ones, and the other way round")
        if self.rotations is not None and self.commanded_rotations is not None:
            shapes += [(self.commanded_rotations, (poses, 3, 3)), (self.rotations, (poses, cycles, 3, 3))]
        wrong = [value for value, shape in shapes if np.shape(value) != shape or not np.isfinite(value).all()]
        if wrong or len(self.joints_rad) != poses or not np.isfinite(self.joints_rad).all() or poses == 0:
            raise CalibrationError(
                "attained poses must be finite: P poses of n cycles, with P commanded ones"
            )
        if cycles < 2:
            raise CalibrationError(
                f"{cycles} cycle says nothing about repeatability.", remedy="Go round five times or more."
            )
        if not 0 <= self.device_sigma_m < math.inf:
            raise CalibrationError("the instrument's uncertainty must be zero or more")


def cube_positions(centre_m: Triple, side_m: float, plane: int = 0) -> Array:
    """Return the five test positions (5, 3) in a cube with edges along the base's axes.

    P1 is the centre; P2 to P5 lie on the two space diagonals in one of the four inclined planes, 10 % of the
    diagonal from its corners. ``plane`` 0 to 3 chooses: through the x edges rising or falling along y, through the
    y edges rising or falling along x.
    """
    if plane not in range(4) or not 0 < side_m < math.inf:
        raise CalibrationError("a test cube has a positive side and planes 0 to 3")
    rise = 1.0 if plane % 2 == 0 else -1.0
    flat = [(1, 1), (-1, 1), (-1, -1), (1, -1)]
    corners = [(a, b, rise * b) if plane < 2 else (b, a, rise * b) for a, b in flat]
    offsets = np.array([(0, 0, 0), *corners]) * (0.5 - _INSET) * side_m
    positions: Array = np.asarray(centre_m, dtype=float) + offsets
    return positions


def evaluate_accuracy(
    attained: AttainedPoses, conditions: AccuracyConditions, *, fitted_joints_rad: Array
) -> AccuracyTest:
    """Evaluate pose accuracy AP and repeatability RP at poses that took no part in a fit.

    Parameters
    ----------
    attained : Attained
        Commanded and attained poses in the base frame [m].
    conditions : Conditions
        Load, speed, warm-up and approach.
    fitted_joints_rad : (F, axes)
        Joints of every row that the model was fitted to [rad]; (0, axes) where nothing was fitted.

    Returns
    -------
    AccuracyTest
        Titled as reduced unless nothing of the full test is missing; ``departures`` says what is.

    Raises
    ------
    CalibrationError
        A test pose was fitted: its error would be a residual, which is no accuracy.

    Notes
    -----
    ``AP = |mean - commanded|`` and ``RP = l + 3 S`` with l the mean and S the standard deviation (n - 1) of the
    distances from the mean place. Turns are rotation vectors from the commanded attitude in base axes: for turns
    this small they are the angles about x, y, z of the standard, without the trouble of its angles at 90 degrees.
    The uncertainty of RP takes the scatter as normal and alike in all directions.

    References
    ----------
    ISO 9283:1998, clause 7.2 (from secondary sources); J. Leland, iso9283testanalyzer.m, for RP.
    """
    refuse_fitted(attained.joints_rad, fitted_joints_rad)
    cycles = attained.positions_m.shape[1]
    poses = tuple(_pose_result(attained, index) for index in range(len(attained.positions_m)))
    departures = _list_departures(len(poses), cycles, conditions)
    return AccuracyTest(REDUCED_TITLE if departures else FULL_TITLE, poses, cycles, conditions, departures)


def refuse_fitted(
    test_joints_rad: Array, fitted_joints_rad: Array, *, same_rad: float = SAME_POSE_RAD
) -> None:
    """Refuse test poses whose joints all are within ``same_rad`` of a row that was fitted.

    Raises
    ------
    CalibrationError
        With the test poses and the rows, counted from zero.
    """
    test, fitted = np.asarray(test_joints_rad, dtype=float), np.asarray(fitted_joints_rad, dtype=float)
    if test.ndim != 2 or fitted.ndim != 2 or test.shape[1] != fitted.shape[1]:
        raise CalibrationError("test and fitted joints must be of the same robot, one row a pose")
    if not np.isfinite(fitted).all():
        raise CalibrationError("the joints of the fitted rows must be finite")
    pairs = [
        f"pose {index} is row {row}"
        for index, joints in enumerate(test)
        for row in np.flatnonzero((np.abs(fitted - joints) <= same_rad).all(axis=1))[:1]
    ]
    if pairs:
        raise CalibrationError(
            f"{len(pairs)} of {len(test)} test poses were fitted ({', '.join(pairs[:3])}): "
            "their errors are residuals.",
            remedy="Test at poses that the fit has not seen, or fit without these rows.",
            code="calibration.leakage",
        )


def _pose_result(attained: AttainedPoses, index: int) -> PoseResult:
    positions = attained.positions_m[index]
    n = len(positions)
    mean = positions.mean(axis=0)
    parts = mean - attained.commanded_m[index]
    accuracy = float(np.linalg.norm(parts))
    distances = np.linalg.norm(positions - mean, axis=1)
    spread = float(distances.std(ddof=1))
    covariance = np.cov(positions.T) / n
    # Where the accuracy vanishes its direction means nothing: the worst direction stands for it.
    along = parts / accuracy if accuracy > 0 else np.linalg.eigh(covariance)[1][:, -1]
    turns = _attained_turns(attained, index)
    return PoseResult(
        ap_m=accuracy,
        ap_parts_m=_to_triple(parts),
        ap_sigma_m=math.sqrt(float(along @ covariance @ along) + attained.device_sigma_m**2),
        rp_m=float(distances.mean()) + 3 * spread,
        rp_sigma_m=spread * math.sqrt(_RP_VARIANCE / n),
        cycles=n,
        ap_turns_rad=None if turns is None else _to_triple(turns.mean(axis=0)),
        rp_turns_rad=None if turns is None else _to_triple(3 * turns.std(axis=0, ddof=1)),
    )


def _attained_turns(attained: AttainedPoses, index: int) -> Array | None:
    if attained.rotations is None or attained.commanded_rotations is None:
        return None
    return log_rotation(attained.rotations[index] @ attained.commanded_rotations[index].T)


def _list_departures(poses: int, cycles: int, conditions: AccuracyConditions) -> tuple[str, ...]:
    checks = [
        (
            cycles >= FULL_CYCLES,
            make_message("{cycles} cycles instead of {full_cycles}", cycles=cycles, full_cycles=FULL_CYCLES),
        ),
        (
            poses == FULL_POSES,
            make_message("{poses} poses instead of {full_poses}", poses=poses, full_poses=FULL_POSES),
        ),
        (
            conditions.load_share == 1.0,
            make_message("{percent:.0f} % of the rated load", percent=100 * conditions.load_share),
        ),
        (
            conditions.speed_share == 1.0,
            make_message("{percent:.0f} % of the rated speed", percent=100 * conditions.speed_share),
        ),
        (conditions.warmed_up, "not warmed up"),
        (conditions.one_direction, "approached from different sides"),
    ]
    return tuple(text for fulfilled, text in checks if not fulfilled)


def _to_triple(values: Array) -> Triple:
    x, y, z = (float(v) for v in values)
    return (x, y, z)
