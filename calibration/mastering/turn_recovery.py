"""Lost motor turns, found again from wire lengths: exactly, or to a stated uncertainty, or not at all."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from cellcal.calibration.arm.kinematics import RobotModel
from cellcal.calibration.errors import CalibrationError
from cellcal.calibration.geometry import Array
from cellcal.calibration.mastering.counts import DriveTrain, MasteringRecord, WireCapture
from cellcal.calibration.mastering.further_poses import further_lengths
from cellcal.calibration.mastering.pose_design import next_poses, predict_turns
from cellcal.calibration.mastering.turn_gate import (
    SUCCESS_PROBABILITY,
    chi_limit,
    consequence_of,
    integer_checks,
    is_blocking_whole_turns,
    is_explained,
)
from cellcal.calibration.mastering.turn_hypotheses import (
    AnyEquipment,
    Hypothesis,
    HypothesisTest,
    LocalResiduals,
    LossProblem,
    TurnEvidence,
    solve_real,
)
from cellcal.calibration.mastering.turn_results import GateCheck, TurnRecovery
from cellcal.calibration.mastering.turn_verification import verification_power, verify_recovery
from cellcal.calibration.message import join_messages

__all__ = [
    "GateCheck",
    "MasteringRecord",
    "TurnRecovery",
    "WireCapture",
    "next_poses",
    "predict_turns",
    "recover_turns",
    "verification_power",
    "verify_recovery",
]

SPARE_CAPTURES = 6  # captures beyond the unknown turns, so that the residuals can object
HIDDEN_OUTLIER_M = 0.006  # a wrong length of this size must show in every capture …
HIDDEN_POWER = 6.0  # … at so many deviations
REAL_LIMIT_RAD = 0.0087266  # 0.5 deg: coarser offsets are not worth writing back
BLIND_SIGMAS = 3.0
_DECISIVE = 4.6  # log of the evidence ratio (100 to 1) needed to name what happened
# Log of how much rarer an unreported exchange is than turns lost alone; any of six motors may look like one,
# and every further capture is one more look.
_UNTOLD_EXCHANGE = 6.0
_SPARE_FOR_CHANGE = 8  # captures beyond the turns before a change of geometry may be stated
_NEAR_WHOLE_TURNS = 0.05  # an untold new reference nearer to a whole turn needs another witness
_CREDIBLE_CHANGE = 3.0  # deviations by which equipment may differ from its record and still be believed
_SPARE_FOR_EQUIPMENT = 12  # captures beyond the turns before equipment may be measured anew along with them

FurtherPoses = Callable[[Array, int], tuple[tuple[float, ...], ...]]


@dataclass(frozen=True, eq=False, slots=True)
class RecoveryRobot:
    """The arm whose counts were lost: what any evidence is judged with."""

    model: RobotModel
    drive: DriveTrain
    counts_at_zero: tuple[int, ...]


def recover_turns(
    model: RobotModel,
    record: MasteringRecord,
    captures: Sequence[WireCapture],
    *,
    provisional_turns: Sequence[int],
    max_turns: float = 10.0,
    replaced_axes: Sequence[int] = (),
) -> TurnRecovery:
    r"""Find the turns that motors lost, or refuse with the reason and the poses still needed.

    A real-valued solution for all motors comes first, in the metric of the whole covariance (the record's
    posterior, what the model does not know, noise). Then stories compete: only whole turns were lost; one or
    two motors were exchanged; all references are lost; a link, the anchor or the hook moved; one length is
    wrong.
    Whole turns are accepted if the gate holds and no other story is clearly better; anything else must beat
    every rival 100 to 1.

    Parameters
    ----------
    model : RobotModel
        Nominal model of the record.
    record : MasteringRecord
        Taken while the robot was healthy.
    captures : sequence of WireCapture
        Counts as the controller reads them after the loss, with wire lengths.
    provisional_turns : (n,)
        Best guess of the lost turns, from the last healthy counts [turns].
    max_turns : float
        How far the guess may be off (one deviation) [turns]; it only matters with few captures.

    replaced_axes : sequence of int
        Motors known to have lost their reference (a reported exchange): these get a real offset
        even where it happens to be near a whole turn.

    Returns
    -------
    TurnRecovery
        Never a guess: ``accepted`` only if every check of the gate passed.

    Raises
    ------
    CalibrationError
        Captures or guesses of another robot, or none.

    Notes
    -----
    The fifth condition, check poses that were not fitted, is ``verify_recovery``. A replaced motor whose new
    zero happens to lie within about three deviations of a whole turn (0.01 to 0.05 turn) looks like whole
    turns; who knows of an exchange says so in ``replaced_axes``.

    References
    ----------
    P. J. G. Teunissen, O. Montenbruck (eds.), Springer Handbook of Global Navigation Satellite Systems, 2017,
    ch. 23: integer estimation and its validation. The stories and their comparison are ours.
    """
    return recover_from(
        LossProblem(model, record, captures) if captures else None,
        RecoveryRobot(model, record.drive, record.counts_at_zero),
        provisional_turns=provisional_turns,
        max_turns=max_turns,
        replaced_axes=replaced_axes,
        further=partial(further_lengths, model, record),
    )


def recover_from(
    problem: TurnEvidence | None,
    robot: RecoveryRobot,
    *,
    provisional_turns: Sequence[int],
    max_turns: float,
    replaced_axes: Sequence[int],
    further: FurtherPoses,
) -> TurnRecovery:
    """Find the lost turns from any evidence, as ``recover_turns`` does from lengths.

    ``further`` names the poses still needed, given the joints measured (m, n) [rad] and how many at least.
    """
    model = robot.model
    guess = np.asarray(provisional_turns, dtype=float)
    if guess.shape != (model.axis_count,) or not np.isfinite(guess).all():
        raise CalibrationError(f"{model.axis_count} provisional turns are needed")
    if problem is None:
        raise CalibrationError("nothing was captured")
    local = solve_real(
        problem, guess, free=range(model.axis_count), towards=guess, uncertainty_turns=max_turns
    )
    hypothesis_test = HypothesisTest(local, max_turns, replaced_axes)
    return _RecoveryTest(robot, problem, local, hypothesis_test, guess, max_turns, further).recover_turns()


@dataclass(frozen=True, eq=False)
class _RecoveryTest:
    """One set of captures on trial."""

    robot: RecoveryRobot
    problem: TurnEvidence
    local: LocalResiduals
    hypothesis_test: HypothesisTest
    guess: Array
    uncertainty_turns: float
    further: FurtherPoses

    @property
    def robot_model(self) -> RobotModel:
        return self.robot.model

    def recover_turns(self) -> TurnRecovery:
        hypothesis_test = self.hypothesis_test
        real, whole = (
            hypothesis_test.test_all_lost(),
            self._refine_hypothesis(hypothesis_test.test_whole_turns()),
        )
        if self._row_count - self.robot_model.axis_count < SPARE_CAPTURES:
            words = f"{self.problem.capture_count} captures are too few to notice a mistake"
            return self._undecided_result(whole, real, words)
        if whole.fix.success_probability <= SUCCESS_PROBABILITY:
            return self._undecided_result(whole, real, self._describe_weak_motor(real))
        rivals = [*hypothesis_test.test_motors(1), real, *hypothesis_test.test_geometry()]
        gate = self._gate_checks(whole, real)
        if all(check.passed for check in gate) and not any(
            is_blocking_whole_turns(rival, whole) for rival in rivals
        ):
            return self._make_result(
                whole, real, (whole.kind, True, self._describe_hypothesis(whole)), gate=gate
            )
        return self._diagnose_rivals([whole, *rivals], real)

    def _diagnose_rivals(self, hypotheses: list[Hypothesis], real: Hypothesis) -> TurnRecovery:
        hypothesis_test = self.hypothesis_test
        hypotheses += [
            *hypothesis_test.test_outliers(),
            *hypothesis_test.test_motors(2),
            *hypothesis_test.motors_and_equipment(),
        ]
        possible = [s for s in hypotheses if is_explained(s)]
        possible = self._with_equipment(possible)
        if not possible:
            motor = max(hypothesis_test.test_motors(1), key=lambda s: s.log_evidence)
            possible = [s for s in hypothesis_test.test_outliers(motor.real_axes) if is_explained(s)]
        if not possible:
            nearest = max(hypothesis_test.test_geometry(), key=lambda s: s.log_evidence)
            return self._changed_result(nearest, real)
        best = max(possible, key=lambda s: s.log_evidence)
        rivals = [s for s in possible if consequence_of(s) != consequence_of(best)]
        close = [s for s in rivals if best.log_evidence - s.log_evidence < self._required_lead(best, s)]
        rival = max(close, key=lambda s: s.log_evidence, default=None)
        # A change of geometry is refused either way; it need not be told from an exchanged motor for that.
        if rival is not None and best.kind != "geometry":
            words = (
                f"{self._describe_hypothesis(best)}, or {self._describe_hypothesis(rival)}: not decidable yet"
            )
            return self._undecided_result(best, real, words)
        return self._conclude_from(best, real)

    def _with_equipment(self, possible: list[Hypothesis]) -> list[Hypothesis]:
        """Let equipment that changed within belief stand for its parts, which would be refused as a crash."""
        equipment = self.hypothesis_test.test_equipment()
        if not (is_explained(equipment) and self._change_of(equipment)[0] <= _CREDIBLE_CHANGE):
            return possible
        parts = self.local.equipment.parts
        return [equipment, *(s for s in possible if not (s.kind == "geometry" and s.subject in parts))]

    def _change_of(self, hypothesis: Hypothesis) -> tuple[float, Array, Array]:
        """Return by how many deviations the equipment changed at most, its change, and the covariance."""
        local = self.problem.linearise_at(hypothesis.turns)
        change, covariance = local.equipment.estimate_change(local.residuals, local.scatter)
        return float(np.abs(change).max(initial=0.0)), change, covariance

    def _conclude_from(self, hypothesis: Hypothesis, real: Hypothesis) -> TurnRecovery:
        if hypothesis.kind == "geometry":
            return self._changed_result(hypothesis, real)
        if hypothesis.kind == "outlier":
            return self._undecided_result(hypothesis, real, self._describe_hypothesis(hypothesis))
        near = [
            j
            for j in self._unreported_motors(hypothesis)
            if abs(hypothesis.turns[j] - round(hypothesis.turns[j])) < _NEAR_WHOLE_TURNS
        ]
        if near and hypothesis.kind == "motor":
            names = " and ".join(self.robot_model.joint_names[j] for j in near)
            words = f"{names} would be less than {_NEAR_WHOLE_TURNS} turn from a whole one: not decidable yet"
            return self._undecided_result(hypothesis, real, words)
        if (
            hypothesis.kind == "equipment"
            and self._row_count - self.robot_model.axis_count < _SPARE_FOR_EQUIPMENT
        ):
            return self._undecided_result(
                hypothesis, real, f"{self._describe_hypothesis(hypothesis)}: not decidable yet"
            )
        hypothesis = self._refine_hypothesis(hypothesis)
        gate = self._gate_checks(hypothesis, real)
        failed = join_messages("; ", (check.sentence for check in gate if not check.passed))
        if failed:
            return self._undecided_result(hypothesis, real, failed, gate=gate)
        return self._make_result(
            hypothesis, real, (hypothesis.kind, True, self._describe_hypothesis(hypothesis)), gate=gate
        )

    @property
    def _row_count(self) -> int:
        return len(self.local.residuals)

    def _unreported_motors(self, hypothesis: Hypothesis) -> list[int]:
        """Return the motors whose reference a story takes as new although no exchange was reported."""
        return [axis for axis in hypothesis.real_axes if axis not in self.hypothesis_test.replaced]

    def _required_lead(self, best: Hypothesis, rival: Hypothesis) -> float:
        """Return by how much a story must beat a rival before it is named, as the log of their evidence."""
        rarer = rival.kind in ("turns", "equipment") and bool(self._unreported_motors(best))
        return _DECISIVE + (_UNTOLD_EXCHANGE if rarer else 0.0)

    def _refine_hypothesis(self, hypothesis: Hypothesis) -> Hypothesis:
        """Judge a story again at its own turns, where nothing is linearised."""
        problem: TurnEvidence = AnyEquipment(self.problem) if hypothesis.kind == "equipment" else self.problem
        if not hypothesis.real_axes:
            return replace(hypothesis, chi_square=problem.linearise_at(hypothesis.turns).chi_square())
        local = solve_real(
            problem,
            hypothesis.turns,
            free=hypothesis.real_axes,
            towards=self.guess,
            uncertainty_turns=self.uncertainty_turns,
        )
        return replace(hypothesis, turns=local.turns, chi_square=local.chi_square())

    def _gate_checks(self, hypothesis: Hypothesis, real: Hypothesis) -> tuple[GateCheck, ...]:
        limit, real_limit = chi_limit(hypothesis), chi_limit(real)
        changed = hypothesis.kind == "equipment"  # then what the motors alone explain says nothing
        fits = hypothesis.chi_square <= limit and (changed or real.chi_square <= real_limit)
        checks = [] if hypothesis.kind == "all" else integer_checks(hypothesis)
        words = f"the lengths fit: {hypothesis.chi_square:.1f} of at most {limit:.1f}"
        words += f" (all motors free: {real.chi_square:.1f} of at most {real_limit:.1f})"
        words = words if fits else words.replace("fit:", "do not fit:")
        checks.append(GateCheck("chi square", fits, hypothesis.chi_square, limit, words))
        if changed:
            checks += self._equipment_checks(hypothesis)
        if hypothesis.real_axes:
            largest = max(self._u_rad(hypothesis))
            words = f"the real offset is known to {np.rad2deg(largest):.4f} deg (k = 2)"
            checks.append(GateCheck("uncertainty", largest <= REAL_LIMIT_RAD, largest, REAL_LIMIT_RAD, words))
            hidden = self.hypothesis_test.detectable_m(hypothesis.real_axes, HIDDEN_POWER)
            words = f"a length wrong by {1e3 * hidden:.1f} mm would show in any capture"
            checks.append(
                GateCheck("redundancy", hidden <= HIDDEN_OUTLIER_M, hidden, HIDDEN_OUTLIER_M, words)
            )
        return tuple(checks)

    def _equipment_checks(self, hypothesis: Hypothesis) -> list[GateCheck]:
        moved = self._change_of(hypothesis)[0]
        words = f"{hypothesis.subject} is off its record by at most {moved:.1f} of the deviations that are believed"
        hidden = self.hypothesis_test.detectable_m((), HIDDEN_POWER, any_equipment=True)
        detectable = f"a length wrong by {1e3 * hidden:.1f} mm would show in any capture"
        return [
            GateCheck("equipment", moved <= _CREDIBLE_CHANGE, moved, _CREDIBLE_CHANGE, words),
            GateCheck("redundancy", hidden <= HIDDEN_OUTLIER_M, hidden, HIDDEN_OUTLIER_M, detectable),
        ]

    def _u_rad(self, hypothesis: Hypothesis) -> tuple[float, ...]:
        """Return the expanded uncertainty of the joints (k = 2), widened where the lengths scatter more."""
        per_turn = self.robot.drive.radians_per_turn()
        variance = np.diag(per_turn @ hypothesis.covariance @ per_turn.T)
        widened = max(1.0, hypothesis.chi_square / max(hypothesis.degrees_of_freedom, 1))
        return tuple(2.0 * float(np.sqrt(max(v, 0.0) * widened)) for v in variance)

    def _changed_result(self, hypothesis: Hypothesis, real: Hypothesis) -> TurnRecovery:
        part = hypothesis.subject
        if self._row_count - self.robot_model.axis_count < _SPARE_FOR_CHANGE:
            return self._undecided_result(
                hypothesis, real, f"{part} may not be where it was: not decidable yet"
            )
        words = f"the robot or the wire is not as recorded (most likely {part}): full calibration advised"
        return self._make_result(
            replace(hypothesis, chi_square=real.chi_square), real, ("geometry", False, words), part=part
        )

    def _undecided_result(
        self,
        hypothesis: Hypothesis,
        real: Hypothesis,
        words: str,
        *,
        gate: tuple[GateCheck, ...] | None = None,
    ) -> TurnRecovery:
        gate = self._gate_checks(hypothesis, real) if gate is None else gate
        if hypothesis.kind == "outlier":
            again = (tuple(float(v) for v in self.local.joints_rad[hypothesis.capture]),)
            return self._make_result(hypothesis, real, ("undecided", False, words), gate=gate, further=again)
        further = self.further(
            self.local.joints_rad, self.robot_model.axis_count + SPARE_CAPTURES - self._row_count
        )
        words = f"{words}; measure {len(further)} more"
        return self._make_result(hypothesis, real, ("undecided", False, words), gate=gate, further=further)

    def _describe_weak_motor(self, real: Hypothesis) -> str:
        sigma = np.sqrt(np.diag(real.covariance))
        worst = int(np.argmax(sigma))
        name = self.robot_model.joint_names[worst]
        return f"these poses leave the motor of {name} open to {sigma[worst]:.2f} turns"

    def _describe_hypothesis(self, hypothesis: Hypothesis) -> str:
        names = self.robot_model.joint_names
        if hypothesis.kind == "turns":
            moved = [f"{names[j]} {round(t):+d}" for j, t in enumerate(hypothesis.turns) if round(t)]
            return f"whole turns only: {', '.join(moved) or 'none lost'}; zero offsets unchanged"
        if hypothesis.kind == "motor":
            renewed = " and ".join(names[j] for j in hypothesis.real_axes)
            return f"the reference of {renewed} is new, the others lost turns"
        if hypothesis.kind == "all":
            return "every reference is lost: all offsets are real"
        if hypothesis.kind == "outlier":
            return f"capture {hypothesis.capture + 1} does not fit the others: measure it again"
        if hypothesis.kind == "equipment":
            moved = [f"{names[j]} {round(t):+d}" for j, t in enumerate(hypothesis.turns) if round(t)]
            return f"whole turns only: {', '.join(moved) or 'none lost'}; {hypothesis.subject} is not as recorded"
        return f"{hypothesis.subject} is not where it was"

    def _make_result(
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
            _, moved, covariance = self._change_of(hypothesis)
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
