"""Positions of many programs side by side, and the tool and frame of each in a cell."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from cellcal.calibration.arm.kinematics import RobotModel
from cellcal.calibration.arm.model_references import shown_name
from cellcal.calibration.geometry import Array, Pose, inverse_transform
from cellcal.calibration.message import make_message
from cellcal.calibration.programs.transfer import same_place
from cellcal.drivers.programs.barred import UNKNOWN_FRAMES
from cellcal.drivers.programs.errors import ProgramFileError
from cellcal.drivers.programs.external_settings import sets_external_axes
from cellcal.drivers.programs.positions import CARTESIAN, JOINTS, UNTAUGHT, ProgramFile
from cellcal.service.engineering.programs.controller_joints import NO_UNIT, as_chain, lacks_units
from cellcal.service.engineering.programs.external.point_reasons import external_reasons
from cellcal.service.engineering.programs.external.point_values import PointAxes
from cellcal.service.engineering.programs.point_columns import held_rows, joints_of, side_by_side
from cellcal.service.engineering.programs.project import Project
from cellcal.service.engineering.programs.project_poses import ProjectTool
from cellcal.service.engineering.programs.project_pulses import MISSING, PULSES
from cellcal.service.engineering.programs.robot_makes import (
    base_of,
    flange_of,
    lacks_coupling,
    runs_programs_of,
)
from cellcal.service.engineering.programs.starting_postures import StartingPostures

Rows = NDArray[np.intp]
Entry = TypeVar("Entry")
CASELESS = frozenset(("abb", "kuka"))  # brands whose languages take a name in any case

_ALWAYS = {"yaskawa": ("BASE", "ROBOT")}  # a file may hold these, but does not bring them
_ALIKE_M, _ALIKE_RAD = 1e-5, np.radians(0.01)  # what a pendant shows of one pose and another
_NEAREST_M = 5e-3  # all points of a program within this of their frame's origin: another unit
_FEWEST = 3
_MISSING = {
    "tool": "no tool {name} in {project}",
    "user frame": "no user frame {name} in {project}",
}
_COMPARED, _ANOTHER_ARM_M = 7, 1e-4
_FARTHEST = 3.0  # times the arm's length


@dataclass(frozen=True, eq=False)
class ProgramPoints:
    """N positions of some programs, one after the other."""

    programs: tuple[ProgramFile, ...]
    of: Rows  # (N,) whose
    row: Rows  # (N,) of its positions
    cartesian: NDArray[np.bool_]
    frame_tip: Array  # (N, 4, 4)
    joints: Array  # (N, n)
    texts: tuple[str, ...]  # configurations
    tools: tuple[str | None, ...]
    user_frames: tuple[str | None, ...]
    stays: NDArray[np.bool_]  # (N,) not meant to change
    reasons: list[str]  # (N,) why a point is left, "" while nothing speaks against it
    held: NDArray[np.bool_]  # (N,) of a tool in the cell, seen from the work in the gripper
    axis_values: Array  # (N, A) of the cell's external axes
    axes_of: tuple[PointAxes, ...]  # by program
    solved: Array  # (N, n) joints that were computed for points that state none, while they are
    unusable: NDArray[np.bool_]  # (N,) whose joints are not where the robot stands there

    def __len__(self) -> int:
        return len(self.row)

    def tips_of(self, rows: Rows) -> Array:
        """Return the tip (K, 4, 4) in the user frame; of work in the gripper, the work seen from the tool."""
        tips = self.frame_tip[rows]
        held = self.held[rows]
        if held.any():
            tips = tips.copy()
            tips[held] = inverse_transform(tips[held])
        return tips

    def written_tips(self, rows: Rows, tips: Array) -> Array:
        """Return tips as `tips_of` has them, as they are written."""
        held = self.held[rows]
        if held.any():
            tips = tips.copy()
            tips[held] = inverse_transform(tips[held])
        return tips

    def begin_programs(self, rows: Rows, postures: Array, starting: StartingPostures) -> None:
        """Set the posture before a program's first rows where none is known: the last found, or the starting one."""
        firsts = np.flatnonzero(np.concatenate([[True], self.of[rows[1:]] != self.of[rows[:-1]]]))
        for first in firsts.tolist():
            program = int(self.of[rows[first]])
            begin = starting.of_program(self.programs[program].name)
            if begin is None or np.isfinite(postures[first]).all():
                continue
            before = np.flatnonzero(
                (self.of[: rows[first]] == program) & np.isfinite(self.solved[: rows[first], 0])
            )
            postures[first] = self.solved[before[-1]] if len(before) else begin

    def refuse_points(self, rows: Rows, why: str | Callable[[int], str]) -> None:
        """Leave points, for the first reason that was found."""
        for i in rows.tolist():
            self.reasons[i] = self.reasons[i] or (why if isinstance(why, str) else why(i))

    def keep_joint_points(self) -> None:
        """Let points in joint angles stay whose tool or frame is unknown: they depend on none."""
        for i, why in enumerate(self.reasons):
            if why in UNKNOWN_FRAMES and not self.cartesian[i] and np.isfinite(self.joints[i]).all():
                self.stays[i], self.reasons[i] = True, ""

    def taught_before(self, rows: Rows) -> Array:
        """Return joints (K, n) taught in the same program after the row before each of K rows, else NaN.

        A point that is left where it is tells the posture as well as one that is changed.
        """
        taught = np.flatnonzero(np.isfinite(self.joints).all(axis=1) & ~self.unusable)
        found = np.full((len(rows), self.joints.shape[1]), np.nan)
        if not len(taught):
            return found
        last = np.searchsorted(taught, rows) - 1
        at = taught[np.maximum(last, 0)]
        previous = np.concatenate([[-1], rows[:-1]])
        there = (last >= 0) & (self.of[at] == self.of[rows]) & (at > previous)
        found[there] = self.joints[at[there]]
        return found

    def open_rows(self) -> Rows:
        """Return the points that nothing speaks against."""
        stays = self.stays.tolist()
        return np.array(
            [i for i, reason in enumerate(self.reasons) if not reason and not stays[i]], dtype=np.intp
        )


