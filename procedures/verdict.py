"""What a finished procedure may claim: each figure with its uncertainty, its limit and the rule that judged it.

A procedure says its verdict in a function ``(spec, result) -> Verdict`` on its card. Four ways to say a figure:

* ``judge_value``: a measured magnitude with its uncertainty against a limit, after ISO 14253-1;
* ``known_within``: how well something is known, against how well it must be known; never FAIL, only "measure more";
* ``state_fact``: a fact that holds or does not, such as a check of a gate or a value read back;
* ``state_figure``: a figure that nothing judges.
"""

import math
from dataclasses import dataclass, replace
from typing import Any

from pydantic_core import to_jsonable_python

from cellcal.calibration import uncertainty
from cellcal.calibration.errors import CalibrationError
from cellcal.calibration.message import join_messages, make_message
from cellcal.calibration.uncertainty import coverage_factor, decide_conformity

PASS, FAIL, UNDECIDED = uncertainty.Verdict.PASS, uncertainty.Verdict.FAIL, uncertainty.Verdict.UNDECIDED

_CHANCE = "a chance of 1 is certainty, and 0 is none; it is shown rounded"
_CHI_SQUARE = (
    "chi square counts how far the measurements are off, in their own deviations; "
    "up to the limit that is noise"
)
NOTHING_MEASURED = "Nothing was measured in this run: nothing to save."


@dataclass(frozen=True, slots=True)
class Contribution:
    """One line of an uncertainty budget, in the unit of its characteristic."""

    name: str
    standard_uncertainty: float
    source: str  # measured, data sheet, cell file, estimated


@dataclass(frozen=True, slots=True)
class Characteristic:
    """One figure that was decided or stated. Units are SI: m, rad, s, turn, 1."""

    name: str
    value: float
    unit: str
    standard_uncertainty: float
    coverage: float  # k of ``expanded_uncertainty``
    limit: float | None = None
    decision: uncertainty.Verdict | None = None  # None where nothing judges it
    rule: str = ""
    budget: tuple[Contribution, ...] = ()

    def __post_init__(self) -> None:
        figures = (self.value, self.standard_uncertainty, self.coverage, self.limit or 0.0)
        if not all(math.isfinite(figure) for figure in figures) or self.standard_uncertainty < 0:
            raise CalibrationError(
                make_message("{name}: a verdict needs finite figures and an uncertainty >= 0", name=self.name)
            )

    @property
    def expanded_uncertainty(self) -> float:
        """Expanded uncertainty U = k u."""
        return self.coverage * self.standard_uncertainty

    def with_budget(self, *contributions: Contribution) -> "Characteristic":
        """Return the same with the lines of its uncertainty budget."""
        return replace(self, budget=contributions)


@dataclass(frozen=True, slots=True)
class ValueChange:
    """Something as it was before and as it is after; None where it was not read."""

    name: str
    before: float | None
    after: float | None
    unit: str


@dataclass(frozen=True, slots=True)
class SetAside:
    """A measurement that was taken and not used; ``step`` is its name in the journal."""

    step: str
    reason: str


@dataclass(frozen=True, slots=True)
class ProcedureVerdict:
    """All that a procedure claims, and what it does not."""

    characteristics: tuple[Characteristic, ...]
    limits_from: str = ""  # "limits of class B"
    not_verified: tuple[str, ...] = ()
    remarks: tuple[str, ...] = ()
    changes: tuple[ValueChange, ...] = ()
    set_aside: tuple[SetAside, ...] = ()
    to_sign: tuple[str, ...] = ()  # what a responsible person must confirm by hand afterwards

    @property
    def overall_decision(self) -> uncertainty.Verdict:
        """FAIL if anything failed, else UNDECIDED if anything is or nothing was decided, else PASS."""
        found = {figure.decision for figure in self.characteristics}
        return next((word for word in (FAIL, UNDECIDED, PASS) if word in found), UNDECIDED)

    def to_json(self) -> dict[str, Any]:
        """Return the verdict as JSON values, with its word and every U."""
        document: dict[str, Any] = to_jsonable_python(self)
        for row, figure in zip(document["characteristics"], self.characteristics, strict=True):
            row["expanded_uncertainty"] = figure.expanded_uncertainty
        return document | {"word": self.overall_decision.value}


def judge_value(
    name: str,
    value: float,
    unit: str,
    *,
    u: float,
    limit: float,
    degrees_of_freedom: float = math.inf,
) -> Characteristic:
    """Judge the magnitude of a measured value: conformity and non-conformity must both be proved."""
    decision = decide_conformity(abs(value), u, limit, degrees_of_freedom=degrees_of_freedom)
    rule = make_message("PASS if x + g <= L, FAIL if x - g > L, else UNDECIDED; {rule}", rule=decision.rule)
    k = coverage_factor(degrees_of_freedom)
    return Characteristic(name, value, unit, u, k, limit, decision.verdict, rule)


def known_within(
    name: str,
    unit: str,
    *,
    u: float,
    limit: float,
    degrees_of_freedom: float = math.inf,
) -> Characteristic:
    """Judge how well something is known: PASS if U is at most the limit, otherwise measure more."""
    k = coverage_factor(degrees_of_freedom)
    word = PASS if k * u <= limit else UNDECIDED
    rule = make_message("PASS if U (k = {k:.2f}, 95 %) <= L, else UNDECIDED: measure more", k=k)
    return Characteristic(name, k * u, unit, u, k, limit, word, rule)


def state_fact(
    name: str, holds: bool, rule: str, *, found: float = 1.0, limit: float | None = None, unit: str = "1"
) -> Characteristic:
    """State a fact that either holds (PASS) or does not (FAIL); ``rule`` says what was compared."""
    return Characteristic(name, found, unit, 0.0, 2.0, limit, PASS if holds else FAIL, rule)


def state_evidence(
    name: str, holds: bool, rule: str, *, found: float, limit: float, unit: str = "1"
) -> Characteristic:
    """State whether the evidence suffices: PASS, or UNDECIDED with what is missing in ``rule``."""
    return Characteristic(name, found, unit, 0.0, 2.0, limit, PASS if holds else UNDECIDED, rule)


def chi_square_rule(rule: str) -> str:
    """Return a rule about a chi square with what the number means."""
    return join_messages("; ", (rule, _CHI_SQUARE))


def chance_rule(rule: str) -> str:
    """Return a rule about a probability with what the number means."""
    return join_messages("; ", (rule, _CHANCE))


def state_figure(
    name: str, value: float, unit: str, *, u: float = 0.0, k: float = 2.0, rule: str = ""
) -> Characteristic:
    """State a figure that nothing judges."""
    return Characteristic(name, value, unit, u, k, rule=rule)
