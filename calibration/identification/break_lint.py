"""Whether the rows at which a device was moved are known, or are found elsewhere in each part of the data."""

from collections.abc import Iterator

import numpy as np

from cellcal.calibration.identification.identify import Identification
from cellcal.calibration.identification.lints import Lint
from cellcal.calibration.identification.observations import Rows
from cellcal.calibration.message import make_message

_FAR = 3.0  # times what the fit leaves


def unsure_breaks(found: Identification, file_rows: Rows) -> Iterator[Lint]:
    """Name breaks whose rows the folds do not agree on, where held-out rows are missed far for it.

    Parameters
    ----------
    found : Identification
        Its rows are those of the series, in order.
    file_rows : (N,)
        Their numbers in the file.
    """
    folds, chosen = found.judgement.breaks, tuple(int(item.row) for item in found.breaks)
    if not chosen or not folds or all(tuple(map(int, rows)) == chosen for rows in folds):
        return
    kept = np.delete(np.arange(len(found.fit_m)), found.rejected)
    held_out_m = found.judgement.held_out_m
    if len(held_out_m) != len(found.fit_m):
        return
    free = max(1.0 - len(found.robust.fit.layout) / (3.0 * len(kept)), 0.1)
    fit_m = float(np.sqrt(np.mean(found.fit_m[kept] ** 2) / free))
    left_m = float(np.sqrt(np.mean(held_out_m[kept] ** 2)))
    if left_m <= _FAR * fit_m:
        return
    yield Lint(
        "breaks",
        make_message(
            "rows that were held out are missed by {left_mm:.3f} mm, and the fit leaves {fit_mm:.3f} mm: from which "
            "rows on the device stood elsewhere (rows {rows}) is found differently in parts of the data. If you know "
            "when it was moved, divide the file there, or describe the parts in a layout (`--layout`).",
            left_mm=left_m * 1e3,
            fit_mm=fit_m * 1e3,
            rows=", ".join(str(int(file_rows[row])) for row in chosen),
        ),
        tuple(int(file_rows[row]) for row in chosen),
    )
