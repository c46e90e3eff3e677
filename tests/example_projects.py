"""``python -m tests.example_projects``: make the projects in ``deploy/example_projects`` anew, the same every time.

Two simulated cells of one type of robot with a door fixture. Their errors are drawn from a seed; what the files
say of them is a little wrong, as after a calibration, and within what the files say of that.
"""

import datetime
import re
import shutil
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from cellcal.calibration.arm.kinematics import RobotModel, load_model
from cellcal.calibration.geometry import Array, Pose, exp_rotation, homogeneous_matrix, inverse_transform
from cellcal.calibration.orientation import rotation_from, values_from
from cellcal.calibration.points.alignment import Alignment, alignment_text
from cellcal.drivers.fanuc.program_files.programs import BRAND
from cellcal.service.engineering.parameters.calibrated_models import nominal_sha256, values_of_model
from cellcal.service.engineering.parameters.parameter_set import ParameterSet, to_text
from cellcal.service.engineering.programs.postures import PostureSearch

FOLDER = Path(__file__).parents[1] / "deploy" / "example_projects" / "door_line"
MODEL = "fanuc_r2000ic_165f"
TOOL = homogeneous_matrix(np.eye(3), np.array([0.0, 0.0, 0.412]))
SIGMA_RAD, SIGMA_M = 1.5e-5, 3e-5
FIXTURE_POINTS = np.array(
    [[0, 0, 0], [1.2, 0, 0], [1.2, 0.9, 0], [0, 0.9, 0], [0.6, 0.45, 0.25]], dtype=float
)
_FLANGE_SEED = np.array([0.0, 0.15, -0.1, 0.0, -0.95, 0.0])


@dataclass(frozen=True)
class ExampleCell:
    """What is true in one cell."""

    name: str
    serial: str
    seed: int
    base_fixture: Array
    entered_frame: Array

    @property
    def real_model(self) -> RobotModel:
        """The arm that stands there."""
        nominal, rng = load_model(MODEL), np.random.default_rng(self.seed)
        errors = rng.normal(scale=[8e-4, 3e-4, 3e-4, 3e-4, 2e-4], size=(nominal.axis_count, 5))
        return nominal.with_dh_errors(np.where(_identifiable_errors(nominal), errors, 0.0))


def main() -> None:
    """Make everything."""
    shutil.rmtree(FOLDER, ignore_errors=True)
    master, clone = example_cells()
    for cell in (master, clone):
        _write_project(cell, master)
    for name, text in example_programs(master.entered_frame).items():
        path = FOLDER / "cell_1" / "programs" / name
        path.parent.mkdir(exist_ok=True)
        path.write_bytes(text)


def example_cells() -> tuple[ExampleCell, ExampleCell]:
    """Return the master's cell and the clone's as they really are."""
    stand = homogeneous_matrix(np.eye(3), np.array([1.05, -0.45, 0.55]))
    shifted = stand @ homogeneous_matrix(
        rotation_from("fanuc_wpr", np.deg2rad([0.12, -0.08, 0.4])), np.array([0.0118, -0.0079, 0.0034])
    )
    return (
        ExampleCell("cell_1", "F-104711", 11, stand, _rounded_pose(stand)),
        ExampleCell("cell_7", "F-118020", 77, shifted, _rounded_pose(shifted)),
    )


def poses_of(listing: bytes) -> Array:
    """Return the points (N, 4, 4) of a listing of ours, by its text alone."""
    found = re.findall(rb"([XYZWPR]) = *(-?[\d.]+) +(?:mm|deg)", listing)
    numbers = np.array([float(number) for _, number in found]).reshape(-1, 6)
    turns = [rotation_from("fanuc_wpr", np.deg2rad(row[3:])) for row in numbers]
    return np.array(
        [homogeneous_matrix(turn, row[:3] / 1e3) for turn, row in zip(turns, numbers, strict=True)]
    )


def tips_at_fixture(cell: ExampleCell, listing: bytes) -> Array:
    """Return where a cell's true tip goes (N, 4, 4), seen from the fixture, when its controller runs a listing."""
    nominal = load_model(MODEL)
    flange = cell.entered_frame @ poses_of(listing) @ inverse_transform(TOOL)
    search = PostureSearch(nominal, nominal, BRAND.configurations)
    joints = search.nearest_postures(flange, np.broadcast_to(_FLANGE_SEED, (len(flange), 6)))
    real_tool = homogeneous_matrix(
        np.eye(3), np.array([float(v) for v in _REAL_TIPS[cell.name].split(",")]) / 1e3
    )
    tips: Array = inverse_transform(cell.base_fixture) @ cell.real_model.base_flange(joints) @ real_tool
    return tips


