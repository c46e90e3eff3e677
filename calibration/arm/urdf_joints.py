"""One joint of a description in URDF: its links, origin, axis and limits, each checked.

What a reader does not know must not be passed over: a second origin, or a word that is nearly ``origin``, would leave
another chain than the one that was meant.
"""

import math
from collections import Counter
from difflib import get_close_matches
from xml.etree import ElementTree as ET

import numpy as np

from cellcal.calibration.arm.joint_kinds import CONTINUOUS, PRISMATIC, REVOLUTE
from cellcal.calibration.arm.robot_models.model_text import UNKNOWN_SPEED
from cellcal.calibration.documents.plain_numbers import parse_number
from cellcal.calibration.errors import CalibrationError
from cellcal.calibration.geometry import Array, homogeneous_matrix
from cellcal.calibration.message import make_message
from cellcal.calibration.orientation import rotation_from

_MOVING = (REVOLUTE, CONTINUOUS, PRISMATIC)
_NEARLY_UNIT = 1e-3  # three decimals of a unit vector's components
_EXACT = 1e-6  # what single precision and printed exponents leave of a length
_MOST_RPY_RAD = 2.0 * math.pi + 1e-3  # an origin needs no more than a turn; numbers beyond are degrees
_MOST_TURN_RAD = 100.0  # sixteen turns: some wrists have fifteen; numbers beyond are degrees or millimetres
_LONGEST_M = 200.0
_PARTS = ("origin", "parent", "child", "axis", "limit", "mimic")  # what a chain is made of, each at most once
# What stands in a joint besides, and is not looked at.
_OTHER_PARTS = (
    "calibration",
    "dynamics",
    "safety_controller",
    "gazebo",
    "hardwareInterface",
    "physics",
    "joint_properties",
)
_WORDS = {"origin": ("xyz", "rpy", "quat_xyzw"), "axis": ("xyz",), "parent": ("link",), "child": ("link",)}
_LIMITS = ("lower", "upper", "velocity", "effort", "acceleration", "deceleration", "jerk")
_NEAR = 0.7  # of difflib: a word so alike is the other, misspelt


def link_of(joint: ET.Element, side: str) -> str:
    """Return the link at one side of a joint: ``parent`` or ``child``."""
    element = joint.find(side)
    link = None if element is None else element.get("link")
    if not link:
        raise CalibrationError(
            make_message(
                "joint {joint!r} of the description names no {side} link.", joint=joint.get("name"), side=side
            ),
            remedy=make_message('Write <{side} link="..."/> into it.', side=side),
        )
    return link


def origin_of(joint: ET.Element) -> Array:
    """Return where a joint stands (4, 4), seen from its parent link."""
    element = joint.find("origin")
    if element is None:
        return np.eye(4)
    xyz = _numbers(joint, "origin xyz", element.get("xyz", "0 0 0"))
    return homogeneous_matrix(_origin_rotation(joint, element), xyz)


def _origin_rotation(joint: ET.Element, element: ET.Element) -> Array:
    """Return the rotation that an origin states: ``rpy`` or ``quat_xyzw``."""
    quaternion = element.get("quat_xyzw")
    if quaternion is None:
        rpy = _numbers(joint, "origin rpy", element.get("rpy", "0 0 0"))
        if np.abs(rpy).max() > _MOST_RPY_RAD:
            raise CalibrationError(
                make_message(
                    "origin rpy of joint {joint!r} turns by {turn:g} rad, more than one turn.",
                    joint=joint.get("name"),
                    turn=float(np.abs(rpy).max()),
                ),
                remedy="Write it in radians, not in degrees.",
            )
        return rotation_from("ros_rpy", rpy)
    if "rpy" in element.attrib:
        raise CalibrationError(
            make_message("the origin of joint {joint!r} states rpy and quat_xyzw.", joint=joint.get("name")),
            remedy="Leave one of them out.",
        )
    values = _numbers(joint, "origin quat_xyzw", quaternion, 4)
    length = float(np.linalg.norm(values))
    if abs(length - 1.0) > _NEARLY_UNIT:
        raise CalibrationError(
            make_message(
                "origin quat_xyzw of joint {joint!r} is {length:g} long, not of length one.",
                joint=joint.get("name"),
                length=length,
            ),
            remedy="Write x y z w of a unit quaternion.",
        )
    return rotation_from("ros_quaternion", values / length)


def axis_turn(joint: ET.Element) -> Array:
    """Return the rotation that carries z onto the axis of a joint; an axis that is not stated is x."""
    element = joint.find("axis")
    text = "1 0 0" if element is None else element.get("xyz", "")
    axis = _numbers(joint, "axis", text)
    length = float(np.linalg.norm(axis))
    if abs(length - 1.0) > min(_NEARLY_UNIT, _length_by_rounding(text, axis)):
        raise CalibrationError(
            make_message(
                "the axis of joint {joint!r} is {length:g} long, not a unit vector.",
                joint=joint.get("name"),
                length=length,
            ),
            remedy="Write its direction with a length of one, such as 0 0 1.",
        )
    axis = axis / length
    other = np.eye(3)[np.argmin(np.abs(axis))]
    x = np.cross(other, axis) / np.linalg.norm(np.cross(other, axis))
    return np.column_stack([x, np.cross(axis, x), axis])


def _length_by_rounding(text: str, axis: Array) -> float:
    """Return by how much rounding may change the length of a unit vector that is printed as this text."""
    steps = [
        10.0 ** -len(word.partition(".")[2]) if "e" not in word.lower() else 0.0 for word in text.split()
    ]
    return _EXACT + 0.5 * float(np.abs(axis) @ np.array(steps))


