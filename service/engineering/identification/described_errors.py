"""Errors of the rows that a model describes: without those that were put aside, which no model would fit."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from cellcal.calibration.geometry import Array
from cellcal.calibration.identification.cross_validation import ErrorSummary
from cellcal.calibration.identification.observations import Rows
from cellcal.service.engineering.measured.usable_rows import OUTLIER, RejectedRow


@dataclass(frozen=True, slots=True)
class DescribedErrors:
    """Errors of the rows that a model describes, by the nominal and by the identified robot."""

    before: ErrorSummary
    held_out: ErrorSummary


def described_errors(
    rejected: Sequence[RejectedRow], rows: Rows, before_m: Array, held_out_m: Array
) -> DescribedErrors | None:
    """Return the errors (H,) of rows of the file (H,) without the outliers; none where no row is one."""
    describes = ~np.isin(rows, [row.row for row in rejected if row.kind == OUTLIER])
    if describes.all():
        return None
    of_nominal, of_identified = before_m[describes], held_out_m[describes]
    return DescribedErrors(ErrorSummary.from_sizes(of_nominal), ErrorSummary.from_sizes(of_identified))
