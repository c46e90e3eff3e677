"""What may be said of a result: PASS must be proved, FAIL must be proved, the rest is measured more."""

import json
import math

import pytest

from cellcal.calibration.errors import CalibrationError
from cellcal.calibration.uncertainty import Verdict as Word
from cellcal.procedures.accuracy_limits import (
    FRAME,
    TOOL,
    FrameLimits,
    is_in_reach,
    limits_in_force,
    limits_text,
)
from cellcal.procedures.verdict import (
    Characteristic,
    ProcedureVerdict,
    judge_value,
    known_within,
    state_evidence,
    state_fact,
    state_figure,
)


@pytest.mark.parametrize(
    ("value", "word"), [(0.80, Word.PASS), (-0.80, Word.PASS), (0.90, Word.UNDECIDED), (1.20, Word.FAIL)]
)
def test_a_magnitude_is_judged_with_its_guard_band(value: float, word: Word) -> None:
    figure = judge_value("residual", value, "m", u=0.1, limit=1.0)
    assert figure.decision is word
    assert "PASS if x + g <= L" in figure.rule
    assert figure.expanded_uncertainty == pytest.approx(0.2)


def test_few_degrees_of_freedom_widen_the_band_and_the_coverage() -> None:
    wide = judge_value("residual", 0.80, "m", u=0.1, limit=1.0, degrees_of_freedom=3)
    assert wide.decision is Word.UNDECIDED
    assert wide.coverage == pytest.approx(3.18, abs=0.01)


def test_how_well_something_is_known_never_fails() -> None:
    assert known_within("tip", "m", u=0.0002, limit=0.0004).decision is Word.PASS
    poor = known_within("tip", "m", u=0.3, limit=0.0004)
    assert poor.decision is Word.UNDECIDED
    assert poor.value == poor.expanded_uncertainty == 0.6


def test_the_worst_figure_gives_the_word() -> None:
    good, bad = state_fact("a", True, "r"), state_fact("b", False, "r")
    open_ = state_evidence("c", False, "r", found=0.9, limit=0.99)
    assert ProcedureVerdict((good, state_figure("d", 1.0, "m"))).overall_decision is Word.PASS
    assert ProcedureVerdict((good, open_)).overall_decision is Word.UNDECIDED
    assert ProcedureVerdict((good, open_, bad)).overall_decision is Word.FAIL
    assert (
        ProcedureVerdict((state_figure("d", 1.0, "m"),)).overall_decision is Word.UNDECIDED
    )  # nothing was decided
    assert ProcedureVerdict(()).overall_decision is Word.UNDECIDED


@pytest.mark.parametrize("wrong", [math.nan, math.inf, -math.inf])
def test_no_figure_that_is_not_finite(wrong: float) -> None:
    with pytest.raises(CalibrationError):
        state_figure("x", wrong, "m")
    with pytest.raises(CalibrationError):
        judge_value("x", 1.0, "m", u=wrong, limit=2.0)
    with pytest.raises(CalibrationError):
        Characteristic("x", 1.0, "m", -0.1, 2.0)


def test_a_verdict_is_json() -> None:
    document = ProcedureVerdict(
        (known_within("tip", "m", u=0.1, limit=1.0, degrees_of_freedom=math.inf),)
    ).to_json()
    told_again = json.loads(json.dumps(document, allow_nan=False))
    assert told_again["word"] == "pass"
    assert told_again["characteristics"][0]["expanded_uncertainty"] == 0.2


def test_classes_grow_coarser_and_an_engineer_may_set_his_own() -> None:
    assert TOOL["A"].tip_m < TOOL["B"].tip_m < TOOL["C"].tip_m
    assert FRAME["A"].angle_rad < FRAME["B"].angle_rad < FRAME["C"].angle_rad
    own = FrameLimits(0.002, 0.01)
    assert limits_in_force(FRAME, "A", own) is own
    assert limits_in_force(FRAME, "A", None) is FRAME["A"]
    assert "class A" in limits_text("A", None)
    assert "engineer" in limits_text("A", own)


def test_a_class_is_in_reach_up_to_a_third_of_its_limit() -> None:
    assert is_in_reach(0.0999, 0.3)
    assert not is_in_reach(0.1001, 0.3)
