"""Tasks of one controller in the folders of a backup: where two of them move, they may move two robots."""

import re
from collections.abc import Set
from pathlib import PurePath
from typing import NamedTuple

_TASK = re.compile(
    r"TASK\d+|T_ROB_?[LR\d]\d*", re.IGNORECASE
)  # of a backup, and as the controller names them


class ControllerTask(NamedTuple):
    """A task: the folder that holds it, and its name."""

    folder: str
    name: str


def find_task(file: str) -> ControllerTask | None:
    """Return the task whose folder a file is in; None where no folder of its path is one."""
    parts = PurePath(file).parent.parts
    at = next((at for at in reversed(range(len(parts))) if _TASK.fullmatch(parts[at])), None)
    return None if at is None else ControllerTask(str(PurePath(*parts[:at])), parts[at])


def other_moving_task(file: str, moving: Set[ControllerTask]) -> str:
    """Return another task of a file's controller that moves; "" where its own is the only one, or does not move."""
    own = find_task(file)
    if own is None or own not in moving:
        return ""
    return min((task.name for task in moving if task.folder == own.folder and task != own), default="")


def is_of_other_task(file: str, other: str) -> bool:
    """Return whether another file is of another task of a file's controller.

    A task may have any name: a folder beside one that is a task's is one, too.
    """
    own, its = find_task(file), find_task(other)
    if own is not None and its is not None:
        return own.folder == its.folder and own != its
    task, beside = (own, other) if own is not None else (its, file)
    return task is not None and PurePath(task.folder) in PurePath(beside).parent.parents
