"""What a result concludes, without what doing a step twice may honestly change."""

from typing import Any

TWICE_IS_DIFFERENT = ("power cycle", "wait for the robot", "turn J")


def comparable_result(result: dict[str, Any]) -> dict[str, Any]:
    """Return a recovery's result as JSON without the figures that an interrupted waking changes.

    A power cycle done twice counts two epochs. A motor whose way past its index was cut short is sent there
    again and comes back a turn further on, so that lengths are then measured elsewhere: the figures behind
    the checks differ, what they say does not.
    """
    gate = [(check["name"], check["passed"]) for check in result["gate"]]
    record = result["record"] | {"epoch": 0, "sha256": ""}
    there = {name: result[name] is not None for name in ("flanks", "drawn")}
    return result | there | {"robot_seconds": 0.0, "gate": gate, "record": record}


def has_same_result(found: dict[str, Any], expected: dict[str, Any], interrupted: str) -> bool:
    """Tell whether a resumed run ended as the undisturbed one did; to the last digit where nothing was done twice."""
    if interrupted.startswith(TWICE_IS_DIFFERENT):
        return comparable_result(found) == comparable_result(expected)
    return found == expected
