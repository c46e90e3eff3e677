"""An installation of PolyScope (``.installation``): its tools and features, for the programs that name them.

What is known of this format: gzip XML, tools below ``TCPSettings``, features in ``Geom…Node`` elements. Which
attributes hold the poses is not known from a document, so a frame is taken only where there can be no doubt: an
element with a name and one pose of six numbers, in itself or in one child. All others are named as not read.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import Self

import numpy as np

from cellcal.calibration.geometry import Pose
from cellcal.calibration.message import make_message
from cellcal.drivers.programs.errors import ProgramFileError
from cellcal.drivers.programs.file_declarations import ExternalUses, FileDeclarations
from cellcal.drivers.programs.positions import PositionChange, Positions, ProgramFrames, Remark
from cellcal.drivers.universal_robots.program_files.script_numbers import LONGEST_M, poses_of
from cellcal.drivers.universal_robots.program_files.script_text import SIX_NUMBERS
from cellcal.drivers.universal_robots.program_files.urp_archive import unpack_file
from cellcal.drivers.universal_robots.program_files.urp_columns import columns_of
from cellcal.drivers.universal_robots.program_files.urp_waypoints import BASE, WaypointReader
from cellcal.drivers.universal_robots.program_files.urp_xml import XmlText

_NAMES = ("name", "tcpName", "referencedName")
_POSES = ("pose", "offset", "tcpOffset")


@dataclass(frozen=True, eq=False)
class InstallationFile:
    """One ``.installation`` file; it has no positions."""

    file: str
    data: bytes
    xml: XmlText
    base_frame: dict[str, Pose]
    flange_tip: dict[str, Pose]
    remarks: tuple[Remark, ...]

    @property
    def declarations(self) -> FileDeclarations:
        """Return what counts for other files: nothing, a program names its features itself."""
        return FileDeclarations("")

    def with_external_uses(self, external_uses: ExternalUses) -> Self:
        """Return the installation itself."""
        return self

    @property
    def brand(self) -> str:
        """Return the brand's package name."""
        return "universal_robots"

    @property
    def name(self) -> str:
        """Return the installation's own name, or the file's."""
        return self.xml.attribute_value(0, "name") or self.file

    @cached_property
    def positions(self) -> Positions:
        """Return no positions."""
        return columns_of(self.xml, []).positions

    @cached_property
    def frames(self) -> ProgramFrames:
        """Return the tools and features, and the arm's kinematics where they are in the file."""
        own = WaypointReader(self.xml).own
        chain = own.chain if own else None
        base = {BASE: Pose((0.0, 0.0, 0.0)), **self.base_frame}
        return ProgramFrames(base, self.flange_tip, chain.to_model() if chain else None)

    def to_bytes(self) -> bytes:
        """Return the file."""
        return self.data

    def with_changes(self, change: PositionChange) -> Self:
        """Return the file itself; an installation has no positions to change."""
        if len(change.rows):
            raise ProgramFileError(
                self.file,
                "an installation has no positions.",
                remedy="Type its frames and tools on the pendant.",
            )
        return self


def read_installation(name: str, data: bytes) -> InstallationFile:
    """Read an ``.installation`` file.

    Raises
    ------
    ProgramFileError
        As for a program: no gzip, a bomb, damaged XML.
    """
    xml = XmlText(name, unpack_file(name, data)[1])
    if "Installation" not in xml.elements[0].tag:
        raise xml.error_at(
            xml.elements[0].offset,
            make_message("this is a {tag}, no installation.", tag=xml.elements[0].tag),
            "Give an .installation file.",
        )
    flange_tip: dict[str, Pose] = {}
    base_frame: dict[str, Pose] = {}
    doubtful: list[int] = []
    for element, into in _frame_elements(xml, base_frame, flange_tip):
        label = next((text for key in _NAMES if (text := xml.attribute_value(element, key))), "")
        poses = _element_poses(xml, element)
        if label and len(poses) == 1 and label not in into:
            into[label] = Pose.from_matrix(poses_of(np.array([poses[0]]))[0])
        elif label:
            doubtful.append(element)
    return InstallationFile(
        name, data, xml, base_frame, flange_tip, tuple(_installation_remarks(xml, doubtful))
    )


def _frame_elements(
    xml: XmlText, base: dict[str, Pose], tip: dict[str, Pose]
) -> Iterator[tuple[int, dict[str, Pose]]]:
    for i, element in enumerate(xml.elements):
        if element.tag.startswith("Geom") and element.tag.endswith("Node"):
            yield i, base
        elif xml.find_above(i, "TCPSettings") is not None:
            yield i, tip


def _element_poses(xml: XmlText, element: int) -> list[tuple[float, ...]]:
    """Return the poses of an element itself, or else of its children."""
    return _own_poses(xml, element) or [
        six for child in xml.children[element] for six in _own_poses(xml, child)
    ]


def _own_poses(xml: XmlText, element: int) -> list[tuple[float, ...]]:
    texts = [xml.attribute_value(element, key) for key in _POSES]
    found = [tuple(map(float, text.split(","))) for text in texts if SIX_NUMBERS.fullmatch(text)]
    return [six for six in found if all(abs(value) <= LONGEST_M for value in six)]


def _installation_remarks(xml: XmlText, doubtful: list[int]) -> Iterator[Remark]:
    yield Remark(
        0, "foreign", "an installation: compare its tools and features with the pendant before they are used."
    )
    for element in doubtful:
        line = xml.line_of(xml.elements[element].offset)
        tag = xml.elements[element].tag
        yield Remark(
            line,
            "foreign",
            make_message("{tag} has a name and not one pose of six numbers: it was not read.", tag=tag),
        )
