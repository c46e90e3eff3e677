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
from cellcal.calibration.mastering.pose_design import next_poses, predict
from cellcal.calibration.mastering.turn_gate import (
    SUCCESS_PROBABILITY,
    blocks_whole_turns,
    chi_limit,
    consequence,
    explains,
    integer_checks,
)
from cellcal.calibration.mastering.turn_hypotheses import (
    AnyEquipment,
    Evidence,
    Local,
    LossProblem,
    Story,
    Storyteller,
    solve_real,
)
from cellcal.calibration.mastering.turn_results import GateCheck, TurnRecovery
from cellcal.calibration.mastering.turn_verification import verification_power, verify_recovery

__all__ = [
    "GateCheck",
    "MasteringRecord",
    "TurnRecovery",
    "WireCapture",
    "next_poses",
    "predict",
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
# Log of how much rarer an exchange that nobody told of is than turns lost alone; any of six motors may look like one,
# and every further capture is one more look.
_UNTOLD_EXCHANGE = 6.0
_SPARE_FOR_CHANGE = 8  # captures beyond the turns before a change of geometry may be stated
_NEAR_WHOLE_TURNS = 0.05  # an untold new reference nearer to a whole turn needs another witness
_CREDIBLE_CHANGE = 3.0  # deviations by which equipment may differ from its record and still be believed
_SPARE_FOR_EQUIPMENT = 12  # captures beyond the turns before equipment may be measured anew along with them

FurtherPoses = Callable[[Array, int], tuple[tuple[float, ...], ...]]


@dataclass(frozen=True, eq=False, slots=True)
class Robot:
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
        Motors known to have lost their reference (an exchange that somebody reports): these get a real offset
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
        Robot(model, record.drive, record.counts_at_zero),
        provisional_turns=provisional_turns,
        max_turns=max_turns,
        replaced_axes=replaced_axes,
        further=partial(further_lengths, model, record),
    )


