"""Datagrams of ABB's and KUKA's joint streams: read as others write them, and refused where they are not whole."""

import math
import random
import struct
from collections.abc import Callable

import pytest
from abb_robot_client._egm_protobuf import egm_pb2

from cellcal.drivers.abb.guided_motion import packets as egm
from cellcal.drivers.kuka.sensor_interface import packets as rsi
from cellcal.drivers.wire.joint_stream import StreamPacket

DEG = (10.5, -20.25, 30.125, 0.0, 179.5, -7.0)
RAD = tuple(map(math.radians, DEG))
Read = Callable[[bytes], StreamPacket]
# a state frame as public KUKA set-ups keep it: more elements than are read, external axes, spaces
RSI_FRAME = (
    b'<Rob Type="KUKA"><RIst X="1620.0" Y="0.0" Z="1910.0" A="0.0" B="90.0" C="0.0"/>'
    b'<RSol X="1620.0" Y="0.0" Z="1910.0" A="0.0" B="90.0" C="0.0"/>'
    b'<AIPos A1="10.5" A2="-20.25" A3="30.125" A4="0.0" A5="1.795E+02" A6="-7.0"/>'
    b'<ASPos A1="0.0" A2="-90.0" A3="90.0" A4="0.0" A5="0.0" A6="0.0"/><EIPos E1="0.0" E2="0.0"/>'
    b'<Delay D="3"/><Tech C11="0.0"/><DiL>0</DiL><IPOC>4208163634</IPOC></Rob>'
)


def as_others_write_it(**changes: object) -> bytes:
    """Return an EgmRobot message as Google's library packs it from the maker's definition."""
    message = egm_pb2.EgmRobot()
    message.header.seqno = changes.get("seqno", 7)
    message.header.tm = changes.get("tm", 123_456)
    message.header.mtype = egm_pb2.EgmHeader.MessageType.Value(str(changes.get("mtype", "MSGTYPE_DATA")))
    message.feedBack.joints.joints.extend(changes.get("joints", DEG))  # type: ignore[arg-type]
    message.feedBack.cartesian.pos.x = 1.0
    message.feedBack.cartesian.pos.y = message.feedBack.cartesian.pos.z = 2.0
    for name in ("u0", "u1", "u2", "u3"):
        setattr(message.feedBack.cartesian.orient, name, 0.5)
    message.planned.joints.joints.extend([1.0] * 6)
    message.feedBack.externalJoints.joints.extend([9.0, 9.0])
    message.motorState.state = 1
    message.mciState.state = 3
    message.mciConvergenceMet = True
    message.rapidExecState.state = 2
    message.utilizationRate = 12.5
    message.moveIndex = 4
    message.RAPIDfromRobot.dnum.extend([1.0, 2.0])
    return bytes(message.SerializeToString())


def test_an_egm_message_is_read_as_googles_library_packs_it() -> None:
    packet = egm.read_robot_packet(as_others_write_it())
    assert (packet.sequence, packet.sent_at_s) == (7, 123.456)
    assert packet.joints_rad == pytest.approx(RAD, abs=1e-12)


def test_packed_joints_are_read_too() -> None:
    one_by_one = as_others_write_it()
    message = egm_pb2.EgmRobot.FromString(one_by_one)
    octets = b"".join(struct.pack("<d", angle) for angle in DEG)
    packed = b"\x0a" + bytes([len(octets)]) + octets  # joints (1), counted
    feedback = b"\x0a" + bytes([len(packed)]) + packed
    header = message.header.SerializeToString()
    data = b"\x0a" + bytes([len(header)]) + header + b"\x12" + bytes([len(feedback)]) + feedback
    assert egm.read_robot_packet(data).joints_rad == pytest.approx(RAD, abs=1e-12)


def test_an_rsi_datagram_is_read_by_names() -> None:
    packet = rsi.read_robot_packet(RSI_FRAME)
    assert (packet.sequence, packet.sent_at_s) == (4_208_163_634, None)
    assert packet.joints_rad == pytest.approx(RAD, abs=1e-12)


