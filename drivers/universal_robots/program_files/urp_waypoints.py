"""The waypoints of a PolyScope program, as its XML holds them.

PolyScope 3.5 and later keeps joints, the tool and the kinematics (``JointAngles``, ``TCPOffset``, ``Kinematics``) and
no pose; older programs, and those of some simulators, keep joints and pose as attributes of ``position``. Source:
public programs in text form, listed in the README.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import NamedTuple

from cellcal.drivers.programs.positions import Remark
from cellcal.drivers.universal_robots.program_files.script_numbers import LARGEST_RAD, LONGEST_M
from cellcal.drivers.universal_robots.program_files.script_text import SIX_NUMBERS
from cellcal.drivers.universal_robots.program_files.urp_kinematics import KNOWN, Chain
from cellcal.drivers.universal_robots.program_files.urp_xml import XmlText

BASE = "base"
_BASE_NAMES = ("", "Joint_0_name", "Base_name")
_LONGEST_LINK_M = 1e6  # d of nearly parallel axes may be large
_COLUMNS = ("deltaTheta", "a", "d", "alpha")


class Six(NamedTuple):
    """Six numbers of one attribute, and where they stand."""

    start: int
    end: int
    values: tuple[float, ...]


@dataclass(frozen=True, slots=True)
class StoredKinematics:
    """One ``Kinematics`` element; ``chain`` is None where the file itself says that the numbers are not the arm's."""

    offset: int
    status: str
    columns: tuple[Six, ...]  # deltaTheta, a, d, alpha
    checksum: Six | None
    chain: Chain | None


@dataclass(frozen=True, slots=True)
class Waypoint:
    """One fixed waypoint."""

    name: str
    offset: int
    joints: Six
    tool: Six | None  # flange_tip
    tool_name: str
    feature: Six | None  # base_feature
    feature_name: str
    kinematics: StoredKinematics | None
    pose: Six | None = None  # base_tip, where it is stored
    in_feature: Six | None = None
    flange: Six | None = None


