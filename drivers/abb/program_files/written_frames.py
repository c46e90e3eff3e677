"""Tools and work objects of RAPID in numbers: where they are, and the name that moves have for them."""

import re
from collections.abc import Mapping

from cellcal.calibration.geometry import Pose
from cellcal.drivers.abb.program_files.collected_positions import pose_of
from cellcal.drivers.abb.program_files.literals import AGGREGATES, W

NUMBERS = "=[["  # between a name and its numbers
_BEHIND = re.compile(rf"{W}[\\,;]")
PARTS = {  # of the kinds, what is in it that says where a tool or a frame is
    "tooldata": ("tframe.trans", "tframe.rot"),
    "wobjdata": ("uframe.trans", "uframe.rot", "oframe.trans", "oframe.rot"),
}
# All of a tool or a work object but the tool's load.
PARTS_THAT_COUNT = ("uframe", "oframe", "tframe", "robhold", "ufprog", "ufmec")


def name_of_numbers(numbers: Mapping[str, tuple[str, ...]]) -> str:
    """Return numbers as they stand in a name: alike, however they are written."""
    parts = (
        ",".join(repr(float(text) + 0.0).removesuffix(".0") for text in some) for some in numbers.values()
    )
    return f"[{','.join(f'[{part}]' for part in parts)}]"


def poses_of_numbers(numbers: Mapping[str, tuple[str, ...]], parts: tuple[str, ...]) -> list[Pose | None]:
    """Return the poses of the parts, place and turn by turn; None for one that is none."""
    return [
        pose_of((*numbers[trans], *numbers[rot])) for trans, rot in zip(parts[::2], parts[1::2], strict=True)
    ]


def standing_numbers(kind: str, found: re.Match[str]) -> dict[str, tuple[str, ...]] | None:
    """Return the numbers of a tool at the flange, or of a work object that stands in the cell; None for others."""
    values = found.groups()
    if kind == "tooldata":
        places = {"tframe.trans": values[1:4], "tframe.rot": values[4:8]}
        return places if values[0].upper() == "TRUE" else None
    stands = values[0].upper() == "FALSE" and values[1].upper() == "TRUE"
    places = {
        "uframe.trans": values[3:6],
        "uframe.rot": values[6:10],
        "oframe.trans": values[10:13],
        "oframe.rot": values[13:17],
    }
    return places if stands else None


def written_work_object(text: str, place: int) -> tuple[str | None, Pose | None]:
    """Return the name and pose of a work object that a move writes out; None where it is none that stands."""
    found = AGGREGATES["wobjdata"].pattern.match(text, place)
    numbers = (
        None if found is None or not _BEHIND.match(text, found.end()) else standing_numbers("wobjdata", found)
    )
    if numbers is None:
        return None, None
    user, inner = poses_of_numbers(numbers, PARTS["wobjdata"])
    return (
        (None, None)
        if user is None or inner is None
        else (f"wobjdata={name_of_numbers(numbers)}", user @ inner)
    )
