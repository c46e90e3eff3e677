"""URDF in: the chain from one link to another, read without any library of robots.

What a description says about anything else (meshes, masses, other arms) is not looked at.
"""

import math
from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass
from difflib import get_close_matches
from xml.etree import ElementTree as ET

import numpy as np

from cellcal.calibration.arm.joint_kinds import CONTINUOUS, PRISMATIC, REVOLUTE
from cellcal.calibration.arm.robot_model import RobotModel
from cellcal.calibration.arm.robot_models.model_text import UNKNOWN_SPEED
from cellcal.calibration.documents import DocumentError
from cellcal.calibration.documents.xml_text import parse_xml
from cellcal.calibration.errors import CalibrationError
from cellcal.calibration.geometry import Array, homogeneous_matrix
from cellcal.calibration.message import make_message
from cellcal.calibration.orientation import rotation_from

_MOVING = (REVOLUTE, CONTINUOUS, PRISMATIC)
_NEARLY_UNIT = 1e-3  # three decimals of a unit vector's components
_MOST_TURN_RAD = 100.0  # sixteen turns: some wrists have fifteen; numbers beyond are degrees or millimetres
_LONGEST_M = 200.0
_MOST_NAMES = 12


@dataclass(frozen=True, eq=False)
class UrdfArm:
    """An arm read from a description: the chain from one link to another."""

    model: RobotModel
    text: str
    tip_link: str
    joint_turns: Array  # (n, 3, 3): carries z onto the axis of each joint


def read_urdf(
    text: str, *, tip_link: str | None = None, base_link: str | None = None, name: str = "urdf"
) -> UrdfArm:
    """Read the chain of joints from ``base_link`` (default: the root) to ``tip_link``.

    Parameters
    ----------
    text : str
        The description, with every xacro expanded; meshes are not loaded.
    tip_link : str or None
        The link that stands for the flange; None where the description ends in one link only.

    Raises
    ------
    CalibrationError
        Not a description, a link that is not there, a joint on the way that mimics another or has no usable axis
        or limits.
    """
    root = parse_description(text)
    tree = _Tree.of(root)
    tip = tree.tip(tip_link)
    base = tree.base(base_link)
    path = tree.path(base, tip)
    moving = [joint for joint in path if joint.get("type") != "fixed"]
    if not moving:
        raise CalibrationError(
            f"no joint moves between the links {base!r} and {tip!r} of the description.",
            remedy="Name the robot's base and its flange.",
        )
    turns = [axis_turn(joint) for joint in moving]
    limits = [_limits(joint) for joint in moving]
    n = len(moving)
    model = RobotModel(
        name=name,
        title=f"{root.get('name') or 'description'}, {base} to {tip}",
        dh=None,
        placements=_placements(path, turns),
        theta0_rad=np.zeros(n),
        joint_coupling=np.eye(n),
        lower_rad=np.array([lower for lower, _, _ in limits]),
        upper_rad=np.array([upper for _, upper, _ in limits]),
        max_speed_rad_s=np.array([speed for _, _, speed in limits]),
        joint_names=tuple(joint.get("name", "") for joint in moving),
        joint_types=tuple(joint.get("type", "") for joint in moving),
    )
    return UrdfArm(model=model, text=text, tip_link=tip, joint_turns=np.array(turns))


def parse_description(text: str) -> ET.Element:
    """Return the root of a description.

    Raises
    ------
    CalibrationError
        It is no URDF, or one whose xacro is not expanded.
    """
    try:
        root = parse_xml(text)
    except DocumentError as broken:
        raise CalibrationError(f"not a robot description: {broken}") from broken
    if root.tag != "robot":
        raise CalibrationError(f"not a robot description: the root element is {root.tag!r}, not 'robot'")
    if any("xacro" in str(element.tag) for element in root.iter()):
        raise CalibrationError(
            "the description holds xacro that is not expanded.",
            remedy="Expand it first: xacro FILE.xacro > arm.urdf, and read arm.urdf.",
        )
    return root


def link_of(joint: ET.Element, side: str) -> str:
    """Return the link at one side of a joint: ``parent`` or ``child``."""
    element = joint.find(side)
    link = None if element is None else element.get("link")
    if not link:
        raise CalibrationError(
            f"joint {joint.get('name')!r} of the description names no {side} link.",
            remedy=f'Write <{side} link="..."/> into it.',
        )
    return link


