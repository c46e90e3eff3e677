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


def alike(left: Any, right: Any) -> bool:
    """Compare two JSON values: numbers to 1e-9 relative, everything else exactly."""
    if isinstance(left, bool) or isinstance(right, bool):
        return left is right
    if isinstance(left, int | float) and isinstance(right, int | float):
        return math.isclose(left, right, rel_tol=FLOAT_RELATIVE, abs_tol=FLOAT_ABSOLUTE)
    if isinstance(left, list) and isinstance(right, list):
        return len(left) == len(right) and all(map(alike, left, right))
    if isinstance(left, dict) and isinstance(right, dict):
        return left.keys() == right.keys() and all(alike(left[key], right[key]) for key in left)
    return bool(left == right)
