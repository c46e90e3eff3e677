"""What may have happened to a robot that lost its counts, and how well each story explains the wire lengths.

All stories are judged around the real-valued solution, where lengths are linear in the motors' turns. With
the lengths whitened by their covariance, one small matrix of inner products is all that any story needs.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from typing import Protocol

import numpy as np

from cellcal.calibration.arm.kinematics import RobotModel
from cellcal.calibration.errors import CalibrationError
from cellcal.calibration.geometry import Array
from cellcal.calibration.mastering.counts import MasteringRecord, WireCapture
from cellcal.calibration.mastering.integer_search import IntegerFix, search_integers
from cellcal.calibration.message import make_message
from cellcal.calibration.wires.model import FRAME_PARAMETERS, WirePoses, WireTerms
from cellcal.calibration.wires.reference import WirePredictor

_MAX_ITERATIONS = 20
_SETTLED_TURNS = 1e-5
_LONGEST_STEP_TURNS = 3.0
# How far a crash or a knock may have moved things (one deviation).
_CRASH_LENGTH_M, _CRASH_ANGLE_RAD, _ANCHOR_MOVED_M, _HOOK_MOVED_M = 0.005, 0.0087266, 0.020, 0.005
_OUTLIER_M = 0.050
# By how much a wire may differ from its record without a knock (one deviation): anchor and hook [m], zero [m], scale.
_WIRE_CHANGED = np.array([0.0025] * 3 + [0.001] * 3 + [0.0025, 0.001])
# Log of how much rarer it is that one more motor is exchanged, or that everything is lost.
_RARER = -4.0


_WIRE_GROUPS = (
    slice(0, 3),
    slice(3, 6),
    slice(6, 8),
    slice(6, 7),
    slice(7, 8),
)  # anchor, hook, zero and scale
_ANCHOR, _HOOK = "the anchor of the wire", "the hook"


class TurnEvidence(Protocol):
    """Captures of a robot that lost counts: what they say if the motors had lost these or those turns."""

    @property
    def capture_count(self) -> int:
        """The number of captures."""
        ...

    def model_values(self, turns: Array) -> Array:
        """Return what is modelled to be seen (m,), if the motors had lost these turns (n,)."""
        ...

    def linearise_at(self, turns: Array) -> "LocalResiduals":
        """Look at the captures as if the motors had lost these turns (n,)."""
        ...


class LossProblem:
    """Captures of a robot with lost counts, seen with its healthy record: lengths against turns."""

    def __init__(self, model: RobotModel, record: MasteringRecord, captures: Sequence[WireCapture]) -> None:
        if any(len(c.counts) != model.axis_count for c in captures):
            raise CalibrationError(
                make_message(
                    "every capture needs the counts of all {axis_count} motors", axis_count=model.axis_count
                )
            )
        self.predictor = WirePredictor(model, *record.wire_lengths())
        self._per_turn = record.drive.radians_per_turn()
        counts = np.array([c.counts for c in captures], dtype=float).reshape(-1, model.axis_count)
        self._read_joints = record.drive.to_joints(counts, np.array(record.counts_at_zero))
        self._lengths = np.array([c.length_m for c in captures])
        self._sigma = np.array([c.sigma_m for c in captures])
        self._flank = np.array([float(c.settled_from != "record") for c in captures])
        self.capture_count = len(captures)

    def model_values(self, turns: Array) -> Array:
        """Return the modelled lengths (m,) [m] if the motors had lost these turns (n,)."""
        return self._wire_terms(turns).lengths

    def _wire_terms(self, turns: Array) -> WireTerms:
        joints = self._read_joints + turns @ self._per_turn.T
        return self.predictor.wire_terms(WirePoses(joints, self._sigma, self._flank))

    def linearise_at(self, turns: Array) -> "LocalResiduals":
        """Look at the captures as if the motors had lost these turns (n,)."""
        terms = self._wire_terms(turns)
        expected, scatter = self.predictor.expected_lengths(terms)
        return LocalResiduals(
            turns=turns,
            joints_rad=terms.poses.joints_rad,
            values=terms.lengths,
            residuals=self._lengths - expected,
            by_turn=terms.by_joint @ self._per_turn,
            scatter=scatter,
            parts=_changed_parts(terms.by_parameter, self._read_joints.shape[1]),
            rows=tuple(slice(k, k + 1) for k in range(self.capture_count)),
            equipment=Equipment(
                "the wire",
                (_ANCHOR, _HOOK),
                terms.by_parameter[:, :FRAME_PARAMETERS] * _WIRE_CHANGED,
                _WIRE_GROUPS,
            ),
        )


def _changed_parts(by_x: Array, axes: int) -> dict[str, Array]:
    """Return the columns of the wire's ends and the links, each of the size of a knock or a crash."""
    ends = {
        _ANCHOR: by_x[:, :3] * _ANCHOR_MOVED_M,
        _HOOK: by_x[:, 3:6] * _HOOK_MOVED_M,
    }
    return ends | bent_links(by_x[:, FRAME_PARAMETERS:], axes)


