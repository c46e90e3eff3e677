"""What `cellcal parameters` prints: a set that was saved, changes between sets, notes."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from cellcal.service.engineering.parameters.parameter_set import ParameterSet
    from cellcal.service.engineering.parameters.parameter_sets import ParameterChange


def print_saved_set(saved: "ParameterSet", notes: Sequence[str], *, as_json: bool) -> int:
    """Print which version of which robot was saved, and return the exit code."""
    from cellcal.service.cli.printing import print_json

    if as_json:
        print_json({**set_head_to_json(saved), "notes": list(notes)})
    else:
        print_with_notes(f"robot {saved.robot_serial}: version {saved.version} saved", notes)
    return 0


def print_with_notes(line: str, notes: Sequence[str]) -> None:
    """Print a line and its notes to standard error; no mark-up in them is obeyed."""
    from cellcal.service.cli.printing import STDERR_CONSOLE

    for text in (line, *(f"note: {note}" for note in notes)):
        STDERR_CONSOLE.print(text, markup=False, soft_wrap=True)


def set_head_to_json(item: "ParameterSet") -> dict[str, object]:
    """Return a set without its values as JSON."""
    keys = (
        "robot_serial", "version", "model", "made_at", "made_by", "source", "note",
        "rolls_back_to", "factory_hash", "sha256",
    )  # fmt: skip
    return {key: getattr(item, key) for key in keys}


def change_to_json(change: "ParameterChange") -> dict[str, object]:
    """Return a parameter's change between two sets as JSON, in SI units."""
    values = {
        key: None if value is None else value.value
        for key, value in (("before", change.before), ("after", change.after))
    }
    return {
        "name": change.name, "unit": change.unit, **values,
        "difference": change.value_difference, "deviations": change.difference_in_sigmas,
        "determined": change.is_determined,
    }  # fmt: skip


def number_or_dash(value: float | None, scale: float) -> str:
    """Return a value times ``scale`` with five decimals, "-" where there is none."""
    return "-" if value is None else f"{value * scale:.5f}"
