"""The tool and user frame that a program names, in its cell; programs of another cell are refused."""

import re
from collections.abc import Mapping, Sequence

import numpy as np

from cellcal.calibration.arm.kinematics import RobotModel
from cellcal.calibration.geometry import Array, Pose, inverse_transform
from cellcal.calibration.message import make_message
from cellcal.calibration.programs.transfer import same_place
from cellcal.drivers.programs.errors import ProgramFileError
from cellcal.drivers.programs.positions import ProgramFile
from cellcal.service.engineering.programs.named_entries import CASELESS, brought_frames, entry_named
from cellcal.service.engineering.programs.project import Project
from cellcal.service.engineering.programs.project_poses import ProjectTool
from cellcal.service.engineering.programs.robot_makes import (
    base_of,
    flange_of,
    lacks_coupling,
    runs_programs_of,
)
from cellcal.service.engineering.programs.written_tools import ALIKE_M, ALIKE_RAD, tool_at

_ALWAYS = {"yaskawa": ("BASE", "ROBOT")}  # a file may hold these, but does not bring them
_NEAREST_M = 5e-3  # all points of a program within this of their frame's origin: another unit
_FEWEST = 3
_MISSING = {
    "tool": "no tool {name} in {project}: state it there as [tools.{key}]",
    "user frame": "no user frame {name} in {project}: state it there as [frames.{key}]",
}
_BARE_KEY = re.compile(r"[\w-]+", re.ASCII)
_COMPARED, _ANOTHER_ARM_M = 7, 1e-4
_FARTHEST = 3.0  # times the arm's length


def bring_their_own(programs: Sequence[ProgramFile]) -> bool:
    """Return whether any program holds tools or frames itself."""
    return any(tools or bases for p in programs for tools, bases in [brought_frames(p, at_home=True)])


def tool_of(
    project: Project, program: ProgramFile, name: str | None, *, home: Project | None = None
) -> ProjectTool | None:
    """Return the tool that a position names or writes: of the project, of the program, or what every controller has.

    ``home`` is the cell where the program is from, where that is not this one.
    """
    home = project if home is None else home
    named = name if name is not None else project.default_tool
    if named is None:
        return None
    entered = entry_named(project.tools, named, program.brand)
    if entered is not None:
        return entered
    pose = _own_pose(
        brought_frames(program, at_home=project is home)[0], named, flange_of(program.brand), program.brand
    )
    if pose is None:
        return None
    return tool_at(project, home, program.brand, named, pose) or ProjectTool(pose, pose)


def frame_of(
    project: Project, program: ProgramFile, name: str | None, *, at_home: bool = True
) -> Array | None:
    """Return the user frame (4, 4) that a position names; ``at_home`` says that this is its own cell."""
    named = name if name is not None else project.default_frame
    if named is None:
        return None
    entered = entry_named(project.frames, named, program.brand)
    if entered is not None:
        return entered
    return _own_pose(
        brought_frames(program, at_home=at_home)[1], named, base_of(program.brand), program.brand
    )


def name_in(project: Project, program: ProgramFile, name: str | None) -> str | None:
    """Return a user frame's name as the project spells it, where the program's language ignores case."""
    if name is None or program.brand not in CASELESS:
        return name
    return next((key for key in project.frames if key.lower() == name.lower()), name)


def names_no_frame(program: ProgramFile, name: str | None) -> bool:
    """Return whether a position names no user frame, or only the robot's base."""
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
    tools, frames = brought_frames(program, at_home=at_home)
    tool = tool if tool is not None else project.default_tool
    frame = frame if frame is not None else project.default_frame
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
        if apart[0] > ALIKE_M or turned[0] > ALIKE_RAD:
            return make_message(
                "the program brings its own {what} {name}, {apart_mm:.2f} mm and {turned_deg:.2f} deg from that of "
                "{project}: make them one",
                what=what,
                name=name,
                apart_mm=apart[0] * 1e3,
                turned_deg=np.degrees(turned[0]),
                project=project.file_name,
            )
    return ""


def missing_reason(what: str, name: str | None, project: Project) -> str:
    """Return why a point of unknown tool or frame is left unchanged."""
    if name is None:
        key = "tool" if what == "tool" else "frame"
        return make_message(
            "the program does not say which {what}, and {path_name} has no [unsaid] {key}",
            what=what,
            path_name=project.file_name,
            key=key,
        )
    key = name if _BARE_KEY.fullmatch(name) else f'"{name}"'
    return make_message(_MISSING[what], name=name, project=project.file_name, key=key)


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
                path_name=project.file_name,
                model_name=model.label,
            ),
            remedy="Name the project of the robot that this program is for.",
        )
    if lacks_coupling(model, program.brand):
        raise ProgramFileError(
            name,
            make_message(
                "a FANUC counts J3 against the horizon, and {shown_name} does not couple J3 with J2.",
                shown_name=model.label,
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
                path_name=project.file_name,
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
