"""The argument that names a robot, completed by the shell from what ships."""

from typing import Annotated

from cyclopts import Parameter
from cyclopts.completion import CompletionContext

_MOST = 60


def complete_robot(context: CompletionContext) -> dict[str, str]:
    """Return names of robots that begin as the word does; where none does, those that it finds."""
    from cellcal.calibration.arm.robot_models.catalogue_index import catalogue_entries, find_robots

    word = context.incomplete
    usable = [entry for entry in catalogue_entries() if entry.usable]
    begun = [entry for entry in usable if entry.name.startswith(word)]
    found = begun or [entry for entry in find_robots(word) if entry.usable]
    return {entry.name: entry.title for entry in found[:_MOST]}


ModelArgument = Annotated[str, Parameter(completer=complete_robot)]
