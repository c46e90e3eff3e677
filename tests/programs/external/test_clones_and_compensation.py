"""Programs with a rail or a positioner, cloned and compensated, against a calculation by plain numpy."""

import datetime
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from cellcal.calibration.arm.kinematics import RobotModel
from cellcal.calibration.compensation.compensate import ProgramDirection
from cellcal.calibration.geometry import Pose
from cellcal.calibration.points.alignment import Alignment, alignment_text
from cellcal.drivers.program_registry import brand_named
from cellcal.service.engineering.parameters.calibrated_models import nominal_sha256, values_of_model
from cellcal.service.engineering.parameters.parameter_set import ParameterSet, to_text
from cellcal.service.engineering.programs.clone import clone_transfer
from cellcal.service.engineering.programs.compensate import compensation_transfer
from cellcal.service.engineering.programs.move import change_at_zero, instead_of_moving
from cellcal.service.engineering.programs.project import Project, read_project
from cellcal.service.exit_codes import ExitCode
from tests.programs.external.brands import BRANDS, WrittenPoint
from tests.programs.external.cells import FRAME, ON_TABLE, TOOL, HandAxis, HandCell, pose_text, rail, table
from tests.programs.external.hand_geometry import Array, apart, arm, axis_pose, flange_of, pose

POINTS = np.array([[0, 0, 0], [0.5, 0, 0], [0.5, 0.4, 0], [0, 0.4, 0.1], [0.2, 0.2, 0.3]], dtype=float)
CLONE_BASE = pose((0.02, -0.015, 0.004), (0.004, -0.003, 0.05))  # the master's cell seen from the clone's
WITHIN_MM, WITHIN_DEG = 1e-3, 1e-4
brands = pytest.mark.parametrize("name", list(BRANDS))


def real_arm(nominal: RobotModel, seed: int) -> RobotModel:
    """Return an arm with errors of its lengths and zeros."""
    values = np.random.default_rng(seed).normal(scale=4e-4, size=(nominal.axis_count, 5))
    free = np.zeros(values.shape, dtype=bool)
    for entry in np.ndindex(values.shape):
        one = np.zeros(values.shape)
        one[entry] = 1e-3
        free[entry] = any(v.value for v in values_of_model(nominal, nominal.with_dh_errors(one)))
    return nominal.with_dh_errors(np.where(free, values, 0.0))


def write_parameters(path: Path, nominal: RobotModel, real: RobotModel, serial: str) -> None:
    """Write the parameters of an arm as an identification would find them, nearly without uncertainty."""
    parameters = ParameterSet(
        robot_serial=serial,
        model=nominal.name,
        nominal_sha256=nominal_sha256(nominal),
        made_at=datetime.datetime(2026, 3, 2, 9, 0, tzinfo=datetime.UTC).isoformat(),
        made_by="test",
        source="made up",
        values=tuple(
            replace(value, standard_uncertainty=1e-6, correlations=(0.0,) * number)
            for number, value in enumerate(values_of_model(nominal, real))
        ),
        version=1,
    )
    path.write_text(to_text(parameters), encoding="utf-8")


def write_project(
    cell: HandCell, folder: Path, *, real: RobotModel, serial: str, fixture: Array | None = None, at: str = ""
) -> Project:
    folder.mkdir(parents=True)
    nominal = arm(cell.spelling.model)
    write_parameters(folder / "robot.toml", nominal, real, serial)
    text = cell.project_text().replace('serial = "S1"', f'serial = "{serial}"\nparameters = "robot.toml"')
    if fixture is not None:
        found = Alignment(
            fixture="door",
            robot_serial=serial,
            model=nominal.name,
            points_in_fixture_m=tuple(map(tuple, POINTS.tolist())),
            base_fixture=Pose.from_matrix(fixture),
            covariance=tuple(map(tuple, (np.eye(6) * 1e-12).tolist())),
        )
        (folder / "door.json").write_text(alignment_text([found]), encoding="utf-8")
        text += f'[fixture]\nalignment = "door.json"\n{at}'
    path = folder / "project.toml"
    path.write_text(text, encoding="utf-8")
    return read_project(path)


def assert_near(one: Array, other: Array) -> None:
    distance, angle = apart(one, other)
    assert distance < WITHIN_MM
    assert angle < WITHIN_DEG


