"""Tools whose pose a program writes itself: which tool of the project such a pose is.

A URScript says ``set_tcp(p[0, 0, 0.15, 0, 0, 0])``: no name of the controller, only numbers. The measured tip of that
tool is in the project under the name that a person gave it, and is found by the pose that the controller has.
"""

from collections.abc import Iterator

import numpy as np

from cellcal.calibration.geometry import Array
from cellcal.calibration.message import make_message
from cellcal.calibration.programs.transfer import same_place
from cellcal.drivers.programs.positions import ProgramFile
from cellcal.service.engineering.programs.program_points import ProgramPoints
from cellcal.service.engineering.programs.project import Project
from cellcal.service.engineering.programs.project_poses import ProjectTool

ALIKE_M, ALIKE_RAD = 1e-5, np.radians(0.01)  # what a pendant shows of one pose and another
_NAMELESS = frozenset(("universal_robots",))  # brands whose programs write poses in place of names


def tool_at(project: Project, brand: str, flange_tip: Array) -> ProjectTool | None:
    """Return the project's tool that the controller has at a written pose (4, 4); None where there is none.

    Of several the first: those that were measured otherwise are refused by `ambiguous_tool`.
    """
    names = _names_at(project, brand, flange_tip)
    return project.tools[names[0]] if names else None


def ambiguous_tool(project: Project, program: ProgramFile, name: str | None) -> str:
    """Return why a position is left whose written tool is several of the project, measured differently; or ""."""
    own = program.frames.flange_tip.get(name or "")
    if own is None or name in project.tools:
        return ""
    names = _names_at(project, program.brand, own.to_matrix())
    tips = [project.tools[each].real for each in names]
    if not any(_are_apart(tips[0], tip) for tip in tips[1:]):
        return ""
    return make_message(
        "the tool that the program writes ({tool}) is {names} of {project}, which were measured differently: "
        "keep the one that this program uses",
        tool=name,
        names=", ".join(names),
        project=project.path.name,
    )


def unmeasured_tools(points: ProgramPoints, project: Project) -> Iterator[str]:
    """Yield a warning for each written tool that is none of a project in which tools were measured."""
    if not any(tool.measured for tool in project.tools.values()):
        return
    some = np.flatnonzero(~points.held).tolist()
    for name, which in dict.fromkeys((points.tools[i], int(points.of[i])) for i in some):
        program = points.programs[which]
        own = program.frames.flange_tip.get(name or "")
        if own is None or name in project.tools or _names_at(project, program.brand, own.to_matrix()):
            continue
        yield make_message(
            "tool {tool} of {program} is none of {project}: its tip is taken as the program writes it, and no "
            "measured tip counts there",
            tool=name,
            program=program.name,
            project=project.path.name,
        )


def _names_at(project: Project, brand: str, flange_tip: Array) -> list[str]:
    if brand not in _NAMELESS:
        return []
    return [name for name, tool in project.tools.items() if not _are_apart(tool.entered, flange_tip)]


def _are_apart(first: Array, second: Array) -> bool:
    apart, turned = same_place(first[None], second[None])
    return bool(apart[0] > ALIKE_M or turned[0] > ALIKE_RAD)
