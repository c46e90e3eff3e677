"""What the readings of a drift check say: a new reference, or the likely cause of a change."""

import math
from dataclasses import dataclass

import numpy as np

from cellcal.calibration.drift.causes import (
    DEVICE,
    NOTHING,
    OTHER,
    TOOL,
    WARMTH,
    DriftCause,
    DriftFinding,
    drift_causes,
    explain_changes,
    most_informative_pose,
)
from cellcal.calibration.drift.reference import DriftReference
from cellcal.calibration.message import make_message
from cellcal.drivers.interfaces import Joints
from cellcal.procedures.arm.arm_bench import ArmCapture, Bench, noise_m, station_of, values_of
from cellcal.procedures.arm.drift_plan import REPEAT_M, DriftRules

NEXT = {
    NOTHING: "nothing: go on working",
    WARMTH: "let the robot reach its working temperature, or cool down, and run drift_check again",
    TOOL: "look at the tool and its mount; then six_point_tcp or end_effector_points, and a new reference",
    DEVICE: "see that the measuring device stands and hangs as it did; then take a new reference (renew)",
    OTHER: "look for a collision or for more than one change; then robot_calibration",
    "joint": "look at that axis; mastering_recovery if its encoder lost its turns, else robot_calibration",
}


@dataclass(frozen=True, slots=True)
class DriftCaptures:
    """The measurements so far, and at which poses of the reference."""

    reference: DriftReference
    poses: tuple[int, ...]
    captures: tuple[ArmCapture, ...]

    def sigma_m(self) -> float:
        """Return the standard deviation [m] of one coordinate of a change: both readings, and the arm coming back."""
        now_m = max(map(noise_m, self.captures))
        return math.hypot(self.reference.sigma_m(REPEAT_M), now_m, REPEAT_M)

    def estimate_causes(self, bench: Bench, poses: tuple[int, ...]) -> tuple[DriftCause, ...]:
        """Return how each cause would move the readings at poses of the reference."""
        rows, joints = list(poses), np.array(self.reference.joints_rad)
        places = self.reference.values_m()[rows] if bench.method == "tracker" else None
        return drift_causes(bench.make_task(), joints[rows], places)


@dataclass(frozen=True, slots=True)
class DriftAssessment:
    """The assessment of the poses measured so far, and which further one would decide; -1 for none."""

    finding: DriftFinding
    decided: bool
    next_pose: int


@dataclass(frozen=True, slots=True)
class DriftResult:
    """A new reference, or what changed since the old one."""

    reference: DriftReference
    taken_now: bool
    look: DriftAssessment | None
    measured: tuple[int, ...]  # poses of the reference, from 0
    sigma_m: float
    recommended: str

    @property
    def saving_text(self) -> str:
        """The effort saved by stopping as soon as it was decided, in words."""
        taken, every = len(self.measured), len(self.reference.poses_rad)
        if taken >= every:
            return make_message("no saving: all {every} poses of the reference were needed", every=every)
        share = 1.0 - taken / every
        return make_message(
            "{taken} poses; a fixed plan goes to all {every} of the reference: {share_percent:.0f} % saved",
            taken=taken,
            every=every,
            share_percent=share * 100,
        )


def look_for_changes(bench: Bench, captures: DriftCaptures, rules: DriftRules) -> DriftAssessment:
    """Explain the changes so far; where that is not sure, say which pose of the reference would decide."""
    reference, sigma_m = captures.reference, captures.sigma_m()
    changes = values_of(captures.captures) - reference.values_m()[list(captures.poses)]
    taken = captures.estimate_causes(bench, captures.poses)
    finding = explain_changes(taken, changes, sigma_m)
    unmeasured = tuple(k for k in range(len(reference.poses_rad)) if k not in captures.poses)
    decided = finding.is_decided(rules.probability)
    if decided or not unmeasured:
        return DriftAssessment(finding, decided, -1)
    both = captures.estimate_causes(bench, (*captures.poses, *unmeasured))
    first, second = [suspect.name for suspect in finding.suspects if suspect.name != OTHER][:2]
    return DriftAssessment(
        finding, False, unmeasured[most_informative_pose(taken, both, changes, sigma_m, (first, second))]
    )


def reference_of(
    bench: Bench,
    ways_rad: tuple[tuple[Joints, ...], ...],
    first: tuple[ArmCapture, ...],
    again: tuple[ArmCapture, ...],
) -> DriftReference:
    """Return two rounds of captures as a reference."""
    values_of((*first, *again))  # one station
    return DriftReference(
        robot_serial=bench.serial,
        model=bench.model,
        method=bench.method,
        counts_at_zero=bench.counts_at_zero,
        station=station_of(first),
        rest_rad=ways_rad[0][0],
        poses_rad=tuple(way[-1] for way in ways_rad),
        joints_rad=tuple(capture.joints_rad for capture in first),
        first_m=_value_rows(first),
        again_m=_value_rows(again),
        noise_m=max(map(noise_m, (*first, *again))),
    )


def _value_rows(captures: tuple[ArmCapture, ...]) -> tuple[tuple[float, ...], ...]:
    return tuple(tuple(float(v) for v in row) for row in values_of(captures))


def recommend_action(finding: DriftFinding, probability: float) -> str:
    """Return what to do next."""
    if not finding.has_changed:
        return NEXT[NOTHING]
    if not finding.is_decided(probability):
        first, second = finding.suspects[:2]
        return make_message(
            "not decided between {first} and {second}, and no pose of the reference would tell: "
            "look at both; {otherwise}",
            first=first.name,
            second=second.name,
            otherwise=NEXT[OTHER],
        )
    name = finding.likeliest_cause.name
    return NEXT.get(name, NEXT["joint"])
