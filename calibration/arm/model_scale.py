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
from cellcal.calibration.message import make_message

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
    """The units that a file's format states, as cures."""

    write_lengths: str
    write_turns: str  # limits of joints that turn
    write_slides: str  # limits of joints that slide


DESCRIPTION_UNITS = FileUnits(
    write_lengths="Write lengths and places in metres.",
    write_turns="Write the limits of joints that turn in radians.",
    write_slides="Write the limits of a joint that slides in metres.",
)
MODEL_FILE_UNITS = FileUnits(
    write_lengths="Write lengths and places in millimetres.",
    write_turns="Write the limits of joints that turn in degrees.",
    write_slides="Write the limits of a joint that slides in millimetres.",
)


def refuse_wrong_units(model: RobotModel, units: FileUnits) -> None:
    """Refuse a model whose size or limits no arm has.

    Raises
    ------
    CalibrationError
        With the number that cannot be, and the unit to write.
    """
    lengths = np.linalg.norm(model.placements[:, :3, 3], axis=1)
    arm_m = float(lengths[1:].sum())
    if arm_m > _LONGEST_M or lengths[0] > _FARTHEST_M:
        raise CalibrationError(
            make_message(
                "the arm is {arm_m:g} m long and its first joint {place:g} m from its base: its lengths are in "
                "another unit.",
                arm_m=arm_m,
                place=float(lengths[0]),
            ),
            remedy=units.write_lengths,
        )
    if model.axis_count >= _FEWEST_JOINTS and model.sliding is None and arm_m < _SHORTEST_M:
        raise CalibrationError(
            make_message(
                "the arm is {arm_mm:g} mm long: its lengths are in another unit.", arm_mm=1000.0 * arm_m
            ),
            remedy=units.write_lengths,
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
                make_message(
                    "robot model {name}: {key} holds {right:.4f}, a right or straight angle in radians.",
                    name=name,
                    key=key,
                    right=right,
                ),
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
                make_message(
                    "joint {name!r} slides to {travel:g} m, and the arm is {arm_m:.3g} m long.",
                    name=name,
                    travel=float(travel),
                    arm_m=arm_m,
                ),
                remedy=units.write_slides,
            )


def _refuse_turns(model: RobotModel, units: FileUnits) -> None:
    turning = np.ones(model.axis_count, dtype=bool) if model.sliding is None else ~model.sliding
    most = np.maximum(np.abs(model.lower_rad), np.abs(model.upper_rad))[turning]
    if len(most) > 1 and 2 * (most > _MANY_TURNS_RAD).sum() >= len(most):
        raise CalibrationError(
            make_message(
                "joints turn to {most:g} rad, half of them beyond four turns: their limits are in another unit.",
                most=float(most.max()),
            ),
            remedy=units.write_turns,
        )
    if len(most) >= _FEWEST_JOINTS and most.max() < _LITTLE_RAD:
        raise CalibrationError(
            make_message(
                "no joint turns further than {most_deg:.3g} deg: their limits are in another unit.",
                most_deg=math.degrees(most.max()),
            ),
            remedy=units.write_turns,
        )