def refuse_unusual(joint: ET.Element) -> None:
    """Refuse a joint that is no part of a plain chain, or whose parts are doubled or misspelt.

    Raises
    ------
    CalibrationError
        With the joint and what to write.
    """
    name, kind = joint.get("name"), joint.get("type")
    _refuse_doubled(joint)
    for part in joint:
        _refuse_unknown_words(joint, part)
    if joint.find("mimic") is not None:
        raise CalibrationError(
            make_message(
                "joint {name!r} on the way mimics another joint: the arm is no plain chain.", name=name
            ),
            remedy="Describe the equivalent chain with joints that move by themselves, coupled in a model file "
            "(calibration/arm/robot_models/README.md shows one whose wrist stays level).",
        )
    if kind not in (*_MOVING, "fixed"):
        raise CalibrationError(
            make_message("joint {name!r} on the way is of type {kind!r}.", name=name, kind=kind),
            remedy="A chain has joints that are revolute, continuous, prismatic or fixed.",
        )


def _refuse_doubled(joint: ET.Element) -> None:
    for tag, count in Counter(str(part.tag) for part in joint).items():
        if tag in _PARTS and count > 1:
            raise CalibrationError(
                make_message(
                    "joint {joint!r} has {count} elements called {tag}.",
                    joint=joint.get("name"),
                    count=count,
                    tag=tag,
                ),
                remedy="Leave the one that is right.",
            )
        if tag not in _PARTS and tag not in _OTHER_PARTS:
            _refuse_nearly(joint, tag, _PARTS)


def _refuse_unknown_words(joint: ET.Element, part: ET.Element) -> None:
    allowed_words = _WORDS.get(str(part.tag), ())
    for word in part.attrib:
        if allowed_words and word not in allowed_words:
            raise CalibrationError(
                make_message(
                    "{part} of joint {joint!r} states {word!r}, which a description does not have.",
                    part=str(part.tag),
                    joint=joint.get("name"),
                    word=word,
                ),
                remedy=make_message("Write {allowed}, or take it out.", allowed=" or ".join(allowed_words)),
            )
        if part.tag == "limit" and word not in _LIMITS:
            _refuse_nearly(joint, word, ("lower", "upper"))


def limits_of(joint: ET.Element) -> tuple[float, float, float]:
    """Return lower, upper and speed; a joint without end is given one turn about zero."""
    name, kind = joint.get("name"), joint.get("type")
    slides = kind == PRISMATIC
    element = joint.find("limit")
    stated = {} if element is None else dict(element.attrib)
    speed = float(_numbers(joint, "velocity", stated.get("velocity", "0"), 1)[0])
    if speed < 0.0:
        raise CalibrationError(
            make_message("the speed of joint {name!r} is {speed:g}, below zero.", name=name, speed=speed),
            remedy="Write its greatest speed as a positive velocity, or 0 where it is not known.",
        )
    speed = speed if speed > 0.0 else UNKNOWN_SPEED[1 if slides else 0]
    if kind == CONTINUOUS:
        return -math.pi, math.pi, speed
    lower, upper = (float(_numbers(joint, side, stated.get(side, "0"), 1)[0]) for side in ("lower", "upper"))
    if lower == upper:
        raise CalibrationError(
            make_message("joint {name!r} has no range: its limits are missing or alike.", name=name),
            remedy="Write lower and upper into its limit"
            + (" in metres." if slides else " in radians, or make it continuous."),
        )
    if lower > upper:
        raise CalibrationError(
            make_message(
                "the limits of joint {name!r} are reversed: lower {lower:g} is above upper {upper:g}.",
                name=name,
                lower=lower,
                upper=upper,
            ),
            remedy="Exchange lower and upper.",
        )
    _refuse_range(joint, lower, upper)
    return lower, upper, speed


def _refuse_range(joint: ET.Element, lower: float, upper: float) -> None:
    name, most = joint.get("name"), max(abs(lower), abs(upper))
    if joint.get("type") == PRISMATIC:
        if most > _LONGEST_M:
            raise CalibrationError(
                make_message("prismatic joint {name!r} slides by {most:g} m.", name=name, most=most),
                remedy="Write its limits in metres.",
            )
    elif most > _MOST_TURN_RAD:
        raise CalibrationError(
            make_message("joint {name!r} is revolute and turns to {most:g} rad.", name=name, most=most),
            remedy="Write its limits in radians; if it turns without end, its type is continuous; if it slides, its "
            "type is prismatic and its limits are metres.",
        )


def _numbers(joint: ET.Element, what: str, text: str, count: int = 3) -> Array:
    try:
        values = np.array([parse_number(word) for word in text.split()])
    except ValueError:
        values = np.array([np.nan])
    if values.shape != (count,) or not np.isfinite(values).all():
        cure = (
            "Expand the xacro first: xacro FILE.xacro > arm.urdf, and read arm.urdf."
            if "$" in text
            else "Correct it: blanks between numbers, a point before decimals."
        )
        raise CalibrationError(
            make_message(
                "{what} of joint {joint!r} is {text!r}, not a finite number.",
                what=what,
                joint=joint.get("name"),
                text=text,
            )
            if count == 1
            else make_message(
                "{what} of joint {joint!r} is {text!r}, not {count} finite numbers.",
                what=what,
                joint=joint.get("name"),
                text=text,
                count=count,
            ),
            remedy=cure,
        )
    return values


def _refuse_nearly(joint: ET.Element, word: str, allowed_words: tuple[str, ...]) -> None:
    """Refuse a word that is nearly one of those that are known."""
    near = get_close_matches(word.lower(), allowed_words, n=1, cutoff=_NEAR)
    if near:
        raise CalibrationError(
            make_message(
                "joint {joint!r} states {word!r}, which a description does not have.",
                joint=joint.get("name"),
                word=word,
            ),
            remedy=make_message("Did you mean {near}?", near=near[0]),
        )
