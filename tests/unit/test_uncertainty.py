"""Coverage factors and the decision rule."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cellcal.calibration.errors import CalibrationError
from cellcal.calibration.uncertainty import (
    Verdict,
    chi_square_limit,
    coverage_factor,
    decide_conformity,
    effective_degrees_of_freedom,
)


@pytest.mark.parametrize(("dof", "factor"), [(6, 2.447), (1, 12.706), (30, 2.042), (float("inf"), 2.0)])
def test_coverage_factors_are_those_of_the_tables(dof, factor):
    assert coverage_factor(dof) == pytest.approx(factor, abs=1e-3)


def test_chi_square_limits_are_those_of_the_tables():
    assert chi_square_limit(6) == pytest.approx(22.458, abs=1e-3)
    assert chi_square_limit(14, 0.95) == pytest.approx(23.685, abs=1e-3)


@pytest.mark.parametrize(
    ("value", "verdict"),
    [(0.7, Verdict.PASS), (0.95, Verdict.UNDECIDED), (1.05, Verdict.UNDECIDED), (1.3, Verdict.FAIL)],
)
def test_conformity_and_nonconformity_must_both_be_proved(value, verdict):
    decision = decide_conformity(value, 0.1, 1.0)
    assert decision.verdict is verdict
    assert decision.guard_band == pytest.approx(0.1645, abs=1e-4)
    assert "ISO 14253-1" in decision.rule


def test_few_degrees_of_freedom_widen_the_guard_band():
    assert decide_conformity(0.82, 0.1, 1.0).verdict is Verdict.PASS
    assert decide_conformity(0.82, 0.1, 1.0, degrees_of_freedom=5).verdict is Verdict.UNDECIDED


@given(st.floats(0, 10), st.floats(0, 2), st.floats(0.1, 10))
def test_a_larger_uncertainty_never_turns_undecided_into_a_verdict(value, u, limit):
    wide = decide_conformity(value, 2 * u, limit).verdict
    assert decide_conformity(value, u, limit).verdict is wide or wide is Verdict.UNDECIDED


def test_the_rule_keeps_its_promise():
    rng = np.random.default_rng(4)
    shown = 1.0 + rng.normal(0, 0.1, 4000)  # the truth lies on the limit
    passed = np.mean([decide_conformity(x, 0.1, 1.0).verdict is Verdict.PASS for x in shown])
    assert passed == pytest.approx(0.05, abs=0.012)


def test_welch_satterthwaite():
    assert effective_degrees_of_freedom([(1.0, 4.0), (1.0, 4.0)]) == pytest.approx(8.0)
    assert effective_degrees_of_freedom([(1.0, float("inf"))]) == float("inf")


@pytest.mark.parametrize("bad", [(float("nan"), 0.1, 1.0), (0.5, -0.1, 1.0), (0.5, 0.1, float("inf"))])
def test_nonsense_is_refused(bad):
    with pytest.raises(CalibrationError):
        decide_conformity(*bad)


def test_no_degrees_of_freedom_are_refused():
    with pytest.raises(CalibrationError):
        coverage_factor(0)
    with pytest.raises(CalibrationError):
        chi_square_limit(0)
