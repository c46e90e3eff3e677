"""What a hypothesis about lost turns is reported as: the checks of the gate, its sentence and the result."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from cellcal.calibration.arm.kinematics import RobotModel
from cellcal.calibration.geometry import Array
from cellcal.calibration.mastering.counts import DriveTrain
from cellcal.calibration.mastering.turn_gate import chi_limit, integer_checks
from cellcal.calibration.mastering.turn_hypotheses import Hypothesis, HypothesisTest, TurnEvidence
from cellcal.calibration.mastering.turn_results import GateCheck, TurnRecovery
from cellcal.calibration.message import make_message

HIDDEN_OUTLIER_M = 0.006  # a wrong length of this size must show in every capture …
HIDDEN_POWER = 6.0  # … at so many deviations
REAL_LIMIT_RAD = 0.0087266  # 0.5 deg: coarser offsets are not worth writing back
BLIND_SIGMAS = 3.0
CREDIBLE_CHANGE = 3.0  # deviations by which equipment may differ from its record and still be believed
_FIT = (
    "the lengths fit: {chi_square:.1f} of at most {limit:.1f} "
    "(all motors free: {free:.1f} of at most {free_limit:.1f})"
)
_NO_FIT = (
    "the lengths do not fit: {chi_square:.1f} of at most {limit:.1f} "
    "(all motors free: {free:.1f} of at most {free_limit:.1f})"
)
_WOULD_SHOW = "a length wrong by {hidden_mm:.1f} mm would show in any capture"


@dataclass(frozen=True, eq=False, slots=True)
class RecoveryRobot:
    """The arm whose counts were lost: what any evidence is judged with."""

    model: RobotModel
    drive: DriveTrain
    counts_at_zero: tuple[int, ...]


@dataclass(frozen=True, eq=False)
class HypothesisReport:
    """Reports hypotheses about one set of captures."""

    robot: RecoveryRobot
    problem: TurnEvidence
    hypothesis_test: HypothesisTest

    def gate_checks(self, hypothesis: Hypothesis, real: Hypothesis) -> tuple[GateCheck, ...]:
        limit, real_limit = chi_limit(hypothesis), chi_limit(real)
        changed = hypothesis.kind == "equipment"  # then what the motors alone explain says nothing
        fits = hypothesis.chi_square <= limit and (changed or real.chi_square <= real_limit)
        checks = [] if hypothesis.kind == "all" else integer_checks(hypothesis)
        words = make_message(
            _FIT if fits else _NO_FIT,
            chi_square=hypothesis.chi_square,
            limit=limit,
            free=real.chi_square,
            free_limit=real_limit,
        )
        checks.append(GateCheck("chi square", fits, hypothesis.chi_square, limit, words))
        if changed:
            checks += self._equipment_checks(hypothesis)
        if hypothesis.real_axes:
            largest = max(self._u_rad(hypothesis))
            words = make_message(
                "the real offset is known to {largest_deg:.4f} deg (k = 2)", largest_deg=np.rad2deg(largest)
            )
            checks.append(
                GateCheck("uncertainty", largest <= REAL_LIMIT_RAD, largest, REAL_LIMIT_RAD, words, "rad")
            )
            hidden = self.hypothesis_test.detectable_m(hypothesis.real_axes, HIDDEN_POWER)
            words = make_message(_WOULD_SHOW, hidden_mm=1e3 * hidden)
            checks.append(
                GateCheck("redundancy", hidden <= HIDDEN_OUTLIER_M, hidden, HIDDEN_OUTLIER_M, words, "m")
            )
        return tuple(checks)

    def _equipment_checks(self, hypothesis: Hypothesis) -> list[GateCheck]:
        moved = self.change_of(hypothesis)[0]
        words = make_message(
            "{subject} is off its record by at most {moved:.1f} of the deviations that are believed",
            subject=hypothesis.subject,
            moved=moved,
        )
        hidden = self.hypothesis_test.detectable_m((), HIDDEN_POWER, any_equipment=True)
        detectable = make_message(_WOULD_SHOW, hidden_mm=1e3 * hidden)
        return [
            GateCheck("equipment", moved <= CREDIBLE_CHANGE, moved, CREDIBLE_CHANGE, words),
            GateCheck("redundancy", hidden <= HIDDEN_OUTLIER_M, hidden, HIDDEN_OUTLIER_M, detectable, "m"),
        ]

    def _u_rad(self, hypothesis: Hypothesis) -> tuple[float, ...]:
        """Return the expanded uncertainty of the joints (k = 2), widened where the lengths scatter more."""
        per_turn = self.robot.drive.radians_per_turn()
        variance = np.diag(per_turn @ hypothesis.covariance @ per_turn.T)
        widened = max(1.0, hypothesis.chi_square / max(hypothesis.degrees_of_freedom, 1))
        return tuple(2.0 * float(np.sqrt(max(v, 0.0) * widened)) for v in variance)

    def change_of(self, hypothesis: Hypothesis) -> tuple[float, Array, Array]:
        """Return by how many deviations the equipment changed at most, its change, and the covariance."""
        local = self.problem.linearise_at(hypothesis.turns)
        change, covariance = local.equipment.estimate_change(local.residuals, local.scatter)
        return float(np.abs(change).max(initial=0.0)), change, covariance

    def describe_weak_motor(self, real: Hypothesis) -> str:
        sigma = np.sqrt(np.diag(real.covariance))
        worst = int(np.argmax(sigma))
        name = self.robot.model.joint_names[worst]
        return make_message(
            "these poses leave the motor of {name} open to {open_turns:.2f} turns",
            name=name,
            open_turns=sigma[worst],
        )

    def describe_hypothesis(self, hypothesis: Hypothesis) -> str:
        names = self.robot.model.joint_names
        if hypothesis.kind == "turns":
            return make_message(
                "whole turns only: {moved}; zero offsets unchanged", moved=_moved_text(names, hypothesis)
            )
        if hypothesis.kind == "motor":
            renewed = " and ".join(names[j] for j in hypothesis.real_axes)
            return make_message("the reference of {renewed} is new, the others lost turns", renewed=renewed)
        if hypothesis.kind == "all":
            return "every reference is lost: all offsets are real"
        if hypothesis.kind == "outlier":
            return make_message(
                "capture {number} does not fit the others: measure it again", number=hypothesis.capture + 1
            )
        if hypothesis.kind == "equipment":
            return make_message(
                "whole turns only: {moved}; {subject} is not as recorded",
                moved=_moved_text(names, hypothesis),
                subject=hypothesis.subject,
            )
        return make_message("{subject} is not where it was", subject=hypothesis.subject)

    def make_result(
        self,
        hypothesis: Hypothesis,
        real: Hypothesis,
        outcome: tuple[str, bool, str],
        *,
        gate: tuple[GateCheck, ...] = (),
        further: tuple[tuple[float, ...], ...] = (),
        part: str = "",
    ) -> TurnRecovery:
        mode, accepted, reason = outcome
        change: dict[str, Any] = {}
        if mode == "equipment":
            mode, part = "motor" if hypothesis.real_axes else "turns", hypothesis.subject
            _, moved, covariance = self.change_of(hypothesis)
            change = {
                "equipment_change": tuple(float(v) for v in moved),
                "equipment_covariance": tuple(tuple(float(v) for v in row) for row in covariance),
            }
        offsets = tuple(float(t) for t in hypothesis.turns)
        return TurnRecovery(
            mode=mode,
            accepted=accepted,
            reason=reason,
            turns=tuple(round(t) for t in offsets),
            replaced_axes=hypothesis.real_axes,
            offset_turns=offsets,
            offset_u_rad=self._u_rad(hypothesis),
            counts_at_zero=self.robot.drive.shifted_zero(self.robot.counts_at_zero, offsets),
            gate=gate,
            poses_needed=len(further),
            next_joints_rad=further,
            suspect_capture=hypothesis.capture if hypothesis.kind == "outlier" else None,
            changed_part=part,
            success_probability=hypothesis.fix.success_probability,
            sigma_turns=tuple(float(v) for v in np.sqrt(np.diag(real.covariance))),
            chi_square=hypothesis.chi_square,
            degrees_of_freedom=hypothesis.degrees_of_freedom,
            captures=self.problem.capture_count,
            offset_covariance=tuple(tuple(float(v) for v in row) for row in hypothesis.covariance),
            **(self._motor_sharpness(hypothesis) if mode == "turns" else {}),
            **change,
        )

    def _motor_sharpness(self, hypothesis: Hypothesis) -> dict[str, Any]:
        """Say how far the captures put each motor from a whole turn, and what would pass for one."""
        changed = hypothesis.kind == "equipment"
        alone = list(
            self.hypothesis_test.motors_and_equipment() if changed else self.hypothesis_test.test_motors(1)
        )
        sigmas = [
            float(np.sqrt(hypothesis.covariance[hypothesis.real_axes[0], hypothesis.real_axes[0]]))
            for hypothesis in alone
        ]
        found = [float(hypothesis.turns[hypothesis.real_axes[0]]) for hypothesis in alone]
        uncertainties = [
            abs(turns - round(turns)) / sigma for turns, sigma in zip(found, sigmas, strict=True)
        ]
        return {
            "doubt_sigmas": max(uncertainties),
            "blind_turns": tuple(BLIND_SIGMAS * sigma for sigma in sigmas),
        }


def _moved_text(names: Sequence[str], hypothesis: Hypothesis) -> str:
    moved = (f"{names[j]} {round(turns):+d}" for j, turns in enumerate(hypothesis.turns) if round(turns))
    return ", ".join(moved) or "none lost"