@brands
@pytest.mark.parametrize("sort", ["rail", "table"])
@pytest.mark.parametrize("coordinated", [True, False])
def test_a_clone_puts_the_tip_at_the_same_place_of_the_work(
    name: str, sort: str, coordinated: bool, tmp_path: Path
) -> None:
    """The clone's axis counts from another zero, the other way round; its travel from there is the master's."""
    spelling = BRANDS[name]
    make = rail if sort == "rail" else table
    axis = make(spelling, coordinated=coordinated, zero=20.0)
    other = replace(axis, zero=-35.0, sign=-1, frame=CLONE_BASE @ axis.frame)
    frames = FRAME, CLONE_BASE @ FRAME @ pose((0.004, 0.0, -0.002), (0, 0, 0.01))
    if sort == "table" and coordinated:
        frames = axis.frame @ ON_TABLE, other.frame @ ON_TABLE
    cells = HandCell(spelling, (axis,), frames[0]), HandCell(spelling, (other,), frames[1])
    nominal = arm(spelling.model)
    reals = real_arm(nominal, 1), real_arm(nominal, 2)
    fixture = pose((0.7, 0.2, 0.1), (0.1, 0.0, 0.3))
    master = write_project(cells[0], tmp_path / "a", real=reals[0], serial="A", fixture=fixture)
    clone = write_project(cells[1], tmp_path / "b", real=reals[1], serial="B", fixture=CLONE_BASE @ fixture)
    values = [{axis.axis: 20.0 + step} for step in (0.0, 30.0, -25.5, 61.25, -12.0)]
    text = spelling.write(cells[0].points(values), spelling.frame)
    brand = brand_named(spelling.brand)
    program = brand.read(spelling.file, text.encode())
    result = clone_transfer(master, clone, brand.configurations).transfer_programs([program])[0]
    assert not result.excluded_points
    after = spelling.read(result.after.to_bytes().decode())
    for old, new in zip(spelling.read(text), after, strict=True):
        travel = old.axes[axis.axis] - 20.0
        assert new.axes[axis.axis] == pytest.approx(-35.0 - travel, abs=1e-6)
        old_tip, new_tip = real_tips(cells, reals, (old, new))
        assert_near(CLONE_BASE @ old_tip, new_tip)


def test_a_left_point_keeps_the_axes_of_a_row_that_it_shares(tmp_path: Path) -> None:
    """A job's station row may stand beside several positions; the clone's axis counts from another zero."""
    spelling = BRANDS["yaskawa"]
    axis = table(spelling, zero=20.0)
    cells = [HandCell(spelling, (each,), axis.frame @ ON_TABLE) for each in (axis, replace(axis, zero=-35.0))]
    nominal, fixture = arm(spelling.model), pose((0.7, 0.2, 0.1), (0.1, 0.0, 0.3))
    master, clone = (
        write_project(cell, tmp_path / serial, real=nominal, serial=serial, fixture=fixture)
        for cell, serial in zip(cells, "AB", strict=True)
    )
    values = [{"S1": value} for value in (20.0, 50.0, 20.0, 80.0, 80.0)]
    text = spelling.write(cells[0].points(values), spelling.frame)
    text = text.replace("MOVL C00002", "MOVL C00002 EC00000").replace("MOVL C00004", "MOVL C00004 EC00003")
    for named in ("C00000", "C00001", "C00003"):
        text = text.replace(f"MOVL {named}", f"MOVL {named} E{named}")
    first = text[text.index("C00000=") : text.index("C00001=")]
    text = text.replace(first, f"///TOOL 7\n{first}///TOOL 1\n")  # a tool that the project does not have
    brand = brand_named(spelling.brand)
    program = brand.read(spelling.file, text.encode())
    result = clone_transfer(master, clone, brand.configurations).transfer_programs([program])[0]
    assert [bool(why) for why in result.reason] == [True, False, True, False, False]
    assert "C00000, which is left" in result.reason[2]
    after = spelling.read(result.after.to_bytes().decode())
    assert [point.axes["S1"] for point in after] == [20.0, -5.0, 20.0, 25.0, 80.0]
    assert b"EC00003=2500" in result.after.to_bytes()


