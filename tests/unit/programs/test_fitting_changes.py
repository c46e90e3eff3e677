"""A program that cannot take every point of a change: the others are made, and each such point has its reason."""

import numpy as np
import pytest

from cellcal.drivers.programs.errors import ProgramFileError
from cellcal.drivers.programs.positions import PositionChange
from cellcal.drivers.yaskawa.program_files.programs import BRAND
from cellcal.service.engineering.programs.fitting_changes import change_what_fits
from tests.programs.test_yaskawa_motions import job_bytes

PROGRAM = BRAND.read("a.jbi", job_bytes("MOVL C00000 V=1.0", "MOVL C00001 V=1.0", "MOVL P001 V=1.0"))
ROWS = np.array([0, 1, 3], dtype=np.intp)


def shift_rows(rows: np.ndarray, *, other: tuple[int, ...]) -> PositionChange:
    """Return a step of all rows, some of which would need another configuration."""
    poses = PROGRAM.positions.frame_tip[rows].copy()
    poses[:, 0, 3] += 0.01
    configurations = [PROGRAM.positions.configurations[row] for row in rows.tolist()]
    texts = [
        "1" + text[1:] if row in other else text
        for row, text in zip(rows.tolist(), configurations, strict=True)
    ]
    return PositionChange(rows.astype(np.int64), frame_tip=poses, configurations=texts)


@pytest.mark.parametrize("other", [(), (1,), (0, 3), (0, 1, 3)])
def test_the_points_that_fit_are_changed_and_the_others_named(other: tuple[int, ...]) -> None:
    new, refused = change_what_fits(PROGRAM, ROWS, lambda rows: shift_rows(rows, other=other))

    step = new.positions.frame_tip[:, 0, 3] - PROGRAM.positions.frame_tip[:, 0, 3]
    for row in ROWS.tolist():
        assert step[row] == pytest.approx(0.0 if row in other else 0.01, abs=1e-9)
    assert refused.keys() == set(other)
    for row, why in refused.items():
        assert why.startswith(f"{PROGRAM.positions.names[row]} would need another configuration")


def test_a_file_that_takes_nothing_is_refused() -> None:
    rows = np.arange(100, dtype=np.intp)

    def refuse_change(some: np.ndarray) -> PositionChange:
        return PositionChange(some.astype(np.int64) + 1000, frame_tip=np.full((len(some), 4, 4), np.nan))

    with pytest.raises(ProgramFileError):
        change_what_fits(PROGRAM, rows, refuse_change)