def bent_links(by_geometry: Array, axes: int) -> dict[str, Array]:
    """Return columns (m, p) by link, scaled to what a crash may do, from derivatives by geometry errors."""
    length, angle = _CRASH_LENGTH_M, _CRASH_ANGLE_RAD
    dh = by_geometry.shape[1] == 5 * axes
    sizes = np.array([angle, length, length, angle, angle] if dh else [length] * 3 + [angle] * 3)
    return {
        make_message("link {link}", link=index + 1 if dh else index): by_geometry[
            :, index * len(sizes) : (index + 1) * len(sizes)
        ]
        * sizes
        for index in range(by_geometry.shape[1] // len(sizes))
    }


@dataclass(frozen=True, eq=False, slots=True)
class Equipment:
    """The measuring equipment, and how residuals change where it is no longer as recorded.

    ``columns`` (m, k) are derivatives by its parameters, each of the size of one deviation; ``parts`` are the names
    of the parts of ``LocalResiduals`` that belong to it; ``groups`` are columns that often change without the others.
    """

    name: str
    parts: tuple[str, ...]
    columns: Array
    groups: tuple[slice, ...]

    def estimate_change(self, residuals: Array, scatter: Array) -> tuple[Array, Array]:
        """Return the change (k,) that explains residuals (m,) best, and its covariance, in units of the deviations.

        The prior is one deviation for each parameter, so that what the poses cannot tell stays as recorded.
        """
        weighted = np.linalg.solve(scatter, np.column_stack([self.columns, residuals]))
        information = np.eye(self.columns.shape[1]) + self.columns.T @ weighted[:, :-1]
        covariance = np.asarray(np.linalg.inv(information), dtype=np.float64)
        return covariance @ (self.columns.T @ weighted[:, -1]), covariance


@dataclass(frozen=True, eq=False, slots=True)
class LocalResiduals:
    """Residuals (m,) at some turns, their derivative by turns (m, n) and their covariance (m, m).

    Rows are lengths [m], coordinates [m] or angles [rad]; ``rows`` tells which belong to one capture. ``parts``
    are columns of what else may have moved, one name each.
    """

    turns: Array
    joints_rad: Array  # of the captures
    values: Array  # as modelled
    residuals: Array
    by_turn: Array
    scatter: Array
    parts: Mapping[str, Array]
    rows: tuple[slice, ...]
    equipment: Equipment

    def with_any_equipment(self) -> "LocalResiduals":
        """Return the same with the equipment's changes as part of the scatter: it is measured anew."""
        columns = self.equipment.columns
        return replace(self, scatter=self.scatter + columns @ columns.T)

    def chi_square(self) -> float:
        """Return the residuals' squared length in the metric of their covariance."""
        return float(self.residuals @ np.linalg.solve(self.scatter, self.residuals))

    def gauss_newton_step(self, free: Sequence[int], *, towards: Array, uncertainty_turns: float) -> Array:
        """Return the Gauss-Newton step (n,) of the free motors, with a weak pull towards what is believed."""
        rows = list(free)
        by_free = self.by_turn[:, rows]
        weighted = np.linalg.solve(self.scatter, np.column_stack([by_free, self.residuals]))
        information = by_free.T @ weighted[:, :-1] + np.eye(len(rows)) / uncertainty_turns**2
        gradient = by_free.T @ weighted[:, -1] + (towards - self.turns)[rows] / uncertainty_turns**2
        step = np.zeros(len(self.turns))
        step[rows] = np.linalg.solve(information, gradient)
        return step / max(1.0, float(np.abs(step).max()) / _LONGEST_STEP_TURNS)


@dataclass(frozen=True, eq=False, slots=True)
class AnyEquipment:
    """The same evidence where the equipment that measures need not be as recorded."""

    evidence: TurnEvidence

    @property
    def capture_count(self) -> int:
        """The number of captures."""
        return self.evidence.capture_count

    def model_values(self, turns: Array) -> Array:
        """Return what is modelled to be seen (m,), as recorded."""
        return self.evidence.model_values(turns)

    def linearise_at(self, turns: Array) -> LocalResiduals:
        """Look at the captures with the equipment's changes as part of their scatter."""
        return self.evidence.linearise_at(turns).with_any_equipment()


def solve_real(
    problem: TurnEvidence, start: Array, *, free: Sequence[int], towards: Array, uncertainty_turns: float
) -> LocalResiduals:
    """Return the real-valued solution of the free motors, by Gauss-Newton from ``start``."""
    local = problem.linearise_at(start)
    for _ in range(_MAX_ITERATIONS):
        step = local.gauss_newton_step(free, towards=towards, uncertainty_turns=uncertainty_turns)
        local = problem.linearise_at(local.turns + step)
        if float(np.abs(step).max()) < _SETTLED_TURNS:
            break
    return local


@dataclass(frozen=True, eq=False, slots=True)
class Hypothesis:
    """One explanation: which motors are off by real amounts, and what else is wrong.

    ``kind`` is turns, motor, all, equipment, geometry, outlier; ``subject`` names the part or capture that is wrong.
    """

    kind: str
    real_axes: tuple[int, ...]
    subject: str
    capture: int
    turns: Array  # (n,): whole where the motor is not in real_axes
    fix: IntegerFix
    rounded_same: bool
    chi_square: float
    degrees_of_freedom: int
    log_evidence: float
    covariance: Array  # (n, n) of the turns; zero for whole ones


class HypothesisTest:
    """Evaluates stories around the real-valued solution."""

    def __init__(
        self, local: LocalResiduals, uncertainty_turns: float, replaced_axes: Sequence[int] = ()
    ) -> None:
        self._local, self.replaced = local, tuple(sorted(set(replaced_axes)))
        self._loose = np.eye(len(local.turns)) / uncertainty_turns**2
        factor = np.linalg.cholesky(local.scatter)
        stacked = np.column_stack(
            [local.by_turn, local.residuals, *local.parts.values(), np.eye(len(factor))]
        )
        self._white = np.linalg.solve(factor, stacked)
        self._equipment = np.linalg.solve(factor, local.equipment.columns)
        names, position = {}, len(local.turns) + 1
        for name, columns in local.parts.items():
            names[name] = slice(position, position + columns.shape[1])
            position += columns.shape[1]
        self._columns, self._impulses = names, position

    def test_all_lost(self) -> "Hypothesis":
        """All references lost: nothing is a whole turn."""
        return self._evaluate_hypothesis("all", tuple(range(len(self._local.turns))))

    def test_whole_turns(self) -> "Hypothesis":
        """Only whole turns were lost, except by the motors that are known to be replaced."""
        return self._evaluate_hypothesis("motor" if self.replaced else "turns", self.replaced)

    def test_motors(self, together: int) -> "Iterator[Hypothesis]":
        """So many more motors were exchanged or slipped; the others lost whole turns."""
        others = [j for j in range(len(self._local.turns)) if j not in self.replaced]
        for axes in combinations(others, together):
            yield self._evaluate_hypothesis("motor", tuple(sorted((*self.replaced, *axes))))

    def test_equipment(self) -> "Hypothesis":
        """Whole turns were lost, and the equipment that measures is not as recorded.

        Turns and gate are judged with all its parameters free; the evidence is that of the group that explains most.
        """
        equipment, columns = self._local.equipment, self._equipment
        groups = [columns, *(columns[:, group] for group in equipment.groups)]
        hypotheses = [
            self._evaluate_hypothesis("equipment", self.replaced, equipment.name, extra=group)
            for group in groups
        ]
        best = max(hypothesis.log_evidence for hypothesis in hypotheses)
        return replace(hypotheses[0], log_evidence=best - float(np.log(len(groups))))

    def motors_and_equipment(self) -> "Iterator[Hypothesis]":
        """One more motor was exchanged, and the equipment is not as recorded either."""
        for axis in (j for j in range(len(self._local.turns)) if j not in self.replaced):
            real = tuple(sorted((*self.replaced, axis)))
            yield self._evaluate_hypothesis("motor", real, self._local.equipment.name, extra=self._equipment)

    def test_geometry(self) -> "Iterator[Hypothesis]":
        """Whole turns were lost, and a link, the anchor or the hook is not where it was."""
        for name, columns in self._columns.items():
            yield self._evaluate_hypothesis("geometry", self.replaced, name, extra=self._white[:, columns])

    def test_outliers(self, real_axes: tuple[int, ...] = ()) -> "Iterator[Hypothesis]":
        """One length is wrong; besides, motors may be replaced."""
        real_axes = real_axes or self.replaced
        for capture, rows in enumerate(self._local.rows):
            impulse = _OUTLIER_M * self._white[:, self._impulses + rows.start : self._impulses + rows.stop]
            yield self._evaluate_hypothesis("outlier", real_axes, str(capture), extra=impulse)

    def detectable_m(self, real_axes: Sequence[int], power: float, *, any_equipment: bool = False) -> float:
        """Return the outlier [m] that shows at ``power`` deviations in the capture that hides it best."""
        white = self._white[:, : len(self._local.turns)][:, list(real_axes)]
        if any_equipment:
            white = np.column_stack([white, self._equipment])
        impulses = self._white[:, self._impulses :]
        if white.shape[1]:
            basis = np.linalg.qr(white)[0]
            impulses = impulses - basis @ (basis.T @ impulses)
        smallest_singular = [
            np.linalg.svd(impulses[:, rows], compute_uv=False)[-1] for rows in self._local.rows
        ]
        return float(power / max(min(smallest_singular), 1e-6))

    def _evaluate_hypothesis(
        self, kind: str, real_axes: tuple[int, ...], subject: str = "", *, extra: Array | None = None
    ) -> Hypothesis:
        """Judge one story; ``extra`` (m, p) are whitened columns of what else may be wrong, unit size."""
        n = len(self._local.turns)
        gram, penalty = _gram_matrix(self._white[:, : n + 1], extra)
        information, gradient, square = gram[:n, :n], gram[:n, n], float(gram[n, n])
        covariance = np.asarray(np.linalg.inv(information + self._loose), dtype=np.float64)
        estimate = self._local.turns + covariance @ gradient
        whole = [j for j in range(n) if j not in real_axes]
        fix = search_integers(estimate[whole], covariance[np.ix_(whole, whole)])
        move = np.zeros(n)
        move[whole] = np.array(fix.best, dtype=float) - self._local.turns[whole]
        real, spread = list(real_axes), np.zeros((n, n))
        if real:
            inner = np.linalg.inv((information + self._loose)[np.ix_(real, real)])
            move[real] = inner @ (gradient[real] - information[np.ix_(real, whole)] @ move[whole])
            spread[np.ix_(real, real)] = inner
            penalty -= float(np.linalg.slogdet(2 * np.pi * inner)[1])
        chi_square = square - 2 * float(gradient @ move) + float(move @ information @ move)
        return Hypothesis(
            kind=kind,
            real_axes=real_axes,
            subject=subject,
            capture=int(subject) if kind == "outlier" else -1,
            turns=self._local.turns + move,
            fix=fix,
            rounded_same=fix.best == tuple(int(v) for v in np.rint(estimate[whole])),
            chi_square=chi_square,
            degrees_of_freedom=len(self._local.residuals)
            - len(real)
            - (extra.shape[1] if kind == "outlier" and extra is not None else 0),
            log_evidence=-0.5 * (chi_square + penalty)
            + _RARER * min(max(len(real) - max(len(self.replaced), 1), 0), 2),
            covariance=spread,
        )


def _gram_matrix(columns: Array, extra: Array | None) -> tuple[Array, float]:
    """Return inner products of whitened columns in the presence of extra unknowns, and log determinant."""
    gram = columns.T @ columns
    if extra is None:
        return gram, 0.0
    cross = columns.T @ extra
    inner = np.eye(extra.shape[1]) + extra.T @ extra
    return gram - cross @ np.linalg.solve(inner, cross.T), float(np.linalg.slogdet(inner)[1])
