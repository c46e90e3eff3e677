"""Tools and frames that a file holds for others, and that a clone's cell has otherwise: they are copied as is."""

from collections.abc import Iterator
from dataclasses import replace

from cellcal.calibration.message import make_message
from cellcal.service.engineering.programs.cell_of_program import find_contradiction
from cellcal.service.engineering.programs.project import Project
from cellcal.service.engineering.programs.result import ProgramResult

_HELD = (
    "it holds {what} {name} as the master has it, and {project} has another: do not load this file, or enter the "
    "clone's value in it"
)


def warn_of_held_frames(result: ProgramResult, clone: Project) -> ProgramResult:
    """Return a clone's result with a warning for each tool and frame that its file holds and the clone has otherwise.

    Those that the file's own points name leave these points already.
    """
    more = tuple(_held_otherwise(result, clone))
    return replace(result, warnings=(*result.warnings, *more)) if more else result


def _held_otherwise(result: ProgramResult, clone: Project) -> Iterator[str]:
    program = result.before
    used_tools, used_frames = set(program.positions.tools), set(program.positions.user_frames)
    for name in sorted(program.frames.flange_tip.keys() - used_tools):
        if find_contradiction(clone, program, name, "", at_home=False):
            yield make_message(_HELD, what="tool", name=name, project=clone.file_name)
    for name in sorted(program.frames.base_frame.keys() - used_frames):
        if find_contradiction(clone, program, "", name, at_home=False):
            yield make_message(_HELD, what="user frame", name=name, project=clone.file_name)