def real_tips(
    cells: tuple[HandCell, HandCell],
    reals: tuple[RobotModel, RobotModel],
    points: tuple[WrittenPoint, WrittenPoint],
) -> tuple[Array, Array]:
    """Return where the real tips of two cells go, in the cells' frames with all axes at zero, on the work."""
    found = []
    for cell, real, point in zip(cells, reals, points, strict=True):
        assert point.tip is not None
        flange = cell.entered_frame(point.axes) @ point.tip @ np.linalg.inv(TOOL)
        joints = joints_of(arm(cell.spelling.model), flange, np.radians(cell.spelling.postures))
        tip = cell.base(point.axes) @ flange_of(real, joints) @ TOOL
        found.append(np.linalg.inv(cell.work(point.axes)) @ tip)
    return found[0], found[1]


def joints_of(model: RobotModel, flange: Array, starts: Array) -> Array:
    """Return the joints that reach a pose, by Newton's steps with differences."""
    for start in starts:
        joints = np.array(start)
        for _ in range(30):
            gap_left = gap(flange, flange_of(model, joints))
            if np.abs(gap_left).max() < 1e-12:
                return joints
            step = 1e-6
            slopes = np.array(
                [
                    (gap(flange, flange_of(model, joints + step * each)) - gap_left) / step
                    for each in np.eye(6)
                ]
            ).T
            joints = joints - np.clip(np.linalg.solve(slopes, gap_left), -0.2, 0.2)
    raise AssertionError("no joints")


def gap(one: Array, other: Array) -> Array:
    turn = one[:3, :3].T @ other[:3, :3]
    skew = 0.5 * np.array([turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1]])
    return np.concatenate([other[:3, 3] - one[:3, 3], skew])


@brands
@pytest.mark.parametrize("sort", ["rail", "table"])
@pytest.mark.parametrize("way", list(ProgramDirection))
def test_compensation_knows_the_axis_as_it_was_identified(
    name: str, sort: str, way: ProgramDirection, tmp_path: Path
) -> None:
    spelling = BRANDS[name]
    axis = rail(spelling) if sort == "rail" else table(spelling)
    frame = FRAME if sort == "rail" else axis.frame @ ON_TABLE
    turned = axis.frame @ pose((0.0004, -0.0003, 0.0002), (0.002, -0.001, 0.0015))
    (tmp_path / "axis.toml").write_text(
        f"{pose_text(turned)}direction = {list(axis.direction)}\nscale = 1.0004\nzero_{axis.unit} = 0.05\n",
        encoding="utf-8",
    )
    real_axis = _RealAxis(axis, turned)
    written = replace(axis, name='axis"\nidentified = "../axis.toml')  # one more line in the table
    cell = HandCell(spelling, (written,), frame)
    nominal = arm(spelling.model)
    real = real_arm(nominal, 5)
    project = write_project(cell, tmp_path / "cell", real=real, serial="A")
    values = [{axis.axis: value} for value in (0.0, 60.0, -45.5, 130.25, 20.0)]
    text = spelling.write(cell.points(values), spelling.frame)
    brand = brand_named(spelling.brand)
    program = brand.read(spelling.file, text.encode())
    result = compensation_transfer(project, way, brand.configurations).transfer_programs([program])[0]
    assert not result.excluded_points
    assert result.exit_code is ExitCode.PASS
    after = spelling.read(result.after.to_bytes().decode())
    for old, new in zip(spelling.read(text), after, strict=True):
        believed, actual = (old, new) if way is ProgramDirection.UPLOAD else (new, old)
        assert believed.tip is not None
        assert actual.tip is not None
        at = old.axes[axis.axis]
        flange = cell.entered_frame(old.axes) @ actual.tip @ np.linalg.inv(TOOL)
        joints = joints_of(nominal, flange, np.radians(spelling.postures))
        tip = flange_of(real, joints) @ TOOL
        if sort == "rail":
            reached, goal = real_axis.motion(at) @ tip, FRAME @ believed.tip
        else:
            reached, goal = np.linalg.inv(real_axis.motion(at)) @ tip, frame @ believed.tip
        assert_near(goal, reached)


