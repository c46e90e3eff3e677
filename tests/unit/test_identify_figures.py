"""Held-out figures of an identification: of the rows that the model describes, and with those put aside."""

from types import SimpleNamespace

import numpy as np
import pytest

from cellcal.calibration.identification.cross_validation import ErrorSummary
from cellcal.service.cli.identify_report import held_out_figures
from cellcal.service.engineering.identification.identify import IdentifyReport
from cellcal.service.engineering.measured.usable_rows import OUTLIER, REPEAT, RejectedRow

ERRORS_M = np.array([1e-4, 2e-4, 5e-3, 1e-4])
ROWS = np.array([0, 2, 3, 5])  # of the file


def described(*rejected: RejectedRow) -> ErrorSummary | None:
    report = SimpleNamespace(rejected=rejected, held_out_rows=ROWS, held_out_m=ERRORS_M)
    getter = IdentifyReport.described.fget
    assert getter is not None
    found: ErrorSummary | None = getter(report)
    return found


def test_rows_put_aside_are_in_one_figure_and_not_in_the_other() -> None:
    found = described(RejectedRow(3, "off", OUTLIER), RejectedRow(4, "twice", REPEAT))
    assert found is not None
    assert found.n == 3
    assert found.max_m == pytest.approx(2e-4)


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
