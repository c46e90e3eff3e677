"""Bytes of the emScon wire, as the maker's header file lays them out.

Imitates
    The packets between an emScon server and its clients.
Source
    Leica Geosystems, ES_C_API_Def.h of the emScon TPI/SDK 3.6; sizes checked against the Python package cesapi
    1.1.3, which was generated from the same header by others.
Modelled
    Commands and answers that a measuring program needs, the three stationary results, errors and status changes.
Not modelled
    Continuous modes, inclination sensor, cameras, trigger boards.
"""

import struct
from collections.abc import Sequence

DT_COMMAND, DT_ERROR, DT_SINGLE, DT_PROBE, DT_STATUS, DT_SINGLE2 = 0, 1, 2, 4, 8, 9

C_GET_SYSTEM_STATUS, C_GET_TRACKER_STATUS, C_SET_UNITS, C_GET_UNITS, C_INITIALIZE = 1, 2, 5, 6, 7
C_SET_ORIENTATION, C_GET_ORIENTATION, C_SET_TRANSFORMATION, C_GET_TRANSFORMATION = 12, 13, 14, 15
C_SET_ENVIRONMENT, C_GET_ENVIRONMENT, C_SET_MODE, C_GET_MODE, C_SET_AXES, C_GET_AXES = 20, 21, 24, 25, 26, 27
C_SET_STATIONARY, C_GET_STATIONARY, C_SET_REFLECTOR, C_GET_REFLECTOR = 28, 29, 40, 41
C_SET_SETTINGS, C_GET_SETTINGS, C_START, C_STOP, C_BIRD_BATH, C_FIND, C_UNKNOWN = 47, 48, 49, 52, 54, 63, 64
C_SET_STATISTICS, C_GET_STATISTICS, C_GET_COMPENSATION, C_GET_TRACKER_INFO = 80, 81, 85, 132

RS_OK, RS_BUSY, RS_NOT_IMPLEMENTED, RS_WRONG_PARAMETER, RS_UNKNOWN, RS_NOT_INITIALIZED = 0, 1, 2, 3, 36, 39
RS_NO_SIX_D, RS_NO_PROBE, RS_NOT_READY, RS_NO_RESULT = 92, 75, 10004, 10009

SSC_UNITS, SSC_REFLECTOR, SSC_SETTINGS, SSC_COMPENSATION, SSC_AXES, SSC_ENVIRONMENT = 6, 7, 8, 11, 12, 2
SSC_ORIENTATION, SSC_TRANSFORMATION, SSC_MODE, SSC_STATISTICS = 15, 16, 17, 24
SSC_NOT_READY, SSC_BUSY, SSC_READY, SSC_INITIALIZATION, SSC_TILT = 25, 26, 27, 151, 152

MM_STATIONARY, MM_6D_STATIONARY = 0, 6
HEADER_BYTES = 8


def make_packet(kind: int, body: bytes) -> bytes:
    """Put the header of size and type before a body."""
    return struct.pack("<iI", HEADER_BYTES + len(body), kind) + body


def make_reply(command: int, status: int, values: bytes = b"") -> bytes:
    """Answer a command."""
    return make_packet(DT_COMMAND, struct.pack("<II", command, status) + values)


def make_error(command: int, status: int) -> bytes:
    """Tell of an error that is no answer."""
    return make_packet(DT_ERROR, struct.pack("<II", command, status))


def status_change(code: int) -> bytes:
    """Tell of an event."""
    return make_packet(DT_STATUS, struct.pack("<I", code))


def single_result(mode: int, is_try: int, values: Sequence[float]) -> bytes:
    """Return SingleMeasResultT: 17 doubles."""
    return make_packet(DT_SINGLE, struct.pack("<IIi17d", RS_OK, mode, is_try, *values))


def single_result_2(mode: int, is_try: int, values: Sequence[float]) -> bytes:
    """Return SingleMeasResult2T: 23 doubles."""
    return make_packet(DT_SINGLE2, struct.pack("<IIi23d", RS_OK, mode, is_try, *values))


def probe_result(is_try: int, words: Sequence[int], values: Sequence[float]) -> bytes:
    """Return ProbeStationaryResultT: seven words and 41 doubles."""
    return make_packet(DT_PROBE, struct.pack("<IIi7i41d", RS_OK, MM_6D_STATIONARY, is_try, *words, *values))


def wide_text(text: str, characters: int = 32) -> bytes:
    """Return text as 16-bit characters, filled up with zeros."""
    return text.encode("utf-16-le").ljust(2 * characters, b"\0")
