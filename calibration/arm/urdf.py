"""URDF out: a bare description of a model, or an existing one with only the origins of its joints corrected.

Meshes, limits and everything else of an existing description stay as they are. Reading is in `urdf_reader`.
"""

from xml.etree import ElementTree as ET

import numpy as np

from cellcal.calibration.arm.joint_kinds import CONTINUOUS, joint_motions
from cellcal.calibration.arm.robot_model import RobotModel
from cellcal.calibration.arm.urdf_joints import link_of, origin_of
from cellcal.calibration.arm.urdf_reader import UrdfArm, parse_description, read_urdf
from cellcal.calibration.errors import CalibrationError
from cellcal.calibration.geometry import Array, homogeneous_matrix, inverse_transform
from cellcal.calibration.orientation import values_from

__all__ = ["UrdfArm", "bare_urdf", "calibrated_urdf", "read_urdf"]


def calibrated_urdf(arm: UrdfArm, calibrated: RobotModel) -> str:
    """Return the description with the origins of the chain's joints moved to those of the calibrated model.

    Joint offsets become part of the origins: the description is driven by the angles that the controller
    shows. Only ``origin`` elements of joints change.

    Raises
    ------
    CalibrationError
        A calibrated model of another chain or with coupled joints, or a tip link that is not fixed behind the
        last joint, so that the flange's own correction would have no place.
    """
    if calibrated.joint_names != arm.model.joint_names:
        raise CalibrationError("the calibrated model has other joints than the description")
    if not np.allclose(calibrated.joint_coupling, np.eye(calibrated.axis_count)):
        raise CalibrationError(
            "a description cannot hold coupled joints", remedy="Calibrate the model read from it."
        )
    root = parse_description(arm.text)
    joints = {joint.get("name", ""): joint for joint in root.findall("joint")}
    last = next((joint for joint in joints.values() if link_of(joint, "child") == arm.tip_link), None)
    if last is None or last.get("type") != "fixed":
        raise CalibrationError(
            f"link {arm.tip_link} is not fixed behind the last joint.",
            remedy="Add a link on a fixed joint at the flange, and read the chain up to it.",
        )
    targets = [*(joints[name] for name in calibrated.joint_names), last]
    for element, correction in zip(targets, _placement_corrections(arm, calibrated), strict=True):
        _set_origin(element, origin_of(element) @ correction)
    return ET.tostring(root, encoding="unicode") + "\n"


def bare_urdf(model: RobotModel, *, geometric_joints: bool = False) -> str:
    """Return a description without meshes: links ``base``, ``link_1`` …, ``flange``, joints about z.

    Parameters
    ----------
    geometric_joints : bool
        A description cannot couple joints. For a model that does (FANUC's J3 against the horizon), True
        writes geometric angles ``joint_coupling @ q``, the custom of ROS-Industrial; False refuses.

    Raises
    ------
    CalibrationError
        Coupled joints without ``geometric_joints``.
    """
    signs = np.diag(model.joint_coupling)
    coupled = bool(
        np.abs(model.joint_coupling - np.diag(signs)).max() > 0 or np.abs(np.abs(signs) - 1).max() > 0
    )
    if coupled and not geometric_joints:
        raise CalibrationError(
            f"{model.label} couples joints, which a description cannot hold.",
            remedy="Write it with geometric joints, and convert the angles where it is used.",
        )
    axes = np.ones(model.axis_count) if coupled else signs
    root = ET.Element("robot", name=model.label)
    if coupled:
        root.append(ET.Comment(" Joint angles are geometric: joint_coupling @ (angles on the pendant). "))
    links = ["base", *(f"link_{i + 1}" for i in range(model.axis_count)), "flange"]
    for link in links:
        ET.SubElement(root, "link", name=link)
    # A motion along the joint's own z, so it commutes with the axis written below.
    origins = model.placements.copy()
    origins[:-1] = origins[:-1] @ joint_motions(model.theta0_rad, model.sliding)
    for i, joint_name in enumerate([*model.joint_names, "flange_fixed"]):
        kind = model.kinds[i] if i < model.axis_count else "fixed"
        joint = ET.SubElement(root, "joint", name=joint_name, type=kind)
        ET.SubElement(joint, "parent", link=links[i])
        ET.SubElement(joint, "child", link=links[i + 1])
        _set_origin(joint, origins[i])
        if i < model.axis_count:
            ET.SubElement(joint, "axis", xyz=f"0 0 {axes[i]:g}")
            ET.SubElement(joint, "limit", _limit_attributes(model, i))
    ET.indent(root)
    return ET.tostring(root, encoding="unicode") + "\n"


def _placement_corrections(arm: UrdfArm, calibrated: RobotModel) -> list[Array]:
    """Return what follows each joint's origin: the placement's own correction, seen from the joint's axes."""
    change = inverse_transform(arm.model.placements) @ calibrated.placements
    change[:-1] = change[:-1] @ joint_motions(calibrated.theta0_rad, calibrated.sliding)
    turns = _to_transform(arm.joint_turns)
    return [*(turns @ change[:-1] @ inverse_transform(turns)), change[-1]]


def _to_transform(rotation: Array) -> Array:
    return homogeneous_matrix(rotation, np.zeros(3))


def _set_origin(joint: ET.Element, matrix: Array) -> None:
    element = joint.find("origin")
    if element is None:
        element = ET.Element("origin")
        joint.insert(0, element)
    # Shortest digits that read back the same: a calibration must not end at six decimals.
    element.set("xyz", " ".join(repr(float(v)) for v in matrix[:3, 3]))
    element.attrib.pop("quat_xyzw", None)
    element.set("rpy", " ".join(repr(float(v)) for v in values_from("ros_rpy", matrix[:3, :3])))


def _limit_attributes(model: RobotModel, joint: int) -> dict[str, str]:
    if model.kinds[joint] == CONTINUOUS:
        return {"velocity": repr(float(model.max_speed_rad_s[joint])), "effort": "0"}
    return {
        "lower": repr(float(model.lower_rad[joint])),
        "upper": repr(float(model.upper_rad[joint])),
        "velocity": repr(float(model.max_speed_rad_s[joint])),
        "effort": "0",
    }
