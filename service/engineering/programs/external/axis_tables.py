"""``[[track]]`` and ``[[positioner]]`` of a project: what an external axis moves, and how."""

import re
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from cellcal.calibration.geometry import Array, homogeneous_matrix
from cellcal.calibration.message import join_messages, make_message
from cellcal.service.engineering.programs.checked_table import unknown_key
from cellcal.service.engineering.programs.external.moving_axes import (
    ANY_FRAME,
    AxisKind,
    AxisMotion,
    CellAxes,
    ExternalAxis,
    axis_key,
)
from cellcal.service.engineering.programs.project_poses import ProjectError
from cellcal.service.engineering.programs.project_tables import (
    AxisMotionTable,
    AxisTable,
    FixtureTable,
    ProjectTables,
    RealAxisTable,
    read_identified_axis,
)
from cellcal.service.engineering.programs.robot_makes import RobotMake

_UNIT_WITHIN = 1e-4
_MOST_SCALE = 0.1  # a factor farther from 1 is a mistake, not an error of the axis
_MOST_TILT_DEG = 5.0  # beyond it is another axis, or one seen from another frame
# By brand: what its programs call external axes, and an example of each.
_NAMES = {
    "fanuc": (re.compile(r"E[1-9]|GP[2-9]J[1-9]"), "E1 of the robot's group, or GP2 J1 of another"),
    "kuka": (re.compile(r"E[1-6]"), "E1 to E6"),
    "abb": (re.compile(r"EAX[A-F]"), "eax_a to eax_f"),
    "yaskawa": (re.compile(r"[BS][1-9]"), "B1 of the base (BC, BP) or S1 of a station (EC, EX)"),
}


def read_axes(
    tables: ProjectTables, folder: Path, make: RobotMake | None, known_frames: Sequence[str], where: str
) -> CellAxes:
    """Return the external axes of a project.

    Raises
    ------
    ProjectError
        An axis that the robot's programs do not have or that stands twice, limits that are reversed, a direction that
        is no unit vector, a value in the unit of the other kind.
    """
    axes = [
        _read_axis(table, folder, make, f"{where}: [[{heading}]] {number} ({table.name})", is_track=is_track)
        for heading, written, is_track in (
            ("track", tables.track, True),
            ("positioner", tables.positioner, False),
        )
        for number, table in enumerate(written, start=1)
    ]
    _refuse_double(axes, where)
    for axis in axes:
        _refuse_frames(axis, known_frames, where)
    return CellAxes(tuple(axes))


def fixture_values(table: FixtureTable, axes: CellAxes, where: str) -> dict[str, float]:
    """Return where external axes stood while the fixture was measured, by name [m or rad].

    Raises
    ------
    ProjectError
        An axis that the project does not state.
    """
    by_name = {axis.name: axis for axis in axes.axes}
    for name in table.at:
        if name not in by_name:
            unknown, remedy = unknown_key(name, tuple(by_name))
            raise ProjectError(
                make_message("{where}: {unknown}", where=where, unknown=unknown),
                remedy=join_messages(" ", ("Name an axis as its [[track]] or [[positioner]] does.", remedy)),
            )
    return {name: value * by_name[name].kind.per_unit for name, value in table.at.items()}


def _read_axis(
    table: AxisTable, folder: Path, make: RobotMake | None, where: str, *, is_track: bool
) -> ExternalAxis:
    _refuse_axis_name(table.axis, make, where)
    kind, frame = AxisKind(table.kind), _frame_of(table)
    entered = _read_motion(table, kind, frame, float(table.sign), where)
    lower, upper = _read_range(table, kind, where)
    return ExternalAxis(
        name=table.name,
        axis=table.axis,
        carries_robot=is_track,
        coordinated=table.coordinated,
        entered=entered,
        real=_read_real(table, entered, frame, folder, where),
        frame=frame,
        lower=lower,
        upper=upper,
        pulses_per_unit=_read_pulses(table, kind, where),
        frames=_read_frames(table, where, is_track=is_track),
    )


def _refuse_axis_name(axis: str, make: RobotMake | None, where: str) -> None:
    if make is None:
        return
    if make.brand not in _NAMES:
        raise ProjectError(
            make_message("{where}: programs of this robot hold no external axes.", where=where),
            remedy="Leave the table out.",
        )
    pattern, example = _NAMES[make.brand]
    if not pattern.fullmatch(axis_key(axis)):
        raise ProjectError(
            make_message("{where}: programs of this robot have no axis {axis!r}.", where=where, axis=axis),
            remedy=make_message("They name {example}.", example=example),
        )


