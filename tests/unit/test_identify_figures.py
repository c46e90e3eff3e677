"""Held-out figures of an identification: of the rows that the model describes, and with those put aside."""

import numpy as np
import pytest

from cellcal.calibration.identification.cross_validation import ErrorSummary
from cellcal.service.cli.identify_report import held_out_figures
from cellcal.service.engineering.identification.described_errors import DescribedErrors, described_errors
from cellcal.service.engineering.measured.usable_rows import OUTLIER, REPEAT, RejectedRow

ERRORS_M = np.array([1e-4, 2e-4, 5e-3, 1e-4])
BEFORE_M = np.array([1e-3, 3e-3, 6e-3, 2e-3])
ROWS = np.array([0, 2, 3, 5])  # of the file


def described(*rejected: RejectedRow) -> DescribedErrors | None:
    return described_errors(rejected, ROWS, BEFORE_M, ERRORS_M)


def test_rows_put_aside_are_in_one_figure_and_not_in_the_other() -> None:
    found = described(RejectedRow(3, "off", OUTLIER), RejectedRow(4, "twice", REPEAT))
    assert found is not None
    assert found.held_out.n == found.before.n == 3
    assert found.held_out.max_m == pytest.approx(2e-4)
    assert found.before.max_m == pytest.approx(3e-3)  # of the same rows: one is compared with the other


def test_without_rows_put_aside_there_is_one_figure() -> None:
    assert described(RejectedRow(4, "twice", REPEAT)) is None
    assert described(RejectedRow(7, "not held out", OUTLIER)) is None


def test_both_figures_are_told_with_how_many_were_put_aside() -> None:
    every, some = ErrorSummary.from_sizes(ERRORS_M), ErrorSummary.from_sizes(ERRORS_M[[0, 1, 3]])
    titles = [title for title, _ in held_out_figures("2", every, some)]
    assert titles == [
        "held out, rows that the model describes: level 2",
        "held out, with 1 put aside: level 2",
    ]
    assert held_out_figures("2", every, None) == [("held out: level 2", every)]
