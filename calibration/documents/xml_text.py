"""XML within limits: no document type, no entities of its own, bounded size, depth and number of elements."""

from xml.etree.ElementTree import Element, ParseError

from defusedxml import DefusedXmlException  # ships no types
from defusedxml.ElementTree import fromstring  # ships no types

from cellcal.calibration.documents.errors import DocumentError
from cellcal.calibration.message import make_message

MOST_CHARACTERS = 64_000_000
_MOST_DEPTH = 100
_CURE = "Save or export it again."


def parse_xml(raw: bytes | str, *, most_depth: int = _MOST_DEPTH) -> Element:
    """Return the root of an XML document.

    Raises
    ------
    DocumentError
        It is no XML, declares a document type, or goes past a limit.
    """
    if len(raw) > MOST_CHARACTERS:
        raise _xml_error(make_message("it is larger than {most} MB", most=MOST_CHARACTERS // 1_000_000))
    try:
        root: Element = fromstring(raw, forbid_dtd=True)
    except ParseError as error:
        raise _xml_error(str(error)) from error
    except DefusedXmlException as error:
        raise _xml_error("it declares a document type or entities") from error
    except (ValueError, LookupError, OverflowError, RecursionError) as error:
        raise _xml_error(str(error)[:200]) from error  # half characters, an encoding that is none
    _refuse_depth(root, most_depth)
    return root


def _refuse_depth(root: Element, most_depth: int) -> None:
    level, depth = [root], 0
    while level:
        depth += 1
        if depth > most_depth:
            raise _xml_error(f"it is nested deeper than {most_depth} levels")
        level = [child for element in level for child in element]


def _xml_error(why: str) -> DocumentError:
    return DocumentError(f"it is no XML that can be used: {why}.", remedy=_CURE)
