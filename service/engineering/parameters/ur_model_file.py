"""A model file of a Universal Robots arm, from what its own controller tells: for arms that the catalogue lacks."""

import math
from collections.abc import Iterable

from cellcal.calibration.arm.kinematics import RobotModel
from cellcal.calibration.arm.model_references import model_of_text
from cellcal.calibration.arm.robot_models.model_text import read_model_text
from cellcal.calibration.arm.ur_factory import factory_model
from cellcal.calibration.errors import CalibrationError
from cellcal.calibration.message import make_message
from cellcal.drivers.universal_robots.arm_types import ArmType, arm_types
from cellcal.drivers.universal_robots.factory_calibration import ControllerArm

_JOINTS = (
    "shoulder_pan_joint",
    "shoulder_lift_joint",
    "elbow_joint",
    "wrist_1_joint",
    "wrist_2_joint",
    "wrist_3_joint",
)
_SOURCE = "Primary interface of the controller at {address}, sub-package 6, type code {code}"
_LONGEST_M = 3.0  # no arm of this maker is longer
_WIDEST_RAD = 6.5  # a little more than a turn; the last joint of some arms turns without an end
_FASTEST_RAD_S = 20.0  # three times the quickest wrist of this maker


def ur_model_text(arm: ControllerArm, arm_type: str, address: str) -> str:
    """Return the text of a model file: the controller's drawing of the arm, its limits and its speeds.

    Raises
    ------
    CalibrationError
        Another type of arm answers, or its factory calibration does not belong to the drawing.
    """
    expected_type = _known_type(arm_type)
    if arm.type_code != expected_type.code:
        raise CalibrationError(
            make_message(
                "the controller at {address} reports type code {found}; a {arm_type} reports {code}.",
                address=address,
                found=arm.type_code,
                arm_type=arm_type,
                code=expected_type.code,
            ),
            remedy="Correct the address, or name the arm that is on its label.",
        )
    _check_joints(arm)
    text = _write_text(arm, arm_type, _SOURCE.format(address=address, code=arm.type_code))
    _check_drawing(arm, _model_of(arm_type, text))
    return text


def _known_type(arm_type: str) -> ArmType:
    if arm_type in arm_types():
        return arm_types()[arm_type]
    raise CalibrationError(
        make_message(
            "there is no arm {arm_type!r}; there are {known}.",
            arm_type=arm_type,
            known=", ".join(arm_types()),
        ),
        remedy="Name the arm that is on its label.",
        code="usage",
    )


def _model_of(name: str, text: str) -> RobotModel:
    return model_of_text(name, read_model_text(name, text))


def _check_joints(arm: ControllerArm) -> None:
    """Raise where a joint's limits or speed are those of no arm, as where degrees are sent for radians."""
    for joint, (low, high, speed) in enumerate(
        zip(arm.lower_rad, arm.upper_rad, arm.max_speed_rad_s, strict=True), 1
    ):
        is_wide = max(abs(low), abs(high)) > _WIDEST_RAD and joint < len(_JOINTS)
        if is_wide or low >= high:
            what = make_message(
                "limits of {low:.5g} to {high:.5g} deg", low=math.degrees(low), high=math.degrees(high)
            )
        elif not 0.0 < speed <= _FASTEST_RAD_S:
            what = make_message("a speed of {speed:.5g} deg/s", speed=math.degrees(speed))
        else:
            continue
        raise CalibrationError(
            make_message(
                "the controller tells {what} of joint {joint}, which no arm has.", what=what, joint=joint
            ),
            remedy="Look at the joint limits in the safety settings at the pendant; where they are right, report "
            "this with the controller's version.",
        )


def _check_drawing(arm: ControllerArm, nominal: RobotModel) -> None:
    assert nominal.dh is not None
    lengths = [*nominal.dh.a_m, *nominal.dh.d_m]
    if max(map(abs, lengths)) > _LONGEST_M:
        raise CalibrationError(
            "the drawing that the controller tells is not that of an arm: a length is beyond 3 m.",
            remedy="Report this with the controller's version; nothing in the cell is at fault.",
        )
    factory_model(nominal, arm.factory.to_table())


def _write_text(arm: ControllerArm, arm_type: str, source: str) -> str:
    rows = arm.nominal.to_rows()
    limits = {"lower_deg": arm.lower_rad, "upper_deg": arm.upper_rad, "speed_deg_s": arm.max_speed_rad_s}
    degrees = {key: [_to_degrees(value) for value in values] for key, values in limits.items()}
    return "\n".join(
        (
            f'title = "Universal Robots {arm_type[:2].upper()}{arm_type[2:]}"',
            f"joints = [{', '.join(f'{joint!r}' for joint in _JOINTS)}]".replace("'", '"'),
            f'dh_source = "{source}, nominal. Its factory calibration is {arm.factory.name}."',
            f"theta_deg = {_to_list(_to_degrees(row[0]) for row in rows)}",
            f"d_mm = {_to_list(round(row[1] * 1e3, 6) for row in rows)}",
            f"a_mm = {_to_list(round(row[2] * 1e3, 6) for row in rows)}",
            f"alpha_deg = {_to_list(_to_degrees(row[3]) for row in rows)}",
            f'limits_source = "{source}."',
            f"lower_deg = {_to_list(degrees['lower_deg'])}",
            f"upper_deg = {_to_list(degrees['upper_deg'])}",
            f'speed_source = "{source}."',
            f"speed_deg_s = {_to_list(degrees['speed_deg_s'])}",
            "",
        )
    )


def _to_degrees(angle_rad: float) -> float:
    return round(math.degrees(angle_rad), 6) + 0.0  # controllers write 1.570796327 for a right angle


def _to_list(values: Iterable[float]) -> str:
    return f"[{', '.join(repr(float(value)) for value in values)}]"