def example_programs(entered_frame: Array) -> dict[str, bytes]:
    """Return the master's programs: spots on a door, a hem, and the rack they come from."""
    spots = [(x, y, 0.02 * np.sin(3 * x)) for y in (0.06, 0.84) for x in np.linspace(0.05, 1.15, 8)]
    hem = [(x, y, 0.015) for x, y in _rectangle_points(1.15, 0.84, 20)]
    rack = [(0.6, 0.45, z) for z in (0.45, 0.30, 0.12, 0.03)]
    tilted = np.deg2rad([6.0, -9.0, 4.0])
    return {
        "DOOR_SPOTS.LS": _fanuc_listing(
            "DOOR_SPOTS", "door spots l.h.", spots, entered_frame, ("L", "FINE", tilted)
        ),
        "HEM_SEAL.LS": _fanuc_listing("HEM_SEAL", "hem bead", hem, entered_frame, ("L", "CNT60", tilted / 2)),
        "RACK_PICK.LS": _fanuc_listing(
            "RACK_PICK", "pick from rack", rack, entered_frame, ("J", "FINE", tilted * 0)
        ),
    }


def _rectangle_points(width: float, height: float, count: int) -> list[tuple[float, float]]:
    return [
        (0.6 + 0.5 * width * np.cos(a), 0.45 + 0.5 * height * np.sin(a))
        for a in np.linspace(0, 2 * np.pi, count, endpoint=False)
    ]


def _fanuc_listing(
    name: str,
    comment: str,
    places: list[tuple[float, float, float]],
    frame: Array,
    way: tuple[str, str, Array],
) -> bytes:
    letter, end, tilt = way
    down = rotation_from("fanuc_wpr", np.array([np.pi, 0.0, 0.0]))
    poses = np.array(
        [
            homogeneous_matrix(down @ exp_rotation(tilt * np.sin(i)), np.array(place))
            for i, place in enumerate(places)
        ]
    )
    nominal = load_model(MODEL)
    search = PostureSearch(nominal, nominal, BRAND.configurations)
    flange = frame @ poses @ inverse_transform(TOOL)
    joints = search.nearest_postures(flange, np.broadcast_to(_FLANGE_SEED, (len(poses), 6)))
    assert np.isfinite(joints).all(), f"{name}: out of reach"
    assert BRAND.configurations is not None
    texts = BRAND.configurations.write_configurations(nominal, joints, ["N U T, 0, 0, 0"] * len(poses))
    speed = "60%" if letter == "J" else "250mm/sec"
    moves = [f"{letter} P[{i + 1}] {speed} {end}    ;" for i in range(len(poses))]
    lines = [
        f"  !{comment} ;",
        "  UFRAME_NUM=2 ;",
        "  UTOOL_NUM=1 ;",
        "J PR[1:Home] 50% FINE    ;",
        *moves,
        "J PR[1:Home] 50% FINE    ;",
    ]
    body = "".join(f"{i:4d}:{line}\n" for i, line in enumerate(lines, start=1))
    positions = "".join(
        _position_record(i, pose, text) for i, (pose, text) in enumerate(zip(poses, texts, strict=True))
    )
    head = _HEAD.format(name=name, comment=comment, lines=len(lines), size=900 + 110 * len(poses))
    return f"{head}/MN\n{body}/POS\n{positions}/END\n".encode("cp437")


def _position_record(i: int, pose: Array, text: str) -> str:
    x, y, z = pose[:3, 3] * 1e3
    w, p, r = np.degrees(values_from("fanuc_wpr", pose[:3, :3]))
    return (
        f"P[{i + 1}]{{\n   GP1:\n\tUF : 2, UT : 1,\t\tCONFIG : '{text}',\n"
        f"\tX = {_format_number(x)}  mm,\tY = {_format_number(y)}  mm,\tZ = {_format_number(z)}  mm,\n"
        f"\tW = {_format_number(w)} deg,\tP = {_format_number(p)} deg,\tR = {_format_number(r)} deg\n}};\n"
    )


def _format_number(value: float) -> str:
    """Write a number as the controller does: three decimals, no zero before the point."""
    return f"{value:.3f}".replace("-0.", "-.", 1).removeprefix("0").rjust(9)


def _write_project(cell: ExampleCell, master: ExampleCell) -> None:
    folder = FOLDER / cell.name
    folder.mkdir(parents=True)
    nominal = load_model(MODEL)
    (folder / "robot.toml").write_text(to_text(_identified_parameters(cell, nominal)), encoding="utf-8")
    (folder / "door_fixture.aln.json").write_text(
        alignment_text([_fixture_alignment(cell, nominal)]), encoding="utf-8"
    )
    (folder / "project.toml").write_text(_project_text(cell, cell is not master), encoding="utf-8")


