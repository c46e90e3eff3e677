"""The fake draw-wire: its daemon byte by byte, its node through the real python-can and canopen."""

import asyncio
import re
import struct
import threading
from collections.abc import AsyncIterator, Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any

import canopen
import pytest
import pytest_asyncio

from cellcal.fake_devices.draw_wire.device import FakeDrawWire
from cellcal.fake_devices.draw_wire.node import OPERATIONAL, PRE_OPERATIONAL, STOPPED
from cellcal.fake_devices.draw_wire.sdo import SdoServer
from cellcal.fake_devices.draw_wire.socketcand import frame_text, parse_send
from tests.machine_speed import stretched_s
from tests.wire.fake_cells import happen, running, until

WAIT_S = stretched_s(10.0)


@pytest_asyncio.fixture
async def wire() -> AsyncIterator[FakeDrawWire]:
    async with running() as cell:
        device = cell.gauges[0]
        assert isinstance(device, FakeDrawWire)
        yield device


# the daemon, byte by byte


class Line:
    """A bare socket to the daemon."""

    def __init__(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        self.reader, self.writer = reader, writer

    @classmethod
    async def to(cls, wire: FakeDrawWire) -> "Line":
        return cls(*await asyncio.open_connection("127.0.0.1", wire.daemon.port))

    async def read(self) -> str:
        async with asyncio.timeout(WAIT_S):
            return (await self.reader.read(4096)).decode()

    async def ask(self, text: str) -> str:
        self.writer.write(text.encode())
        return await self.read()

    async def frame(self) -> str:
        async with asyncio.timeout(WAIT_S):
            return (await self.reader.readuntil(b">")).decode()

    async def raw(self) -> "Line":
        assert await self.read() == "< hi >"
        assert await self.ask("< open can0 >") == "< ok >"
        assert await self.ask("< rawmode >") == "< ok >"
        return self

    async def close(self) -> None:
        self.writer.close()
        try:
            await self.writer.wait_closed()
        except ConnectionError:
            return


@pytest_asyncio.fixture
async def line(wire: FakeDrawWire) -> AsyncIterator[Line]:
    connection = await (await Line.to(wire)).raw()
    yield connection
    await connection.close()


async def test_the_handshake_is_the_documents_letter_for_letter(wire: FakeDrawWire):
    connection = await Line.to(wire)
    assert await connection.read() == "< hi >"
    assert await connection.ask("< rawmode >") == "< error unknown command >"
    assert await connection.ask("< open can9 >") == "< error could not open bus >"
    assert await connection.ask("< open can0 >") == "< ok >"
    assert await connection.ask("< rawmode >") == "< ok >"
    assert await connection.ask("< echo >") == "< echo >"
    assert await connection.ask("< bcmmode >") == "< error unknown command >"
    await connection.close()


async def test_an_sdo_transcript_byte_for_byte(line: Line):
    line.writer.write(b"< send 607 8 40 18 10 4 0 0 0 0 >")
    answer = await line.frame()
    assert re.fullmatch(r"< frame 587 \d+\.\d{6} 4318100467120000 >", answer)  # serial 4711


async def test_a_command_may_come_in_pieces_and_two_in_one(line: Line):
    for byte in b"< send 607 8 40 18 10 1 0 0 0 0 >":
        line.writer.write(bytes([byte]))
        await line.writer.drain()
    assert "4318100" in await line.frame()
    line.writer.write(b"< send 607 8 40 0 10 0 0 0 0 0 >< send 607 8 40 5 60 1 0 0 0 0 >")
    first, second = await line.frame(), await line.frame()
    assert "43001000" in first
    assert "43056001" in second


@pytest.mark.parametrize(
    "text", ["< send 607 8 40 >", "< send xyz 0 >", "< send >", "< send 607 9 1 2 3 4 5 6 7 8 9 >"]
)
async def test_nonsense_is_answered_with_an_error(line: Line, text):
    assert await line.ask(text) == "< error unknown command >"


async def test_clients_hear_each_other_as_on_a_real_bus(wire: FakeDrawWire, line: Line):
    other = await (await Line.to(wire)).raw()
    await until(lambda: wire.daemon.ready_clients == 2)
    other.writer.write(b"< send 123 2 de ad >")
    assert re.fullmatch(r"< frame 123 \d+\.\d{6} DEAD >", await line.frame())
    line.writer.write(b"< send 124 0  >")
    assert re.fullmatch(r"< frame 124 \d+\.\d{6}  >", await other.frame())
    await other.close()


async def test_no_frame_comes_between_the_handshakes_answers(wire: FakeDrawWire):
    wire.node.settings.now["heartbeat_ms"] = 1
    connection = await (await Line.to(wire)).raw()
    assert (await connection.frame()).startswith("< frame 707 ")
    await connection.close()


async def test_a_daemon_that_dies_hangs_and_comes_back(wire: FakeDrawWire, line: Line):
    await happen(wire, "daemon_hang", duration_s=60)
    line.writer.write(b"< send 607 8 40 18 10 4 0 0 0 0 >")
    wire.clear_faults()
    await until(lambda: not wire.daemon.hung)
    await happen(wire, "daemon_stop")
    await until(lambda: wire.daemon.client_count == 0)
    with pytest.raises(ConnectionRefusedError):
        await Line.to(wire)
    wire.clear_faults()
    await until(lambda: wire.daemon.is_listening)
    again = await (await Line.to(wire)).raw()
    await again.close()


async def test_an_error_frame_and_a_foreign_master_are_seen(wire: FakeDrawWire, line: Line):
    await until(lambda: wire.daemon.ready_clients == 1)
    await happen(wire, "error_frame")
    assert re.fullmatch(r"< error 020 \d+\.\d{6} >", await line.frame())
    await happen(wire, "foreign_master")
    assert " 607 " in await line.frame()
    assert " 587 " in await line.frame()


def test_frames_are_printed_and_parsed_by_the_book():
    assert frame_text(0x707, b"", 1.5) == "< frame 707 1.500000  >"
    assert frame_text(0x7, bytes([0, 255]), 0.0) == "< frame 007 0.000000 00FF >"
    assert parse_send(["send", "1AB", "2", "a", "ff"]) == (0x1AB, b"\x0a\xff")
    assert parse_send(["send", "1AB", "2", "a"]) is None
    assert parse_send(["send", "1AB", "1", "100"]) is None


# the node, through canopen


@dataclass
class Heard:
    """What came over the bus, with a bell."""

    frames: list[tuple[int, bytes]] = field(default_factory=list)
    bell: threading.Condition = field(default_factory=threading.Condition)

    def take(self, can_id: int, data: bytes, _timestamp: float) -> None:
        with self.bell:
            self.frames.append((can_id, bytes(data)))
            self.bell.notify_all()

    def next(self, can_id: int, after: int = 0) -> bytes:
        """Wait for a frame with that identifier behind the first ``after`` of its kind."""

        def arrived() -> list[bytes]:
            return [data for number, data in self.frames if number == can_id][after:]

        with self.bell:
            assert self.bell.wait_for(lambda: bool(arrived()), WAIT_S), f"no frame 0x{can_id:03X}"
            return arrived()[0]

    def count(self, can_id: int) -> int:
        with self.bell:
            return sum(number == can_id for number, _ in self.frames)


class Bus:
    """The draw-wire's node seen through canopen; lives in a worker thread."""

    def __init__(self, network: canopen.Network) -> None:
        self.network, self.heard = network, Heard()
        self.node = network.add_node(7, canopen.ObjectDictionary())
        self.node.sdo.RESPONSE_TIMEOUT = 1.0
        for can_id in (0x087, 0x187, 0x587, 0x607, 0x707):
            network.subscribe(can_id, self.heard.take)

    def read(self, index: int, sub: int = 0, layout: str = "<I") -> int:
        return int(struct.unpack(layout, self.node.sdo.read_bytes(index, sub))[0])

    def write(self, index: int, sub: int, value: int, layout: str = "<I") -> None:
        self.node.sdo.write_bytes(index, sub, struct.pack(layout, value))

    def position(self) -> int:
        return self.read(0x6004, 0, "<i")

    def nmt(self, command: int) -> None:
        self.network.send_message(0, bytes([command, 7]))

    def abort_of(self, action: Callable[[], Any]) -> int:
        with pytest.raises(canopen.SdoAbortedError) as caught:
            action()
        return caught.value.code


@contextmanager
def connected(wire: FakeDrawWire) -> Iterator[Bus]:
    network = canopen.Network()
    network.connect(interface="socketcand", host="127.0.0.1", port=wire.daemon.port, channel="can0")
    try:
        yield Bus(network)
    finally:
        network.disconnect()


async def on_the_bus(wire: FakeDrawWire, story: Callable[[Bus], None]) -> None:
    """Tell a story in a thread: canopen blocks."""

    def tell() -> None:
        with connected(wire) as bus:
            story(bus)

    await asyncio.to_thread(tell)


async def test_who_it_is(wire: FakeDrawWire):
    def story(bus: Bus) -> None:
        assert bus.read(0x1000) & 0xFFFF == 406
        assert bus.read(0x1018, 4) == bus.read(0x650B) == 4711
        assert bus.node.sdo.read_bytes(0x1008, 0) == b"DW-3000 draw-wire encoder"  # in segments
        assert bus.node.sdo.read_bytes(0x1009, 0) == b"HW 1.2"

    await on_the_bus(wire, story)


async def test_the_position_is_the_wires_length_in_steps(wire: FakeDrawWire):
    def story(bus: Bus) -> None:
        step_m = bus.read(0x6005, 1) * 1e-9
        assert bus.position() * step_m == pytest.approx(wire.gauge.exact_reading_m(), abs=5e-4)
        assert bus.read(0x6002) * step_m == pytest.approx(3.0)
        bus.write(0x6005, 1, 1_000_000)
        assert bus.position() * 1e-3 == pytest.approx(wire.gauge.exact_reading_m(), abs=1e-3)

    await on_the_bus(wire, story)


async def test_refusals_carry_the_abort_code_of_the_book(wire: FakeDrawWire):
    def story(bus: Bus) -> None:
        assert bus.abort_of(lambda: bus.read(0x2222)) == 0x06020000
        assert bus.abort_of(lambda: bus.read(0x6005, 9)) == 0x06090011
        assert bus.abort_of(lambda: bus.write(0x6004, 0, 1)) == 0x06010002
        assert bus.abort_of(lambda: bus.write(0x6005, 1, 1)) == 0x06090030
        assert bus.abort_of(lambda: bus.write(0x1017, 0, 1, "<B")) == 0x06070010
        assert bus.abort_of(lambda: bus.write(0x1010, 1, 0x12345678)) == 0x08000020
        assert bus.abort_of(lambda: bus.write(0x1A00, 1, 0x60050020)) == 0x06040041
        assert bus.abort_of(lambda: bus.write(0x6003, 0, -(2**31), "<i")) == 0x06090030
        bus.node.sdo.write_bytes(0x1017, 0, bytes(9 - 7), force_segment=True)
        assert bus.read(0x1017, 0, "<H") == 0

    await on_the_bus(wire, story)


def test_a_segmented_transfer_checks_its_toggle_bit(wire_node_sdo: SdoServer):
    assert wire_node_sdo.answer_request(bytes.fromhex("4008100000000000"))[:1] == b"\x41"
    assert wire_node_sdo.answer_request(bytes.fromhex("6000000000000000"))[0] == 0x00
    aborted = wire_node_sdo.answer_request(bytes.fromhex("6000000000000000"))
    assert aborted == bytes.fromhex("80081000") + struct.pack("<I", 0x05030000)
    assert wire_node_sdo.answer_request(bytes.fromhex("7000000000000000"))[4:] == struct.pack(
        "<I", 0x05040001
    )
    assert wire_node_sdo.answer_request(bytes.fromhex("8008100000000000")) is None
    assert wire_node_sdo.answer_request(bytes.fromhex("C618100000000000"))[4:] == struct.pack(
        "<I", 0x05040001
    )


@pytest_asyncio.fixture
async def wire_node_sdo(wire: FakeDrawWire) -> SdoServer:
    return wire.node.sdo


async def test_a_preset_moves_the_offset_with_its_sign(wire: FakeDrawWire):
    def story(bus: Bus) -> None:
        before = bus.position()
        for value in (0, -123_456, 250_000):
            bus.write(0x6003, 0, value, "<i")
            assert bus.position() == pytest.approx(value, abs=60)
            assert bus.read(0x6509, 0, "<i") == pytest.approx(value - before, abs=60)
        bus.write(0x6003, 0, before, "<i")
        bus.write(0x6000, 0, 1, "<H")
        bus.write(0x6003, 0, 0, "<i")
        assert bus.position() == pytest.approx(0, abs=60)

    await on_the_bus(wire, story)


async def test_a_preset_is_lost_without_save_and_kept_with_it(wire: FakeDrawWire):
    def story(bus: Bus) -> None:
        before = bus.position()
        bus.write(0x6003, 0, before + 5000, "<i")
        bus.nmt(0x81)
        assert bus.heard.next(0x707) == b"\x00"
        assert bus.position() == pytest.approx(before, abs=60)
        bus.write(0x6003, 0, before + 5000, "<i")
        bus.write(0x1010, 1, 0x65766173)
        bus.nmt(0x81)
        assert bus.heard.next(0x707, after=1) == b"\x00"
        assert bus.position() == pytest.approx(before + 5000, abs=60)
        bus.write(0x1011, 1, 0x64616F6C)
        bus.nmt(0x81)
        assert bus.heard.next(0x707, after=2) == b"\x00"
        assert bus.position() == pytest.approx(before, abs=60)

    await on_the_bus(wire, story)


async def test_heartbeats_tell_the_state(wire: FakeDrawWire):
    def story(bus: Bus) -> None:
        bus.write(0x1017, 0, 10, "<H")
        assert bus.heard.next(0x707) == bytes([PRE_OPERATIONAL])
        for command, state in ((1, OPERATIONAL), (2, STOPPED), (0x80, PRE_OPERATIONAL)):
            bus.nmt(command)
            seen = bus.heard.count(0x707)
            assert bus.heard.next(0x707, after=seen + 1) == bytes([state])

    await on_the_bus(wire, story)


async def test_position_telegrams_flow_in_operational_only(wire: FakeDrawWire):
    def story(bus: Bus) -> None:
        bus.write(0x6200, 0, 5, "<H")
        assert bus.heard.count(0x187) == 0
        bus.nmt(1)
        data = bus.heard.next(0x187, after=3)
        assert struct.unpack("<i", data)[0] == pytest.approx(bus.position(), abs=60)
        bus.nmt(0x80)
        bus.read(0x1000)
        stood = bus.heard.count(0x187)
        bus.read(0x1000)
        assert bus.heard.count(0x187) == stood

    await on_the_bus(wire, story)


async def test_position_telegrams_follow_sync(wire: FakeDrawWire):
    def story(bus: Bus) -> None:
        bus.write(0x1800, 2, 2, "<B")
        bus.nmt(1)
        for _ in range(4):
            bus.network.send_message(0x80, b"")
        bus.read(0x1000)
        assert bus.heard.count(0x187) == 2
        bus.write(0x1800, 1, 0x80000187)
        bus.network.send_message(0x80, b"")
        bus.network.send_message(0x80, b"")
        bus.read(0x1000)
        assert bus.heard.count(0x187) == 2

    await on_the_bus(wire, story)


async def test_a_stopped_node_answers_no_sdo(wire: FakeDrawWire):
    def story(bus: Bus) -> None:
        bus.node.sdo.RESPONSE_TIMEOUT = 0.1
        bus.nmt(2)
        with pytest.raises(canopen.SdoCommunicationError):
            bus.read(0x1000)
        bus.nmt(0x80)
        assert bus.read(0x1000) & 0xFFFF == 406
        bus.network.send_message(0, bytes([2, 8]))  # another node's affair
        assert bus.read(0x1000) & 0xFFFF == 406

    await on_the_bus(wire, story)


async def test_beyond_the_end_it_says_so_and_says_when_it_is_over(wire: FakeDrawWire):
    wire.gauge.range_m = 0.5

    def beyond(bus: Bus) -> None:
        assert bus.position() == 50_000
        assert bus.heard.next(0x087) == bytes.fromhex("0050 81 0000000000")
        assert bus.read(0x1001, 0, "<B") == 0x81
        assert bus.read(0x6503, 0, "<H") == 1
        assert bus.read(0x1003, 0, "<B") == 1
        assert bus.read(0x1003, 1) == 0x5000

        wire.gauge.range_m = 3.0
        assert bus.position() > 50_000
        assert bus.heard.next(0x087, after=1) == bytes(8)
        assert bus.read(0x1001, 0, "<B") == 0
        bus.write(0x1003, 0, 0, "<B")
        assert bus.read(0x1003, 0, "<B") == 0
        assert bus.abort_of(lambda: bus.write(0x1003, 0, 1, "<B")) == 0x06090030

    await on_the_bus(wire, beyond)


async def test_emergencies_can_be_asked_for_of_any_length(wire: FakeDrawWire, line: Line):
    """On a bare socket: canopen's receiver stumbles over an emergency of fewer than 8 bytes."""
    await until(lambda: wire.daemon.ready_clients == 1)
    for length, data in ((8, "0042810000000000"), (2, "0042"), (0, "")):
        await happen(wire, "emcy", code=0x4200, length=length)
        assert re.fullmatch(rf"< frame 087 \d+\.\d{{6}} {data} >", await line.frame())
    await happen(wire, "emcy_clear")
    assert (await line.frame()).endswith(" 0000000000000000 >")


async def test_a_node_without_power_is_gone_and_boots_when_it_returns(wire: FakeDrawWire):
    loop = asyncio.get_running_loop()

    def fault(name: str) -> None:
        asyncio.run_coroutine_threadsafe(happen(wire, name), loop).result(WAIT_S)

    def story(bus: Bus) -> None:
        bus.node.sdo.RESPONSE_TIMEOUT = 0.1
        bus.nmt(1)
        bus.read(0x1000)
        fault("node_off")
        with pytest.raises(canopen.SdoCommunicationError):
            bus.read(0x1000)
        fault("node_on")
        assert bus.heard.next(0x707) == b"\x00"
        assert bus.read(0x1000) & 0xFFFF == 406
        assert wire.node.state == PRE_OPERATIONAL

    await on_the_bus(wire, story)


async def test_sdo_faults(wire: FakeDrawWire):
    loop = asyncio.get_running_loop()

    def fault(name: str, **parameters: Any) -> None:
        asyncio.run_coroutine_threadsafe(happen(wire, name, **parameters), loop).result(WAIT_S)

    def story(bus: Bus) -> None:
        bus.node.sdo.RESPONSE_TIMEOUT = 0.1
        fault("sdo_abort", code=0x08000022, count=1)
        assert bus.abort_of(lambda: bus.read(0x6004)) == 0x08000022
        fault("sdo_silent", count=2)
        with pytest.raises(canopen.SdoCommunicationError):
            bus.read(0x6004)
        fault("sdo_wrong_object", count=1)
        with pytest.raises(canopen.SdoCommunicationError):
            bus.read(0x6004)
        bus.node.sdo.RESPONSE_TIMEOUT = 2.0
        fault("sdo_slow", delay_s=0.05, count=1)
        assert bus.read(0x6005, 1) == 10_000

    await on_the_bus(wire, story)


async def test_heartbeat_and_telegrams_can_stop_or_freeze(wire: FakeDrawWire):
    loop = asyncio.get_running_loop()

    def fault(name: str, **parameters: Any) -> None:
        asyncio.run_coroutine_threadsafe(happen(wire, name, **parameters), loop).result(WAIT_S)

    def story(bus: Bus) -> None:
        bus.write(0x1017, 0, 5, "<H")
        bus.write(0x6200, 0, 5, "<H")
        bus.nmt(1)
        bus.heard.next(0x707, after=1)
        bus.heard.next(0x187, after=1)
        fault("heartbeat_stop")
        fault("tpdo_frozen")
        beats, frozen = bus.heard.count(0x707), bus.heard.next(0x187, after=bus.heard.count(0x187))
        wire.gauge.lengthen_readings(0.1)
        assert bus.heard.next(0x187, after=bus.heard.count(0x187) + 3) == frozen
        assert bus.heard.count(0x707) <= beats + 1
        fault("tpdo_stop", duration_s=0.05)
        wire.clear_faults()
        newest = bus.heard.next(0x187, after=bus.heard.count(0x187) + 1)
        assert struct.unpack("<i", newest)[0] - struct.unpack("<i", frozen)[0] == pytest.approx(
            10_000, abs=60
        )

    await on_the_bus(wire, story)


async def test_what_happens_to_the_wire_shows_in_the_position(wire: FakeDrawWire):
    loop = asyncio.get_running_loop()

    def fault(name: str, **parameters: Any) -> None:
        asyncio.run_coroutine_threadsafe(happen(wire, name, **parameters), loop).result(WAIT_S)

    def story(bus: Bus) -> None:
        here = bus.position()
        fault("wire_offset", m=0.005)
        assert bus.position() - here == pytest.approx(500, abs=60)
        fault("wire_snap")
        assert bus.position() == pytest.approx(0, abs=100)
        fault("wire_restore")
        assert bus.position() == pytest.approx(here, abs=60)
        fault("wire_slack")
        assert bus.position() == pytest.approx(here, abs=60)
        assert wire.true_state()["snapped"] is False

    await on_the_bus(wire, story)
