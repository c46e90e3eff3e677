"""A description with one of its fixed joints moving: a joint that was written as fixed is no part of its chain."""

import xml.etree.ElementTree as ET
from collections.abc import Iterator
from dataclasses import dataclass

from cellcal.calibration.arm.joint_kinds import PRISMATIC, REVOLUTE
from cellcal.calibration.arm.robot_model import RobotModel
from cellcal.calibration.arm.urdf_reader import fixed_joints_between, parse_description, read_urdf
from cellcal.calibration.errors import CalibrationError

_WIDE = {REVOLUTE: "12.5", PRISMATIC: "3.0"}  # rad, m


@dataclass(frozen=True, eq=False)
class FreedJoint:
    """An arm one of whose fixed joints moves."""

    joint: str
    kind: str  # what it is then
    model: RobotModel


def freed_joints(text: str, *, base_link: str | None, tip_link: str | None) -> Iterator[FreedJoint]:
    """Return the arm of a description with each fixed joint between base and tip moving, about or along its axis.

    A fixed joint without an axis is passed over: a moving joint that was changed into a fixed one has its axis still.

    Raises
    ------
    CalibrationError
        As `read_urdf`.
    """
    for name in fixed_joints_between(text, base_link=base_link, tip_link=tip_link):
        for kind in (REVOLUTE, PRISMATIC):
            root = parse_description(text)
            joint = next(each for each in root.iter("joint") if each.get("name") == name)
            if joint.find("axis") is None:
                continue
            joint.set("type", kind)
            for limit in joint.findall("limit"):
                joint.remove(limit)
            ET.SubElement(joint, "limit", {"lower": f"-{_WIDE[kind]}", "upper": _WIDE[kind], "velocity": "1"})
            try:
                found = read_urdf(
                    ET.tostring(root, encoding="unicode"), base_link=base_link, tip_link=tip_link
                )
            except CalibrationError:  # an axis or a placement of the fixed joint that no moving one may have
                continue
            yield FreedJoint(name, kind, found.model)