def origin_of(joint: ET.Element) -> Array:
    """Return where a joint stands (4, 4), seen from its parent link."""
    element = joint.find("origin")
    if element is None:
        return np.eye(4)
    xyz = _numbers(joint, "origin xyz", element.get("xyz", "0 0 0"))
    rpy = _numbers(joint, "origin rpy", element.get("rpy", "0 0 0"))
    return homogeneous_matrix(rotation_from("ros_rpy", rpy), xyz)


def axis_turn(joint: ET.Element) -> Array:
    """Return the rotation that carries z onto the axis of a joint; an axis that is not stated is x."""
    element = joint.find("axis")
    axis = _numbers(joint, "axis", "1 0 0" if element is None else element.get("xyz", ""))
    length = float(np.linalg.norm(axis))
    if abs(length - 1.0) > _NEARLY_UNIT:
        raise CalibrationError(
            f"the axis of joint {joint.get('name')!r} is {length:g} long, not a unit vector.",
            remedy="Write its direction with a length of one, such as 0 0 1.",
        )
    axis = axis / length
    other = np.eye(3)[np.argmin(np.abs(axis))]
    x = np.cross(other, axis) / np.linalg.norm(np.cross(other, axis))
    return np.column_stack([x, np.cross(axis, x), axis])


@dataclass(frozen=True, eq=False)
class _Tree:
    """The links of a description, and the joint above each."""

    links: tuple[str, ...]
    above: dict[str, ET.Element]  # by child link

    @classmethod
    def of(cls, root: ET.Element) -> "_Tree":
        links = tuple(link.get("name", "") for link in root.findall("link"))
        joints = root.findall("joint")
        _refuse_twice("link", links)
        _refuse_twice("joint", [joint.get("name", "") for joint in joints])
        above: dict[str, ET.Element] = {}
        for joint in joints:
            parent, child = link_of(joint, "parent"), link_of(joint, "child")
            for link in (parent, child):
                if link not in links:
                    raise CalibrationError(
                        f"joint {joint.get('name')!r} names the link {link!r}, which the description does not have.",
                        remedy="Correct the name, or add the link.",
                    )
            if child in above:
                raise CalibrationError(
                    f"link {child!r} hangs on two joints, {above[child].get('name')!r} and {joint.get('name')!r}.",
                    remedy="A description is a tree: leave one of them out.",
                )
            above[child] = joint
        return cls(links, above)

    def base(self, asked: str | None) -> str:
        if asked is not None:
            return self._require_link("base", asked)
        roots = [link for link in self.links if link not in self.above]
        if len(roots) != 1:
            raise CalibrationError(
                f"the description has {len(roots)} links that hang on nothing: {_named(roots)}.",
                remedy="Name the robot's base: ?base=LINK.",
            )
        return roots[0]

    def tip(self, asked: str | None) -> str:
        if asked is not None:
            return self._require_link("tip", asked)
        carrying = {link_of(joint, "parent") for joint in self.above.values()}
        ends = [link for link in self.links if link not in carrying]
        if len(ends) != 1:
            raise CalibrationError(
                f"the description ends in {len(ends)} links, and none is named as the flange.",
                remedy=f"Name it: ?tip=LINK, one of {_named(ends)}.",
            )
        return ends[0]

    def path(self, base: str, tip: str) -> list[ET.Element]:
        """Return the joints from the base to the tip."""
        path: list[ET.Element] = []
        link = tip
        while link != base:
            joint = self.above.get(link)
            if joint is None or len(path) > len(self.above):
                raise CalibrationError(
                    f"link {tip!r} does not hang on link {base!r}.",
                    remedy="Name a base on the way from the root to the tip.",
                )
            path.insert(0, joint)
            link = link_of(joint, "parent")
        for joint in path:
            _refuse_unusual(joint)
        return path

    def _require_link(self, what: str, link: str) -> str:
        if link in self.links:
            return link
        near = get_close_matches(link, self.links, n=1)
        there = (
            make_message("Did you mean {near}?", near=near[0])
            if near
            else make_message("It has {names}.", names=_named(self.links))
        )
        raise CalibrationError(f"the description has no link {link!r} for the {what}.", remedy=there)


