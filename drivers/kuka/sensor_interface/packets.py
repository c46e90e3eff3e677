"""Datagrams of the Robot Sensor Interface: XML with the joints and the controller's count.

Read are ``<AIPos A1="…" … A6="…"/>`` [deg] and ``<IPOC>…</IPOC>``, which every datagram carries; a configuration
may send more, which is passed over. IPOC orders the datagrams and is not taken as a clock: a public server of this
protocol counts 4 ms in a cycle of 8.
"""

import math
import re
from xml.etree.ElementTree import Element

from cellcal.calibration.documents.errors import DocumentError
from cellcal.calibration.documents.xml_text import parse_xml
from cellcal.drivers.wire.joint_stream import StreamPacket

AXES = 6
_MOST_OCTETS = 8192
_MOST_DEG = 1e4
_NUMBER = re.compile(r"[-+]?\d{1,9}(\.\d{1,17})?([eE][-+]?\d{1,3})?", re.ASCII)
_COUNT = re.compile(r"\d{1,18}", re.ASCII)


def read_robot_packet(data: bytes) -> StreamPacket:
    """Return count and joints of a ``<Rob>`` datagram.

    Raises
    ------
    ValueError
        The octets are no such datagram, or lack what is needed; a code says why, for the log.
    """
    if len(data) > _MOST_OCTETS:
        raise ValueError("datagram.too_long")
    try:
        root = parse_xml(data)
    except DocumentError as error:
        raise ValueError("datagram.no_xml") from error
    if root.tag != "Rob":
        raise ValueError("datagram.no_robot_data")
    position = _only(root, "AIPos")
    angles = [_angle(position.get(f"A{axis}")) for axis in range(1, AXES + 1)]
    count = (_only(root, "IPOC").text or "").strip()
    if not _COUNT.fullmatch(count):
        raise ValueError("datagram.count_out_of_range")
    return StreamPacket(int(count), None, tuple(map(math.radians, angles)))


def _only(root: Element, name: str) -> Element:
    found = root.findall(name)
    if len(found) != 1:
        raise ValueError("datagram.element_missing_or_doubled")
    return found[0]


def _angle(text: str | None) -> float:
    if text is None or not _NUMBER.fullmatch(text.strip()):
        raise ValueError("datagram.joint_missing_or_no_number")
    value = float(text)
    if not math.isfinite(value) or abs(value) > _MOST_DEG:
        raise ValueError("datagram.joint_out_of_range")
    return value
