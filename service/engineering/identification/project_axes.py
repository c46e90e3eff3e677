"""Identified tracks and positioners as a project of programs states them, and the parameters of the arm on a track.

The chain of a description is fitted as one arm. Programs have the arm for itself, and what moves it or its work
beside it: where the robot's base stands at B(s) while the track is at s, the track goes along B(0)^-1 B(s).
"""

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from cellcal.calibration.arm.joint_kinds import PRISMATIC
from cellcal.calibration.arm.joint_terms import JointTerm
from cellcal.calibration.arm.model_references import ModelReference, load_model, parse_reference
from cellcal.calibration.arm.mounting import FLOOR
from cellcal.calibration.arm.robot_model import RobotModel
from cellcal.calibration.arm.urdf_joints import link_of
from cellcal.calibration.arm.urdf_reader import parse_description
from cellcal.calibration.documents.plain_files import read_plain_bytes, read_plain_text
from cellcal.calibration.geometry import Array, inverse_transform
from cellcal.calibration.identification.parameters import GEOMETRY, ArmState, Parameter
from cellcal.calibration.message import make_message
from cellcal.service.engineering.identification.identify import IdentifyReport
from cellcal.service.engineering.measured.table import MeasurementError
from cellcal.service.engineering.parameters.calibrated_models import nominal_sha256, values_of_identification
from cellcal.service.engineering.parameters.parameter_files import SetOrigin
from cellcal.service.engineering.parameters.parameter_set import ParameterSet, ParameterValue, to_text
from cellcal.service.files import SHARED_FILE, replace_file

AXES_FILE, ARM_FILE = "axes.toml", "arm.toml"
_FEWEST_ARM_JOINTS = 4  # behind a track
_MOST_TABLE_JOINTS = 2  # of a positioner
_MOST_TILT_DEG = 5.0  # beyond it a project refuses the identified axis
_MOST_ASIDE_M = 0.1
_DIGITS = 9


@dataclass(frozen=True, eq=False)
class _Axis:
    """One external axis as described and as identified, in the frame that a project states it in."""

    name: str
    kind: str  # prismatic | revolute
    entered: Array  # (4, 4) z is the axis, everything at zero
    real: Array  # (4, 4)
    scale: float
    lower: float  # [m or rad]
    upper: float

    def as_table(self, heading: str) -> str:
        """Return its table, without what only the project's owner knows."""
        unit, per_unit = ("mm", 1e-3) if self.kind == PRISMATIC else ("deg", np.pi / 180.0)
        lines = [f"[[{heading}]]", f'name = "{self.name}"']
        lines += ['# axis = "E1"             # as programs name it', f'kind = "{self.kind}"']
        lines += ["# coordinated = true      # false where the controller only moves it"]
        if heading == "positioner":
            lines += [
                '# frames = ["*"]          # user frames whose points are at its work; ["*"] all points'
            ]
        lines += [*_pose_lines(self.entered, self.entered, self.kind), f"zero_{unit} = 0.0"]
        lines += [
            f"lower_{unit} = {self.lower / per_unit:.9g}",
            f"upper_{unit} = {self.upper / per_unit:.9g}",
        ]
        lines += [f"[{heading}.real]", *_pose_lines(self.real, self.entered, self.kind)]
        return "\n".join([*lines, f"zero_{unit} = 0.0", f"scale = {self.scale:.{_DIGITS}f}", ""])


