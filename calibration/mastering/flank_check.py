"""What coming to the same posture from the other side tells: the play of the gears, or that something is loose.

Two lengths at one posture differ by what changed between them and by nothing else: link errors, sag, ripple and the
wire's own errors are the same. From the same side that is warmth, a hook that slips, a wire that was touched; from
the other side it is, beside these, the tooth flanks of the joints that no weight holds. Derived here.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from cellcal.calibration.arm.kinematics import RobotModel
from cellcal.calibration.errors import CalibrationError
from cellcal.calibration.geometry import Array
from cellcal.calibration.mastering.counts import MasteringRecord, WireCapture
from cellcal.calibration.mastering.turn_results import TurnRecovery
from cellcal.calibration.wires.arm import flank_values
from cellcal.calibration.wires.model import WirePoses, WireTerms
from cellcal.calibration.wires.reference import WirePredictor

SAME_POSTURE_RAD = 0.01  # two captures nearer than that are of one posture
SIGMAS = 3.29  # 99.9 %
OTHER_SIDE = "other"


@dataclass(frozen=True, slots=True)
class FlankCheck:
    """Check postures measured twice. What was not measured is None; U are k = 2.

    ``moved_m`` is the largest change of a length from the same side, ``lost_motion_m`` from the other side;
    ``backlash_rad`` is the play per unloaded joint that explains the latter best, all of them alike.
    """

    moved_m: float | None
    moved_limit_m: float
    lost_motion_m: float | None
    lost_motion_limit_m: float
    backlash_rad: float | None
    backlash_u_rad: float
    joints: tuple[str, ...]  # that no weight holds on one flank
    pairs: int

    @property
    def nothing_moved(self) -> bool:
        """Whether hook, wire and warmth stayed, as far as the lengths tell."""
        return self.moved_m is None or self.moved_m <= self.moved_limit_m

    @property
    def nothing_loose(self) -> bool:
        """Whether the other side differs by no more than the teeth of gears."""
        return self.lost_motion_m is None or self.lost_motion_m <= self.lost_motion_limit_m


def compare_flanks(
    model: RobotModel,
    record: MasteringRecord,
    recovery: TurnRecovery,
    before: Sequence[WireCapture],
    again: Sequence[WireCapture],
) -> FlankCheck:
    """Compare captures with earlier ones of the same postures.

    Parameters
    ----------
    model : RobotModel
        Nominal model of the record.
    record : MasteringRecord
        Taken while the robot was healthy.
    recovery : TurnRecovery
        By which the counts of both become joints.
    before, again : sequences of WireCapture
        ``settled_from`` of ``again`` is "record" for the same side as before, "other" for the other one.

    Raises
    ------
    CalibrationError
        There is nothing to compare.
    """
    if not before or not again:
        raise CalibrationError("two captures of one posture are needed to look at the tooth flanks")
    wire, prior = record.wire_lengths()
    predictor = WirePredictor(model, wire, prior)
    then, now = (_wire_terms_of(predictor, record, recovery, captures) for captures in (before, again))
    apart = np.abs(now.poses.joints_rad[:, None] - then.poses.joints_rad[None]).max(axis=2)
    pairs = [(k, int(row.argmin())) for k, row in enumerate(apart) if row.min() <= SAME_POSTURE_RAD]
    change = np.array([_length_change((before, then), (again, now), pair) for pair in pairs])
    noise = np.array(
        [_change_noise(prior.sigma_repeat_rad, (before, then), (again, now), pair) for pair in pairs]
    )
    other = np.array([again[k].settled_from == OTHER_SIDE for k, _ in pairs], dtype=bool)
    loaded, _ = flank_values(model, now.poses.joints_rad)
    loose = [joint for joint in range(model.axis_count) if joint not in loaded]
    lever = np.array([now.by_joint[k, loose].sum() for k, _ in pairs])
    flanks = np.array([np.linalg.norm(now.by_joint[k, loose]) for k, _ in pairs])
    limits = SIGMAS * np.sqrt(noise + (2.0 * prior.sigma_backlash_rad * flanks) ** 2)
    backlash, u_rad = _estimate_backlash(change[other], noise[other], lever[other])
    return FlankCheck(
        *_worst_change(change[~other], SIGMAS * np.sqrt(noise[~other])),
        *_worst_change(change[other], limits[other]),
        backlash,
        u_rad,
        tuple(model.joint_names[joint] for joint in loose),
        len(pairs),
    )


def _wire_terms_of(
    predictor: WirePredictor, record: MasteringRecord, recovery: TurnRecovery, captures: Sequence[WireCapture]
) -> WireTerms:
    counts = np.array([capture.counts for capture in captures], dtype=float)
    joints = record.drive.to_joints(counts, np.array(record.counts_at_zero))
    joints = joints + record.drive.radians_per_turn() @ np.array(recovery.offset_turns)
    return predictor.wire_terms(
        WirePoses.from_record_side(joints, np.array([capture.sigma_m for capture in captures]))
    )


FlankLook = tuple[Sequence[WireCapture], WireTerms]


def _length_change(before: FlankLook, again: FlankLook, pair: tuple[int, int]) -> float:
    """Return by how much more a length changed than its posture [m]."""
    (k, first), (captures, terms), (earlier, was) = pair, again, before
    expected = float(terms.lengths[k] - was.lengths[first])
    return captures[k].length_m - earlier[first].length_m - expected


def _change_noise(
    sigma_repeat_rad: float, before: FlankLook, again: FlankLook, pair: tuple[int, int]
) -> float:
    (k, first), (captures, terms), (earlier, _) = pair, again, before
    resting = 2.0 * sigma_repeat_rad**2 * float(np.sum(terms.by_joint[k] ** 2))
    return captures[k].sigma_m ** 2 + earlier[first].sigma_m ** 2 + resting


def _worst_change(changes: Array, limits: Array) -> tuple[float | None, float]:
    if not len(changes):
        return None, 0.0
    worst = int(np.argmax(np.abs(changes) / limits))
    return float(abs(changes[worst])), float(limits[worst])


def _estimate_backlash(changes: Array, noise: Array, lever: Array) -> tuple[float | None, float]:
    """Return the play that all unloaded joints would have to have, and its U (k = 2) [rad]."""
    information = float(np.sum(lever**2 / noise)) if len(changes) else 0.0
    if information <= 0.0:
        return None, 0.0
    return float(np.sum(lever * changes / noise)) / information, 2.0 / float(np.sqrt(information))