def points_of(programs: Sequence[ProgramFile], cell: Project) -> ProgramPoints:
    """Put the positions of programs of a cell side by side.

    Raises
    ------
    ProgramFileError
        A program of an arm with another number of joints: every joint position says so.
    """
    axes = cell.nominal.axis_count
    set_later = len(cell.axes) > 0 and any(sets_external_axes(one.brand, one.to_bytes()) for one in programs)
    found = [
        external_reasons(program, cell.axes, cell.standing_tools, axes, set_later=set_later)
        for program in programs
    ]
    all_of = [program.positions for program in programs]
    count = [len(positions) for positions in all_of]
    no_units = [lacks_units(one.brand, one.positions, cell.nominal) for one in programs]
    reasons = [
        ""
        if each.stays[row]
        else _first_reason(kind, p.barred.get(row, ""), axes)
        or each.reasons[row]
        or (NO_UNIT if bare[row] else "")
        for p, each, bare in zip(all_of, found, no_units, strict=True)
        for row, kind in enumerate(p.kinds)
    ]
    return ProgramPoints(
        programs=tuple(programs),
        of=np.repeat(np.arange(len(programs)), count).astype(np.intp),
        row=side_by_side([np.arange(n, dtype=np.intp) for n in count], np.zeros(0, dtype=np.intp)),
        cartesian=np.array([kind == CARTESIAN for p in all_of for kind in p.kinds], dtype=bool),
        frame_tip=side_by_side([p.frame_tip for p in all_of], np.zeros((0, 4, 4))),
        joints=side_by_side(
            [as_chain(one.brand, joints_of(one.positions, axes)) for one in programs], np.zeros((0, axes))
        ),
        texts=tuple(text for p in all_of for text in p.configurations),
        tools=tuple(name for p in all_of for name in p.tools),
        user_frames=tuple(name for p in all_of for name in p.user_frames),
        stays=side_by_side([each.stays for each in found], np.zeros(0, dtype=bool)),
        reasons=reasons,
        held=side_by_side([held_rows(p) for p in all_of], np.zeros(0, dtype=bool)),
        axis_values=side_by_side([each.point_axes.values for each in found], np.zeros((0, len(cell.axes)))),
        axes_of=tuple(each.point_axes for each in found),
        solved=np.full((sum(count), axes), np.nan),
        unusable=np.array([bool(reason) and reason not in UNKNOWN_FRAMES for reason in reasons], dtype=bool),
    )


@dataclass(frozen=True, eq=False)
class PointGroup:
    """Points that share tool and frame."""

    rows: Rows
    tool: str | None
    frame: str | None
    held: bool = False  # work in the gripper, at a tool that stands in the cell


def groups_of(points: ProgramPoints, programs_apart: bool) -> tuple[PointGroup, ...]:
    """Return the points by tool and frame; by program too where programs bring tools and frames of their own."""
    found: dict[tuple[str | None, str | None, int, bool], list[int]] = {}
    for i in points.open_rows().tolist():
        whose = int(points.of[i]) if programs_apart else -1
        key = (points.tools[i], points.user_frames[i], whose, bool(points.held[i]))
        found.setdefault(key, []).append(i)
    return tuple(
        PointGroup(np.array(rows, dtype=np.intp), key[0], key[1], key[3]) for key, rows in found.items()
    )


