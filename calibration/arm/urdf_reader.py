"""URDF in: the chain from one link to another, read without any library of robots.

What a description says about anything else (meshes, masses, other arms) is not looked at.
"""

from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass
from difflib import get_close_matches
from xml.etree import ElementTree as ET

import numpy as np

from cellcal.calibration.arm.model_scale import DESCRIPTION_UNITS, refuse_wrong_units
from cellcal.calibration.arm.robot_model import RobotModel
from cellcal.calibration.arm.urdf_joints import axis_turn, limits_of, link_of, origin_of, refuse_unusual
from cellcal.calibration.documents import DocumentError
from cellcal.calibration.documents.xml_text import parse_xml
from cellcal.calibration.errors import CalibrationError
from cellcal.calibration.geometry import Array, homogeneous_matrix
from cellcal.calibration.message import make_message

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
            make_message(
                "no joint moves between the links {base!r} and {tip!r} of the description.",
                base=base,
                tip=tip,
            ),
            remedy="Name the robot's base and its flange.",
        )
    turns = [axis_turn(joint) for joint in moving]
    limits = [limits_of(joint) for joint in moving]
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
    refuse_wrong_units(model, DESCRIPTION_UNITS)
    return UrdfArm(model=model, text=text, tip_link=tip, joint_turns=np.array(turns))


def fixed_joints_between(text: str, *, base_link: str | None, tip_link: str | None) -> tuple[str, ...]:
    """Return the names of the fixed joints on the way from base to tip.

    Raises
    ------
    CalibrationError
        As `read_urdf`, for links that are not there.
    """
    tree = _Tree.of(parse_description(text))
    path = tree.path(tree.base(base_link), tree.tip(tip_link))
    return tuple(joint.get("name", "") for joint in path if joint.get("type") == "fixed")


def parse_description(text: str) -> ET.Element:
    """Return the root of a description.

    Raises
    ------
    CalibrationError
        It is no URDF, or one whose xacro is not expanded.
    """
    if not text.strip("\ufeff \t\r\n\0"):
        raise CalibrationError(
            "the file is empty.",
            remedy="Write the description again from its source: xacro FILE.xacro > arm.urdf.",
        )
    try:
        root = parse_xml(text)
    except DocumentError as broken:
        if "<xacro:" in text:
            raise _xacro_error() from broken  # without its namespace it is no XML either
        raise CalibrationError(
            make_message("not a robot description: {cause}", cause=broken.message),
            remedy="Write the description again from its source.",
        ) from broken
    if root.tag != "robot":
        raise CalibrationError(
            make_message("not a robot description: the root element is {tag!r}, not 'robot'.", tag=root.tag),
            remedy=_root_remedy(root.tag),
        )
    if any("xacro" in str(element.tag) for element in root.iter()) or _names_are_computed(root):
        raise _xacro_error()
    return root


def _names_are_computed(root: ET.Element) -> bool:
    """Return whether a link or joint is called by an expression that xacro would have replaced."""
    named = [*root.iter("link"), *root.iter("joint"), *root.iter("parent"), *root.iter("child")]
    names = (element.get(key, "") for element in named for key in ("name", "link", "type"))
    return any("${" in name or "$(" in name for name in names)


def _xacro_error() -> CalibrationError:
    return CalibrationError(
        "the description holds xacro that is not expanded.",
        remedy="Expand it first: xacro FILE.xacro > arm.urdf, and read arm.urdf.",
    )


