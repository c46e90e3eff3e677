"""Postures over several lines, names beside numbers, marks of byte order and numbered groups: read, or one sentence."""

import numpy as np
import pytest

from cellcal.calibration.arm.kinematics import load_model
from cellcal.calibration.identification.misfit_lengths import length_readings
from cellcal.calibration.identification.observations import LengthObservations
from cellcal.service.engineering.measured.measurements import ReadOptions, read_measurements
from cellcal.service.engineering.measured.table import MeasurementError, read_table
from tests.unit.helpers.simulated_arm import random_joints, tracker_points

MODEL = load_model("abb_irb120")
POINTS = tracker_points("abb_irb120", 20)
DEG, MM = np.rad2deg(POINTS.observations.joints_rad), POINTS.observations.positions_m * 1e3
LENGTHS = np.linalg.norm(MM, axis=1)
J = [f"J{k}" for k in range(1, 7)]


def written(tmp_path, lines, name="rows.txt", end="\n"):
    path = tmp_path / name
    path.write_bytes((end.join(lines) + end).encode())
    return path


def blocks(words=("POSE", "JOINTS", "LENGTH"), mark=" "):
    for at in range(len(DEG)):
        yield f"{words[0]}{mark}{at + 1}"
        yield f"  {words[1]}{mark}" + " ".join(f"{v:.4f}" for v in DEG[at])
        yield f"  {words[2]}{mark}{LENGTHS[at]:.4f}"


@pytest.mark.parametrize("mark", [" ", ": ", " = "])
def test_a_posture_over_three_lines_is_one_row(tmp_path, mark):
    path = written(tmp_path, ["Measurement File", "Version 3.2", "Robot: IRB120", *blocks(mark=mark)])
    table = read_table(path)
    assert table.names == ("POSE", *(f"JOINTS {k}" for k in range(1, 7)), "LENGTH")
    assert table.numbers[:, 1:7] == pytest.approx(DEG, abs=1e-4)
    layout = read_measurements(path, MODEL, ReadOptions()).layout
    assert layout.joints == tuple(f"JOINTS {k}" for k in range(1, 7))
    assert layout.length == "LENGTH"


@pytest.mark.parametrize("end", ["\n", "\r\n", "\r"])
@pytest.mark.parametrize("between", ["\n", " ", ", "])
def test_numbers_behind_their_names_are_one_row_a_posture(tmp_path, between, end):
    rows = [
        [
            *(f"{j}: {v:.4f}" for j, v in zip(J, q, strict=True)),
            *(f"{x}={v:.4f}" for x, v in zip("XYZ", p, strict=True)),
        ]
        for q, p in zip(DEG, MM, strict=True)
    ]
    lines = [line for row in rows for line in between.join(row).split("\n")]
    table = read_table(written(tmp_path, lines, end=end))
    assert table.names == (*J, "X", "Y", "Z")
    assert table.numbers == pytest.approx(np.hstack([DEG, MM]), abs=1e-4)


@pytest.mark.parametrize("lacks", ["LENGTH", "POSE", "JOINTS"])
def test_a_posture_that_lacks_a_line_is_named(tmp_path, lacks):
    lines = list(blocks())
    lines.remove([line for line in lines if lacks in line][14])
    with pytest.raises(MeasurementError, match=r"posture 1[456] has others") as refused:
        read_table(written(tmp_path, lines))
    assert "one row a posture" in refused.value.remedy


def test_rows_that_begin_with_names_stay_a_table(tmp_path):
    lines = [f"P{at % 3} {' '.join(f'{v:.4f}' for v in (*DEG[at], *MM[at]))}" for at in range(len(DEG))]
    table = read_table(written(tmp_path, lines))
    assert table.numbers.shape == (20, 10)
    named = [f"point,{','.join(f'{v:.4f}' for v in (*DEG[at], *MM[at]))}" for at in range(len(DEG))]
    assert read_table(written(tmp_path, named)).numbers.shape == (20, 10)


MARK = "\ufeff"


@pytest.mark.parametrize("mark", [MARK, "\u00ef\u00bb\u00bf"])
@pytest.mark.parametrize("places", [(0,), (0, 0), (10,), (0, 10)])
@pytest.mark.parametrize("again", [False, True])
def test_marks_of_byte_order_are_no_text_wherever_files_were_put_together(tmp_path, mark, places, again):
    heading = ",".join([*J, "X (mm)", "Y (mm)", "Z (mm)"])
    lines = [heading, *(",".join(f"{v:.4f}" for v in row) for row in np.hstack([DEG, MM]))]
    if again:
        lines.insert(10, heading)
    for at in places:
        lines[at] = mark + lines[at]
    table = read_table(written(tmp_path, lines))
    full = table.numbers[np.isfinite(table.numbers).all(axis=1)]
    assert table.names[0] == "J1"
    assert full == pytest.approx(np.hstack([DEG, MM]), abs=1e-4)


@pytest.mark.parametrize("number", ["1", '"1"', "42"])
def test_numbers_of_bodies_above_the_names_are_no_readings(tmp_path, number):
    turns = np.tile([0.0, 0.0, 0.0, 1.0], (20, 1))
    lines = [
        "Format Version,1.23,Take Name,Take1,Length Units,Millimeters", "",
        ",," + ",".join(["Rigid Body"] * 7), ",," + ",".join(["Tool"] * 7), ",," + ",".join([number] * 7),
        ",," + ",".join(["Rotation"] * 4 + ["Position"] * 3), "Frame,Time (Seconds),X,Y,Z,W,X,Y,Z",
        *(f"{at},{at / 2}," + ",".join(f"{v:.4f}" for v in (*turns[at], *MM[at])) for at in range(20)),
    ]  # fmt: skip
    table = read_table(written(tmp_path, lines))
    assert len(table) == 20
    assert table.numbers[:, -3:] == pytest.approx(MM, abs=1e-4)
    assert table.names[2:6] == ("Rotation X", "Rotation Y", "Rotation Z", "Rotation W")


def test_a_column_that_numbers_the_rows_is_no_joint_of_the_example(tmp_path):
    lines = [f"{at + 1} {' '.join(f'{v:.4f}' for v in (*DEG[at], LENGTHS[at]))}" for at in range(20)]
    with pytest.raises(MeasurementError) as refused:
        read_measurements(written(tmp_path, lines), MODEL, ReadOptions())
    assert "joints=2,3,4,5,6,7" in refused.value.remedy
    assert "length=8" in refused.value.remedy


def test_a_report_with_one_axis_a_line_is_told_as_that(tmp_path):
    lines = ["REPORT"]
    for at, place in enumerate(MM):
        lines += [f"DIM P{at}= LOCATION OF POINT PNT{at} UNITS=MM", "AX NOMINAL +TOL -TOL MEAS DEV OUTTOL"]
        lines += [
            f"{x} {v + 0.1:.4f} 0.05 0.05 {v:.4f} -0.1000 0.0000" for x, v in zip("XYZ", place, strict=True)
        ]
    with pytest.raises(MeasurementError) as refused:
        read_measurements(written(tmp_path, lines), MODEL, ReadOptions())
    assert "one row a point" in refused.value.remedy


def test_angles_taken_for_lengths_have_neither_zero_nor_scale():
    """No piece and no factor makes lengths of them; looking for one ended in an internal error."""
    joints = random_joints(MODEL, np.random.default_rng(2), 60)
    some = LengthObservations(
        joints, np.linspace(-0.15, 0.15, 60) * 20, np.full(60, 1e-4), np.zeros(60, dtype=np.intp)
    )
    assert list(length_readings(MODEL, some)) == []
