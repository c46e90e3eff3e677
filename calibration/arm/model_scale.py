"""Whether the numbers of a model can be in the units of its file: no arm is a kilometre long, or a millimetre.

Millimetres in a description, or metres in a model file, give an arm that computes without complaint. So do degrees
where radians are due, and the reverse.
"""

import math
from dataclasses import dataclass

import numpy as np

from cellcal.calibration.arm.robot_model import RobotModel
from cellcal.calibration.errors import CalibrationError
from cellcal.calibration.geometry import Array

_LONGEST_M = 50.0  # from the first joint to the flange
_SHORTEST_M = 0.02
_FARTHEST_M = 200.0  # from the base to the first joint
_LONG_TRAVEL_M = 20.0  # tracks may be longer; such a travel is compared with the arm
_TRAVEL_BY_ARM = 40.0  # times the arm: a stroke of 200 mm that is written as 200 m is beyond
_MANY_TURNS_RAD = 4.5 * 2.0 * math.pi  # one wrist may turn so far, but not half of the joints
_LITTLE_RAD = math.radians(7.5)
_FEWEST_JOINTS = 3  # of fewer, a positioner's, neither size nor range tells
_RIGHT_ANGLES = (math.pi / 2.0, math.pi)
_EQUAL = 1e-3


@dataclass(frozen=True, slots=True)
class FileUnits:
    """The units that a file's format states, for the cures."""

    lengths: str
    angles: str


DESCRIPTION_UNITS = FileUnits(lengths="metres", angles="radians")
MODEL_FILE_UNITS = FileUnits(lengths="millimetres", angles="degrees")


def refuse_wrong_units(model: RobotModel, units: FileUnits) -> None:
    """Refuse a model whose size or limits no arm has.

    Raises
    ------
    CalibrationError
        With the number that cannot be, and the unit to write.
    """
    lengths = np.linalg.norm(model.placements[:, :3, 3], axis=1)
    arm_m = float(lengths[1:].sum())
    write_lengths = f"Write lengths and places in {units.lengths}."
    if arm_m > _LONGEST_M or lengths[0] > _FARTHEST_M:
        raise CalibrationError(
            f"the arm is {arm_m:g} m long and its first joint {lengths[0]:g} m from its base: its lengths are in "
            "another unit.",
            remedy=write_lengths,
        )
    if model.axis_count >= _FEWEST_JOINTS and model.sliding is None and arm_m < _SHORTEST_M:
        raise CalibrationError(
            f"the arm is {1e3 * arm_m:g} mm long: its lengths are in another unit.", remedy=write_lengths
        )
    _refuse_travel(model, arm_m, units)
    _refuse_turns(model, units)


def refuse_radians(name: str, key: str, values_deg: Array) -> None:
    """Refuse DH angles of a model file, in degrees, that are a right or straight angle in radians.

    Raises
    ------
    CalibrationError
        One of them is 1.5708 or 3.1416.
    """
    for right in _RIGHT_ANGLES:
        if (np.abs(np.abs(values_deg) - right) < _EQUAL).any():
            raise CalibrationError(
                f"robot model {name}: {key} holds {right:.4f}, a right or straight angle in radians.",
                remedy="Write angles in degrees.",
            )


def _refuse_travel(model: RobotModel, arm_m: float, units: FileUnits) -> None:
    if model.sliding is None:
        return
    travels = np.maximum(np.abs(model.lower_rad), np.abs(model.upper_rad))
    others = float(travels[model.sliding & (travels <= _LONG_TRAVEL_M)].sum())
    most_m = max(_LONG_TRAVEL_M, _TRAVEL_BY_ARM * max(arm_m + others, 1.0))
    for name, travel, slides in zip(model.joint_names, travels, model.sliding, strict=True):
        if slides and travel > most_m:
            raise CalibrationError(
                f"joint {name!r} slides to {travel:g} m, and the arm is {arm_m:.3g} m long.",
                remedy=f"Write the limits of a joint that slides in {units.lengths}.",
            )


def _refuse_turns(model: RobotModel, units: FileUnits) -> None:
    turning = np.ones(model.axis_count, dtype=bool) if model.sliding is None else ~model.sliding
    most = np.maximum(np.abs(model.lower_rad), np.abs(model.upper_rad))[turning]
    write_limits = f"Write the limits of joints that turn in {units.angles}."
    if len(most) > 1 and 2 * (most > _MANY_TURNS_RAD).sum() >= len(most):
        raise CalibrationError(
            f"joints turn to {most.max():g} rad, half of them beyond four turns: their limits are in another unit.",
            remedy=write_limits,
        )
    if len(most) >= _FEWEST_JOINTS and most.max() < _LITTLE_RAD:
        raise CalibrationError(
            f"no joint turns further than {math.degrees(most.max()):.3g} deg: their limits are in another unit.",
            remedy=write_limits,
        )
