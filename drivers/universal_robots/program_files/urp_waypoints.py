"""The waypoints of a PolyScope program, as its XML holds them.

PolyScope 3.5 and later keeps joints, the tool and the kinematics (``JointAngles``, ``TCPOffset``, ``Kinematics``) and
no pose; older programs, and those of some simulators, keep joints and pose as attributes of ``position``. Source:
public programs in text form, listed in the README.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import NamedTuple

from cellcal.calibration.message import make_message
from cellcal.drivers.programs.positions import Remark
from cellcal.drivers.universal_robots.program_files.script_numbers import LARGEST_RAD, LONGEST_M
from cellcal.drivers.universal_robots.program_files.script_text import SIX_NUMBERS
from cellcal.drivers.universal_robots.program_files.urp_kinematics import LINEARIZED_STATUS, DhChain
from cellcal.drivers.universal_robots.program_files.urp_xml import XmlText

BASE = "base"
_BASE_NAMES = ("", "Joint_0_name", "Base_name")
_LONGEST_LINK_M = 1e6  # d of nearly parallel axes may be large
_COLUMNS = ("deltaTheta", "a", "d", "alpha")


class SixNumbers(NamedTuple):
    """Six numbers of one attribute, and where they stand."""

    start: int
    end: int
    values: tuple[float, ...]


@dataclass(frozen=True, slots=True)
class StoredKinematics:
    """One ``Kinematics`` element; ``chain`` is None where the file itself says that the numbers are not the arm's."""

    offset: int
    status: str
    columns: tuple[SixNumbers, ...]  # deltaTheta, a, d, alpha
    checksum: SixNumbers | None
    chain: DhChain | None


@dataclass(frozen=True, slots=True)
class Waypoint:
    """One fixed waypoint."""

    name: str
    offset: int
    joints: SixNumbers
    tool: SixNumbers | None  # flange_tip
    tool_name: str
    feature: SixNumbers | None  # base_feature
    feature_name: str
    kinematics: StoredKinematics | None
    pose: SixNumbers | None = None  # base_tip, where it is stored
    in_feature: SixNumbers | None = None
    flange: SixNumbers | None = None


_POSES_BESIDE = ("BaseToFeature", "poseInFeatureCoordinates", "outputFlangePose")


