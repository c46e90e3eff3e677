"""Changes of which a program cannot take every point: the others are made, and each such point has its reason."""

from collections.abc import Callable

from cellcal.drivers.program_registry import change_programs
from cellcal.drivers.programs.errors import ProgramFileError
from cellcal.drivers.programs.positions import PositionChange, ProgramFile
from cellcal.service.engineering.programs.program_points import Rows

_MOST = 64  # points found one by one; where more do not fit, the file itself is what does not
_PLACE = ": "


def change_what_fits(
    program: ProgramFile, rows: Rows, change_of: Callable[[Rows], PositionChange]
) -> tuple[ProgramFile, dict[int, str]]:
    """Return a program with a change of all rows that it can take, and why by row for those that it cannot.

    Raises
    ------
    ProgramFileError
        More rows do not fit than single points would explain.
    """
    try:
        return change_programs([program], [change_of(rows)])[0], {}
    except ProgramFileError as error:
        if len(rows) == 1:
            return program, {int(rows[0]): _error_reason(error)}
    refused: dict[int, str] = {}
    waiting = [rows]
    while waiting:
        some = waiting.pop()
        why = _change_refusal(program, some, change_of)
        if why is not None and len(some) == 1:
            refused[int(some[0])] = _error_reason(why)
            if len(refused) > _MOST:
                raise why
        elif why is not None:
            middle = len(some) // 2
            waiting += [some[middle:], some[:middle]]
    fitting = rows[[row not in refused for row in rows.tolist()]]
    if not len(fitting):
        return program, refused
    return change_programs([program], [change_of(fitting)])[0], refused


def _change_refusal(
    program: ProgramFile, rows: Rows, change_of: Callable[[Rows], PositionChange]
) -> ProgramFileError | None:
    try:
        change_programs([program], [change_of(rows)])
    except ProgramFileError as error:
        return error
    return None


def _error_reason(error: ProgramFileError) -> str:
    """Return the error without its place: the report names program, point and line."""
    return error.message.partition(_PLACE)[2].rstrip(".")