class _RealAxis:
    """An axis as it really is."""

    def __init__(self, axis: HandAxis, frame: Array) -> None:
        self._axis, self._frame = axis, frame

    def motion(self, value: float) -> Array:
        per_unit = 1e-3 if self._axis.kind == "prismatic" else np.pi / 180
        travel = 1.0004 * (value - 0.05) * per_unit
        return axis_pose(self._axis.kind, self._frame, self._axis.direction, travel)


def test_a_fixture_that_was_measured_with_the_robot_elsewhere_on_its_rail(tmp_path: Path) -> None:
    spelling = BRANDS["kuka"]
    axis = rail(spelling)
    cells = HandCell(spelling, (axis,)), HandCell(spelling, (axis,), CLONE_BASE @ FRAME)
    nominal = arm(spelling.model)
    fixture = pose((0.7, 0.2, 0.1), (0.1, 0.0, 0.3))
    clone_base = np.linalg.inv(axis.motion(450.0)) @ CLONE_BASE @ fixture
    master = write_project(cells[0], tmp_path / "a", real=nominal, serial="A", fixture=fixture)
    clone = write_project(
        cells[1], tmp_path / "b", real=nominal, serial="B", fixture=clone_base, at="at = { rail = 450.0 }\n"
    )
    text = spelling.write(cells[0].points([{axis.axis: 100.0}]), spelling.frame)
    brand = brand_named(spelling.brand)
    program = brand.read(spelling.file, text.encode())
    result = clone_transfer(master, clone, brand.configurations).transfer_programs([program])[0]
    assert not result.excluded_points
    for old, new in zip(spelling.read(text), spelling.read(result.after.to_bytes().decode()), strict=True):
        assert old.tip is not None
        assert new.tip is not None
        assert_near(old.tip, new.tip)  # the frame went along


def test_a_cell_without_the_axis_gets_no_point(tmp_path: Path) -> None:
    spelling = BRANDS["abb"]
    nominal, fixture = arm(spelling.model), pose((0.7, 0.2, 0.1))
    cells = HandCell(spelling, (rail(spelling),)), HandCell(spelling, ())
    master = write_project(cells[0], tmp_path / "a", real=nominal, serial="A", fixture=fixture)
    clone = write_project(cells[1], tmp_path / "b", real=nominal, serial="B", fixture=fixture)
    text = spelling.write(cells[0].points([{spelling.rail: 100.0}]), spelling.frame)
    brand = brand_named(spelling.brand)
    program = brand.read(spelling.file, text.encode())
    result = clone_transfer(master, clone, brand.configurations).transfer_programs([program])[0]
    assert len(result.excluded_points) == 5
    assert "one of the cells only" in result.reason[0]
    assert result.after.to_bytes() == text.encode()


def test_a_move_that_was_measured_with_the_robot_elsewhere_on_its_rail(tmp_path: Path) -> None:
    spelling = BRANDS["kuka"]
    axis, nominal = rail(spelling), arm(spelling.model)
    at = "at = { rail = 450.0 }\n"
    cell = HandCell(spelling, (axis,))
    project = write_project(
        cell, tmp_path / "a", real=nominal, serial="A", fixture=pose((0.7, 0.2, 0.1)), at=at
    )
    seen = pose((0.01, -0.02, 0.005), (0.0, 0.01, 0.05))
    carrier = axis.motion(450.0)
    assert np.allclose(change_at_zero(project, seen), carrier @ seen @ np.linalg.inv(carrier), atol=1e-12)


@pytest.mark.parametrize("coordinated", [True, False])
def test_the_frame_that_could_be_entered_instead(coordinated: bool, tmp_path: Path) -> None:
    """A frame on a table is typed as its controller has it; none makes up for a table that the controller ignores."""
    spelling = BRANDS["kuka"]
    axis = table(spelling, coordinated=coordinated)
    cell = HandCell(spelling, (axis,), frame=axis.frame if coordinated else FRAME)
    project = cell.project(tmp_path)
    change = axis.frame @ pose((0.01, 0.02, 0.03)) @ np.linalg.inv(axis.frame)
    advice = instead_of_moving(project, spelling.frame, change)
    assert ("X 10.000, Y 20.000, Z 30.000 mm" in advice) == coordinated
    assert bool(advice) == coordinated