def _root_remedy(tag: str) -> str:
    if tag.endswith("}robot"):
        return 'Take xmlns="…" out of <robot>: the elements of a description stand in no namespace.'
    return "Name a description in URDF, whose outermost element is <robot>; SDF and MJCF can be exported as URDF."


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
        if not links or not joints:
            raise CalibrationError(
                "the description has no joints, and so no arm."
                if links
                else "the description has no links, and so no arm.",
                remedy="Write it again from its source, with every <link> and <joint> between base and flange.",
            )
        above: dict[str, ET.Element] = {}
        for joint in joints:
            parent, child = link_of(joint, "parent"), link_of(joint, "child")
            for link in (parent, child):
                if link not in links:
                    raise CalibrationError(
                        make_message(
                            "joint {joint!r} names the link {link!r}, which the description does not have.",
                            joint=joint.get("name"),
                            link=link,
                        ),
                        remedy="Correct the name, or add the link.",
                    )
            if parent == child:
                raise CalibrationError(
                    make_message(
                        "joint {joint!r} hangs on itself: its parent and its child are {child!r}.",
                        joint=joint.get("name"),
                        child=child,
                    ),
                    remedy="Correct its <parent> or its <child>.",
                )
            if child in above:
                raise CalibrationError(
                    make_message(
                        "link {child!r} hangs on two joints, {first!r} and {joint!r}.",
                        child=child,
                        first=above[child].get("name"),
                        joint=joint.get("name"),
                    ),
                    remedy="A description is a tree: leave one of them out.",
                )
            above[child] = joint
        if len(above) == len(links):
            raise CalibrationError(
                make_message(
                    "no link of the description is its base: each hangs on a joint, {joint_names}.",
                    joint_names=_named([joint.get("name", "") for joint in above.values()]),
                ),
                remedy="A description is a tree: leave out the joint that leads back to the base.",
            )
        return cls(links, above)

    def base(self, link_name: str | None) -> str:
        if link_name is not None:
            return self._require_link("base", link_name)
        roots = [link for link in self.links if link not in self.above]
        if len(roots) != 1:
            raise CalibrationError(
                make_message(
                    "the description has {count} links that hang on nothing: {links}.",
                    count=len(roots),
                    links=_named(roots),
                ),
                remedy="Name the robot's base: ?base=LINK.",
            )
        return roots[0]

    def tip(self, link_name: str | None) -> str:
        if link_name is not None:
            return self._require_link("tip", link_name)
        carrying = {link_of(joint, "parent") for joint in self.above.values()}
        ends = [link for link in self.links if link not in carrying]
        if len(ends) != 1:
            raise CalibrationError(
                make_message(
                    "the description ends in {count} links, and none is named as the flange.", count=len(ends)
                ),
                remedy=make_message("Name it: ?tip=LINK, one of {links}.", links=_named(ends)),
            )
        return ends[0]

    def path(self, base: str, tip: str) -> list[ET.Element]:
        """Return the joints from the base to the tip."""
        path: list[ET.Element] = []
        link = tip
        while link != base:
            joint = self.above.get(link)
            if joint is None or len(path) > len(self.above):
                raise self._not_between(base, tip, path)
            path.insert(0, joint)
            link = link_of(joint, "parent")
        for joint in path:
            refuse_unusual(joint)
        return path

    def _not_between(self, base: str, tip: str, path: list[ET.Element]) -> CalibrationError:
        """Return why no chain leads from the base to the tip; ``path`` leads to the tip from where it ends."""
        why = make_message("link {tip!r} does not hang on link {base!r}.", tip=tip, base=base)
        if len(path) > len(self.above):
            return CalibrationError(
                make_message("the joints above link {tip!r} form a ring.", tip=tip),
                remedy="Let the base of the robot hang on nothing.",
            )
        above: list[str] = []
        link = base
        while (joint := self.above.get(link)) is not None and len(above) <= len(self.above):
            link = link_of(joint, "parent")
            above.append(link)
        if tip in above:
            return CalibrationError(
                why, remedy=make_message("Exchange them: ?base={tip}&tip={base}.", tip=tip, base=base)
            )
        there = [link_of(joint, "parent") for joint in path]
        return CalibrationError(
            why,
            remedy=make_message(
                "Name a base on the way from the root to the tip: {links}.", links=_named(there)
            )
            if there
            else "Name the tip that hangs on the base; this link hangs on nothing.",
        )

    def _require_link(self, what: str, link: str) -> str:
        if link in self.links:
            return link
        near = get_close_matches(link, self.links, n=1)
        there = (
            make_message("Did you mean {near}?", near=near[0])
            if near
            else make_message("It has {names}.", names=_named(self.links))
        )
        raise CalibrationError(
            make_message("the description has no link {link!r} for the base.", link=link)
            if what == "base"
            else make_message("the description has no link {link!r} for the tip.", link=link),
            remedy=there,
        )


def _refuse_twice(what: str, names: Iterable[str]) -> None:
    counted = Counter(names)
    if "" in counted:
        raise CalibrationError(
            "a link of the description has no name."
            if what == "link"
            else "a joint of the description has no name.",
            remedy="Give it one.",
        )
    for name, count in counted.items():
        if count > 1:
            raise CalibrationError(
                make_message("{count} links of the description are called {name!r}.", count=count, name=name)
                if what == "link"
                else make_message(
                    "{count} joints of the description are called {name!r}.", count=count, name=name
                ),
                remedy="Give each a name of its own.",
            )


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
