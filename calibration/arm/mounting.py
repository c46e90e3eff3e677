"""How a robot is mounted: where gravity pulls, seen from its base."""

import math

from cellcal.calibration.errors import CalibrationError

MOUNTED = "@"  # between a model's name and its mounting
DESCRIPTIONS, MODEL_FILES = (".urdf", ".xml", ".xacro"), (".toml",)
FILE_ENDINGS = (*DESCRIPTIONS, *MODEL_FILES)
Direction = tuple[float, float, float]

FLOOR: Direction = (0.0, 0.0, -1.0)
# On a wall the base's x points up, away from the pull: the usual way that makers draw it.
_NAMED: dict[str, Direction] = {"floor": FLOOR, "ceiling": (0.0, 0.0, 1.0), "wall": (-1.0, 0.0, 0.0)}
_TILT = {"x": 0, "y": 1}
_SHORTEST = 1e-6


def gravity_of(mounting: str) -> Direction:
    """Return the unit vector of gravity in a robot's base.

    ``floor``; ``ceiling``; ``wall`` (the base's x points up); ``tilt:x=30`` or ``tilt:y=-15`` (the base is turned by
    so many degrees about its own x or y, from the floor); or the vector itself, ``0,-1,0``.

    Raises
    ------
    CalibrationError
        None of these, or numbers that are not finite.
    """
    text = mounting.strip().lower()
    if text in _NAMED:
        return _NAMED[text]
    try:
        found = (
            _tilted_gravity(text.removeprefix("tilt:")) if text.startswith("tilt:") else _parse_vector(text)
        )
    except (ValueError, KeyError) as broken:
        raise _unknown_mounting_error(mounting) from broken
    length = math.hypot(*found)
    if not (math.isfinite(length) and length > _SHORTEST):
        raise _unknown_mounting_error(mounting)
    return found[0] / length, found[1] / length, found[2] / length


def mounted_name(model: str, mounting: str) -> str:
    """Return the name of a model that is mounted in some way; without one, the name as it is.

    Raises
    ------
    CalibrationError
        No such mounting, or the name has another one already.
    """
    if not mounting:
        return model
    gravity_of(mounting)
    named = split_mounting(model)[1]
    if named.strip().lower() == mounting.strip().lower():  # a cure that was copied beside the option
        return model
    if named:
        raise CalibrationError(
            f"{model} says how it is mounted, and {mounting} was asked for.",
            remedy="Leave one of the two out.",
            code="usage",
        )
    return f"{model}{MOUNTED}{mounting.strip().lower()}"


def split_mounting(name: str) -> tuple[str, str]:
    """Return a model's name and what stands behind its last ``@``, unless that belongs to the path of a file."""
    head, at, mounting = name.rpartition(MOUNTED)
    if not at or any(mark in mounting for mark in "/\\?") or mounting.lower().endswith(FILE_ENDINGS):
        return name, ""
    return head, mounting


def _tilted_gravity(text: str) -> Direction:
    axis, angle = text.split("=")
    turn = math.radians(float(angle))
    if not math.isfinite(turn):
        raise ValueError(angle)
    # Seen from a base that turns one way, gravity turns the other way.
    if _TILT[axis.strip()] == 0:
        return 0.0, -math.sin(turn), -math.cos(turn)
    return math.sin(turn), 0.0, -math.cos(turn)


def _parse_vector(text: str) -> Direction:
    x, y, z = (float(word) for word in text.split(","))
    return x, y, z


def _unknown_mounting_error(mounting: str) -> CalibrationError:
    return CalibrationError(
        f"{mounting!r} is no mounting.",
        remedy="Write floor, wall (the base's x points up), ceiling, tilt:x=30, tilt:y=-15 (degrees), or the "
        "direction of gravity in the robot's base such as 0,-1,0.",
        code="usage",
    )
