"""PolyScope's XML with the place of every attribute, so that a number can be changed and nothing else.

A parser of the standard library says first whether the text is well-formed (no DTD, no entities of its own); our own
reading of it must then see the same elements and the same attributes, or the file is refused.
"""

import re
from collections.abc import Iterator, Mapping
from typing import NamedTuple
from xml.etree.ElementTree import Element as TreeElement
from xml.etree.ElementTree import ParseError

from cellcal.calibration.documents import DocumentError
from cellcal.calibration.documents.xml_text import parse_xml
from cellcal.calibration.message import make_message
from cellcal.drivers.programs.errors import ProgramFileError
from cellcal.drivers.programs.line_numbers import LineNumbers

_MARK = re.compile(
    r"""<!--.*?-->|<!\[CDATA\[.*?\]\]>|<\?.*?\?>
    |<(?P<slash>/?)(?P<tag>[^\s/>!?]++)(?P<attributes>(?:\s++[^\s=/>]++\s*+=\s*+(?:"[^"]*+"|'[^']*+'))*+)\s*+(?P<empty>/?)>""",
    re.DOTALL | re.VERBOSE,
)
_ATTRIBUTE = re.compile(r"""([^\s=/>]++)\s*+=\s*+(?:"([^"]*+)"|'([^']*+)')""", re.DOTALL)
_ENCODING = re.compile(r"""<\?xml[^>]*?encoding\s*=\s*["']([^"']*)""")
_REFERENCE = re.compile(r"&(#x?[0-9a-fA-F]+|\w+);")
_NAMED = {"lt": "<", "gt": ">", "amp": "&", "quot": '"', "apos": "'"}
_STEP = re.compile(r"([^\[\]]+)(?:\[(\d+)\])?")
_CURE = "Save the program again on the robot, or fetch it again."


class XmlElement(NamedTuple):
    """One element; its attributes by name, each with where its value stands."""

    tag: str
    offset: int
    parent: int  # -1 for the root
    attributes: Mapping[str, tuple[int, int]]


class XmlText:
    """A document as text with a character a byte (latin-1), and its elements in order."""

    def __init__(self, file: str, xml: bytes) -> None:
        self.file = file
        self.text = xml.decode("latin-1")
        tree = _parse_tree(file, xml)
        self._lines = LineNumbers(self.text)
        self.elements = list(self._read_elements())
        self.children: list[list[int]] = [[] for _ in self.elements]
        for i, element in enumerate(self.elements):
            if element.parent >= 0:
                self.children[element.parent].append(i)
        if not self._is_same_as(tree):
            raise ProgramFileError(file, "this XML can be read in two ways.", remedy=_CURE)

    def line_of(self, offset: int) -> int:
        """Return the line of an offset, from 1."""
        return self._lines.line_of(offset)

    def error_at(self, offset: int, what: str, remedy: str = _CURE) -> ProgramFileError:
        """Return the error for something at an offset of the XML."""
        line, column = self.line_of(offset), self._lines.column_of(offset)
        return ProgramFileError(self.file, what, line=line, column=column, remedy=remedy)

    def attribute_value(self, element: int, name: str, default: str = "") -> str:
        """Return an attribute as a person reads it."""
        span = self.elements[element].attributes.get(name)
        return default if span is None else _plain_value(self.text[span[0] : span[1]])

    def find_child(self, element: int, *tags: str) -> int | None:
        """Return the first child, of the first child, with these tags."""
        at: int | None = element
        for tag in tags:
            at = (
                next((i for i in self.children[at] if self.elements[i].tag == tag), None)
                if at is not None
                else None
            )
        return at

    def find_above(self, element: int, tag: str) -> int | None:
        """Return the nearest element around this one with a tag."""
        at = self.elements[element].parent
        while at >= 0 and self.elements[at].tag != tag:
            at = self.elements[at].parent
        return at if at >= 0 else None

    def resolve_reference(self, element: int) -> int:
        """Follow ``reference="../../Move[2]/feature"`` to the element it means; an element without one is itself."""
        at = element
        for step in self.attribute_value(element, "reference").split("/"):
            found = _STEP.fullmatch(step)
            if step == "..":
                at = max(self.elements[at].parent, 0)
            elif found:
                same = [i for i in self.children[at] if self.elements[i].tag == found[1]]
                which = int((found[2] or "1")[:9]) - 1  # no program has so many of one kind
                at = same[which] if which < len(same) else element
        return at

    def _read_elements(self) -> Iterator[XmlElement]:
        open_elements = [-1]
        count = 0
        for mark in _MARK.finditer(self.text):
            if mark["tag"] is None:
                continue
            if mark["slash"]:
                open_elements.pop()
                continue
            start = mark.start("attributes")
            attributes = {
                found[1]: _value_span(found, start) for found in _ATTRIBUTE.finditer(mark["attributes"])
            }
            yield XmlElement(mark["tag"], mark.start(), open_elements[-1], attributes)
            if not mark["empty"]:
                open_elements.append(count)
            count += 1

    def _is_same_as(self, tree: TreeElement) -> bool:
        theirs = list(tree.iter())
        return len(theirs) == len(self.elements) and all(
            self._is_same_tree(i, element) for i, element in enumerate(theirs)
        )

    def _is_same_tree(self, i: int, theirs: TreeElement) -> bool:
        ours = self.elements[i]
        if ours.tag.rpartition(":")[2] != theirs.tag.rpartition("}")[2]:
            return False
        return all(
            self.attribute_value(i, name) == theirs.attrib.get(name)
            for name in ours.attributes
            if ":" not in name and name != "xmlns"
        )


def _parse_tree(file: str, xml: bytes) -> TreeElement:
    encoding = _ENCODING.match(xml[:200].decode("latin-1").lstrip("\xef\xbb\xbf"))
    if encoding and encoding[1].upper() not in ("UTF-8", "US-ASCII", "ASCII"):
        raise ProgramFileError(
            file,
            make_message("the XML is in {encoding}.", encoding=encoding[1]),
            line=1,
            column=1,
            remedy="PolyScope writes UTF-8.",
        )
    try:
        return parse_xml(xml)
    except DocumentError as wrong:
        cause = wrong.__cause__
        if isinstance(cause, ParseError):
            line, column = cause.position
            raise ProgramFileError(
                file,
                make_message("the XML is damaged ({cause}).", cause=cause),
                line=line,
                column=column + 1,
                remedy=_CURE,
            ) from wrong
        raise ProgramFileError(
            file,
            make_message("the XML has parts that no program needs ({why}).", why=wrong.why),
            remedy="Do not open files of unknown origin.",
        ) from wrong


def _value_span(found: re.Match[str], start: int) -> tuple[int, int]:
    which = 2 if found[2] is not None else 3
    return start + found.start(which), start + found.end(which)


def _plain_value(text: str) -> str:
    """Return an attribute's value as XML means it: references resolved, white space blank, UTF-8."""
    text = text.encode("latin-1").decode("utf-8", "replace")
    if "\n" in text or "\t" in text or "\r" in text:
        text = text.replace("\r\n", " ").replace("\n", " ").replace("\r", " ").replace("\t", " ")
    return _REFERENCE.sub(_resolve_entity, text) if "&" in text else text


def _resolve_entity(found: re.Match[str]) -> str:
    name = found[1]
    if not name.startswith("#"):
        return _NAMED.get(name, found[0])
    number = int(name[2:], 16) if name[1] == "x" else int(name[1:])
    return chr(number) if number < 0x110000 else found[0]