class WaypointReader:
    """Reads waypoints and kinematics out of the XML."""

    def __init__(self, xml: XmlText) -> None:
        self.xml = xml
        tags: dict[str, list[int]] = {}
        for i, element in enumerate(xml.elements):
            tags.setdefault(element.tag, []).append(i)
        self.tags = tags
        self.kinematics = {
            i: self._read_kinematics(i) for tag in ("kinematics", "Kinematics") for i in tags.get(tag, ())
        }
        root = xml.find_child(0, "kinematics")
        self.own = self.kinematics[root] if root is not None else None
        self.read: set[int] = set()  # position elements that are waypoints of ours
        self.broken: list[int] = []  # waypoints with what is no number

    def read_waypoints(self) -> Iterator[Waypoint]:
        """Yield the fixed waypoints in the order of the file.

        Raises
        ------
        ProgramFileError
            One stands inside another, whose numbers would then be on both sides of it: the file is damaged.
        """
        for i in self.tags.get("Waypoint", ()):
            if self.xml.attribute_value(i, "type", "Fixed") == "Fixed":
                position = self.xml.find_child(i, "position")
                if position is not None and self._holds_joints(position):
                    if self.xml.find_above(i, "Waypoint") is not None:
                        raise self.xml.error_at(
                            self.xml.elements[i].offset, "this waypoint stands inside another one."
                        )
                    self.read.add(position)
                    if self._is_broken(i, position):
                        self.broken.append(i)
                        continue
                    yield self._read_waypoint(i, position)

    def list_remarks(self, waypoints: list[Waypoint]) -> Iterator[Remark]:
        """Yield what else carries positions, or changes them."""
        yield from self._of_kinematics(waypoints)
        kinds: dict[str, list[int]] = {}
        for i in self.tags.get("Waypoint", ()):
            kinds.setdefault(self.xml.attribute_value(i, "type", "Fixed"), []).append(i)
        yield from self._element_remarks(
            "relative",
            kinds.get("Relative", []),
            "relative waypoints: a step between two stored positions; not changed",
        )
        others = [i for kind, found in kinds.items() if kind not in ("Fixed", "Relative") for i in found]
        yield from self._element_remarks(
            "indirect", others, "waypoints whose place is in a variable; not changed"
        )
        empty = [i for i in kinds.get("Fixed", []) if self.xml.find_child(i, "position") not in self.read]
        yield from self._element_remarks(
            "indirect", empty, "waypoints without joints of their own; not changed"
        )
        stray = self.stray_joints()
        yield from self._element_remarks("foreign", stray, "joints that belong to no waypoint; not changed")
        scripts = self.tags.get("cachedContents", [])
        yield from self._element_remarks(
            "computed", scripts, "script nodes: their text may hold positions; not changed"
        )
        yield from self._element_remarks(
            "computed", self._pose_expressions(), "expressions with poses; not changed"
        )
        yield from self._element_remarks(
            "foreign", self.tags.get("programFile", []), "subprograms of other files: change these, too"
        )
        yield from self._element_remarks(
            "foreign", self.tags.get("SafeHome", []), "moves to the installation's home position"
        )
        yield from self._element_remarks(
            "foreign",
            self.tags.get("Contributed", []),
            "nodes of a URCap: what they hold is not known; not changed",
        )

    def stray_joints(self) -> list[int]:
        """Return elements with joints that belong to no waypoint."""
        return [
            i for i in self.tags.get("JointAngles", ())
            if self.xml.elements[i].parent not in self.read and self._kind_around(i) == "Fixed"
        ]  # fmt: skip

    def _of_kinematics(self, waypoints: list[Waypoint]) -> Iterator[Remark]:
        unknown = [w.offset for w in waypoints if w.kinematics is None or w.kinematics.chain is None]
        yield from self._line_remarks(
            "foreign",
            unknown,
            "waypoints whose kinematics are not stated, or nominal or another arm's: their poses are unknown",
        )
        own = self.own.chain if self.own else None
        other = [
            w.offset for w in waypoints
            if own and w.kinematics and w.kinematics.chain and w.kinematics.chain != own
        ]  # fmt: skip
        yield from self._line_remarks(
            "foreign", other, "waypoints taught on another arm than the program was saved on"
        )

    def _kind_around(self, element: int) -> str:
        around = self.xml.find_above(element, "Waypoint")
        return "Fixed" if around is None else self.xml.attribute_value(around, "type", "Fixed")

    def _pose_expressions(self) -> list[int]:
        found = []
        for i in self.tags.get("expression", ()):
            text = "".join(self.xml.attribute_value(c, "character") for c in self.xml.children[i])
            if "pose_" in text or "p[" in text or "_kin(" in text:
                found.append(i)
        return found

    def _element_remarks(self, code: str, elements: list[int], text: str) -> Iterator[Remark]:
        yield from self._line_remarks(code, [self.xml.elements[i].offset for i in elements], text)

    def _line_remarks(self, code: str, offsets: list[int], text: str) -> Iterator[Remark]:
        if offsets:
            lines = [self.xml.line_of(offset) for offset in offsets]
            shown = ", ".join(map(str, lines[:6])) + (f" and {len(lines) - 6} more" if len(lines) > 6 else "")
            yield Remark(lines[0], code, make_message("{text} (line {where}).", text=text, where=shown))

    def _holds_joints(self, position: int) -> bool:
        return (
            self.xml.find_child(position, "JointAngles") is not None
            or "joints" in self.xml.elements[position].attributes
        )

    def _is_broken(self, element: int, position: int) -> bool:
        """Return whether joints or a pose of a waypoint are not six numbers."""
        xml = self.xml
        parts = (
            (position, "joints"),
            (position, "pose"),
            (xml.find_child(position, "JointAngles"), "angles"),
            (xml.find_child(position, "TCPOffset"), "pose"),
            *((xml.find_child(element, tag), "pose") for tag in _POSES_BESIDE),
        )
        spans = (xml.elements[part].attributes.get(name) for part, name in parts if part is not None)
        return any(span is not None and not SIX_NUMBERS.fullmatch(xml.text[slice(*span)]) for span in spans)

    def _read_waypoint(self, element: int, position: int) -> Waypoint:
        xml = self.xml
        angles = xml.find_child(position, "JointAngles")
        joints = (
            self.read_six(position, "joints", LARGEST_RAD)
            if angles is None
            else self.read_six(angles, "angles", LARGEST_RAD)
        )
        if joints is None:
            raise xml.error_at(xml.elements[element].offset, "a waypoint has no joint angles.")
        own = xml.find_child(position, "Kinematics")
        move = xml.find_above(element, "Move")
        return Waypoint(
            name=xml.attribute_value(element, "name") or f"line {xml.line_of(xml.elements[element].offset)}",
            offset=xml.elements[element].offset,
            joints=joints,
            tool=self._read_pose(xml.find_child(position, "TCPOffset")),
            tool_name=self._referenced_name(move, "tcp"),
            feature=self._read_pose(xml.find_child(element, "BaseToFeature")),
            feature_name=self._referenced_name(move, "feature"),
            kinematics=self.own if own is None else self.kinematics[own],
            pose=self._read_pose(position),
            in_feature=self._read_pose(xml.find_child(element, "poseInFeatureCoordinates")),
            flange=self._read_pose(xml.find_child(element, "outputFlangePose")),
        )

    def _read_pose(self, element: int | None) -> SixNumbers | None:
        return None if element is None else self.read_six(element, "pose", LONGEST_M)

    def _referenced_name(self, move: int | None, tag: str) -> str:
        element = None if move is None else self.xml.find_child(move, tag)
        if element is None:
            return ""
        element = self.xml.resolve_reference(element)
        name = (
            self.xml.attribute_value(element, "referencedName")
            if self.xml.elements[element].tag == tag
            else ""
        )
        return BASE if tag == "feature" and name in _BASE_NAMES else name

    def _read_kinematics(self, element: int) -> StoredKinematics:
        xml = self.xml
        parts = [xml.find_child(element, name) for name in _COLUMNS]
        read = [self.read_six(part, "value", _LONGEST_LINK_M) if part is not None else None for part in parts]
        columns = tuple(six for six in read if six is not None)
        check = xml.find_child(element, "jointChecksum")
        status = xml.attribute_value(element, "status")
        is_known = status == LINEARIZED_STATUS and len(columns) == len(_COLUMNS)
        return StoredKinematics(
            offset=xml.elements[element].offset,
            status=status,
            columns=columns,
            checksum=self.read_six(check, "value", 2.0**33) if check is not None else None,
            chain=DhChain.from_columns(*(six.values for six in columns)) if is_known else None,
        )

    def read_six(self, element: int, name: str, largest: float) -> SixNumbers | None:
        """Return six numbers of an attribute, None where there is no such attribute."""
        span = self.xml.elements[element].attributes.get(name)
        if span is None:
            return None
        text = self.xml.text[span[0] : span[1]]
        if not SIX_NUMBERS.fullmatch(text):
            raise self.xml.error_at(span[0], make_message("{name} has not six numbers.", name=name))
        values = tuple(float(number) for number in text.split(","))
        if not all(abs(value) <= largest for value in values):
            raise self.xml.error_at(
                span[0], make_message("a number of {name} is beyond what an arm can have.", name=name)
            )
        return SixNumbers(*span, values)
