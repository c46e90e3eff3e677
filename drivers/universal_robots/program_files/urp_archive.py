"""The gzip around PolyScope's XML: opened within bounds, closed with the header it had.

Source: RFC 1952. A file that is XML already stays without gzip.
"""

import zlib

from cellcal.calibration.message import make_message
from cellcal.drivers.programs.errors import ProgramFileError

MOST_XML_BYTES = 32 << 20
_MOST_RATIO = 250  # PolyScope's own files reach 60; a bomb reaches 1000
_FREE_BYTES = 1 << 20  # below this no ratio is too much
_MAGIC = b"\x1f\x8b\x08"
_CRC, _EXTRA, _NAME, _COMMENT = 2, 4, 8, 16
_FETCH = "Fetch the file from the robot again, as binary."


def unpack_file(file: str, data: bytes) -> tuple[bytes, bytes]:
    """Return the gzip header (empty where there is none) and the XML.

    Raises
    ------
    ProgramFileError
        Neither gzip nor XML, damaged, cut short, followed by something, or far larger than a program can be.
    """
    if not data.startswith(_MAGIC):
        if not data.lstrip(b"\xef\xbb\xbf \t\r\n").startswith(b"<"):
            raise ProgramFileError(file, "this is neither gzip nor XML.", remedy=_FETCH)
        return b"", _check_size(file, data, len(data))
    header = _gzip_header(file, data)
    inflate = zlib.decompressobj(zlib.MAX_WBITS | 16)
    most = min(MOST_XML_BYTES, max(_FREE_BYTES, _MOST_RATIO * len(data)))
    try:
        xml = inflate.decompress(data, most + 1)
    except zlib.error as wrong:
        raise ProgramFileError(
            file, make_message("the gzip data are damaged ({error}).", error=wrong), remedy=_FETCH
        ) from wrong
    _check_size(file, xml, len(data))
    if len(xml) > most or (not inflate.eof and inflate.unconsumed_tail):
        raise _too_large_error(file, len(data))
    if not inflate.eof:
        raise ProgramFileError(file, "the gzip data end too soon.", remedy=_FETCH)
    if inflate.unused_data:
        raise ProgramFileError(file, "something follows the gzip data.", remedy=_FETCH)
    return header, xml


def pack_file(header: bytes, xml: bytes) -> bytes:
    """Return the file: the same header and XML always give the same bytes."""
    if not header:
        return xml
    deflate = zlib.compressobj(6, zlib.DEFLATED, -zlib.MAX_WBITS)
    body = deflate.compress(xml) + deflate.flush()
    tail = zlib.crc32(xml).to_bytes(4, "little") + (len(xml) & 0xFFFFFFFF).to_bytes(4, "little")
    return header + body + tail


def _gzip_header(file: str, data: bytes) -> bytes:
    flags = data[3] if len(data) > 3 else 0
    at = 10
    if flags & _EXTRA:
        at += 2 + int.from_bytes(data[10:12], "little")
    for flag in (_NAME, _COMMENT):
        if flags & flag:
            at = data.find(b"\0", at) + 1 or len(data)
    at += 2 if flags & _CRC else 0
    if at >= len(data):
        raise ProgramFileError(file, "the gzip data end too soon.", remedy=_FETCH)
    return data[:at]


def _check_size(file: str, xml: bytes, size: int) -> bytes:
    if len(xml) > MOST_XML_BYTES:
        raise _too_large_error(file, size)
    return xml


def _too_large_error(file: str, size: int) -> ProgramFileError:
    return ProgramFileError(
        file,
        make_message("{size} bytes unpack to more than a program can be; unpacking was stopped.", size=size),
        remedy=make_message(
            "A program has at most {most_xml_bytes} MiB of XML; fetch it from the robot again.",
            most_xml_bytes=MOST_XML_BYTES >> 20,
        ),
    )
