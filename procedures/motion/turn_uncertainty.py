"""How far a robot that lost its position may stand from where it seems to: in turns of its motors, and in space."""

from dataclasses import replace

import numpy as np

from cellcal.calibration.mastering.counts import DriveTrain, MasteringRecord
from cellcal.calibration.mastering.turn_recovery import TurnRecovery
from cellcal.calibration.motion.motion_check import MotionLimits
from cellcal.calibration.motion.position_uncertainty import PositionUncertainty
from cellcal.calibration.uncertainty import chi_square_limit
from cellcal.procedures.motion.plans import MotionBounds, motion_limits
from cellcal.procedures.motors import MotorState

Turns = tuple[float, ...]
HALF_TURN = (
    0.5  # of each motor, brakes shut since its last healthy count: one that moved further is counted wrongly
)
SURE_SIGMAS = 4.0


def first_uncertainty(room: MotionBounds, axes: int, *, is_measured: bool) -> Turns:
    """Return how far each motor may stand from where it is thought [turns], before anything is measured.

    ``is_measured``: its last healthy counts are known. Else a person brought the arm near its reference by the marks.
    """
    return (min(float(room.lost_turns), HALF_TURN) if is_measured else float(room.lost_turns),) * axes


def uncertainty_after(recovery: TurnRecovery, guess: tuple[int, ...], before: Turns) -> Turns:
    """Return the doubt that captures leave [turns]: how far off they find the guess, and how surely.

    Captures that do not fit their best explanation take no doubt away, nor do so few that anything would fit them.
    """
    if recovery.mode == "geometry" or recovery.degrees_of_freedom < 1:
        return before
    if recovery.chi_square > chi_square_limit(recovery.degrees_of_freedom):
        return before
    uncertain_turns = np.abs(np.subtract(recovery.offset_turns, guess)) + SURE_SIGMAS * np.array(
        recovery.sigma_turns
    )
    return tuple(float(v) for v in np.minimum(before, uncertain_turns))


def sure_turns(covariance: tuple[tuple[float, ...], ...]) -> Turns:
    """Return how far each motor may be from where a solution puts it [turns]."""
    return tuple(float(v) for v in SURE_SIGMAS * np.sqrt(np.diag(np.array(covariance))))


def posture_uncertainty(drive: DriveTrain, turns: Turns) -> PositionUncertainty:
    """Return by how much each joint may stand elsewhere, for doubts of its motors and those that turn it too.

    The draw-wire passes so near the wrist that it could keep no distance at two turns of every motor: it keeps
    that for half a turn.
    """
    per_turn = np.abs(drive.radians_per_turn())
    bodies, wire = per_turn @ np.array(turns), per_turn @ np.minimum(turns, HALF_TURN)
    return PositionUncertainty(tuple(float(v) for v in bodies), tuple(float(v) for v in wire))


def lost_limits(state: MotorState, record: MasteringRecord, room: MotionBounds, turns: Turns) -> MotionLimits:
    """Return the limits of motion of a robot whose motors may stand so many turns from where they are thought."""
    return replace(
        motion_limits(state, record.drive, room),
        position_uncertainty=posture_uncertainty(record.drive, turns),
    )
