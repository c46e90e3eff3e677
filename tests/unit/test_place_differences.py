"""Places that a file writes as differences from others, and sums of columns that a person names."""

from pathlib import Path

import numpy as np
import pytest

from cellcal.calibration.arm.kinematics import load_model
from cellcal.calibration.geometry import Array
from cellcal.service.engineering.measured.errors import MeasurementError
from cellcal.service.engineering.measured.measurements import Measurements, ReadOptions, read_measurements
from tests.unit.helpers.simulated_arm import tracker_points

MODEL = load_model("abb_irb120")
TRUE = tracker_points("abb_irb120", 20)
DEG = np.rad2deg(TRUE.observations.joints_rad)
MEASURED_MM = TRUE.observations.positions_m * 1e3
TARGET_MM = MODEL.base_flange(TRUE.observations.joints_rad)[:, :3, 3] * 1e3
DIFFERENCE_MM = np.random.default_rng(2).normal(0.0, 3.0, MEASURED_MM.shape)
SUM = ("x_t+x_dif", "y_t+y_dif", "z_t+z_dif")


def read_rows(folder: Path, heading: str, *blocks: Array, position: tuple[str, ...] = ()) -> Measurements:
    """Return what is read of rows with joints first."""
    rows = [",".join(f"{cell:.5f}" for cell in row) for row in np.column_stack([DEG, *blocks])]
    joints = ",".join(f"J{at}" for at in range(1, 7))
    path = folder / "rows.csv"
    path.write_text("\n".join([f"{joints},{heading}", *rows]) + "\n", encoding="utf-8")
    columns = {"position": position} if position else {}
    return read_measurements(path, MODEL, ReadOptions(columns=columns))


@pytest.mark.parametrize("word", ["dif", "diff", "dev", "delta", "error"])
def test_differences_from_calculated_places_are_asked_about(tmp_path: Path, word: str) -> None:
    heading = f"x_t,y_t,z_t,x_{word},y_{word},z_{word}"
    with pytest.raises(MeasurementError, match="x_t, y_t, z_t are calculated") as refused:
        read_rows(tmp_path, heading, TARGET_MM, DIFFERENCE_MM)
    assert f"`--columns position=x_t+x_{word},y_t+y_{word},z_t+z_{word}`" in refused.value.remedy


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_sum_of_columns_is_a_place(tmp_path: Path, sign: float) -> None:
    position = SUM if sign > 0 else tuple(each.replace("+", "-") for each in SUM)
    blocks = (MEASURED_MM - sign * DIFFERENCE_MM, DIFFERENCE_MM)
    found = read_rows(tmp_path, "x_t,y_t,z_t,x_dif,y_dif,z_dif", *blocks, position=position)
    assert np.allclose(found.observations.positions_m * 1e3, MEASURED_MM, atol=1e-3)
    assert found.layout.position == position
    numbered = tuple(f"{at + 7}{'+' if sign > 0 else '-'}{at + 10}" for at in range(3))
    again = read_rows(tmp_path, "x_t,y_t,z_t,x_dif,y_dif,z_dif", *blocks, position=numbered)
    assert again.layout.position == position


def test_a_sum_has_the_unit_of_its_columns_and_no_other(tmp_path: Path) -> None:
    heading = "X [m],Y [m],Z [m],dX [m],dY [m],dZ [m]"
    blocks = ((MEASURED_MM - DIFFERENCE_MM) / 1e3, DIFFERENCE_MM / 1e3)
    found = read_rows(tmp_path, heading, *blocks, position=("X+dX", "Y+dY", "Z+dZ"))
    assert np.allclose(found.observations.positions_m * 1e3, MEASURED_MM, atol=0.05)
    with pytest.raises(MeasurementError, match="different units"):
        read_rows(tmp_path, heading.replace("dX [m]", "dX [mm]"), *blocks, position=("X+dX", "Y+dY", "Z+dZ"))


def test_measured_places_with_deviations_beside_are_read(tmp_path: Path) -> None:
    found = read_rows(tmp_path, "X,Y,Z,dX,dY,dZ", MEASURED_MM, DIFFERENCE_MM)
    assert found.layout.position == ("X", "Y", "Z")
    with pytest.raises(MeasurementError, match="no column"):
        read_rows(tmp_path, "X,Y,Z,dX,dY,dZ", MEASURED_MM, DIFFERENCE_MM, position=("X+dX", "Y+dY", "Z+10"))
