"""Tools whose pose a program writes itself: which tool of the project such a pose is.

A URScript says ``set_tcp(p[0, 0, 0.15, 0, 0, 0])``, KRL ``$TOOL={X 0,…}``: no name of the controller, only numbers.
The measured tip of that tool is in the project under the name that a person gave it, and is found by the pose that
the controller of the program's own cell has. In a clone's cell it is the tool of the same name.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from cellcal.calibration.geometry import Array
from cellcal.calibration.message import make_message
from cellcal.calibration.programs.transfer import same_place
from cellcal.drivers.programs.positions import ProgramFile
from cellcal.service.engineering.programs.named_entries import brought_frames, entry_named, is_written_out
from cellcal.service.engineering.programs.program_points import ProgramPoints
from cellcal.service.engineering.programs.project import Project
from cellcal.service.engineering.programs.project_poses import ProjectTool
from cellcal.service.engineering.programs.result import LEFT, PointFinding, ProgramResult

ALIKE_M, ALIKE_RAD = 1e-5, np.radians(0.01)  # what a pendant shows of one pose and another
_WITHOUT_TOOL_NAMES = frozenset(("universal_robots",))  # brands whose programs write poses in place of names


def tool_at(project: Project, home: Project, brand: str, name: str, flange_tip: Array) -> ProjectTool | None:
    """Return the project's tool for a pose (4, 4) that a program of the cell ``home`` writes; None where none is.

    The controller computes with the pose as written. Of several tools the first: those that were measured otherwise
    are refused by `ambiguous_tool`.
    """
    names = _names_at(project, home, brand, name, flange_tip)
    tool = project.tools[names[0]] if names else None
    if tool is None:
        return None
    is_entered = not _are_apart(tool.entered, flange_tip)
    real = flange_tip if is_entered and not tool.measured else tool.real
    return replace(tool, entered=flange_tip, real=real)


def ambiguous_tool(project: Project, home: Project, program: ProgramFile, name: str | None) -> str:
    """Return why a position is left whose written tool is several of the project, or entered otherwise; or ""."""
    flange_tip = _written_pose(project, program, name, at_home=project is home)
    if name is None or flange_tip is None:
        return ""
    names = _names_at(project, home, program.brand, name, flange_tip)
    tips = [project.tools[each].real for each in names]
    sets_it = program.frames.sets_tools or is_written_out(name)
    if names and not sets_it and _are_apart(project.tools[names[0]].entered, flange_tip):
        return make_message(
            "the tool that the program was saved with ({tool}) is {name} in its own cell, which {project} has at "
            "another pose: make them one",
            tool=name,
            name=names[0],
            project=project.file_name,
        )
    if not any(_are_apart(tips[0], tip) for tip in tips[1:]):
        return ""
    return make_message(
        "the tool that the program writes ({tool}) is {names} of {project}, which were measured differently: "
        "keep the one that this program uses",
        tool=name,
        names=", ".join(names),
        project=project.file_name,
    )


def unmeasured_tools(
    points: ProgramPoints, start: int, result: ProgramResult, cells: Sequence[Project]
) -> Iterator[PointFinding]:
    """Yield a finding for each tool of a program that is none of a cell, where any cell's tools were measured.

    Nothing says where the tip of such a tool really is, so that its points may be off by as much as others' are. A
    move needs no tip: the flange goes along with the work. The rows of the program begin at ``start``; the first of
    the cells is that of the programs.
    """
    if not any(tool.measured for cell in cells for tool in cell.tools.values()):
        return
    program = result.before
    used: dict[str | None, int] = {}
    for row, status in enumerate(result.status):
        if status != LEFT and not points.held[start + row]:
            used.setdefault(points.tools[start + row], row)
    for cell in dict.fromkeys(cells):
        for name, row in used.items():
            flange_tip = _written_pose(cell, program, name, at_home=cell is cells[0])
            if name is None or flange_tip is None:
                continue
            if _names_at(cell, cells[0], program.brand, name, flange_tip):
                continue
            text = make_message(
                "tool {tool} of {program} is none of {project}: its tip is taken as the program writes it, and no "
                "measured tip counts there",
                tool=name,
                program=program.name,
                project=cell.file_name,
            )
            line = int(program.positions.lines[row])
            yield PointFinding(line, name, "TOOL", 0.0, math.nan, math.nan, text)


def _written_pose(project: Project, program: ProgramFile, name: str | None, *, at_home: bool) -> Array | None:
    """Return the pose (4, 4) that files bring for a tool which the project does not name, None where none is."""
    if name is None or entry_named(project.tools, name, program.brand) is not None:
        return None
    pose = entry_named(brought_frames(program, at_home=at_home)[0], name, program.brand)
    return None if pose is None else pose.to_matrix()


def _names_at(project: Project, home: Project, brand: str, name: str, flange_tip: Array) -> list[str]:
    """Return which tools a written pose may be: those that have it in the program's own cell, else in this one."""
    if brand not in _WITHOUT_TOOL_NAMES and not is_written_out(name):
        return []
    at_home = _alike_in(home, flange_tip)
    return [each for each in at_home if each in project.tools] or _alike_in(project, flange_tip)


def _alike_in(project: Project, flange_tip: Array) -> list[str]:
    return [name for name, tool in project.tools.items() if not _are_apart(tool.entered, flange_tip)]


def _are_apart(first: Array, second: Array) -> bool:
    apart, turned = same_place(first[None], second[None])
    return bool(apart[0] > ALIKE_M or turned[0] > ALIKE_RAD)