def recover_from(
    problem: Evidence | None,
    robot: Robot,
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
    if guess.shape != (model.axes,) or not np.isfinite(guess).all():
        raise CalibrationError(f"{model.axes} provisional turns are needed")
    if problem is None:
        raise CalibrationError("nothing was captured")
    local = solve_real(problem, guess, free=range(model.axes), towards=guess, doubt_turns=max_turns)
    teller = Storyteller(local, max_turns, replaced_axes)
    return _Case(robot, problem, local, teller, guess, max_turns, further).judge()


@dataclass(frozen=True, eq=False)
class _Case:
    """One set of captures on trial."""

    robot: Robot
    problem: Evidence
    local: Local
    teller: Storyteller
    guess: Array
    doubt_turns: float
    further: FurtherPoses

    @property
    def model(self) -> RobotModel:
        return self.robot.model

    def judge(self) -> TurnRecovery:
        teller = self.teller
        real, whole = teller.real(), self._refined(teller.turns())
        if self._count - self.model.axes < SPARE_CAPTURES:
            words = f"{self.problem.captures} captures are too few to notice a mistake"
            return self._undecided(whole, real, words)
        if whole.fix.success_probability <= SUCCESS_PROBABILITY:
            return self._undecided(whole, real, self._weak_words(real))
        rivals = [*teller.motors(1), real, *teller.changes()]
        gate = self._gate(whole, real)
        if all(check.passed for check in gate) and not any(
            blocks_whole_turns(rival, whole) for rival in rivals
        ):
            return self._result(whole, real, (whole.kind, True, self._words(whole)), gate=gate)
        return self._diagnose([whole, *rivals], real)

    def _diagnose(self, stories: list[Story], real: Story) -> TurnRecovery:
        teller = self.teller
        stories += [*teller.outliers(), *teller.motors(2), *teller.motors_and_equipment()]
        possible = [s for s in stories if explains(s)]
        possible = self._with_equipment(possible)
        if not possible:
            motor = max(teller.motors(1), key=lambda s: s.log_evidence)
            possible = [s for s in teller.outliers(motor.real_axes) if explains(s)]
        if not possible:
            nearest = max(teller.changes(), key=lambda s: s.log_evidence)
            return self._changed(nearest, real)
        best = max(possible, key=lambda s: s.log_evidence)
        rivals = [s for s in possible if consequence(s) != consequence(best)]
        close = [s for s in rivals if best.log_evidence - s.log_evidence < self._lead_needed(best, s)]
        rival = max(close, key=lambda s: s.log_evidence, default=None)
        # A change of geometry is refused either way; it need not be told from an exchanged motor for that.
        if rival is not None and best.kind != "geometry":
            words = f"{self._words(best)}, or {self._words(rival)}: not decidable yet"
            return self._undecided(best, real, words)
        return self._conclude(best, real)

    def _with_equipment(self, possible: list[Story]) -> list[Story]:
        """Let equipment that changed within belief stand for its parts, which would be refused as a crash."""
        equipment = self.teller.equipment()
        if not (explains(equipment) and self._change_of(equipment)[0] <= _CREDIBLE_CHANGE):
            return possible
        parts = self.local.equipment.parts
        return [equipment, *(s for s in possible if not (s.kind == "geometry" and s.subject in parts))]

    def _change_of(self, story: Story) -> tuple[float, Array, Array]:
        """Return by how many deviations the equipment changed at most, its change, and the covariance."""
        local = self.problem.at(story.turns)
        change, covariance = local.equipment.estimate_change(local.residuals, local.scatter)
        return float(np.abs(change).max(initial=0.0)), change, covariance

    def _conclude(self, story: Story, real: Story) -> TurnRecovery:
        if story.kind == "geometry":
            return self._changed(story, real)
        if story.kind == "outlier":
            return self._undecided(story, real, self._words(story))
        near = [
            j for j in self._untold(story) if abs(story.turns[j] - round(story.turns[j])) < _NEAR_WHOLE_TURNS
        ]
        if near and story.kind == "motor":
            names = " and ".join(self.model.joint_names[j] for j in near)
            words = f"{names} would be less than {_NEAR_WHOLE_TURNS} turn from a whole one: not decidable yet"
            return self._undecided(story, real, words)
        if story.kind == "equipment" and self._count - self.model.axes < _SPARE_FOR_EQUIPMENT:
            return self._undecided(story, real, f"{self._words(story)}: not decidable yet")
        story = self._refined(story)
        gate = self._gate(story, real)
        failed = "; ".join(check.sentence for check in gate if not check.passed)
        if failed:
            return self._undecided(story, real, failed, gate=gate)
        return self._result(story, real, (story.kind, True, self._words(story)), gate=gate)

    @property
    def _count(self) -> int:
        return len(self.local.residuals)

    def _untold(self, story: Story) -> list[int]:
        """Return the motors whose reference a story takes as new although no exchange was reported."""
        return [axis for axis in story.real_axes if axis not in self.teller.replaced]

    def _lead_needed(self, best: Story, rival: Story) -> float:
        """Return by how much a story must beat a rival before it is named, as the log of their evidence."""
        rarer = rival.kind in ("turns", "equipment") and bool(self._untold(best))
        return _DECISIVE + (_UNTOLD_EXCHANGE if rarer else 0.0)

    def _refined(self, story: Story) -> Story:
        """Judge a story again at its own turns, where nothing is linearised."""
        problem: Evidence = AnyEquipment(self.problem) if story.kind == "equipment" else self.problem
        if not story.real_axes:
            return replace(story, chi_square=problem.at(story.turns).chi_square())
        local = solve_real(
            problem, story.turns, free=story.real_axes, towards=self.guess, doubt_turns=self.doubt_turns
        )
        return replace(story, turns=local.turns, chi_square=local.chi_square())

    def _gate(self, story: Story, real: Story) -> tuple[GateCheck, ...]:
        limit, real_limit = chi_limit(story), chi_limit(real)
        changed = story.kind == "equipment"  # then what the motors alone explain says nothing
        fits = story.chi_square <= limit and (changed or real.chi_square <= real_limit)
        checks = [] if story.kind == "all" else integer_checks(story)
        words = f"the lengths fit: {story.chi_square:.1f} of at most {limit:.1f}"
        words += f" (all motors free: {real.chi_square:.1f} of at most {real_limit:.1f})"
        words = words if fits else words.replace("fit:", "do not fit:")
        checks.append(GateCheck("chi square", fits, story.chi_square, limit, words))
        if changed:
            checks += self._equipment_checks(story)
        if story.real_axes:
            largest = max(self._u_rad(story))
            words = f"the real offset is known to {np.rad2deg(largest):.4f} deg (k = 2)"
            checks.append(GateCheck("uncertainty", largest <= REAL_LIMIT_RAD, largest, REAL_LIMIT_RAD, words))
            hidden = self.teller.detectable_m(story.real_axes, HIDDEN_POWER)
            words = f"a length wrong by {1e3 * hidden:.1f} mm would show in any capture"
            checks.append(
                GateCheck("redundancy", hidden <= HIDDEN_OUTLIER_M, hidden, HIDDEN_OUTLIER_M, words)
            )
        return tuple(checks)

    def _equipment_checks(self, story: Story) -> list[GateCheck]:
        moved = self._change_of(story)[0]
        words = (
            f"{story.subject} is off its record by at most {moved:.1f} of the deviations that are believed"
        )
        hidden = self.teller.detectable_m((), HIDDEN_POWER, any_equipment=True)
        seen = f"a length wrong by {1e3 * hidden:.1f} mm would show in any capture"
        return [
            GateCheck("equipment", moved <= _CREDIBLE_CHANGE, moved, _CREDIBLE_CHANGE, words),
            GateCheck("redundancy", hidden <= HIDDEN_OUTLIER_M, hidden, HIDDEN_OUTLIER_M, seen),
        ]

    def _u_rad(self, story: Story) -> tuple[float, ...]:
        """Return the expanded uncertainty of the joints (k = 2), widened where the lengths scatter more."""
        per_turn = self.robot.drive.radians_per_turn()
        variance = np.diag(per_turn @ story.covariance @ per_turn.T)
        widened = max(1.0, story.chi_square / max(story.degrees_of_freedom, 1))
        return tuple(2.0 * float(np.sqrt(max(v, 0.0) * widened)) for v in variance)

    def _changed(self, story: Story, real: Story) -> TurnRecovery:
        part = story.subject
        if self._count - self.model.axes < _SPARE_FOR_CHANGE:
            return self._undecided(story, real, f"{part} may not be where it was: not decidable yet")
        words = f"the robot or the wire is not as recorded (most likely {part}): full calibration advised"
        return self._result(
            replace(story, chi_square=real.chi_square), real, ("geometry", False, words), part=part
        )

    def _undecided(
        self, story: Story, real: Story, words: str, *, gate: tuple[GateCheck, ...] | None = None
    ) -> TurnRecovery:
        gate = self._gate(story, real) if gate is None else gate
        if story.kind == "outlier":
            again = (tuple(float(v) for v in self.local.joints_rad[story.capture]),)
            return self._result(story, real, ("undecided", False, words), gate=gate, further=again)
        further = self.further(self.local.joints_rad, self.model.axes + SPARE_CAPTURES - self._count)
        words = f"{words}; measure {len(further)} more"
        return self._result(story, real, ("undecided", False, words), gate=gate, further=further)

    def _weak_words(self, real: Story) -> str:
        sigma = np.sqrt(np.diag(real.covariance))
        worst = int(np.argmax(sigma))
        name = self.model.joint_names[worst]
        return f"these poses leave the motor of {name} open to {sigma[worst]:.2f} turns"

    def _words(self, story: Story) -> str:
        names = self.model.joint_names
        if story.kind == "turns":
            moved = [f"{names[j]} {round(t):+d}" for j, t in enumerate(story.turns) if round(t)]
            return f"whole turns only: {', '.join(moved) or 'none lost'}; zero offsets unchanged"
        if story.kind == "motor":
            renewed = " and ".join(names[j] for j in story.real_axes)
            return f"the reference of {renewed} is new, the others lost turns"
        if story.kind == "all":
            return "every reference is lost: all offsets are real"
        if story.kind == "outlier":
            return f"capture {story.capture + 1} does not fit the others: measure it again"
        if story.kind == "equipment":
            moved = [f"{names[j]} {round(t):+d}" for j, t in enumerate(story.turns) if round(t)]
            return f"whole turns only: {', '.join(moved) or 'none lost'}; {story.subject} is not as recorded"
        return f"{story.subject} is not where it was"

    def _result(
        self,
        story: Story,
        real: Story,
        outcome: tuple[str, bool, str],
        *,
        gate: tuple[GateCheck, ...] = (),
        further: tuple[tuple[float, ...], ...] = (),
        part: str = "",
    ) -> TurnRecovery:
        mode, accepted, reason = outcome
        change: dict[str, Any] = {}
        if mode == "equipment":
            mode, part = "motor" if story.real_axes else "turns", story.subject
            _, moved, covariance = self._change_of(story)
            change = {
                "equipment_change": tuple(float(v) for v in moved),
                "equipment_covariance": tuple(tuple(float(v) for v in row) for row in covariance),
            }
        offsets = tuple(float(t) for t in story.turns)
        return TurnRecovery(
            mode=mode,
            accepted=accepted,
            reason=reason,
            turns=tuple(round(t) for t in offsets),
            replaced_axes=story.real_axes,
            offset_turns=offsets,
            offset_u_rad=self._u_rad(story),
            counts_at_zero=self.robot.drive.shifted_zero(self.robot.counts_at_zero, offsets),
            gate=gate,
            poses_needed=len(further),
            next_joints_rad=further,
            suspect_capture=story.capture if story.kind == "outlier" else None,
            changed_part=part,
            success_probability=story.fix.success_probability,
            sigma_turns=tuple(float(v) for v in np.sqrt(np.diag(real.covariance))),
            chi_square=story.chi_square,
            degrees_of_freedom=story.degrees_of_freedom,
            captures=self.problem.captures,
            offset_covariance=tuple(tuple(float(v) for v in row) for row in story.covariance),
            **(self._sharpness(story) if mode == "turns" else {}),
            **change,
        )

    def _sharpness(self, story: Story) -> dict[str, Any]:
        """Say how far the captures put each motor from a whole turn, and what would pass for one."""
        changed = story.kind == "equipment"
        alone = list(self.teller.motors_and_equipment() if changed else self.teller.motors(1))
        sigmas = [float(np.sqrt(story.covariance[story.real_axes[0], story.real_axes[0]])) for story in alone]
        found = [float(story.turns[story.real_axes[0]]) for story in alone]
        doubts = [abs(turns - round(turns)) / sigma for turns, sigma in zip(found, sigmas, strict=True)]
        return {
            "doubt_sigmas": max(doubts),
            "blind_turns": tuple(BLIND_SIGMAS * sigma for sigma in sigmas),
        }
