"""One way to write a value down: canonical JSON, so that equal facts have equal hashes."""

import hashlib
import json
import math
from typing import Any

FLOAT_RELATIVE = 1e-9  # another BLAS may change the last bits of a fit
FLOAT_ABSOLUTE = 1e-12


def canonical_json(value: Any) -> str:
    """Return JSON with sorted keys, no blanks, shortest exact floats.

    Raises
    ------
    ValueError
        The value holds NaN or infinity: not a fact.
    """
    return json.dumps(value, sort_keys=True, separators=(",", ":"), ensure_ascii=False, allow_nan=False)


def sha256_of(value: Any) -> str:
    """Return the hexadecimal SHA-256 of the canonical JSON of a value."""
    return hashlib.sha256(canonical_json(value).encode()).hexdigest()


def is_alike(first: Any, second: Any) -> bool:
    """Compare two JSON values: numbers to 1e-9 relative, everything else exactly."""
    if isinstance(first, bool) or isinstance(second, bool):
        return first is second
    if isinstance(first, int | float) and isinstance(second, int | float):
        return math.isclose(first, second, rel_tol=FLOAT_RELATIVE, abs_tol=FLOAT_ABSOLUTE)
    if isinstance(first, list) and isinstance(second, list):
        return len(first) == len(second) and all(map(is_alike, first, second))
    if isinstance(first, dict) and isinstance(second, dict):
        return first.keys() == second.keys() and all(is_alike(first[key], second[key]) for key in first)
    return bool(first == second)