@pytest.mark.parametrize(
    "data",
    [
        b"",
        b"\x00",
        b"\xff" * 40,
        as_others_write_it(joints=DEG[:5]),
        as_others_write_it(joints=(*DEG, 1.0)),
        as_others_write_it(joints=(*DEG[:5], math.nan)),
        as_others_write_it(joints=(*DEG[:5], math.inf)),
        as_others_write_it(joints=(*DEG[:5], 9e9)),
        as_others_write_it(mtype="MSGTYPE_CORRECTION"),
        as_others_write_it()[:-1],
        as_others_write_it() + b"\x0a",
        as_others_write_it() + as_others_write_it(),  # a library would merge them
        as_others_write_it() + bytes(2048),
        as_others_write_it() + b"\x73\x74",  # a group
    ],
)
def test_what_is_no_whole_egm_message_is_refused(data: bytes) -> None:
    with pytest.raises(ValueError, match=r"."):
        egm.read_robot_packet(data)


@pytest.mark.parametrize(
    ("old", "new"),
    [
        (b'A6="-7.0"', b""),
        (b'A6="-7.0"', b'A6="nan"'),
        (b'A6="-7.0"', b'A6="1e300"'),
        (b'A6="-7.0"', b'A6="1_0"'),
        (b'A6="-7.0"', b'A6="7,0"'),
        (b'A6="-7.0"', b'A6="-7.0" A6="8.0"'),
        (b"<AIPos", b"<AIPas"),
        (b"<ASPos", b"<AIPos"),  # two of them
        (b"4208163634", b"-4"),
        (b"4208163634", b"4208163634.5"),
        (b"4208163634", b"9" * 30),
        (b"<IPOC>4208163634</IPOC>", b""),
        (b"Rob", b"Sen"),
        (b"</Rob>", b""),
        (b'<Rob Type="KUKA">', b'<!DOCTYPE a [<!ENTITY b "1">]><Rob Type="KUKA">'),
        (b"<Rob", b'<?xml version="1.0" encoding="no-such"?><Rob'),
        (b"<Delay", b"<!--" + b"x" * 9000 + b"--><Delay"),
    ],
)
def test_what_is_no_whole_rsi_datagram_is_refused(old: bytes, new: bytes) -> None:
    data = RSI_FRAME.replace(old, new)
    assert data != RSI_FRAME
    with pytest.raises(ValueError, match=r"."):
        rsi.read_robot_packet(data)


def mutated(frame: bytes, rng: random.Random) -> bytes:
    """Return a frame with octets changed, taken out, put in or doubled."""
    data = bytearray(frame)
    for _ in range(rng.randint(1, 3)):
        at = rng.randrange(len(data)) if data else 0
        kind = rng.randrange(4)
        if kind == 0 and data:
            data[at] = rng.randrange(256)
        elif kind == 1:
            del data[at : at + rng.randint(1, 20)]
        elif kind == 2:
            data[at:at] = rng.randbytes(rng.randint(1, 8))
        else:
            data[at:at] = data[at : at + rng.randint(1, 60)]
    return bytes(data)


def survives(read: Read, frame: bytes, times: int) -> int:
    """Read mutations; return how many still were datagrams. Whatever is taken is finite and in its range."""
    rng = random.Random(26)
    taken = 0
    for _ in range(times):
        try:
            packet = read(mutated(frame, rng))
        except ValueError:
            continue
        taken += 1
        assert len(packet.joints_rad) == 6
        assert all(abs(angle) <= math.radians(1e4) for angle in packet.joints_rad)
        assert 0 <= packet.sequence < 10**18
        assert packet.sent_at_s is None or math.isfinite(packet.sent_at_s)
    return taken


PROTOCOLS = [(egm.read_robot_packet, as_others_write_it()), (rsi.read_robot_packet, RSI_FRAME)]


@pytest.mark.parametrize(("read", "frame"), PROTOCOLS, ids=["egm", "rsi"])
def test_a_spoiled_datagram_is_refused_or_still_one(read: Read, frame: bytes) -> None:
    assert 0 < survives(read, frame, 10_000) < 10_000


@pytest.mark.soak
@pytest.mark.parametrize(("read", "frame"), PROTOCOLS, ids=["egm", "rsi"])
def test_a_million_spoiled_datagrams_do_no_harm(read: Read, frame: bytes) -> None:
    assert 0 < survives(read, frame, 1_000_000) < 1_000_000