def write_project_axes(
    report: IdentifyReport, measurements: Path, folder: Path, who: SetOrigin
) -> tuple[Path, ...]:
    """Write the tables of the external axes, and for a track the arm's parameter set; return the files.

    Raises
    ------
    MeasurementError
        The chain has no external axis, its geometry was not identified, or a positioner was measured in another frame
        than its description begins in.
    """
    if report.level < GEOMETRY:
        raise MeasurementError(
            make_message(
                "level {level} leaves the direction of an external axis as it is described.",
                level=report.level,
            ),
            remedy="Measure more postures, or ask for `--level 2`.",
        )
    state = report.identification.state
    digest = hashlib.sha256(read_plain_bytes(measurements)).hexdigest()
    source = make_message(
        "identification of the arm on its track: {file}, sha256 {sha256}",
        file=measurements.name,
        sha256=digest,
    )
    files = {}
    if tracks := _leading_slides(state.nominal):
        carried = _carried_reference(state.nominal, tracks)
        arm = _carried_arm(report, load_model(str(carried)), tracks, who, source)
        head = f'[robot]\nserial = "{who.robot_serial}"\nmodel = "{carried}"\nparameters = "{ARM_FILE}"\n'
        tables = [axis.as_table("track") for axis in _track_axes(state, load_model(str(carried)), tracks)]
        files[ARM_FILE] = to_text(arm)
    else:
        head, tables = "", [axis.as_table("positioner") for axis in _positioner_axes(state)]
    commented = "".join(f"# {line}\n" for line in head.splitlines())
    files[AXES_FILE] = (
        f"# Identified by cellcal from {measurements.name}, sha256 {digest}. "
        f"Tables for a project.toml:\n{commented}\n" + "\n".join(tables)
    )
    folder.mkdir(parents=True, exist_ok=True)
    for name, text in files.items():
        replace_file(folder / name, text, mode=SHARED_FILE)
    return tuple(folder / name for name in sorted(files))


def needs_owner(robot: str) -> bool:
    """Return whether a parameter set of an arm belongs to the tables: behind a track, and not for a positioner.

    Raises
    ------
    MeasurementError
        No joints before an arm that slide, and no table of one or two axes; or no description in URDF.
    """
    model, reference = load_model(robot), parse_reference(robot)
    tracks = _leading_slides(model)
    if not reference.is_description or not (tracks or _is_positioner(model)):
        raise MeasurementError(
            make_message("{robot} has no external axis that stands apart from its arm.", robot=model.label),
            remedy="Name a description in URDF of the whole chain: a track that slides and the arm on it, or the one "
            "or two axes of a positioner.",
        )
    return bool(tracks)


def _leading_slides(model: RobotModel) -> int:
    """Return how many joints slide before an arm; zero where what is behind them is no arm."""
    slides = [kind == PRISMATIC for kind in model.kinds]
    count = slides.index(False) if False in slides else len(slides)
    return count if model.axis_count - count >= _FEWEST_ARM_JOINTS else 0


def _is_positioner(model: RobotModel) -> bool:
    return model.axis_count <= _MOST_TABLE_JOINTS and PRISMATIC not in model.kinds


def _carried_reference(nominal: RobotModel, tracks: int) -> ModelReference:
    """Return the arm behind its tracks: the same description, from the link that its first joint hangs on."""
    whole = parse_reference(nominal.name)
    root = parse_description(read_plain_text(Path(whole.where)))
    first = next(j for j in root.findall("joint") if j.get("name") == nominal.joint_names[tracks])
    carried = replace(whole, base=link_of(first, "parent"), mounting="")
    base_carried = _base_carried(nominal.placements, load_model(str(carried)), tracks)
    gravity = base_carried[:3, :3].T @ np.array(nominal.gravity_in_base)
    if np.allclose(gravity, FLOOR, atol=1e-9):
        return carried
    return replace(carried, mounting=",".join(f"{value:.12g}" for value in gravity))


def _base_carried(placements: Array, arm: RobotModel, tracks: int) -> Array:
    """Return the pose of the arm's base in that of the chain, tracks at zero."""
    found = placements[0]
    for placement in placements[1 : tracks + 1]:
        found = found @ placement
    return np.asarray(found @ inverse_transform(arm.placements[0]))


def _track_axes(state: ArmState, arm: RobotModel, tracks: int) -> list[_Axis]:
    """Return the tracks in the frame of the arm's base while all of them are at zero."""
    axes = []
    for joint in range(tracks):
        poses = []
        for placements in (state.nominal.placements, state.arm_model.placements):
            here = np.eye(4)
            for placement in placements[: joint + 1]:
                here = here @ placement
            poses.append(inverse_transform(_base_carried(placements, arm, tracks)) @ here)
        axes.append(_axis_of(state, joint, *poses))
    return axes


def _positioner_axes(state: ArmState) -> list[_Axis]:
    """Return the axes of a positioner in the instrument's frame, which has to be that of its description."""
    axes, entered, real = [], np.eye(4), state.device_of(0).device_base
    for joint in range(state.nominal.axis_count):
        entered = entered @ state.nominal.placements[joint]
        real = real @ state.arm_model.placements[joint]
        _refuse_other_frame(entered, real, state.nominal.joint_names[joint])
        axes.append(_axis_of(state, joint, entered, real))
    return axes


