"""Axes of a motion group that follow those of the arm and do not turn: a rail as axis 7 of a robot on a track."""

from dataclasses import dataclass

from cellcal.drivers.fanuc.program_files.va_spots import parse_integer, parse_real
from cellcal.drivers.fanuc.program_files.va_text import VaVariable

_MOST_AXES = 9


@dataclass(frozen=True, slots=True)
class FurtherAxis:
    """An axis that no record has: its count at zero and its state."""

    axis: int
    count_at_zero: int
    state: int


def read_further_axes(
    drives: VaVariable, data: VaVariable, group: int, after: int
) -> tuple[FurtherAxis, ...]:
    """Return the axes behind the first ``after`` ones that have a scale, with what $DMR_GRP says of them."""
    found = []
    for axis in range(after + 1, _MOST_AXES + 1):
        scale = drives.values.get(f"$PARAM_GROUP[{group}].$ENCSCALES[{axis}]")
        names = (f"$DMR_GRP[{group}].${name}[{axis}]" for name in ("MASTER_COUN", "EACHMST_DON"))
        count, state = (data.values.get(name) for name in names)
        if scale is None or not scale.is_initialised or parse_real(drives.file, scale) == 0:
            break
        if count is not None and count.is_initialised and state is not None and state.is_initialised:
            found.append(FurtherAxis(axis, parse_integer(data.file, count), parse_integer(data.file, state)))
    return tuple(found)
