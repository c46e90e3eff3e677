"""Lost motor turns, found again from wire lengths: exactly, or to a stated uncertainty, or not at all."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from cellcal.calibration.arm.kinematics import RobotModel
from cellcal.calibration.errors import CalibrationError
from cellcal.calibration.geometry import Array
from cellcal.calibration.mastering.counts import MasteringRecord, WireCapture
from cellcal.calibration.mastering.further_poses import further_lengths
from cellcal.calibration.mastering.hypothesis_report import CREDIBLE_CHANGE, HypothesisReport, RecoveryRobot
from cellcal.calibration.mastering.pose_design import next_poses, predict_turns
from cellcal.calibration.mastering.turn_gate import (
    SUCCESS_PROBABILITY,
    consequence_of,
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
from cellcal.calibration.message import join_messages, make_message

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
_DECISIVE = 4.6  # log of the evidence ratio (100 to 1) needed to name what happened
# Log of how much rarer an unreported exchange is than turns lost alone; any of six motors may look like one,
# and every further capture is one more look.
_UNREPORTED_EXCHANGE = 6.0
_SPARE_FOR_CHANGE = 8  # captures beyond the turns before a change of geometry may be stated
_NEAR_WHOLE_TURNS = 0.05  # an unannounced new reference nearer to a whole turn needs another witness
_SPARE_FOR_EQUIPMENT = 12  # captures beyond the turns before equipment may be measured anew along with them

FurtherPoses = Callable[[Array, int], tuple[tuple[float, ...], ...]]


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
    posterior, what the model does not know, noise). Then hypotheses compete: only whole turns were lost; one or
    two motors were exchanged; all references are lost; a link, the anchor or the hook moved; one length is
    wrong.
    Whole turns are accepted if the gate holds and no other hypothesis is clearly better; anything else must beat
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
    ch. 23: integer estimation and its validation. The hypotheses and their comparison are ours.
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
        raise CalibrationError(
            make_message("{axis_count} provisional turns are needed", axis_count=model.axis_count)
        )
    if problem is None:
        raise CalibrationError("nothing was captured")
    local = solve_real(
        problem, guess, free=range(model.axis_count), towards=guess, uncertainty_turns=max_turns
    )
    hypothesis_test = HypothesisTest(local, max_turns, replaced_axes)
    report = HypothesisReport(robot, problem, hypothesis_test)
    return _RecoveryTest(
        robot, problem, local, hypothesis_test, report, guess, max_turns, further
    ).recover_turns()


@dataclass(frozen=True, eq=False)
class _RecoveryTest:
    """One set of captures on trial."""

    robot: RecoveryRobot
    problem: TurnEvidence
    local: LocalResiduals
    hypothesis_test: HypothesisTest
    report: HypothesisReport
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
            words = make_message(
                "{count} captures are too few to notice a mistake", count=self.problem.capture_count
            )
            return self._undecided_result(whole, real, words)
        if whole.fix.success_probability <= SUCCESS_PROBABILITY:
            return self._undecided_result(whole, real, self.report.describe_weak_motor(real))
        rivals = [*hypothesis_test.test_motors(1), real, *hypothesis_test.test_geometry()]
        gate = self.report.gate_checks(whole, real)
        if all(check.passed for check in gate) and not any(
            is_blocking_whole_turns(rival, whole) for rival in rivals
        ):
            return self.report.make_result(
                whole, real, (whole.kind, True, self.report.describe_hypothesis(whole)), gate=gate
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
            first, second = map(self.report.describe_hypothesis, (best, rival))
            return self._undecided_result(
                best,
                real,
                make_message("{first}, or {second}: not decidable yet", first=first, second=second),
            )
        return self._conclude_from(best, real)

    def _with_equipment(self, possible: list[Hypothesis]) -> list[Hypothesis]:
        """Let equipment that changed within belief stand for its parts, which would be refused as a crash."""
        equipment = self.hypothesis_test.test_equipment()
        if not (is_explained(equipment) and self.report.change_of(equipment)[0] <= CREDIBLE_CHANGE):
            return possible
        parts = self.local.equipment.parts
        return [equipment, *(s for s in possible if not (s.kind == "geometry" and s.subject in parts))]

    def _conclude_from(self, hypothesis: Hypothesis, real: Hypothesis) -> TurnRecovery:
        if hypothesis.kind == "geometry":
            return self._changed_result(hypothesis, real)
        if hypothesis.kind == "outlier":
            return self._undecided_result(hypothesis, real, self.report.describe_hypothesis(hypothesis))
        near = [
            j
            for j in self._unreported_motors(hypothesis)
            if abs(hypothesis.turns[j] - round(hypothesis.turns[j])) < _NEAR_WHOLE_TURNS
        ]
        if near and hypothesis.kind == "motor":
            names = " and ".join(self.robot_model.joint_names[j] for j in near)
            words = make_message(
                "{names} would be less than {near} turn from a whole one: not decidable yet",
                names=names,
                near=_NEAR_WHOLE_TURNS,
            )
            return self._undecided_result(hypothesis, real, words)
        if (
            hypothesis.kind == "equipment"
            and self._row_count - self.robot_model.axis_count < _SPARE_FOR_EQUIPMENT
        ):
            return self._undecided_result(
                hypothesis,
                real,
                make_message("{first}: not decidable yet", first=self.report.describe_hypothesis(hypothesis)),
            )
        hypothesis = self._refine_hypothesis(hypothesis)
        gate = self.report.gate_checks(hypothesis, real)
        failed = join_messages("; ", (check.sentence for check in gate if not check.passed))
        if failed:
            return self._undecided_result(hypothesis, real, failed, gate=gate)
        return self.report.make_result(
            hypothesis, real, (hypothesis.kind, True, self.report.describe_hypothesis(hypothesis)), gate=gate
        )

    @property
    def _row_count(self) -> int:
        return len(self.local.residuals)

    def _unreported_motors(self, hypothesis: Hypothesis) -> list[int]:
        """Return the motors whose reference a hypothesis takes as new although no exchange was reported."""
        return [axis for axis in hypothesis.real_axes if axis not in self.hypothesis_test.replaced]

    def _required_lead(self, best: Hypothesis, rival: Hypothesis) -> float:
        """Return by how much a hypothesis must beat a rival before it is named, as the log of their evidence."""
        rarer = rival.kind in ("turns", "equipment") and bool(self._unreported_motors(best))
        return _DECISIVE + (_UNREPORTED_EXCHANGE if rarer else 0.0)

    def _refine_hypothesis(self, hypothesis: Hypothesis) -> Hypothesis:
        """Judge a hypothesis again at its own turns, where nothing is linearised."""
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

    def _changed_result(self, hypothesis: Hypothesis, real: Hypothesis) -> TurnRecovery:
        part = hypothesis.subject
        if self._row_count - self.robot_model.axis_count < _SPARE_FOR_CHANGE:
            return self._undecided_result(
                hypothesis, real, make_message("{part} may not be where it was: not decidable yet", part=part)
            )
        words = make_message(
            "the robot or the wire is not as recorded (most likely {part}): full calibration advised",
            part=part,
        )
        return self.report.make_result(
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
        gate = self.report.gate_checks(hypothesis, real) if gate is None else gate
        if hypothesis.kind == "outlier":
            again = (tuple(float(v) for v in self.local.joints_rad[hypothesis.capture]),)
            return self.report.make_result(
                hypothesis, real, ("undecided", False, words), gate=gate, further=again
            )
        further = self.further(
            self.local.joints_rad, self.robot_model.axis_count + SPARE_CAPTURES - self._row_count
        )
        words = make_message("{words}; measure {count} more", words=words, count=len(further))
        return self.report.make_result(
            hypothesis, real, ("undecided", False, words), gate=gate, further=further
        )
