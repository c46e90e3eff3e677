"""What may be said of a result: PASS must be proved, FAIL must be proved, the rest is measured more."""

import json
import math

import pytest

from cellcal.calibration.errors import CalibrationError
from cellcal.calibration.uncertainty import Verdict as Word
from cellcal.procedures.limits import FRAME, TOOL, FrameLimits, chosen, in_reach, told
from cellcal.procedures.verdict import Characteristic, Verdict, enough, held, judged, known_within, stated


@pytest.mark.parametrize(
    ("value", "word"), [(0.80, Word.PASS), (-0.80, Word.PASS), (0.90, Word.UNDECIDED), (1.20, Word.FAIL)]
)
def test_a_magnitude_is_judged_with_its_guard_band(value: float, word: Word) -> None:
    figure = judged("residual", value, "m", u=0.1, limit=1.0)
    assert figure.decision is word
    assert "PASS if x + g <= L" in figure.rule
    assert figure.expanded == pytest.approx(0.2)


def test_few_degrees_of_freedom_widen_the_band_and_the_coverage() -> None:
    wide = judged("residual", 0.80, "m", u=0.1, limit=1.0, degrees_of_freedom=3)
    assert wide.decision is Word.UNDECIDED
    assert wide.coverage == pytest.approx(3.18, abs=0.01)


def test_how_well_something_is_known_never_fails() -> None:
    assert known_within("tip", "m", u=0.0002, limit=0.0004).decision is Word.PASS
    poor = known_within("tip", "m", u=0.3, limit=0.0004)
    assert poor.decision is Word.UNDECIDED
    assert poor.value == poor.expanded == 0.6


def test_the_worst_figure_gives_the_word() -> None:
    good, bad = held("a", True, "r"), held("b", False, "r")
    open_ = enough("c", False, "r", found=0.9, limit=0.99)
    assert Verdict((good, stated("d", 1.0, "m"))).word is Word.PASS
    assert Verdict((good, open_)).word is Word.UNDECIDED
    assert Verdict((good, open_, bad)).word is Word.FAIL
    assert Verdict((stated("d", 1.0, "m"),)).word is Word.UNDECIDED  # nothing was decided
    assert Verdict(()).word is Word.UNDECIDED


@pytest.mark.parametrize("wrong", [math.nan, math.inf, -math.inf])
def test_no_figure_that_is_not_finite(wrong: float) -> None:
    with pytest.raises(CalibrationError):
        stated("x", wrong, "m")
    with pytest.raises(CalibrationError):
        judged("x", 1.0, "m", u=wrong, limit=2.0)
    with pytest.raises(CalibrationError):
        Characteristic("x", 1.0, "m", -0.1, 2.0)


def test_a_verdict_is_json() -> None:
    document = Verdict((known_within("tip", "m", u=0.1, limit=1.0, degrees_of_freedom=math.inf),)).as_object()
    told_again = json.loads(json.dumps(document, allow_nan=False))
    assert told_again["word"] == "pass"
    assert told_again["characteristics"][0]["expanded_uncertainty"] == 0.2


def test_classes_grow_coarser_and_an_engineer_may_set_his_own() -> None:
    assert TOOL["A"].tip_m < TOOL["B"].tip_m < TOOL["C"].tip_m
    assert FRAME["A"].angle_rad < FRAME["B"].angle_rad < FRAME["C"].angle_rad
    own = FrameLimits(0.002, 0.01)
    assert chosen(FRAME, "A", own) is own
    assert chosen(FRAME, "A", None) is FRAME["A"]
    assert "class A" in told("A", None)
    assert "engineer" in told("A", own)


def test_a_class_is_in_reach_up_to_a_third_of_its_limit() -> None:
    assert in_reach(0.0999, 0.3)
    assert not in_reach(0.1001, 0.3)
