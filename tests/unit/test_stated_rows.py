"""What a file itself says of its rows and joints: readings that are not valid, joints that stand twice."""

from pathlib import Path

import numpy as np
import pytest

from cellcal.service.engineering.measured.measurements import Measurements, read_measurements
from tests.unit.helpers.simulated_arm import tracker_points

TRUE = tracker_points("abb_irb120", 40)
DEG = np.rad2deg(TRUE.observations.joints_rad)
MM = TRUE.observations.positions_m * 1e3
J, A = ([f"{letter}{i}" for i in range(1, 7)] for letter in "JA")


def read(path: Path, heading: list[str], rows: list[list[object]]) -> Measurements:
    lines = [heading, *([f"{v:.4f}" if isinstance(v, float) else str(v) for v in row] for row in rows)]
    path.write_text("\n".join(",".join(line) for line in lines) + "\n", encoding="utf-8")
    return read_measurements(path, TRUE.model)


def rows_with(extra: list[object]) -> list[list[object]]:
    return [[*DEG[i].tolist(), *MM[i].tolist(), extra[i]] for i in range(len(extra))]


@pytest.mark.parametrize(
    ("column", "good", "bad"),
    [("Status", "OK", "BAD"), ("valid", "1", "0"), ("Ergebnis", "i.O.", "n.i.O."), ("Measured", "yes", "no")],
)
def test_readings_that_the_file_calls_bad_are_left_out(
    tmp_path: Path, column: str, good: str, bad: str
) -> None:
    found = read(
        tmp_path / "m.csv",
        [*J, "X", "Y", "Z", column],
        rows_with([bad if i in (3, 11) else good for i in range(20)]),
    )
    assert [row.row for row in found.rejected] == [3, 11]
    assert f"'{bad}'" in found.rejected[0].reason


@pytest.mark.parametrize(
    ("column", "few", "many"),
    [
        ("Retry", "no", "yes"),  # asks something else
        ("Status", "0", "1"),  # of many devices 0 is no fault
        ("valid", "1", "0"),  # too few would remain
        ("Status", "tracking", "OK"),  # a word that is not known
        ("Gripper", "1", "0"),
    ],
)
def test_columns_that_say_something_else_leave_no_row_out(
    tmp_path: Path, column: str, few: str, many: str
) -> None:
    found = read(
        tmp_path / "m.csv",
        [*J, "X", "Y", "Z", column],
        rows_with([few if i in (3, 11) else many for i in range(20)]),
    )
    assert not found.rejected


def test_of_joints_that_stand_twice_those_that_fit_are_taken(tmp_path: Path) -> None:
    told = DEG + np.random.default_rng(1).normal(0.0, 0.3, DEG.shape)
    rows = [[*told[i].tolist(), *DEG[i].tolist(), *MM[i].tolist()] for i in range(40)]
    for name, first, second in (("a", J, A), ("b", A, J)):
        found = read(tmp_path / f"{name}.csv", [*first, *second, "X", "Y", "Z"], rows)
        assert list(found.layout.joints) == second
        assert not [text for text in found.guesses if "twice" in text]


def test_joints_that_stand_twice_and_fit_alike_are_named(tmp_path: Path) -> None:
    told = DEG + np.random.default_rng(1).normal(0.0, 1e-3, DEG.shape)
    rows = [[*told[i].tolist(), *DEG[i].tolist(), *MM[i].tolist()] for i in range(40)]
    found = read(tmp_path / "m.csv", [*J, *A, "X", "Y", "Z"], rows)
    assert [text for text in found.guesses if "joints stand twice" in text]
    same = [[*DEG[i].tolist(), *DEG[i].tolist(), *MM[i].tolist()] for i in range(40)]
    found = read(tmp_path / "n.csv", [*J, *A, "X", "Y", "Z"], same)
    assert not [text for text in found.guesses if "joints stand twice" in text]


def test_deviations_called_s_are_no_place(tmp_path: Path) -> None:
    rows = [[*DEG[i].tolist(), 0.01, 0.012, 0.009, *MM[i].tolist()] for i in range(12)]
    found = read(tmp_path / "m.csv", [*J, "sX", "sY", "sZ", "X", "Y", "Z"], rows)
    assert found.layout.position == ("X", "Y", "Z")
    only = [[*DEG[i].tolist(), *MM[i].tolist()] for i in range(12)]
    assert read(tmp_path / "n.csv", [*J, "sX", "sY", "sZ"], only).layout.position == ("sX", "sY", "sZ")
