"""What no arm can be at, in whatever protocol: finite numbers that would be taken for readings."""

import math
from collections.abc import Iterable

from cellcal.calibration.geometry import Pose
from cellcal.calibration.message import make_message
from cellcal.drivers.errors import RefusedError, WireProtocolError

_MOST_OF_JOINT = 2000.0  # rad, 318 turns of an axis that turns without an end; or m
_MOST_M = 1000.0  # of a place, tracks included
_MOST_KG = 1e5
_ROUNDING = 1e-6  # of a share that is told with single precision
_LOOK = "Compare with what the pendant shows; where that is right, report this with the log of the wire."
_BY_PENDANT = "Set the speed override at the pendant anew."


def are_possible_joints(joints: Iterable[float]) -> bool:
    """Return whether an arm can stand at these angles [rad] or places [m]; not where one is no number."""
    return all(abs(value) <= _MOST_OF_JOINT for value in joints)


def check_joints(device: str, joints: tuple[float, ...]) -> tuple[float, ...]:
    """Return joints [rad or m]; raise WireProtocolError where no axis can stand there."""
    if are_possible_joints(joints):
        return joints
    axis = next(axis for axis, value in enumerate(joints, 1) if not are_possible_joints((value,)))
    raise WireProtocolError(
        device,
        make_message(
            "it tells {value:.4g} of axis {axis} (rad or m), where no axis can stand.",
            value=joints[axis - 1],
            axis=axis,
        ),
        remedy=_LOOK,
    )


def check_pose(device: str, pose: Pose) -> Pose:
    """Return a pose; raise WireProtocolError where no arm reaches that far."""
    farthest_m = max(map(abs, pose.position_m))
    if farthest_m <= _MOST_M:  # not where it is no number
        return pose
    raise WireProtocolError(
        device,
        make_message("it tells a place {farthest_m:.4g} m away.", farthest_m=farthest_m),
        remedy=_LOOK,
    )


def check_mass(device: str, mass_kg: float) -> float:
    """Return the mass of a load; raise WireProtocolError where no robot carries it."""
    if abs(mass_kg) <= _MOST_KG:
        return mass_kg
    raise WireProtocolError(
        device, make_message("it tells a load of {mass_kg:.4g} kg.", mass_kg=mass_kg), remedy=_LOOK
    )


def check_override(device: str, share: float) -> float:
    """Return a speed override as a share; raise RefusedError outside 0 to 1."""
    if -_ROUNDING <= share <= 1.0 + _ROUNDING:
        return min(max(share, 0.0), 1.0)
    percent = share * 100.0 if math.isfinite(share) else share
    raise RefusedError(
        device,
        make_message(
            "the controller shows a speed override of {percent:.4g} %, outside 0 to 100.", percent=percent
        ),
        remedy=_BY_PENDANT,
    )
