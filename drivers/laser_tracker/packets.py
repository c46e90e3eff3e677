"""The packets of the emScon wire: little endian, packed to 4 bytes, size and type first.

Source: Leica Geosystems, ES_C_API_Def.h of the emScon TPI/SDK 3.6 (structures and numbers; `long` and enums are
4 bytes, `double` 8). Positions count from the byte after the header of 8.
"""

import struct
from dataclasses import dataclass, replace
from enum import IntEnum

HEADER = struct.Struct("<iI")  # size of the whole packet, type
ANSWER = struct.Struct("<II")  # command, status
WORD = struct.Struct("<I")
MOST_BYTES = 65_536

Triple = tuple[float, float, float]


class PacketKind(IntEnum):
    """ES_DataType."""

    COMMAND = 0
    ERROR = 1
    POINT = 2
    POINT_SERIES = 3
    PROBE = 4
    PROBE_SERIES = 5
    LEVEL = 6
    TARGET_PLACE = 7
    STATUS_CHANGE = 8
    POINT_WITH_COVARIANCE = 9
    POINT_SERIES_WITH_COVARIANCE = 10
    PROBE_PLACE = 11


class TrackerCommand(IntEnum):
    """ES_Command, as far as it is used here."""

    GET_SYSTEM_STATUS = 1
    GET_TRACKER_STATUS = 2
    SET_UNITS = 5
    GET_UNITS = 6
    INITIALIZE = 7
    GET_STATION_ORIENTATION = 13
    GET_TRANSFORMATION = 15
    SET_MEASUREMENT_MODE = 24
    GET_MEASUREMENT_MODE = 25
    SET_COORDINATE_SYSTEM = 26
    GET_COORDINATE_SYSTEM = 27
    GET_REFLECTOR = 41
    SET_SYSTEM_SETTINGS = 47
    GET_SYSTEM_SETTINGS = 48
    START_MEASUREMENT = 49
    STOP_MEASUREMENT = 52
    FIND_REFLECTOR = 63
    UNKNOWN = 64  # the command of an unsolicited error: a broken beam
    SET_STATISTIC_MODE = 80
    GET_COMPENSATION = 85
    GET_TRACKER_INFO = 132


class MeasurementMode(IntEnum):
    """ES_MeasMode, as far as it is used here."""

    POINT = 0
    PROBE = 6


class StatusChange(IntEnum):
    """ES_SystemStatusChange, as far as it means something here."""

    UNITS = 6
    REFLECTOR = 7
    SYSTEM_SETTINGS = 8
    COMPENSATION = 11
    COORDINATE_SYSTEM = 12
    STATION_ORIENTATION = 15
    TRANSFORMATION = 16
    MEASUREMENT_MODE = 17
    NOT_READY = 25
    INITIALIZATION = 151
    TILT = 152
    SENSOR_DETECTED = 850
    SENSOR_DISCONNECTED = 851
    SERVER_STARTED = 999


SIZES = {
    PacketKind.ERROR: 16,
    PacketKind.POINT: 156,
    PacketKind.PROBE: 376,
    PacketKind.LEVEL: 40,
    PacketKind.TARGET_PLACE: 36,
    PacketKind.STATUS_CHANGE: 12,
    PacketKind.POINT_WITH_COVARIANCE: 204,
    PacketKind.PROBE_PLACE: 108,
}
RESULTS = frozenset({PacketKind.POINT, PacketKind.POINT_WITH_COVARIANCE, PacketKind.PROBE})

_POINT = struct.Struct("<IIi17d")  # status, mode, try, values
_POINT_WITH_COVARIANCE = struct.Struct("<IIi23d")
_PROBE = struct.Struct("<IIi7i41d")  # status, mode, try, seven words, values
_POINT_FIELDS = {"value": 0, "scatter": 3, "expected": 10, "air": 14}
_COVARIANCE_FIELDS = {"value": 0, "scatter": 3, "expected": 13, "covariance": 17, "air": 20}
_PROBE_FIELDS = {"value": 0, "scatter": 3, "expected": 10, "covariance": 14, "quaternion": 17, "turn_scatter": 24,
                 "turn_expected": 31, "air": 38}  # fmt: skip


@dataclass(frozen=True, slots=True)
class StationaryResult:
    """One stationary result as the wire has it, in the units that were set."""

    kind: PacketKind
    status: int
    mode: int
    is_try: bool
    value: Triple
    scatter: Triple  # standard deviation of the samples of this measurement
    expected: Triple  # what the tracker expects of itself here, a priori
    covariance: Triple  # xy, xz, yz of what it expects
    air: Triple  # temperature, pressure, humidity
    quaternion: tuple[float, float, float, float] = (1.0, 0.0, 0.0, 0.0)
    turn_scatter: Triple = (0.0, 0.0, 0.0)
    turn_expected: Triple = (0.0, 0.0, 0.0)
    rotation_status: int = 1
    tip_status: int = 0
    raw: str = ""


def encode_packet(kind: PacketKind, body: bytes) -> bytes:
    """Return a whole packet."""
    return HEADER.pack(HEADER.size + len(body), kind) + body


def encode_command(number: TrackerCommand, parameters: bytes = b"") -> bytes:
    """Return a command with its parameters."""
    return encode_packet(PacketKind.COMMAND, WORD.pack(number) + parameters)


def decode_result(kind: PacketKind, body: bytes) -> StationaryResult:
    """Decode a stationary result of a type in ``RESULTS``; the size has been checked."""
    layout, fields = {
        PacketKind.POINT: (_POINT, _POINT_FIELDS),
        PacketKind.POINT_WITH_COVARIANCE: (_POINT_WITH_COVARIANCE, _COVARIANCE_FIELDS),
        PacketKind.PROBE: (_PROBE, _PROBE_FIELDS),
    }[kind]
    status, mode, is_try, *rest = layout.unpack(body)
    words = rest[: 7 if kind is PacketKind.PROBE else 0]
    values = rest[len(words) :]

    def triple_of(name: str) -> Triple:
        at = fields.get(name)
        return (0.0, 0.0, 0.0) if at is None else (values[at], values[at + 1], values[at + 2])

    plain = StationaryResult(
        kind, status, mode, bool(is_try),
        triple_of("value"), triple_of("scatter"), triple_of("expected"), triple_of("covariance"),
        triple_of("air"), raw=encode_packet(kind, body).hex(),
    )  # fmt: skip
    return plain if kind is not PacketKind.PROBE else _with_turn(plain, words, values)


def _with_turn(plain: StationaryResult, words: list[int], values: list[float]) -> StationaryResult:
    """Add what only a probe's result has: of the words, the second is its rotation and the fifth its tip."""
    q, s, e = (_PROBE_FIELDS[name] for name in ("quaternion", "turn_scatter", "turn_expected"))
    return replace(
        plain,
        quaternion=(values[q], values[q + 1], values[q + 2], values[q + 3]),
        turn_scatter=(values[s], values[s + 1], values[s + 2]),
        turn_expected=(values[e], values[e + 1], values[e + 2]),
        rotation_status=words[1],
        tip_status=words[4],
    )
