"""Turns from places: which of them to record, what they would tell, and the recovery they give."""

from collections.abc import Sequence

import numpy as np

from cellcal.calibration.arm.kinematics import RobotModel, load_model
from cellcal.calibration.errors import CalibrationError
from cellcal.calibration.geometry import Array
from cellcal.calibration.mastering.counts import DriveTrain, MasteringRecord, PlaceCapture, RecoveryKit
from cellcal.calibration.mastering.hypothesis_report import RecoveryRobot
from cellcal.calibration.mastering.place_choice import PlaceChoice
from cellcal.calibration.mastering.place_evidence import PlaceProblem
from cellcal.calibration.mastering.pose_design import TURN_UNCERTAINTY
from cellcal.calibration.mastering.turn_recovery import TurnRecovery, recover_from
from cellcal.calibration.mastering.turn_verification import verify_evidence

FITTED = 6  # places that tell all motors to a few hundredths of a degree; the others are left for checking


def recover_from_places(
    record: MasteringRecord,
    kit: RecoveryKit,
    captures: Sequence[PlaceCapture],
    *,
    provisional_turns: Sequence[int],
    replaced_axes: Sequence[int] = (),
    max_turns: float = 10.0,
) -> TurnRecovery:
    """Find the turns that motors lost from places visited again; as ``recover_turns``, by the same gate."""
    model, robot = load_model(record.model), (record.drive, record.counts_at_zero)
    return recover_from(
        PlaceProblem(model, kit, robot, captures) if captures else None,
        RecoveryRobot(model, *robot),
        provisional_turns=provisional_turns,
        max_turns=max_turns,
        replaced_axes=replaced_axes,
        further=lambda _, __: _unvisited_postures(record, kit, captures),
    )


def verify_at_places(
    record: MasteringRecord,
    kit: RecoveryKit,
    recovery: TurnRecovery,
    checks: Sequence[PlaceCapture],
) -> TurnRecovery:
    """Judge a recovery at places that were not fitted; as ``verify_recovery``."""
    model = load_model(record.model)
    return verify_evidence(PlaceProblem(model, kit, (record.drive, record.counts_at_zero), checks), recovery)


def place_covariance(
    model: RobotModel, kit: RecoveryKit, robot: tuple[DriveTrain, tuple[int, ...]], numbers: Sequence[int]
) -> Array:
    """Return the covariance (n, n) [turns^2] of real estimates of the turns, were these places visited again."""
    again = [place for place in kit.places if place.place in set(numbers) or place.kind == "nest"]
    local = PlaceProblem(model, kit, robot, again).linearise_at(np.zeros(model.axis_count))
    information = local.by_turn.T @ np.linalg.solve(local.scatter, local.by_turn)
    return np.asarray(
        np.linalg.inv(information + np.eye(model.axis_count) / TURN_UNCERTAINTY**2), dtype=float
    )


def choose_places(
    model: RobotModel, kit: RecoveryKit, robot: tuple[DriveTrain, tuple[int, ...]], count: int
) -> tuple[int, ...]:
    """Choose which places to visit after a loss, best first: the smallest sum of variances of the joints.

    Greedy A-optimality; the places not chosen are left for checking.
    """
    numbers = [place.place for place in kit.places if place.kind != "nest"]
    return tuple(numbers[k] for k in PlaceChoice.from_kit(model, kit, robot).best_fit(count))


def places_to_fit(record: MasteringRecord) -> tuple[int, ...]:
    """Return the places to visit first: the best six; of a seat the seat, twice; at least two stay for checking.

    Raises
    ------
    CalibrationError
        The record holds no recovery kit.
    """
    kit = record.kit
    if kit is None:
        raise CalibrationError("the record holds no recovery kit")
    return places_to_fit_of(load_model(record.model), kit, (record.drive, record.counts_at_zero))


def places_to_fit_of(
    model: RobotModel, kit: RecoveryKit, robot: tuple[DriveTrain, tuple[int, ...]]
) -> tuple[int, ...]:
    """Return the places of a kit to visit first, as ``places_to_fit`` does for a record."""
    seats = tuple(place.place for place in kit.places if place.kind == "seat")
    if seats:
        return (seats[0], seats[0])
    arms = [place for place in kit.places if place.kind != "nest"]
    return choose_places(model, kit, robot, max(1, min(FITTED, len(arms) - 2)))


def _unvisited_postures(
    record: MasteringRecord, kit: RecoveryKit, captures: Sequence[PlaceCapture]
) -> tuple[tuple[float, ...], ...]:
    visited = {capture.place for capture in captures}
    remaining = [place.counts for place in kit.places if place.place not in visited and place.kind != "nest"]
    counts = np.array(remaining, dtype=float).reshape(-1, len(record.counts_at_zero))
    joints = record.drive.to_joints(counts, np.array(record.counts_at_zero))
    return tuple(tuple(float(q) for q in row) for row in joints)
