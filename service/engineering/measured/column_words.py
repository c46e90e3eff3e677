"""Words of headings that more than one search for columns needs, and columns that differ by an axis only."""

import re
from collections.abc import Mapping, Sequence

CONTROLLER_WORDS = {
    "goal", "cmd", "command", "commanded", "nominal", "nom", "set", "setpoint", "desired", "target", "robot",
    "controller", "tcp", "flange", "ctrl", "reported", "planned", "program", "programmed", "ref", "reference",
    "fk", "theoretical", "theo", "cad", "model", "ideal", "expected", "design",
}  # fmt: skip
SPREAD_WORDS = {
    "std", "sigma", "sd", "stdev", "stddev", "uncertainty", "unc", "rms", "var", "error", "err", "residual",
    "u", "u95", "mpe", "variance", "precision",
}  # fmt: skip


def find_triples(
    names: Sequence[str], plain: Mapping[str, str], axes: Sequence[str]
) -> dict[tuple[str, str], tuple[str, ...]]:
    """Return the columns that spell one word for each of the axes, by what surrounds it."""
    families: dict[tuple[str, str], dict[str, str]] = {}
    for name in names:
        for axis in axes:
            match = re.match(rf"^(?P<before>(?:.*_)?(?:pos|p|t)?){axis}(?P<after>\d*(?:_.*)?)$", plain[name])
            if match:
                families.setdefault((match["before"], match["after"]), {}).setdefault(axis, name)
    return {
        key: tuple(found[axis] for axis in axes) for key, found in families.items() if len(found) == len(axes)
    }