def _refuse_twice(what: str, names: Iterable[str]) -> None:
    counted = Counter(names)
    if "" in counted:
        raise CalibrationError(f"a {what} of the description has no name.", remedy="Give it one.")
    for name, count in counted.items():
        if count > 1:
            raise CalibrationError(
                f"{count} {what}s of the description are called {name!r}.",
                remedy="Give each a name of its own.",
            )


def _refuse_unusual(joint: ET.Element) -> None:
    name, kind = joint.get("name"), joint.get("type")
    if joint.find("mimic") is not None:
        raise CalibrationError(
            f"joint {name!r} on the way mimics another joint: the arm is no plain chain.",
            remedy="Describe the equivalent chain with joints that move by themselves, coupled in a model file.",
        )
    if kind not in (*_MOVING, "fixed"):
        raise CalibrationError(
            f"joint {name!r} on the way is of type {kind!r}.",
            remedy="A chain has joints that are revolute, continuous, prismatic or fixed.",
        )


def _limits(joint: ET.Element) -> tuple[float, float, float]:
    """Return lower, upper and speed; a joint without end is given one turn about zero."""
    name, kind = joint.get("name"), joint.get("type")
    slides = kind == PRISMATIC
    element = joint.find("limit")
    stated = {} if element is None else dict(element.attrib)
    speed = float(_numbers(joint, "velocity", stated.get("velocity", "0"), 1)[0])
    speed = speed if speed > 0.0 else UNKNOWN_SPEED[1 if slides else 0]
    if kind == CONTINUOUS:
        return -math.pi, math.pi, speed
    lower, upper = (float(_numbers(joint, side, stated.get(side, "0"), 1)[0]) for side in ("lower", "upper"))
    if lower == upper:
        raise CalibrationError(
            f"joint {name!r} has no range: its limits are missing or alike.",
            remedy="Write lower and upper into its limit"
            + (" in metres." if slides else " in radians, or make it continuous."),
        )
    if lower > upper:
        raise CalibrationError(
            f"the limits of joint {name!r} are reversed: lower {lower:g} is above upper {upper:g}.",
            remedy="Exchange lower and upper.",
        )
    _refuse_range(joint, lower, upper)
    return lower, upper, speed


def _refuse_range(joint: ET.Element, lower: float, upper: float) -> None:
    name, most = joint.get("name"), max(abs(lower), abs(upper))
    if joint.get("type") == PRISMATIC:
        if most > _LONGEST_M:
            raise CalibrationError(
                f"prismatic joint {name!r} slides by {most:g} m.", remedy="Write its limits in metres."
            )
    elif most > _MOST_TURN_RAD:
        raise CalibrationError(
            f"joint {name!r} is revolute and turns to {most:g} rad.",
            remedy="Write its limits in radians; if it slides, its type is prismatic and its limits are metres.",
        )


def _numbers(joint: ET.Element, what: str, text: str, count: int = 3) -> Array:
    try:
        values = np.array([float(word) for word in text.split()])
    except ValueError:
        values = np.array([np.nan])
    if values.shape != (count,) or not np.isfinite(values).all():
        wanted = "a finite number" if count == 1 else f"{count} finite numbers"
        raise CalibrationError(
            f"{what} of joint {joint.get('name')!r} is {text!r}, not {wanted}.", remedy="Correct it."
        )
    return values


def _placements(path: list[ET.Element], turns: list[Array]) -> Array:
    """Return (n + 1, 4, 4): from each joint's frame, whose z is its axis, to the next one's."""
    found, here, k = [], np.eye(4), 0
    for joint in path:
        here = here @ origin_of(joint)
        if joint.get("type") == "fixed":
            continue
        turn = homogeneous_matrix(turns[k], np.zeros(3))
        found.append(here @ turn)
        here, k = turn.T, k + 1
    return np.array([*found, here])


def _named(links: Iterable[str]) -> str:
    names = list(links)
    more = f" and {len(names) - _MOST_NAMES} more" if len(names) > _MOST_NAMES else ""
    return ", ".join(names[:_MOST_NAMES]) + more