def bring_their_own(programs: Sequence[ProgramFile]) -> bool:
    """Tell whether any program holds tools or frames itself."""
    return any(tools or bases for p in programs for tools, bases in [_brought_frames(p, at_home=True)])


def _brought_frames(program: ProgramFile, *, at_home: bool) -> tuple[Mapping[str, Pose], Mapping[str, Pose]]:
    """Return tools and frames that a program brings; ``at_home`` those of its cell's other files, too."""
    frames = program.frames
    if not at_home or not (frames.cell_flange_tip or frames.cell_base_frame):
        return frames.flange_tip, frames.base_frame
    return {**frames.cell_flange_tip, **frames.flange_tip}, {**frames.cell_base_frame, **frames.base_frame}


def tool_of(
    project: Project, program: ProgramFile, name: str | None, *, at_home: bool = True
) -> ProjectTool | None:
    """Return the tool that a position names: of the project, of the program, or what every controller has.

    ``at_home`` says that the project is the cell where the program is from.
    """
    named = name if name is not None else project.unsaid_tool
    if named is None:
        return None
    entered = entry_named(project.tools, named, program.brand)
    if entered is not None:
        return entered
    pose = _own_pose(
        _brought_frames(program, at_home=at_home)[0], named, flange_of(program.brand), program.brand
    )
    return None if pose is None else ProjectTool(pose, pose)


def frame_of(
    project: Project, program: ProgramFile, name: str | None, *, at_home: bool = True
) -> Array | None:
    """Return the user frame (4, 4) that a position names; ``at_home`` as for `tool_of`."""
    named = name if name is not None else project.unsaid_frame
    if named is None:
        return None
    entered = entry_named(project.frames, named, program.brand)
    if entered is not None:
        return entered
    return _own_pose(
        _brought_frames(program, at_home=at_home)[1], named, base_of(program.brand), program.brand
    )


def entry_named(entries: Mapping[str, Entry], name: str, brand: str) -> Entry | None:
    """Return the entry of a name; a language that ignores case finds it in any case."""
    if name in entries or brand not in CASELESS:
        return entries.get(name)
    return next((entry for key, entry in entries.items() if key.lower() == name.lower()), None)


def name_in(project: Project, program: ProgramFile, name: str | None) -> str | None:
    """Return a user frame's name as the project spells it, where the program's language ignores case."""
    if name is None or program.brand not in CASELESS:
        return name
    return next((key for key in project.frames if key.lower() == name.lower()), name)


def in_no_frame(program: ProgramFile, name: str | None) -> bool:
    """Tell whether a position names no user frame, or only the robot's base."""
    return name is None or _is_same_name(name, base_of(program.brand), program.brand)


def _entered_frame(project: Project, frame: str | None, brand: str) -> Array | None:
    """Return a user frame as its controller has it: from the axis, where an axis turns it."""
    found = entry_named(project.frames, frame or "", brand)
    table = entry_named(project.table_frames, frame or "", brand)
    return found if found is None or table is None else inverse_transform(table) @ found


def find_contradiction(
    project: Project, program: ProgramFile, tool: str | None, frame: str | None, *, at_home: bool = True
) -> str:
    """Return why points are left whose tool or frame the program brings along, and the cell has another; or ""."""
    tools, frames = _brought_frames(program, at_home=at_home)
    tool = tool if tool is not None else project.unsaid_tool
    frame = frame if frame is not None else project.unsaid_frame
    brand = program.brand
    tool_entry = None if tool is None else entry_named(project.tools, tool, brand)
    entered = None if tool_entry is None else tool_entry.entered
    pairs = (
        ("tool", tool, entered, tools, (flange_of(brand),)),
        (
            "user frame",
            frame,
            _entered_frame(project, frame, brand),
            frames,
            (base_of(brand), *_ALWAYS.get(brand, ())),
        ),
    )
    for what, name, cells, files, always in pairs:
        own = None if name is None else entry_named(files, name, brand)
        if own is None or cells is None or any(_is_same_name(name or "", one, brand) for one in always):
            continue
        apart, turned = same_place(own.to_matrix()[None], cells[None])
        if apart[0] > _ALIKE_M or turned[0] > _ALIKE_RAD:
            return (
                f"the program brings its own {what} {name}, {apart[0] * 1e3:.2f} mm and "
                f"{np.degrees(turned[0]):.2f} deg from that of {project.path.name}: make them one"
            )
    return ""