def _axis_of(state: ArmState, joint: int, entered: Array, real: Array) -> _Axis:
    nominal = state.nominal
    ratio = JointTerm("gear", joint, source=joint)
    scales = [
        1.0 + c for term, c in zip(state.terms, state.coefficients.tolist(), strict=True) if term == ratio
    ]
    return _Axis(
        nominal.joint_names[joint],
        PRISMATIC if nominal.kinds[joint] == PRISMATIC else "revolute",
        entered,
        real,
        scales[0] if scales else 1.0,
        float(nominal.lower_rad[joint]),
        float(nominal.upper_rad[joint]),
    )


def _refuse_other_frame(entered: Array, real: Array, name: str) -> None:
    apart_deg = float(np.degrees(np.arccos(np.clip(entered[:3, 2] @ real[:3, 2], -1.0, 1.0))))
    aside_m = float(np.linalg.norm(_nearest_point(real, entered) - entered[:3, 3]))
    if apart_deg > _MOST_TILT_DEG or aside_m > _MOST_ASIDE_M:
        raise MeasurementError(
            make_message(
                "axis {name} was measured {apart_deg:.1f} deg and {aside_mm:.0f} mm away from where the description "
                "has it: the instrument's frame is not the one that the description begins in.",
                name=name,
                apart_deg=apart_deg,
                aside_mm=aside_m * 1e3,
            ),
            remedy="Set the instrument's frame to the robot's base, and let the description begin there too.",
        )


def _nearest_point(axis: Array, place: Array) -> Array:
    """Return the point (3,) of an axis that is nearest to the origin of a frame."""
    direction, origin = axis[:3, 2], axis[:3, 3]
    point: Array = origin + direction * float(direction @ (place[:3, 3] - origin))
    return point


def _pose_lines(axis: Array, entered: Array, kind: str) -> list[str]:
    """Return place and direction of an axis; a slide goes alike wherever its place is said to be."""
    place = entered[:3, 3] if kind == PRISMATIC else _nearest_point(axis, entered)
    return [
        f"position_mm = {_numbers(1e3 * place)}",
        "ros_rpy_deg = [0.0, 0.0, 0.0]",
        f"direction = {_numbers(axis[:3, 2])}",
    ]


def _numbers(values: Array) -> str:
    return f"[{', '.join(f'{value + 0.0:.{_DIGITS}f}' for value in np.round(values, _DIGITS).tolist())}]"


def _carried_arm(
    report: IdentifyReport, arm: RobotModel, tracks: int, who: SetOrigin, source: str
) -> ParameterSet:
    """Return the arm's parameters without the track's; what lies between both belongs to the track."""
    layout = report.identification.robust.fit.layout
    names = _names_on_the_arm(layout.parameters, report.identification.state.terms, tracks)
    kept = [p for p in report.parameters if p.name in names]
    values = values_of_identification(kept, report.identification.robust.fit)
    return ParameterSet(
        robot_serial=who.robot_serial,
        model=arm.name,
        nominal_sha256=nominal_sha256(arm),
        made_at=who.made_at,
        made_by=who.made_by,
        source=source,
        values=tuple(_renamed(value, names[value.name]) for value in values),
        note=who.note,
        version=1,
    )


def _renamed(value: ParameterValue, name: str) -> ParameterValue:
    return replace(value, name=name)


def _names_on_the_arm(
    parameters: Sequence[Parameter], terms: Sequence[JointTerm], tracks: int
) -> dict[str, str]:
    """Return the names that the chain's parameters have on the arm alone, by those that they have on the chain."""
    shifted = {
        term.name: replace(
            term,
            joint=term.joint - tracks,
            link=max(term.link - tracks, 0),
            source=max(term.source - tracks, 0),
        ).name
        for term in terms
        if term.joint >= tracks
    }
    for parameter in parameters:
        # The placement before the arm's first joint is the way from the track to the robot's base.
        if parameter.role in ("offset", "geometry") and parameter.joint > tracks:
            number = f"J{parameter.joint + 1} "
            shifted[parameter.name] = f"J{parameter.joint + 1 - tracks} {parameter.name.removeprefix(number)}"
    return shifted
