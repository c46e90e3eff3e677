"""Words of headings that more than one search for columns needs, and columns that differ by an axis only."""

import re
from collections.abc import Mapping, Sequence

CONTROLLER_WORDS = {
    "goal", "cmd", "command", "commanded", "nominal", "nom", "set", "setpoint", "desired", "target", "robot",
    "controller", "tcp", "flange", "ctrl", "reported", "planned", "program", "programmed", "ref", "reference",
    "fk", "theoretical", "theo", "cad", "model", "ideal", "expected", "design", "robtarget",
}  # fmt: skip
SPREAD_WORDS = {
    "std", "sigma", "sd", "stdev", "stddev", "uncertainty", "unc", "rms", "var", "error", "err", "residual",
    "u", "u95", "mpe", "variance", "precision",
}  # fmt: skip
DIFFERENCE_WORDS = {
    "delta", "dev", "deviation", "deviations", "dif", "diff", "difference", "differences", "offset", "correction",
    "corr", "tol", "tolerance", "tolplus", "tolminus", "min", "max", "upper", "lower", "range", "velocity", "vel",
    "speed", "acceleration", "acc", "force", "torque", "test", "out", "d",
}  # fmt: skip
ATTITUDE_WORDS = {
    "rot", "rotation", "orientation", "ori", "orient", "quat", "quaternion", "q", "attitude", "euler", "normal",
    "angle", "rotvec", "rpy", "normalised", "direction", "vector", "vec",
}  # fmt: skip

_JOINED_PREFIXES = "pos|p|t|m|meas|act|cmd|nom|ref|real"  # Mx, measX
_JOINED_SUFFIXES = (
    "pos|act|actual|cmd|meas|measured|nom|nominal|ref|real|mm|cm|inch|[a-dmrt]"  # Xact, xmm, Xa
)


def find_triples(
    names: Sequence[str], plain: Mapping[str, str], axes: Sequence[str]
) -> dict[tuple[str, str], tuple[str, ...]]:
    """Return the columns that spell one word for each of the axes, by what surrounds it.

    Words may be glued to the axis. Columns such as Mx, My, Mz are moments where forces Fx, Fy, Fz stand beside them.
    """
    has_forces = {"fx", "fy", "fz"} <= {plain[name] for name in names}
    families: dict[tuple[str, str], dict[str, str]] = {}
    for name in names:
        for axis in axes:
            match = re.match(
                rf"^(?P<before>(?:.*_)?(?:{_JOINED_PREFIXES})?){axis}"
                rf"(?P<after>(?:{_JOINED_SUFFIXES})?\d*(?:_.*)?)$",
                plain[name],
            )
            if match and not (has_forces and match["before"].endswith("m")):
                families.setdefault((match["before"], match["after"]), {}).setdefault(axis, name)
    return {
        key: tuple(found[axis] for axis in axes) for key, found in families.items() if len(found) == len(axes)
    }


def key_words(key: tuple[str, str]) -> set[str]:
    """Return the words that surround an axis in a heading."""
    return set(re.split(r"[_\d]+", "_".join(key))) - {""}