def _identified_parameters(cell: ExampleCell, nominal: RobotModel) -> ParameterSet:
    rng = np.random.default_rng(cell.seed + 1000)
    values = []
    for value in values_of_model(nominal, cell.real_model):
        sigma = SIGMA_RAD if value.unit == "rad" else SIGMA_M
        found = round(value.value + rng.normal(scale=sigma), 9)
        values.append(
            replace(value, value=found, standard_uncertainty=sigma, correlations=(0.0,) * len(values))
        )
    return ParameterSet(
        robot_serial=cell.serial,
        model=nominal.name,
        nominal_sha256=nominal_sha256(nominal),
        made_at=datetime.datetime(2026, 3, 2, 9, 0, tzinfo=datetime.UTC).isoformat(),
        made_by="example",
        source="simulated calibration",
        values=tuple(values),
        version=1,
    )


def _fixture_alignment(cell: ExampleCell, nominal: RobotModel) -> Alignment:
    rng = np.random.default_rng(cell.seed + 2000)
    sigma = np.array([2e-5, 2e-5, 2e-5, 3e-5, 3e-5, 3e-5])
    off = rng.normal(scale=sigma)
    found = cell.base_fixture @ homogeneous_matrix(exp_rotation(off[3:]), off[:3])
    return Alignment(
        fixture="door fixture",
        robot_serial=cell.serial,
        model=nominal.name,
        points_in_fixture_m=tuple((float(x), float(y), float(z)) for x, y, z in FIXTURE_POINTS),
        base_fixture=Pose.from_matrix(found),
        covariance=tuple(tuple(row) for row in np.diag(sigma**2).tolist()),
    )


def _project_text(cell: ExampleCell, is_clone: bool) -> str:
    x, y, z = cell.entered_frame[:3, 3] * 1e3
    w, p, r = np.degrees(values_from("fanuc_wpr", cell.entered_frame[:3, :3]))
    head = f"""# One cell of the door line. Made by a simulation: a pattern to copy, not a robot.
format = 1
name = "door line, {cell.name.replace("_", " ")}"
programs = ["programs/*.LS"]
"""
    master = '\n[master]\nproject = "../cell_1/project.toml"\n' if is_clone else ""
    return f"""{head}{master}
[robot]
serial = "{cell.serial}"
model = "{MODEL}"
parameters = "robot.toml"
held_out_rms_mm = 0.08

[tools.1.entered]
position_mm = [0.0, 0.0, 412.0]

[tools.1.real]
position_mm = [{_measured_tip(cell)}]
sigma_mm = 0.03

[frames.2]
position_mm = [{x:.3f}, {y:.3f}, {z:.3f}]
fanuc_wpr_deg = [{w:.3f}, {p:.3f}, {r:.3f}]

[fixture]
alignment = "door_fixture.aln.json"
"""


def _measured_tip(cell: ExampleCell) -> str:
    off = np.random.default_rng(cell.seed + 3000).normal(scale=0.03, size=3)
    tip = np.array([float(v) for v in _REAL_TIPS[cell.name].split(",")]) + off
    return ", ".join(f"{v:.3f}" for v in tip)


_REAL_TIPS = {"cell_1": "0.31, -0.22, 411.64", "cell_7": "-0.18, 0.27, 412.41"}
_HEAD = """/PROG  {name}
/ATTR
OWNER\t\t= MNEDITOR;
COMMENT\t\t= "{comment}";
PROG_SIZE\t= {size};
CREATE\t\t= DATE 26-02-09  TIME 14:02:30;
MODIFIED\t= DATE 26-02-27  TIME 09:41:12;
FILE_NAME\t= ;
VERSION\t\t= 0;
LINE_COUNT\t= {lines};
MEMORY_SIZE\t= {size};
PROTECT\t\t= READ_WRITE;
TCD:  STACK_SIZE\t= 0,
      TASK_PRIORITY\t= 50,
      TIME_SLICE\t= 0,
      BUSY_LAMP_OFF\t= 0,
      ABORT_REQUEST\t= 0,
      PAUSE_REQUEST\t= 0;
DEFAULT_GROUP\t= 1,*,*,*,*;
CONTROL_CODE\t= 00000000 00000000;
/APPL
"""


def _identifiable_errors(nominal: RobotModel) -> Array:
    """Return (n, 5): where the arm's geometry has a parameter of its own; the other errors cannot be identified."""
    free = np.zeros((nominal.axis_count, 5), dtype=bool)
    for entry in np.ndindex(free.shape):
        errors = np.zeros(free.shape)
        errors[entry] = 1e-3
        free[entry] = any(v.value for v in values_of_model(nominal, nominal.with_dh_errors(errors)))
    return free


def _rounded_pose(pose: Array) -> Array:
    """Return a frame as it was taught: half a millimetre off, in three decimals."""
    wpr = np.round(np.degrees(values_from("fanuc_wpr", pose[:3, :3])), 3)
    place = np.round(pose[:3, 3] + [4e-4, -3e-4, 5e-4], 6)
    return homogeneous_matrix(rotation_from("fanuc_wpr", np.deg2rad(wpr)), place)


if __name__ == "__main__":
    main()
