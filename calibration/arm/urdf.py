"""URDF in, and calibrated URDF out.

Reading goes through Pinocchio (the extra ``planning``), imported when it is needed. Writing is plain XML:
either a bare description of a model, or an existing description with only the origins of its joints
corrected, so that meshes, limits and everything else stay as they are.
"""

import math
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from types import ModuleType
from typing import Any
from xml.etree import ElementTree as ET

import numpy as np

from cellcal.calibration.arm.kinematics import RobotModel
from cellcal.calibration.documents import DocumentError
from cellcal.calibration.documents.xml_text import parse_xml
from cellcal.calibration.errors import CalibrationError, CellError
from cellcal.calibration.geometry import Array, homogeneous_matrix, inverse_transform
from cellcal.calibration.orientation import elementary_rotation, rotation_from, values_from


@dataclass(frozen=True, eq=False)
class UrdfArm:
    """An arm read from a description: the chain from one link to another."""

    model: RobotModel
    text: str
    tip_link: str
    joint_turns: Array  # (n, 3, 3): carries z onto the axis of each joint


def read_urdf(text: str, *, tip_link: str, base_link: str | None = None, name: str = "urdf") -> UrdfArm:
    """Read the chain of turning joints from ``base_link`` (default: the root) to ``tip_link``.

    Parameters
    ----------
    text : str
        The description, with every xacro expanded; meshes are not loaded.
    tip_link : str
        The link that stands for the flange.

    Raises
    ------
    CellError
        Pinocchio is not installed.
    CalibrationError
        Not a description, a link that is not there, a joint on the way that slides or mimics another.
    """
    pin = _import_pinocchio()
    mimics = {
        joint.get("name")
        for joint in _parse_description(text).findall("joint")
        if joint.find("mimic") is not None
    }
    try:
        with _quiet_errors():
            arm = pin.buildModelFromXML(text)
    except ValueError as refused:
        raise CalibrationError(f"Pinocchio cannot read the description: {refused}") from refused
    tip, base = _body_index(arm, tip_link), _body_index(arm, base_link) if base_link else 0
    path = _moving_joints(arm, base, tip)
    if mimics & {arm.names[joint] for joint in path}:
        raise CalibrationError("a joint on the way mimics another")
    turns = [_axis_turn(pin, arm, joint) for joint in path]
    limits = [_joint_limits(arm, joint) for joint in path]
    n = len(path)
    model = RobotModel(
        name=name,
        title=f"{arm.name}, {arm.frames[base].name} to {tip_link}",
        dh=None,
        placements=_joint_placements(arm, base, tip, path, turns),
        theta0_rad=np.zeros(n),
        joint_coupling=np.eye(n),
        lower_rad=np.array([lower for lower, _, _ in limits]),
        upper_rad=np.array([upper for _, upper, _ in limits]),
        max_speed_rad_s=np.array([speed for _, _, speed in limits]),
        joint_names=tuple(arm.names[j] for j in path),
    )
    return UrdfArm(model=model, text=text, tip_link=tip_link, joint_turns=np.array(turns))


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
    root = _parse_description(arm.text)
    joints = {joint.get("name", ""): joint for joint in root.findall("joint")}
    last = next((joint for joint in joints.values() if _link_name(joint, "child") == arm.tip_link), None)
    if last is None or last.get("type") != "fixed":
        raise CalibrationError(
            f"link {arm.tip_link} is not fixed behind the last joint.",
            remedy="Add a link on a fixed joint at the flange, and read the chain up to it.",
        )
    targets = [*(joints[name] for name in calibrated.joint_names), last]
    for element, correction in zip(targets, _placement_corrections(arm, calibrated), strict=True):
        _set_origin(element, _joint_origin(element) @ correction)
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
            f"{model.name} couples joints, which a description cannot hold.",
            remedy="Write it with geometric joints, and convert the angles where it is used.",
        )
    axes = np.ones(model.axis_count) if coupled else signs
    root = ET.Element("robot", name=model.name)
    if coupled:
        root.append(ET.Comment(" Joint angles are geometric: joint_coupling @ (angles on the pendant). "))
    links = ["base", *(f"link_{i + 1}" for i in range(model.axis_count)), "flange"]
    for link in links:
        ET.SubElement(root, "link", name=link)
    # A turn about the joint's own z, so it commutes with the axis written below.
    zeros = model.theta0_rad
    origins = [
        p @ _to_transform(elementary_rotation("z", t))
        for p, t in zip(model.placements, [*zeros, 0.0], strict=True)
    ]
    for i, joint_name in enumerate([*model.joint_names, "flange_fixed"]):
        kind = "revolute" if i < model.axis_count else "fixed"
        joint = ET.SubElement(root, "joint", name=joint_name, type=kind)
        ET.SubElement(joint, "parent", link=links[i])
        ET.SubElement(joint, "child", link=links[i + 1])
        _set_origin(joint, origins[i])
        if i < model.axis_count:
            ET.SubElement(joint, "axis", xyz=f"0 0 {axes[i]:g}")
            ET.SubElement(joint, "limit", _limit_attributes(model, i))
    ET.indent(root)
    return ET.tostring(root, encoding="unicode") + "\n"


def _import_pinocchio() -> ModuleType:
    try:
        import pinocchio  # noqa: PLC0415  # optional: the extra "planning"
    except ImportError as missing:
        raise CellError(
            "reading a URDF needs Pinocchio, which is not installed.",
            remedy="Install the extra: pip install 'cellcal[planning]'.",
            code="missing_extra",
        ) from missing
    module: ModuleType = pinocchio
    return module