def missing_reason(what: str, name: str | None, project: Project) -> str:
    """Return why a point of unknown tool or frame is left unchanged."""
    if name is None:
        key = "tool" if what == "tool" else "frame"
        return make_message(
            "the program does not say which {what}, and {path_name} has no [unsaid] {key}",
            what=what,
            path_name=project.path.name,
            key=key,
        )
    return make_message(_MISSING[what], name=name, project=project.path.name)


def refuse_foreign(program: ProgramFile, project: Project) -> None:
    """Refuse a program of another make, or written in another unit, before any point of it is computed.

    Raises
    ------
    ProgramFileError
        With the cure.
    """
    name, model = program.name, project.nominal
    if not runs_programs_of(model, program.brand):
        raise ProgramFileError(
            name,
            make_message(
                "this is a program of {brand}, the robot of {path_name} is a {model_name}.",
                brand=program.brand,
                path_name=project.path.name,
                model_name=model.name,
            ),
            remedy="Name the project of the robot that this program is for.",
        )
    if lacks_coupling(model, program.brand):
        raise ProgramFileError(
            name,
            make_message(
                "a FANUC counts J3 against the horizon, and {shown_name} does not couple J3 with J2.",
                shown_name=shown_name(model.name),
            ),
            remedy="Name a robot of `cellcal models`, or a model file with interaction = [[3, 2, 1.0]].",
        )
    _refuse_other_kinematics(program, project)
    places = program.positions.frame_tip[:, :3, 3]
    stands = ~np.nan_to_num(program.positions.external).any(axis=1)  # what axes carry may be anywhere
    places = places[~np.isnan(places[:, 0]) & stands]  # a position that is no pose holds none
    if not len(places):
        return
    sizes = np.sqrt((places * places).sum(axis=1))
    reach = arm_length(model)
    if sizes.min() > _FARTHEST * reach and sizes.min() > _FARTHEST * (reach + _farthest_frame(project)):
        raise ProgramFileError(
            name,
            make_message(
                "its nearest point is {sizes:.0f} m from its frame, the arm reaches {reach:.1f} m.",
                sizes=sizes.min(),
                reach=reach,
            ),
            remedy="Numbers look a thousand times too large: millimetres written where metres belong?",
        )
    if len(places) >= _FEWEST and sizes.max() < _NEAREST_M:
        raise ProgramFileError(
            name,
            make_message(
                "all its {place_count} points are within {sizes:.1f} mm of their frame's origin.",
                place_count=len(places),
                sizes=sizes.max() * 1000.0,
            ),
            remedy="Numbers look a thousand times too small: metres written where millimetres belong?",
        )


def _farthest_frame(project: Project) -> float:
    return max((float(np.linalg.norm(pose[:3, 3])) for pose in project.frames.values()), default=0.0)


def _refuse_other_kinematics(program: ProgramFile, project: Project) -> None:
    """Compare the arm that a file says it was taught on with that of the project's controller."""
    own = program.frames.kinematics
    if own is None or own.axis_count != project.controller.axis_count:
        return
    still = np.linspace(-1.5, 1.5, _COMPARED)[:, None] * np.ones(own.axis_count)
    apart = own.base_flange(still)[:, :3, 3] - project.controller.base_flange(still)[:, :3, 3]
    most = float(np.linalg.norm(apart, axis=1).max())
    if most > _ANOTHER_ARM_M:
        cure = "Name the project of the robot it was taught on."
        if not project.factory_known:
            cure = "Name the controller's calibration.conf as factory under [robot]."
        raise ProgramFileError(
            program.name,
            make_message(
                "it holds the kinematics of an arm that is up to {most:.1f} mm away from what the "
                "controller of {path_name} computes.",
                most=most * 1000.0,
                path_name=project.path.name,
            ),
            remedy=cure,
        )


def arm_length(model: RobotModel) -> float:
    """Return the length of the stretched arm [m]."""
    places = model.placements[:, :3, 3]
    return float(np.sqrt((places * places).sum(axis=1)).sum())


def _own_pose(poses: Mapping[str, Pose], name: str, always: str, brand: str) -> Array | None:
    pose = entry_named(poses, name, brand)
    if pose is not None:
        return pose.to_matrix()
    return np.eye(4) if _is_same_name(name, always, brand) else None


def _is_same_name(name: str, other: str, brand: str) -> bool:
    return name == other or (brand in CASELESS and name.lower() == other.lower())


def _first_reason(kind: str, barred: str, axes: int) -> str:
    if barred:
        return barred
    if kind == UNTAUGHT:
        return "not taught"
    if kind == PULSES:
        return MISSING
    return "" if kind in (CARTESIAN, JOINTS) else f"holds {kind}, which is no position of {axes} joints"
