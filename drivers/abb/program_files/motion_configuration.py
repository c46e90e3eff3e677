"""Where the robots of an ABB controller stand in its world, by the lists of its backup.

RAPID's work objects, ``wobj0`` too, stand in the world; the arm begins at its base frame, which is the world's only
where nothing else is configured: a robot that hangs or stands on a pedestal has another one.
"""

import re
from pathlib import PurePath

import numpy as np

from cellcal.calibration.geometry import Pose
from cellcal.drivers.programs.controller_tasks import find_task
from cellcal.drivers.programs.declared_poses import Poses
from cellcal.drivers.programs.errors import ProgramFileError
from cellcal.drivers.programs.file_declarations import ExternalUses, FileDeclarations
from cellcal.drivers.programs.spans import ProgramText

LISTS = (
    PurePath("SYSPAR") / "MOC.cfg",  # in a backup, beside its RAPID folder: the robots
    PurePath("BACKINFO") / "backinfo.txt",  # the tasks in the folders TASK1, TASK2 …
)
_BASE_FRAME = (
    "$base frame"  # among the bases that it declares; with the robot's number where there are several
)
_ROBOTS = re.compile(r"^ROBOT:[ \t\r]*\n(.*?)(?=^#|\Z)", re.MULTILINE | re.DOTALL)
_TASKS = re.compile(r"^>>(TASK\d+): ?\(([^,()\s]+),", re.MULTILINE | re.IGNORECASE)
_BACKED_UP = ">>SYSTEM_ID:"
_NAME = re.compile(r'-name\s+"([^"]*)"')
_ENTRY = re.compile(r'-name\s+"[^"]*"(?:(?!-name\s)[^"]|"[^"]*")*')
_PART = re.compile(
    r"-base_frame_(pos_[xyz]|orient_u[0-3])\s+([-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?)(?=\s|\\|$)"
)
_CARRIED = re.compile(r"-base_frame_coordinated\b")
_OWN_PART = re.compile(r"(?:ROB|TASK)_?(\w+)$", re.IGNORECASE)
_ORIGIN = Pose((0.0, 0.0, 0.0))
UNKNOWN_ROBOT = (
    "its controller has several robots in its world, and no folder tells which of them moves there"
)
_UNIT = 1e-3


def declarations_of(name: str, data: bytes) -> FileDeclarations | None:
    """Return the base frames of the robots, m, or the tasks of a backup; None for another file.

    A robot that a track carries has no base frame.
    """
    suffix = PurePath(name).suffix.lower()
    if (suffix != ".cfg" or not data.startswith(b"MOC:")) and suffix != ".txt":
        return None
    try:
        text = ProgramText(name, data).text
    except ProgramFileError:
        return None
    if suffix == ".txt":
        folder = PurePath(name).parent.parent
        tasks = _TASKS.findall(text) if _BACKED_UP in text else ()
        return FileDeclarations("", doubtful={_task_key(folder, number): task for number, task in tasks})
    entries = [entry for section in _ROBOTS.findall(text) for entry in _ENTRY.findall(section)]
    poses: Poses = {_key(entry if len(entries) > 1 else ""): _base_frame(entry) for entry in entries}
    return FileDeclarations("", bases=poses)


def base_frame_of(module: ExternalUses) -> Pose | None:
    """Return where the robot of a module stands in the world; None where that is its origin, or not known."""
    found = module.bases.get(_BASE_FRAME) or module.bases.get(_key_of_task(module))
    return None if found == _ORIGIN else found


def is_of_unknown_robot(module: ExternalUses) -> bool:
    """Return whether a controller has robots at other places, and no folder tells which of them a module moves."""
    poses = {key: pose for key, pose in module.bases.items() if key.startswith(f"{_BASE_FRAME} ")}
    elsewhere = any(pose is not None and pose != _ORIGIN for pose in poses.values())
    return elsewhere and _key_of_task(module) not in poses


def _key_of_task(module: ExternalUses) -> str:
    """Return the key of the robot that a module moves by the task in whose folder it is; "" where none tells."""
    task = find_task(module.file)
    if task is None:
        return ""
    return _numbered(module.doubtful.get(_task_key(PurePath(task.folder).parent, task.name), task.name))


def _task_key(backup: PurePath, folder: str) -> str:
    return f"{backup} task {folder.upper()}"


def _key(entry: str) -> str:
    name = _NAME.search(entry)
    return _numbered(name[1]) if name is not None else _BASE_FRAME


def _numbered(name: str) -> str:
    """Return the key of a robot or its task: ROB_1, T_ROB1 and TASK1 are one, as are ROB_L and T_ROB_L."""
    own = _OWN_PART.search(name)
    return f"{_BASE_FRAME} {(own[1] if own is not None else name).lower()}"


def _base_frame(entry: str) -> Pose | None:
    if _CARRIED.search(entry) is not None:
        return None
    parts = {name: float(number) for name, number in _PART.findall(entry)}
    place = tuple(parts.get(f"pos_{axis}", 0.0) for axis in "xyz")
    turn = np.array([parts.get(f"orient_u{n}", 1.0 if n == 0 else 0.0) for n in range(4)])
    length = float(np.linalg.norm(turn))
    if abs(length - 1.0) > _UNIT:
        return None
    w, x, y, z = (turn / length).tolist()
    return Pose((place[0], place[1], place[2]), (w, x, y, z))
