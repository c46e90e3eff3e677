"""How the work moved, as it is said on the command line."""

from pathlib import Path
from typing import TYPE_CHECKING

from cellcal.calibration.documents import DocumentError
from cellcal.calibration.documents.plain_files import describe_unreadable, read_plain_text
from cellcal.calibration.errors import CellError
from cellcal.calibration.message import join_messages, make_message

if TYPE_CHECKING:
    from cellcal.calibration.geometry import Array
    from cellcal.calibration.points.alignment import Alignment
    from cellcal.service.engineering.programs.project import Project


class MoveError(CellError):
    """The arguments do not tell how the work moved."""

    code = "usage"


def base_change_of(
    cell: "Project", offset: str | None, frame: str | None, alignments: tuple[Path | None, Path | None]
) -> "Array":
    """Return the move (4, 4) in the robot's base from an offset or from two alignments of a fixture.

    Raises
    ------
    CellError
        Neither, both, or numbers and files that are not what they should be.
    """
    from cellcal.service.engineering.programs.move import change_at_zero, change_between, change_of_frame

    before, after = alignments
    if (offset is None) == (before is None) or (before is None) != (after is None):
        raise MoveError(
            "It is not clear how the work moved.",
            remedy="Give --offset x,y,z,w,p,r, or the fixture's alignments with --from and --to.",
        )
    if before is not None and after is not None:
        return change_at_zero(
            cell, change_between(_read_alignment(before, cell), _read_alignment(after, cell))
        )
    moved = offset_of(offset or "")
    if frame is None:
        return moved
    return change_of_frame(cell.frame_named(frame), moved)


def offset_of(text: str) -> "Array":
    """Return (4, 4) of ``x,y,z`` in mm, or with turns about the fixed x, y and z axes in degrees.

    Raises
    ------
    MoveError
        Not three or six finite numbers.
    """
    import numpy as np

    from cellcal.calibration.geometry import homogeneous_matrix
    from cellcal.calibration.orientation import rotation_from

    try:
        numbers = np.array([float(part) for part in text.split(",")])
    except ValueError:
        numbers = np.empty(0)
    if len(numbers) not in (3, 6) or not np.isfinite(numbers).all():
        raise MoveError(
            f"--offset {text!r} is not three or six numbers.",
            remedy="Write x,y,z in mm or x,y,z,w,p,r in mm and degrees: --offset=-12.5,0,3,0,0,1.5",
        )
    turned = numbers[3:] if len(numbers) == 6 else np.zeros(3)
    return homogeneous_matrix(rotation_from("fanuc_wpr", np.deg2rad(turned)), numbers[:3] / 1e3)


def print_frame_instead(cell: "Project", frame: str, base_change: "Array") -> None:
    """Say what could be entered into the controller instead, so that programs stay as they are."""
    from cellcal.service.cli.printing import STDERR_CONSOLE
    from cellcal.service.engineering.programs.move import instead_of_moving

    if advice := instead_of_moving(cell, frame, base_change):
        STDERR_CONSOLE.print(advice, markup=False)


def _read_alignment(path: Path, cell: "Project") -> "Alignment":
    from cellcal.calibration.points.alignment import read_alignments

    try:
        found = read_alignments(read_plain_text(path))
    except (OSError, DocumentError) as broken:
        raise MoveError(
            describe_unreadable(path, broken),
            remedy="Give an alignment file.",
        ) from broken
    name = None if cell.alignment is None else cell.alignment.fixture
    mine = [one for one in found if one.robot_serial == cell.serial and name in (None, one.fixture)]
    if len(mine) != 1:
        there = join_messages(
            "; ",
            (
                make_message("{fixture} from robot {serial}", fixture=one.fixture, serial=one.robot_serial)
                for one in found
            ),
        )
        raise MoveError(
            f"{path} holds {len(mine)} alignments of this cell's fixture by robot {cell.serial}: "
            f"{there or 'nothing'}.",
            remedy="Give the file of one fixture, measured by this robot (`cellcal alignments export`).",
        )
    return mine[0]