def _parse_description(text: str) -> ET.Element:
    try:
        root = parse_xml(text)
    except DocumentError as broken:
        raise CalibrationError(f"not a robot description: {broken}") from broken
    if root.tag != "robot":
        raise CalibrationError(f"not a robot description: the root element is {root.tag!r}, not 'robot'")
    return root


@contextmanager
def _quiet_errors() -> Iterator[None]:
    """Keep the C++ parser's remarks off the terminal: what they say is in the error that it raises."""
    sys.stderr.flush()
    saved_stderr, nowhere = os.dup(2), os.open(os.devnull, os.O_WRONLY)
    try:
        os.dup2(nowhere, 2)
        yield
    finally:
        os.dup2(saved_stderr, 2)
        os.close(saved_stderr)
        os.close(nowhere)


def _body_index(arm: Any, link: str) -> int:
    for index, frame in enumerate(arm.frames):
        if frame.name == link and frame.type.name == "BODY":
            return index
    raise CalibrationError(f"the description has no link {link!r}")


def _moving_joints(arm: Any, base: int, tip: int) -> list[int]:
    """Return the moving joints between two frames."""
    path: list[int] = []
    joint, stop = arm.frames[tip].parentJoint, arm.frames[base].parentJoint
    while joint not in (stop, 0):
        path.insert(0, joint)
        joint = arm.parents[joint]
    if joint != stop:
        raise CalibrationError(f"link {arm.frames[tip].name} does not hang on link {arm.frames[base].name}")
    if not path:
        raise CalibrationError("there is no moving joint between the two links")
    return path


def _axis_turn(pin: ModuleType, arm: Any, joint: int) -> Array:
    """Return the rotation that carries z onto the axis of a joint; refuses joints that do not turn."""
    jacobian = pin.computeJointJacobian(arm, arm.createData(), pin.neutral(arm), joint)
    column = jacobian.reshape(6, arm.nv)[
        :, arm.idx_vs[joint]
    ]  # of one joint alone, the library gives a vector
    axis = column[3:]
    if arm.nvs[joint] != 1 or abs(np.linalg.norm(axis) - 1.0) > 1e-9 or np.abs(column[:3]).max() > 1e-9:
        raise CalibrationError(f"joint {arm.names[joint]} does not turn about one axis")
    other = np.eye(3)[np.argmin(np.abs(axis))]
    x = np.cross(other, axis) / np.linalg.norm(np.cross(other, axis))
    return np.column_stack([x, np.cross(axis, x), axis])


def _joint_placements(arm: Any, base: int, tip: int, path: list[int], turns: list[Array]) -> Array:
    steps = [arm.jointPlacements[j].homogeneous for j in path] + [arm.frames[tip].placement.homogeneous]
    before = [arm.frames[base].placement.inverse().homogeneous, *(_to_transform(turn.T) for turn in turns)]
    after = [*(_to_transform(turn) for turn in turns), np.eye(4)]
    return np.array([a @ step @ b for a, step, b in zip(before, steps, after, strict=True)])


def _joint_limits(arm: Any, joint: int) -> tuple[float, float, float]:
    """Return lower, upper and speed; a joint without end is given one turn about zero."""
    speed = float(arm.velocityLimit[arm.idx_vs[joint]])
    if arm.nqs[joint] != 1:
        return -math.pi, math.pi, speed
    index = arm.idx_qs[joint]
    return float(arm.lowerPositionLimit[index]), float(arm.upperPositionLimit[index]), speed


def _placement_corrections(arm: UrdfArm, calibrated: RobotModel) -> list[Array]:
    """Return what follows each joint's origin: the placement's own correction, seen from the joint's axes."""
    change = inverse_transform(arm.model.placements) @ calibrated.placements
    change[:-1] = change[:-1] @ _to_transform(elementary_rotation("z", calibrated.theta0_rad))
    turns = _to_transform(arm.joint_turns)
    return [*(turns @ change[:-1] @ inverse_transform(turns)), change[-1]]


def _to_transform(rotation: Array) -> Array:
    return homogeneous_matrix(rotation, np.zeros(3))


def _link_name(joint: ET.Element, side: str) -> str | None:
    element = joint.find(side)
    return None if element is None else element.get("link")


def _joint_origin(joint: ET.Element) -> Array:
    element = joint.find("origin")
    xyz, rpy = (
        ("0 0 0", "0 0 0") if element is None else (element.get("xyz", "0 0 0"), element.get("rpy", "0 0 0"))
    )
    rotation = rotation_from("ros_rpy", np.array(rpy.split(), dtype=float))
    return homogeneous_matrix(rotation, np.array(xyz.split(), dtype=float))


def _set_origin(joint: ET.Element, matrix: Array) -> None:
    element = joint.find("origin")
    if element is None:
        element = ET.Element("origin")
        joint.insert(0, element)
    # Shortest digits that read back the same: a calibration must not end at six decimals.
    element.set("xyz", " ".join(repr(float(v)) for v in matrix[:3, 3]))
    element.set("rpy", " ".join(repr(float(v)) for v in values_from("ros_rpy", matrix[:3, :3])))


def _limit_attributes(model: RobotModel, joint: int) -> dict[str, str]:
    return {
        "lower": repr(float(model.lower_rad[joint])),
        "upper": repr(float(model.upper_rad[joint])),
        "velocity": repr(float(model.max_speed_rad_s[joint])),
        "effort": "0",
    }
