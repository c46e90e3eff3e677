"""Files whose headings tell nothing are read by what fits the robot, and refused where nothing or too much fits."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest

from cellcal.calibration.arm.kinematics import load_model
from cellcal.service.engineering.measured.attitudes import attitude_ways
from cellcal.service.engineering.measured.joint_columns import find_joints
from cellcal.service.engineering.measured.measurements import Measurements, ReadOptions, read_measurements
from cellcal.service.engineering.measured.table import MeasurementError
from cellcal.service.engineering.measured.unnamed_columns import _turn_behind
from tests.unit.helpers.simulated_arm import TOOL, TRACKER, tracker_points

ROBOT = "franka_fer"
ROWS = 40
TRUE = tracker_points(ROBOT, ROWS, seed=5)
JOINTS_DEG = np.rad2deg(TRUE.observations.joints_rad)
PLACES_MM = TRUE.observations.positions_m * 1e3


def write(path: Path, columns: Sequence[np.ndarray], heading: str = "", first: str = "") -> Path:
    rows = np.hstack(columns)
    lines = [heading] if heading else []
    lines += [
        first.format(at) + ",".join(f"{value:.7g}" for value in row) for at, row in enumerate(rows.tolist())
    ]
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return path


def read(path: Path, robot: str = ROBOT, **columns: Sequence[str]) -> Measurements:
    return read_measurements(path, load_model(robot), ReadOptions(columns=columns))


def prove_read(found: Measurements, joints: Sequence[int], place: Sequence[int]) -> None:
    """The columns are those of these places, counted from 0, and so are the numbers."""
    assert len(found.observations) == ROWS
    np.testing.assert_allclose(found.observations.joints_rad, TRUE.observations.joints_rad, atol=1e-6)
    np.testing.assert_allclose(found.observations.positions_m, TRUE.observations.positions_m, atol=1e-6)
    assert any("headings tell nothing" in each for each in found.guesses)
    assert len(found.layout.joints) == len(joints)
    assert len(found.layout.position) == len(place)


@pytest.mark.parametrize(
    ("heading", "first"),
    [
        ("", ""),
        ("", "Motion{},"),
        (",".join(map(str, range(10))), ""),
        ("," + ",".join(map(str, range(10))), "{},"),
        (",".join(f"Var{at}" for at in range(1, 11)), ""),
    ],
)
def test_joints_and_then_places(tmp_path: Path, heading: str, first: str) -> None:
    found = read(write(tmp_path / "rows.csv", [JOINTS_DEG, PLACES_MM], heading, first))
    prove_read(found, range(7), range(7, 10))
    assert found.units == {"joints": "deg", "position": "mm"}


def test_places_first_and_other_units(tmp_path: Path) -> None:
    file = write(tmp_path / "rows.csv", [PLACES_MM * 1e-3, np.deg2rad(JOINTS_DEG)])
    found = read(file)
    prove_read(found, range(3, 10), range(3))
    assert found.units == {"joints": "rad", "position": "m"}


def test_times_and_speeds_stand_between(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    times = np.arange(ROWS)[:, None] * 0.75
    speeds = rng.standard_normal((ROWS, 7))
    prove_read(
        read(write(tmp_path / "rows.csv", [times, JOINTS_DEG, speeds, PLACES_MM])), range(1, 8), range(15, 18)
    )


@pytest.mark.parametrize("rows_of_pose", [3, 4])
def test_a_pose_of_rows_of_four(tmp_path: Path, rows_of_pose: int) -> None:
    poses = np.tile(np.eye(4), (ROWS, 1, 1))
    poses[:, :3, :3] = TRUE.model.base_flange(TRUE.observations.joints_rad)[:, :3, :3]
    poses[:, :3, 3] = TRUE.observations.positions_m
    file = write(tmp_path / "rows.csv", [JOINTS_DEG, poses[:, :rows_of_pose].reshape(ROWS, -1)])
    found = read(file)
    prove_read(found, range(7), (10, 14, 18))
    assert found.layout.position == ("column 11", "column 15", "column 19")


def test_what_the_controller_calculated_is_not_what_was_measured(tmp_path: Path) -> None:
    nominal_mm = TRUE.model.base_flange(TRUE.observations.joints_rad)[:, :3, 3] * 1e3
    found = read(write(tmp_path / "rows.csv", [JOINTS_DEG, nominal_mm, PLACES_MM]))
    prove_read(found, range(7), range(10, 13))
    assert found.layout.position == ("column 11", "column 12", "column 13")
    assert found.layout.controller == ("column 8", "column 9", "column 10")
    assert any("column 11, column 12, column 13 the position" in each for each in found.guesses)


def test_where_nothing_fits_the_refusal_stays(tmp_path: Path) -> None:
    shuffled = np.random.default_rng(1).permutation(ROWS)
    for places in (PLACES_MM[shuffled], PLACES_MM * [1.0, 1.0, 0.5]):
        with pytest.raises(MeasurementError, match="no 7 joint columns found") as refused:
            read(write(tmp_path / "rows.csv", [JOINTS_DEG, places]))
        assert "--columns joints=1,2,3,4,5,6,7" in refused.value.remedy


def test_a_few_rows_prove_nothing(tmp_path: Path) -> None:
    with pytest.raises(MeasurementError, match="no 7 joint columns found"):
        read(write(tmp_path / "rows.csv", [JOINTS_DEG[:8], PLACES_MM[:8]]))


def test_two_series_of_joints_that_fit_alike_are_not_chosen_from(tmp_path: Path) -> None:
    """What the arm was told and what it had: which of them is meant, no fit can tell."""
    commanded_deg = JOINTS_DEG + 0.001 * np.random.default_rng(2).standard_normal(JOINTS_DEG.shape)
    with pytest.raises(MeasurementError, match="no 7 joint columns found"):
        read(write(tmp_path / "rows.csv", [JOINTS_DEG, commanded_deg, PLACES_MM]))


def test_numbers_that_are_typed_go_first(tmp_path: Path) -> None:
    file = write(tmp_path / "rows.csv", [JOINTS_DEG, PLACES_MM])
    found = read(file, joints=["1", "2", "3", "4", "5", "6", "7"], position=["10", "9", "8"])
    assert found.layout.position == ("column 10", "column 9", "column 8")


def test_joints_that_slide_have_their_own_unit(tmp_path: Path) -> None:
    model = load_model("mitsubishi_rh6frh5520")
    assert model.sliding is not None
    low, high = np.maximum(model.lower_rad, -2.0), np.minimum(model.upper_rad, 2.0)
    joints = np.random.default_rng(4).uniform(low, high, (ROWS, model.axis_count))
    places = (TRACKER @ model.base_flange(joints) @ TOOL)[:, :3, 3]
    raw = np.where(model.sliding, joints * 1e3, np.rad2deg(joints))
    found = read(write(tmp_path / "rows.csv", [raw, places * 1e3]), "mitsubishi_rh6frh5520")
    np.testing.assert_allclose(found.observations.joints_rad, joints, atol=1e-6)
    assert found.units == {"joints": "deg", "slides": "mm", "position": "mm"}


PLAIN_JOINTS = ",".join(f"q_{at}" for at in range(1, 8))


@pytest.mark.parametrize(
    "place", ["p_1,p_2,p_3", "측정값X,측정값Y,측정값Z", "pos1,pos2,pos3", "Хизм,Yизм,Zизм"]
)
def test_a_position_that_no_heading_tells_is_what_fits(tmp_path: Path, place: str) -> None:
    speeds = np.random.default_rng(0).standard_normal((ROWS, 3))
    heading = f"{PLAIN_JOINTS},v_1,v_2,v_3,{place}"
    found = read(write(tmp_path / "rows.csv", [JOINTS_DEG, speeds, PLACES_MM], heading))
    np.testing.assert_allclose(found.observations.positions_m, TRUE.observations.positions_m, atol=1e-6)
    assert found.layout.position == tuple(place.split(","))
    assert any("no heading tells what was measured" in each for each in found.guesses)


def test_columns_of_a_command_are_no_position_unless_named(tmp_path: Path) -> None:
    nominal_mm = TRUE.model.base_flange(TRUE.observations.joints_rad)[:, :3, 3] * 1e3
    heading = f"{PLAIN_JOINTS},cmd_1,cmd_2,cmd_3"
    with pytest.raises(MeasurementError, match="no measurement found"):
        read(write(tmp_path / "rows.csv", [JOINTS_DEG, nominal_mm], heading))


def test_a_position_that_does_not_fit_stays_unread(tmp_path: Path) -> None:
    shuffled = PLACES_MM[np.random.default_rng(1).permutation(ROWS)]
    with pytest.raises(MeasurementError, match="no measurement found") as refused:
        read(write(tmp_path / "rows.csv", [JOINTS_DEG, shuffled], f"{PLAIN_JOINTS},p_1,p_2,p_3"))
    assert "--columns position=" in refused.value.remedy


@pytest.mark.parametrize("word", ["θ{} (°)", "ציר {}", "ข้อต่อ {}", "Góc khớp {}", "Axe n°{}", "phi{}"])
def test_joints_are_counted_by_a_word_that_is_not_known(tmp_path: Path, word: str) -> None:
    heading = [word.format(at) for at in range(1, 8)]
    found = read(write(tmp_path / "rows.csv", [JOINTS_DEG, PLACES_MM], ",".join([*heading, "X", "Y", "Z"])))
    assert found.layout.joints == tuple(heading)
    np.testing.assert_allclose(found.observations.joints_rad, TRUE.observations.joints_rad, atol=1e-6)


@pytest.mark.parametrize("word", ["velocity_{}", "torque{}", "Marker {}", "column {}"])
def test_what_is_no_joint_is_not_taken_for_one(tmp_path: Path, word: str) -> None:
    heading = [word.format(at) for at in range(1, 8)]
    with pytest.raises(MeasurementError, match="no 7 joint columns found"):
        read(write(tmp_path / "rows.csv", [JOINTS_DEG, PLACES_MM], ",".join([*heading, "X", "Y", "Z"])))


def test_two_sets_of_columns_that_a_strange_word_counts_are_not_chosen_from(tmp_path: Path) -> None:
    heading = [*(f"phi{at}" for at in range(1, 8)), *(f"psi{at}" for at in range(1, 8)), "X", "Y", "Z"]
    with pytest.raises(MeasurementError, match="no 7 joint columns found"):
        read(write(tmp_path / "rows.csv", [JOINTS_DEG, JOINTS_DEG, PLACES_MM], ",".join(heading)))


def test_a_joint_without_a_column_is_named_with_what_to_add() -> None:
    names = ["J1", "J2", "J3", "J4", "X", "Y", "Z"]
    with pytest.raises(MeasurementError, match="no 5 joint columns found") as refused:
        find_joints(
            names, {name: name.lower() for name in names}, joint_names=("J1", "J2", "J3", "level", "J4")
        )
    assert "add a column level of zeros" in str(refused.value.remedy)


def test_a_second_place_of_a_row_is_apart_from_the_first(tmp_path: Path) -> None:
    """y, z and the x of a second place are x, y, z turned round, and no place of their own."""
    found = read(write(tmp_path / "rows.csv", [JOINTS_DEG, PLACES_MM, PLACES_MM + 0.3]))
    prove_read(found, range(7), range(7, 10))
    assert found.layout.further == (("column 11", "column 12", "column 13"),)
    assert not found.layout.is_named


def test_a_heading_between_blanks_has_names_of_two_words(tmp_path: Path) -> None:
    axes = "XYZ"
    names = [f"{word} {axis}" for word in ("Nominal", "Measure") for axis in axes]
    heading = " ".join([*names, *(f"J{at}" for at in range(1, 8))])
    rows = np.hstack([PLACES_MM + 1.0, PLACES_MM, JOINTS_DEG])
    lines = [heading, *(" ".join(f"{value:.7g}" for value in row) for row in rows.tolist())]
    path = tmp_path / "rows.txt"
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    found = read(path)
    assert found.layout.position == ("Measure X", "Measure Y", "Measure Z")
    assert found.layout.controller == ("Nominal X", "Nominal Y", "Nominal Z")


QUATERNIONS = np.random.default_rng(2).normal(size=(12, 4))


@pytest.mark.parametrize(
    ("behind", "turn"),
    [
        ([QUATERNIONS / np.linalg.norm(QUATERNIONS, axis=1, keepdims=True)], slice(3, 7)),
        ([QUATERNIONS], slice(0, 0)),  # four numbers that are no attitude
        ([QUATERNIONS[:, :3]], slice(3, 6)),  # perhaps angles: the fit says
        ([np.tile(np.eye(3).ravel(), (12, 1)), QUATERNIONS], slice(3, 12)),
    ],
)
def test_an_attitude_stands_right_behind_the_place(behind: Sequence[np.ndarray], turn: slice) -> None:
    values = np.hstack([np.zeros((12, 3)), *behind])
    columns = [f"column {at}" for at in range(1, values.shape[1] + 1)]
    assert _turn_behind(columns[:3], columns, values, set(columns[:3])) == tuple(columns[turn])


def test_numbered_columns_of_a_quaternion_are_taken_in_their_order() -> None:
    turns = QUATERNIONS / np.linalg.norm(QUATERNIONS, axis=1, keepdims=True)
    found = attitude_ways(turns, [f"column_{at}" for at in (9, 10, 11, 12)], "abb_quaternion")
    np.testing.assert_allclose(
        found["abb_quaternion"], attitude_ways(turns, ["qw", "qx", "qy", "qz"], "")["abb_quaternion"]
    )