def _frame_of(table: AxisMotionTable) -> Array:
    """Return the frame of an axis (4, 4) [m]; without a position at the origin."""
    return homogeneous_matrix(table.rotation(), np.asarray(table.position_mm or (0.0, 0.0, 0.0)) / 1e3)


def _read_motion(
    table: AxisMotionTable, kind: AxisKind, frame: Array, sign: float, where: str, scale: float = 1.0
) -> AxisMotion:
    if table.direction is not None:
        direction = np.asarray(table.direction)
        length = float(np.linalg.norm(direction))
        if abs(length - 1.0) > _UNIT_WITHIN:
            raise ProjectError(
                make_message(
                    "{where}: direction has the length {length:.4g}, not 1.", where=where, length=length
                ),
                remedy="Divide its three numbers by this length; a direction has no unit.",
            )
        direction = direction / length
    elif kind is AxisKind.REVOLUTE:
        direction = np.array([0.0, 0.0, 1.0])
    else:
        raise ProjectError(
            make_message("{where}: {name} is missing.", where=where, name="direction"),
            remedy="Write the unit vector of its slide, such as [1, 0, 0].",
        )
    zero = _value_of("zero", table.zero_mm, table.zero_deg, kind, where)
    return AxisMotion(
        kind,
        frame[:3, 3].copy(),
        frame[:3, :3] @ direction,
        0.0 if zero is None else zero * kind.per_unit,
        sign,
        scale,
    )


def _value_of(
    key: str, in_mm: float | None, in_deg: float | None, kind: AxisKind, where: str
) -> float | None:
    """Return a value in the unit of the axis; one in the unit of the other kind is refused."""
    right, wrong, unit = (in_mm, in_deg, "deg") if kind is AxisKind.PRISMATIC else (in_deg, in_mm, "mm")
    if wrong is not None:
        raise ProjectError(
            make_message(
                "{where}: {key} does not fit an axis of kind {kind}.",
                where=where,
                key=f"{key}_{unit}",
                kind=kind,
            ),
            remedy=make_message("Write {key}, or correct its kind.", key=f"{key}_{kind.unit}"),
        )
    return right


def _read_range(table: AxisTable, kind: AxisKind, where: str) -> tuple[float, float]:
    lower = _value_of("lower", table.lower_mm, table.lower_deg, kind, where)
    upper = _value_of("upper", table.upper_mm, table.upper_deg, kind, where)
    low, high = -np.inf if lower is None else lower, np.inf if upper is None else upper
    if low >= high:
        raise ProjectError(
            make_message(
                "{where}: {lower} ({low:g}) is not below {upper} ({high:g}).",
                where=where,
                lower=f"lower_{kind.unit}",
                low=low,
                upper=f"upper_{kind.unit}",
                high=high,
            ),
            remedy="Exchange the two.",
        )
    return low * kind.per_unit, high * kind.per_unit


def _read_pulses(table: AxisTable, kind: AxisKind, where: str) -> float | None:
    pulses = _value_of("pulses_per", table.pulses_per_mm, table.pulses_per_deg, kind, where)
    if pulses is None:
        return None
    if pulses == 0:
        raise ProjectError(
            make_message("{where}: {key} is zero.", where=where, key=f"pulses_per_{kind.unit}"),
            remedy="Divide its pulses by its travel.",
        )
    return pulses / kind.per_unit


def _read_frames(table: AxisTable, where: str, *, is_track: bool) -> tuple[str, ...]:
    if is_track:
        if table.frames:
            raise ProjectError(
                make_message("{where}: a track carries the robot, and no frames.", where=where),
                remedy="Leave frames out, or write [[positioner]].",
            )
        return ()
    if table.frames is None:
        raise ProjectError(
            make_message(
                "{where}: frames is missing: nothing tells which points are at the work that it carries.",
                where=where,
            ),
            remedy='Name their user frames, frames = ["*"] for all points, or frames = [] for none.',
        )
    return tuple(table.frames)