class Reader:
    """Reads waypoints and kinematics out of the XML."""

    def __init__(self, xml: XmlText) -> None:
        self.xml = xml
        tags: dict[str, list[int]] = {}
        for i, element in enumerate(xml.elements):
            tags.setdefault(element.tag, []).append(i)
        self.tags = tags
        self.kinematics = {
            i: self._kinematics(i) for tag in ("kinematics", "Kinematics") for i in tags.get(tag, ())
        }
        root = xml.child(0, "kinematics")
        self.own = self.kinematics[root] if root is not None else None
        self.read: set[int] = set()  # position elements that are waypoints of ours

    def waypoints(self) -> Iterator[Waypoint]:
        """Yield the fixed waypoints in the order of the file.

        Raises
        ------
        ProgramFileError
            One stands inside another, whose numbers would then be on both sides of it: the file is damaged.
        """
        for i in self.tags.get("Waypoint", ()):
            if self.xml.value(i, "type", "Fixed") == "Fixed":
                position = self.xml.child(i, "position")
                if position is not None and self._holds_joints(position):
                    if self.xml.above(i, "Waypoint") is not None:
                        raise self.xml.wrong(
                            self.xml.elements[i].offset, "this waypoint stands inside another one."
                        )
                    self.read.add(position)
                    yield self._waypoint(i, position)

    def remarks(self, waypoints: list[Waypoint]) -> Iterator[Remark]:
        """Yield what else carries positions, or changes them."""
        yield from self._of_kinematics(waypoints)
        kinds: dict[str, list[int]] = {}
        for i in self.tags.get("Waypoint", ()):
            kinds.setdefault(self.xml.value(i, "type", "Fixed"), []).append(i)
        yield from self._grouped(
            "relative",
            kinds.get("Relative", []),
            "relative waypoints: a step between two stored positions; not changed",
        )
        others = [i for kind, found in kinds.items() if kind not in ("Fixed", "Relative") for i in found]
        yield from self._grouped("indirect", others, "waypoints whose place is in a variable; not changed")
        empty = [i for i in kinds.get("Fixed", []) if self.xml.child(i, "position") not in self.read]
        yield from self._grouped("indirect", empty, "waypoints without joints of their own; not changed")
        stray = self.stray_joints()
        yield from self._grouped("foreign", stray, "joints that belong to no waypoint; not changed")
        scripts = self.tags.get("cachedContents", [])
        yield from self._grouped(
            "computed", scripts, "script nodes: their text may hold positions; not changed"
        )
        yield from self._grouped("computed", self._expressions(), "expressions with poses; not changed")
        yield from self._grouped(
            "foreign", self.tags.get("programFile", []), "subprograms of other files: change these, too"
        )
        yield from self._grouped(
            "foreign", self.tags.get("SafeHome", []), "moves to the installation's home position"
        )
        yield from self._grouped(
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
        yield from self._lines(
            "foreign",
            unknown,
            "waypoints whose kinematics are not stated, or nominal or another arm's: their poses are unknown",
        )
        own = self.own.chain if self.own else None
        other = [
            w.offset for w in waypoints
            if own and w.kinematics and w.kinematics.chain and w.kinematics.chain != own
        ]  # fmt: skip
        yield from self._lines(
            "foreign", other, "waypoints taught on another arm than the program was saved on"
        )

    def _kind_around(self, element: int) -> str:
        around = self.xml.above(element, "Waypoint")
        return "Fixed" if around is None else self.xml.value(around, "type", "Fixed")

    def _expressions(self) -> list[int]:
        found = []
        for i in self.tags.get("expression", ()):
            text = "".join(self.xml.value(c, "character") for c in self.xml.children[i])
            if "pose_" in text or "p[" in text or "_kin(" in text:
                found.append(i)
        return found

    def _grouped(self, code: str, elements: list[int], text: str) -> Iterator[Remark]:
        yield from self._lines(code, [self.xml.elements[i].offset for i in elements], text)

    def _lines(self, code: str, offsets: list[int], text: str) -> Iterator[Remark]:
        if offsets:
            lines = [self.xml.line(offset) for offset in offsets]
            shown = ", ".join(map(str, lines[:6])) + (f" and {len(lines) - 6} more" if len(lines) > 6 else "")
            yield Remark(lines[0], code, f"{text} (line {shown}).")

    def _holds_joints(self, position: int) -> bool:
        return (
            self.xml.child(position, "JointAngles") is not None
            or "joints" in self.xml.elements[position].attributes
        )

    def _waypoint(self, element: int, position: int) -> Waypoint:
        xml = self.xml
        angles = xml.child(position, "JointAngles")
        joints = (
            self.six(position, "joints", LARGEST_RAD)
            if angles is None
            else self.six(angles, "angles", LARGEST_RAD)
        )
        if joints is None:
            raise xml.wrong(xml.elements[element].offset, "a waypoint has no joint angles.")
        own = xml.child(position, "Kinematics")
        move = xml.above(element, "Move")
        return Waypoint(
            name=xml.value(element, "name") or f"line {xml.line(xml.elements[element].offset)}",
            offset=xml.elements[element].offset,
            joints=joints,
            tool=self._pose(xml.child(position, "TCPOffset")),
            tool_name=self._referenced(move, "tcp"),
            feature=self._pose(xml.child(element, "BaseToFeature")),
            feature_name=self._referenced(move, "feature"),
            kinematics=self.own if own is None else self.kinematics[own],
            pose=self._pose(position),
            in_feature=self._pose(xml.child(element, "poseInFeatureCoordinates")),
            flange=self._pose(xml.child(element, "outputFlangePose")),
        )

    def _pose(self, element: int | None) -> Six | None:
        return None if element is None else self.six(element, "pose", LONGEST_M)

    def _referenced(self, move: int | None, tag: str) -> str:
        element = None if move is None else self.xml.child(move, tag)
        if element is None:
            return ""
        element = self.xml.resolved(element)
        name = self.xml.value(element, "referencedName") if self.xml.elements[element].tag == tag else ""
        return BASE if tag == "feature" and name in _BASE_NAMES else name

    def _kinematics(self, element: int) -> StoredKinematics:
        xml = self.xml
        parts = [xml.child(element, name) for name in _COLUMNS]
        read = [self.six(part, "value", _LONGEST_LINK_M) if part is not None else None for part in parts]
        columns = tuple(six for six in read if six is not None)
        check = xml.child(element, "jointChecksum")
        status = xml.value(element, "status")
        known = status == KNOWN and len(columns) == len(_COLUMNS)
        return StoredKinematics(
            offset=xml.elements[element].offset,
            status=status,
            columns=columns,
            checksum=self.six(check, "value", 2.0**33) if check is not None else None,
            chain=Chain.of(*(six.values for six in columns)) if known else None,
        )

    def six(self, element: int, name: str, largest: float) -> Six | None:
        """Return six numbers of an attribute, None where there is no such attribute."""
        span = self.xml.elements[element].attributes.get(name)
        if span is None:
            return None
        text = self.xml.text[span[0] : span[1]]
        if not SIX_NUMBERS.fullmatch(text):
            raise self.xml.wrong(span[0], f"{name} has not six numbers.")
        values = tuple(float(number) for number in text.split(","))
        if not all(abs(value) <= largest for value in values):
            raise self.xml.wrong(span[0], f"a number of {name} is beyond what an arm can have.")
        return Six(*span, values)
