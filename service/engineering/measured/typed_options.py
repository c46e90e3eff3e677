"""Options of reading; those that name nothing are refused, for a word that is passed over looks followed."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from cellcal.calibration.message import make_message
from cellcal.service.engineering.measured.attitudes import refuse_unknown_convention
from cellcal.service.engineering.measured.columns import TableLayout
from cellcal.service.engineering.measured.table import MeasurementError

_UNITS = ("joints", "slides", "position", "rotation", "length", "controller")


@dataclass(frozen=True, slots=True)
class ReadOptions:
    """Options that override what would be detected in a file."""

    columns: Mapping[str, Sequence[str]] = field(default_factory=dict)
    units: Mapping[str, str] = field(default_factory=dict)  # by their meanings, of `refuse_unknown_options`
    convention: str = ""  # of the measured attitude; "none" leaves it out
    sheet: str | None = None
    joint_coupling: str = ""  # "controller", or "geometric": every angle is turned against the link before
    joints_file: Path | None = None  # that holds the joints, where readings stand alone
    of_another_file: bool = False  # which may have columns that this one lacks


def refuse_unknown_options(units: Mapping[str, str], convention: str) -> None:
    """Refuse a unit of something that is no part of a table, and an attitude that is written in no known way.

    Raises
    ------
    MeasurementError
        With what is known.
    """
    unknown = [meaning for meaning in units if meaning not in _UNITS]
    if unknown:
        raise MeasurementError(
            make_message("--units knows no {meaning!r}.", meaning=unknown[0]),
            remedy=make_message("It knows {meanings}.", meanings=", ".join(_UNITS)),
        )
    refuse_unknown_convention(convention)


def refuse_idle_words(options: ReadOptions, used: Mapping[str, str], layout: TableLayout) -> None:
    """Refuse units and a convention of what a file does not have: who typed them takes its columns for others.

    Raises
    ------
    MeasurementError
        With the first of them, and the columns that were read.
    """
    if options.of_another_file:
        return
    idle = [f"--units {meaning}={unit}" for meaning, unit in options.units.items() if meaning not in used]
    if options.convention not in ("", "none") and not layout.turn:
        idle.append(f"--convention {options.convention}")
    if idle:
        read = (*layout.joints, *layout.position, *layout.turn, layout.length, *layout.controller)
        raise MeasurementError(
            make_message(
                "`{option}` has no effect: the file is read by columns {columns}.",
                option=idle[0],
                columns=", ".join(filter(None, read)),
            ),
            remedy="Leave it out, or name the columns that it is about (`--columns`).",
        )