def _read_real(table: AxisTable, entered: AxisMotion, frame: Array, folder: Path, where: str) -> AxisMotion:
    """Return the axis as it was identified: a table of its own, or a file with the same keys."""
    real = table.real
    if not real.is_empty and table.identified is not None:
        raise ProjectError(
            make_message(
                "{where}: {name} and {other} exclude each other.",
                where=where,
                name="real",
                other="identified",
            ),
            remedy="Leave one of the two out.",
        )
    if table.identified is not None:
        path = (folder / table.identified).resolve()
        where, real = str(path), read_identified_axis(path)
    if real.is_empty:
        return entered
    scale = 1.0 if real.scale is None else real.scale
    if abs(scale - 1.0) > _MOST_SCALE:
        raise ProjectError(
            make_message("{where}: scale {scale:g} is no error of an axis.", where=where, scale=scale),
            remedy="It is the travel for each unit of the value: near 1.",
        )
    stated: dict[str, object] = {}
    if real.zero_mm is None and real.zero_deg is None:
        stated[f"zero_{entered.kind.unit}"] = entered.zero / entered.kind.per_unit
    if real.direction is None:
        stated["direction"] = (frame[:3, :3].T @ entered.direction).tolist()
    found = _read_motion(
        real.model_copy(update=stated), entered.kind, _real_frame(real, frame), entered.sign, where, scale
    )
    _refuse_other_axis(found, entered, where)
    return found


def _real_frame(real: RealAxisTable, frame: Array) -> Array:
    """Return the frame of an axis as it was identified; a place or a turn that is not stated is as entered."""
    rotation = real.rotation() if real.orientation_keys else frame[:3, :3]
    place = frame[:3, 3] if real.position_mm is None else np.asarray(real.position_mm) / 1e3
    return homogeneous_matrix(rotation, place)


def _refuse_other_axis(real: AxisMotion, entered: AxisMotion, where: str) -> None:
    """Refuse a direction that no error of an axis makes: the numbers stand in another frame than the entered ones."""
    apart_deg = float(np.degrees(np.arccos(np.clip(real.direction @ entered.direction, -1.0, 1.0))))
    if apart_deg > _MOST_TILT_DEG:
        raise ProjectError(
            make_message(
                "{where}: the identified axis points {apart_deg:.1f} deg away from the entered one, which no error "
                "of an axis does.",
                where=where,
                apart_deg=apart_deg,
            ),
            remedy="State both in the cell frame, with the same direction in the frame of the axis.",
        )


def _refuse_double(axes: Sequence[ExternalAxis], where: str) -> None:
    for template, names in (
        ("{where}: two external axes have the name {name}.", [axis.name for axis in axes]),
        ("{where}: two external axes have the axis {name}.", [axis_key(axis.axis) for axis in axes]),
    ):
        double = next((name for name in names if names.count(name) > 1), None)
        if double is not None:
            raise ProjectError(
                make_message(template, where=where, name=double), remedy="Give each axis a table of its own."
            )


def frames_at_zero(frames: Mapping[str, Array], axes: CellAxes) -> tuple[dict[str, Array], dict[str, Array]]:
    """Return user frames in the cell frame with all axes at zero, and the tables of those that an axis turns.

    A frame that a positioner turns is written as its controller has it, from the last of the axes that turn it.
    """
    found, tables = dict(frames), dict[str, Array]()
    for name, pose in frames.items():
        turning = [n for n in axes.carriers_of(name, caseless=False) if axes.axes[n].coordinated]
        if turning:
            tables[name] = axes.axes[turning[-1]].frame
            found[name] = tables[name] @ pose
    return found, tables


def _refuse_frames(axis: ExternalAxis, known_frames: Sequence[str], where: str) -> None:
    if not axis.coordinated or axis.carries_robot:
        return
    if ANY_FRAME in axis.frames:
        raise ProjectError(
            make_message(
                '{where}: [[positioner]] {axis_name} turns user frames, and frames = ["*"] names none.',
                where=where,
                axis_name=axis.name,
            ),
            remedy="Name each frame that it turns; frames that stand still have coordinated = false.",
        )
    unknown = [name for name in axis.frames if name not in known_frames]
    if unknown:
        raise ProjectError(
            make_message(
                "{where}: [[positioner]] {axis_name} turns the user frame {frame}, which no [frames.{frame}] states.",
                where=where,
                axis_name=axis.name,
                frame=unknown[0],
            ),
            remedy="Write its pose on the table, as the controller has it; a fixed frame has coordinated = false.",
        )
