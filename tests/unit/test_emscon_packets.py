"""Bytes of the emScon wire, written down from the maker's header; cesapi 1.1.3 packs the same."""

import struct

import pytest

from cellcal.drivers.laser_tracker.packets import (
    RESULTS,
    SIZES,
    PacketKind,
    TrackerCommand,
    decode_result,
    encode_command,
)


@pytest.mark.parametrize(
    ("number", "parameters", "golden"),
    [
        (TrackerCommand.INITIALIZE, b"", "0c000000 00000000 07000000"),
        (TrackerCommand.START_MEASUREMENT, b"", "0c000000 00000000 31000000"),
        (TrackerCommand.GET_SYSTEM_STATUS, b"", "0c000000 00000000 01000000"),
        (
            TrackerCommand.SET_UNITS,
            struct.pack("<5I", 0, 0, 0, 0, 0),
            "20000000 00000000 05000000" + " 00000000" * 5,
        ),
        (
            TrackerCommand.FIND_REFLECTOR,
            struct.pack("<d", 3.0),
            "14000000 00000000 3f000000 0000000000000840",
        ),
        (TrackerCommand.SET_MEASUREMENT_MODE, struct.pack("<I", 6), "10000000 00000000 18000000 06000000"),
    ],
)
def test_commands(number: TrackerCommand, parameters: bytes, golden: str) -> None:
    assert encode_command(number, parameters) == bytes.fromhex(golden)


def packet_body(words: tuple[int, ...], count: int) -> bytes:
    """Return status, words and the numbers 1, 2, 3, … as doubles."""
    return struct.pack(f"<I{len(words)}i{count}d", 0, *words, *(float(n) for n in range(1, count + 1)))


def test_a_point_has_seventeen_numbers() -> None:
    found = decode_result(PacketKind.POINT, packet_body((0, 1), 17))
    assert found.is_try
    assert (found.value, found.scatter) == ((1, 2, 3), (4, 5, 6))
    assert found.expected == (11, 12, 13)  # 7 is their total, 8 to 10 are pointing errors, 14 a total again
    assert found.air == (15, 16, 17)
    assert found.covariance == (0, 0, 0)


def test_a_point_with_covariance_has_twenty_three() -> None:
    found = decode_result(PacketKind.POINT_WITH_COVARIANCE, packet_body((0, 0), 23))
    assert (found.value, found.scatter) == ((1, 2, 3), (4, 5, 6))
    assert found.expected == (14, 15, 16)  # 8 to 10 are the scatter's covariances, 11 to 13 pointing errors
    assert found.covariance == (18, 19, 20)
    assert found.air == (21, 22, 23)


def test_a_probe_has_forty_one() -> None:
    found = decode_result(PacketKind.PROBE, packet_body((6, 0, 0, 0x21, 5, 1, 2, 7, 8), 41))
    assert (found.mode, found.rotation_status, found.tip_status) == (6, 0x21, 2)
    assert (found.value, found.scatter, found.expected) == ((1, 2, 3), (4, 5, 6), (11, 12, 13))
    assert found.covariance == (15, 16, 17)
    assert found.quaternion == (18, 19, 20, 21)  # 22 to 24 are angles
    assert (found.turn_scatter, found.turn_expected) == ((25, 26, 27), (32, 33, 34))
    assert found.air == (39, 40, 41)


@pytest.mark.parametrize(
    ("kind", "words", "count"),
    [(PacketKind.POINT, 2, 17), (PacketKind.POINT_WITH_COVARIANCE, 2, 23), (PacketKind.PROBE, 9, 41)],
)
def test_sizes_are_those_of_the_packed_structures(kind: PacketKind, words: int, count: int) -> None:
    assert kind in RESULTS
    assert SIZES[kind] == 12 + 4 * words + 8 * count
