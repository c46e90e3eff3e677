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
from tests.wire.fake_cells import cause_fault, run_cell, wait_until

WAIT_S = stretched_s(10.0)


@pytest_asyncio.fixture
async def wire() -> AsyncIterator[FakeDrawWire]:
    async with run_cell() as cell:
        device = cell.gauges[0]
        assert isinstance(device, FakeDrawWire)
        yield device


# the daemon, byte by byte


class DaemonLine:
    """A bare socket to the daemon."""

    def __init__(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        self.reader, self.writer = reader, writer

    @classmethod
    async def connect_to(cls, wire: FakeDrawWire) -> "DaemonLine":
        return cls(*await asyncio.open_connection("127.0.0.1", wire.daemon.port))

    async def read(self) -> str:
        async with asyncio.timeout(WAIT_S):
            return (await self.reader.read(4096)).decode()

    async def send_and_read(self, text: str) -> str:
        self.writer.write(text.encode())
        return await self.read()

    async def read_frame(self) -> str:
        async with asyncio.timeout(WAIT_S):
            return (await self.reader.readuntil(b">")).decode()

    async def switch_to_raw(self) -> "DaemonLine":
        assert await self.read() == "< hi >"
        assert await self.send_and_read("< open can0 >") == "< ok >"
        assert await self.send_and_read("< rawmode >") == "< ok >"
        return self

    async def close(self) -> None:
        self.writer.close()
        try:
            await self.writer.wait_closed()
        except ConnectionError:
            return


@pytest_asyncio.fixture
async def daemon_line(wire: FakeDrawWire) -> AsyncIterator[DaemonLine]:
    connection = await (await DaemonLine.connect_to(wire)).switch_to_raw()
    yield connection
    await connection.close()


async def test_the_handshake_is_the_documents_letter_for_letter(wire: FakeDrawWire):
    connection = await DaemonLine.connect_to(wire)
    assert await connection.read() == "< hi >"
    assert await connection.send_and_read("< rawmode >") == "< error unknown command >"
    assert await connection.send_and_read("< open can9 >") == "< error could not open bus >"
    assert await connection.send_and_read("< open can0 >") == "< ok >"
    assert await connection.send_and_read("< rawmode >") == "< ok >"
    assert await connection.send_and_read("< echo >") == "< echo >"
    assert await connection.send_and_read("< bcmmode >") == "< error unknown command >"
    await connection.close()


async def test_an_sdo_transcript_byte_for_byte(daemon_line: DaemonLine):
    daemon_line.writer.write(b"< send 607 8 40 18 10 4 0 0 0 0 >")
    answer = await daemon_line.read_frame()
    assert re.fullmatch(r"< frame 587 \d+\.\d{6} 4318100467120000 >", answer)  # serial 4711


async def test_a_command_may_come_in_pieces_and_two_in_one(daemon_line: DaemonLine):
    for byte in b"< send 607 8 40 18 10 1 0 0 0 0 >":
        daemon_line.writer.write(bytes([byte]))
        await daemon_line.writer.drain()
    assert "4318100" in await daemon_line.read_frame()
    daemon_line.writer.write(b"< send 607 8 40 0 10 0 0 0 0 0 >< send 607 8 40 5 60 1 0 0 0 0 >")
    first, second = await daemon_line.read_frame(), await daemon_line.read_frame()
    assert "43001000" in first
    assert "43056001" in second


@pytest.mark.parametrize(
    "text", ["< send 607 8 40 >", "< send xyz 0 >", "< send >", "< send 607 9 1 2 3 4 5 6 7 8 9 >"]
)
async def test_nonsense_is_answered_with_an_error(daemon_line: DaemonLine, text):
    assert await daemon_line.send_and_read(text) == "< error unknown command >"


async def test_clients_hear_each_other_as_on_a_real_bus(wire: FakeDrawWire, daemon_line: DaemonLine):
    other = await (await DaemonLine.connect_to(wire)).switch_to_raw()
    await wait_until(lambda: wire.daemon.ready_clients == 2)
    other.writer.write(b"< send 123 2 de ad >")
    assert re.fullmatch(r"< frame 123 \d+\.\d{6} DEAD >", await daemon_line.read_frame())
    daemon_line.writer.write(b"< send 124 0  >")
    assert re.fullmatch(r"< frame 124 \d+\.\d{6}  >", await other.read_frame())
    await other.close()


async def test_no_frame_comes_between_the_handshakes_answers(wire: FakeDrawWire):
    wire.node.settings.now["heartbeat_ms"] = 1
    connection = await (await DaemonLine.connect_to(wire)).switch_to_raw()
    assert (await connection.read_frame()).startswith("< frame 707 ")
    await connection.close()


async def test_a_daemon_that_dies_hangs_and_comes_back(wire: FakeDrawWire, daemon_line: DaemonLine):
    await cause_fault(wire, "daemon_hang", duration_s=60)
    daemon_line.writer.write(b"< send 607 8 40 18 10 4 0 0 0 0 >")
    wire.clear_faults()
    await wait_until(lambda: not wire.daemon.hung)
    await cause_fault(wire, "daemon_stop")
    await wait_until(lambda: wire.daemon.client_count == 0)
    with pytest.raises(ConnectionRefusedError):
        await DaemonLine.connect_to(wire)
    wire.clear_faults()
    await wait_until(lambda: wire.daemon.is_listening)
    again = await (await DaemonLine.connect_to(wire)).switch_to_raw()
    await again.close()


async def test_an_error_frame_and_a_foreign_master_are_seen(wire: FakeDrawWire, daemon_line: DaemonLine):
    await wait_until(lambda: wire.daemon.ready_clients == 1)
    await cause_fault(wire, "error_frame")
    assert re.fullmatch(r"< error 020 \d+\.\d{6} >", await daemon_line.read_frame())
    await cause_fault(wire, "foreign_master")
    assert " 607 " in await daemon_line.read_frame()
    assert " 587 " in await daemon_line.read_frame()


def test_frames_are_printed_and_parsed_by_the_book():
    assert frame_text(0x707, b"", 1.5) == "< frame 707 1.500000  >"
    assert frame_text(0x7, bytes([0, 255]), 0.0) == "< frame 007 0.000000 00FF >"
    assert parse_send(["send", "1AB", "2", "a", "ff"]) == (0x1AB, b"\x0a\xff")
    assert parse_send(["send", "1AB", "2", "a"]) is None
    assert parse_send(["send", "1AB", "1", "100"]) is None


# the node, through canopen


@dataclass
class ReceivedFrames:
    """What came over the bus, with a bell."""

    frames: list[tuple[int, bytes]] = field(default_factory=list)
    bell: threading.Condition = field(default_factory=threading.Condition)

    def take_frame(self, can_id: int, data: bytes, _timestamp: float) -> None:
        with self.bell:
            self.frames.append((can_id, bytes(data)))
            self.bell.notify_all()

    def wait_for_frame(self, can_id: int, after: int = 0) -> bytes:
        """Wait for a frame with that identifier behind the first ``after`` of its kind."""

        def arrived_frames() -> list[bytes]:
            return [data for number, data in self.frames if number == can_id][after:]

        with self.bell:
            assert self.bell.wait_for(lambda: bool(arrived_frames()), WAIT_S), f"no frame 0x{can_id:03X}"
            return arrived_frames()[0]

    def count_frames(self, can_id: int) -> int:
        with self.bell:
            return sum(number == can_id for number, _ in self.frames)


class CanopenBus:
    """The draw-wire's node seen through canopen; lives in a worker thread."""

    def __init__(self, network: canopen.Network) -> None:
        self.network, self.received_frames = network, ReceivedFrames()
        self.node = network.add_node(7, canopen.ObjectDictionary())
        self.node.sdo.RESPONSE_TIMEOUT = 1.0
        for can_id in (0x087, 0x187, 0x587, 0x607, 0x707):
            network.subscribe(can_id, self.received_frames.take_frame)

    def read_object(self, index: int, sub: int = 0, layout: str = "<I") -> int:
        return int(struct.unpack(layout, self.node.sdo.upload(index, sub))[0])

    def write_object(self, index: int, sub: int, value: int, layout: str = "<I") -> None:
        self.node.sdo.download(index, sub, struct.pack(layout, value))

    def read_position(self) -> int:
        return self.read_object(0x6004, 0, "<i")

    def send_nmt(self, command: int) -> None:
        self.network.send_message(0, bytes([command, 7]))

    def abort_of(self, action: Callable[[], Any]) -> int:
        with pytest.raises(canopen.SdoAbortedError) as caught:
            action()
        return caught.value.code


@contextmanager
def connect_bus(wire: FakeDrawWire) -> Iterator[CanopenBus]:
    network = canopen.Network()
    network.connect(interface="socketcand", host="127.0.0.1", port=wire.daemon.port, channel="can0")
    try:
        yield CanopenBus(network)
    finally:
        network.disconnect()


async def on_the_bus(wire: FakeDrawWire, story: Callable[[CanopenBus], None]) -> None:
    """Tell a story in a thread: canopen blocks."""

    def run_scenario() -> None:
        with connect_bus(wire) as bus:
            story(bus)

    await asyncio.to_thread(run_scenario)


async def test_identity(wire: FakeDrawWire):
    def check_identity(bus: CanopenBus) -> None:
        assert bus.read_object(0x1000) & 0xFFFF == 406
        assert bus.read_object(0x1018, 4) == bus.read_object(0x650B) == 4711
        assert bus.node.sdo.upload(0x1008, 0) == b"DW-3000 draw-wire encoder"  # in segments
        assert bus.node.sdo.upload(0x1009, 0) == b"HW 1.2"

    await on_the_bus(wire, check_identity)


async def test_the_position_is_the_wires_length_in_steps(wire: FakeDrawWire):
    def check_position(bus: CanopenBus) -> None:
        step_m = bus.read_object(0x6005, 1) * 1e-9
        assert bus.read_position() * step_m == pytest.approx(wire.gauge.exact_reading_m(), abs=5e-4)
        assert bus.read_object(0x6002) * step_m == pytest.approx(3.0)
        bus.write_object(0x6005, 1, 1_000_000)
        assert bus.read_position() * 1e-3 == pytest.approx(wire.gauge.exact_reading_m(), abs=1e-3)

    await on_the_bus(wire, check_position)


async def test_refusals_carry_the_abort_code_of_the_book(wire: FakeDrawWire):
    def check_refusals(bus: CanopenBus) -> None:
        assert bus.abort_of(lambda: bus.read_object(0x2222)) == 0x06020000
        assert bus.abort_of(lambda: bus.read_object(0x6005, 9)) == 0x06090011
        assert bus.abort_of(lambda: bus.write_object(0x6004, 0, 1)) == 0x06010002
        assert bus.abort_of(lambda: bus.write_object(0x6005, 1, 1)) == 0x06090030
        assert bus.abort_of(lambda: bus.write_object(0x1017, 0, 1, "<B")) == 0x06070010
        assert bus.abort_of(lambda: bus.write_object(0x1010, 1, 0x12345678)) == 0x08000020
        assert bus.abort_of(lambda: bus.write_object(0x1A00, 1, 0x60050020)) == 0x06040041
        assert bus.abort_of(lambda: bus.write_object(0x6003, 0, -(2**31), "<i")) == 0x06090030
        bus.node.sdo.download(0x1017, 0, bytes(9 - 7), force_segment=True)
        assert bus.read_object(0x1017, 0, "<H") == 0

    await on_the_bus(wire, check_refusals)


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
    def check_preset(bus: CanopenBus) -> None:
        before = bus.read_position()
        for value in (0, -123_456, 250_000):
            bus.write_object(0x6003, 0, value, "<i")
            assert bus.read_position() == pytest.approx(value, abs=60)
            assert bus.read_object(0x6509, 0, "<i") == pytest.approx(value - before, abs=60)
        bus.write_object(0x6003, 0, before, "<i")
        bus.write_object(0x6000, 0, 1, "<H")
        bus.write_object(0x6003, 0, 0, "<i")
        assert bus.read_position() == pytest.approx(0, abs=60)

    await on_the_bus(wire, check_preset)


async def test_a_preset_is_lost_without_save_and_kept_with_it(wire: FakeDrawWire):
    def check_saved_preset(bus: CanopenBus) -> None:
        before = bus.read_position()
        bus.write_object(0x6003, 0, before + 5000, "<i")
        bus.send_nmt(0x81)
        assert bus.received_frames.wait_for_frame(0x707) == b"\x00"
        assert bus.read_position() == pytest.approx(before, abs=60)
        bus.write_object(0x6003, 0, before + 5000, "<i")
        bus.write_object(0x1010, 1, 0x65766173)
        bus.send_nmt(0x81)
        assert bus.received_frames.wait_for_frame(0x707, after=1) == b"\x00"
        assert bus.read_position() == pytest.approx(before + 5000, abs=60)
        bus.write_object(0x1011, 1, 0x64616F6C)
        bus.send_nmt(0x81)
        assert bus.received_frames.wait_for_frame(0x707, after=2) == b"\x00"
        assert bus.read_position() == pytest.approx(before, abs=60)

    await on_the_bus(wire, check_saved_preset)


async def test_heartbeats_tell_the_state(wire: FakeDrawWire):
    def check_heartbeats(bus: CanopenBus) -> None:
        bus.write_object(0x1017, 0, 10, "<H")
        assert bus.received_frames.wait_for_frame(0x707) == bytes([PRE_OPERATIONAL])
        for command, state in ((1, OPERATIONAL), (2, STOPPED), (0x80, PRE_OPERATIONAL)):
            bus.send_nmt(command)
            heartbeat_count = bus.received_frames.count_frames(0x707)
            assert bus.received_frames.wait_for_frame(0x707, after=heartbeat_count + 1) == bytes([state])

    await on_the_bus(wire, check_heartbeats)


async def test_position_telegrams_flow_in_operational_only(wire: FakeDrawWire):
    def check_telegrams(bus: CanopenBus) -> None:
        bus.write_object(0x6200, 0, 5, "<H")
        assert bus.received_frames.count_frames(0x187) == 0
        bus.send_nmt(1)
        data = bus.received_frames.wait_for_frame(0x187, after=3)
        assert struct.unpack("<i", data)[0] == pytest.approx(bus.read_position(), abs=60)
        bus.send_nmt(0x80)
        bus.read_object(0x1000)
        stood = bus.received_frames.count_frames(0x187)
        bus.read_object(0x1000)
        assert bus.received_frames.count_frames(0x187) == stood

    await on_the_bus(wire, check_telegrams)


async def test_position_telegrams_follow_sync(wire: FakeDrawWire):
    def check_sync(bus: CanopenBus) -> None:
        bus.write_object(0x1800, 2, 2, "<B")
        bus.send_nmt(1)
        for _ in range(4):
            bus.network.send_message(0x80, b"")
        bus.read_object(0x1000)
        assert bus.received_frames.count_frames(0x187) == 2
        bus.write_object(0x1800, 1, 0x80000187)
        bus.network.send_message(0x80, b"")
        bus.network.send_message(0x80, b"")
        bus.read_object(0x1000)
        assert bus.received_frames.count_frames(0x187) == 2

    await on_the_bus(wire, check_sync)


async def test_a_stopped_node_answers_no_sdo(wire: FakeDrawWire):
    def check_stopped_node(bus: CanopenBus) -> None:
        bus.node.sdo.RESPONSE_TIMEOUT = 0.1
        bus.send_nmt(2)
        with pytest.raises(canopen.SdoCommunicationError):
            bus.read_object(0x1000)
        bus.send_nmt(0x80)
        assert bus.read_object(0x1000) & 0xFFFF == 406
        bus.network.send_message(0, bytes([2, 8]))  # another node's affair
        assert bus.read_object(0x1000) & 0xFFFF == 406

    await on_the_bus(wire, check_stopped_node)


async def test_beyond_the_end_it_says_so_and_says_when_it_is_over(wire: FakeDrawWire):
    wire.gauge.range_m = 0.5

    def check_beyond_end(bus: CanopenBus) -> None:
        assert bus.read_position() == 50_000
        assert bus.received_frames.wait_for_frame(0x087) == bytes.fromhex("0050 81 0000000000")
        assert bus.read_object(0x1001, 0, "<B") == 0x81
        assert bus.read_object(0x6503, 0, "<H") == 1
        assert bus.read_object(0x1003, 0, "<B") == 1
        assert bus.read_object(0x1003, 1) == 0x5000

        wire.gauge.range_m = 3.0
        assert bus.read_position() > 50_000
        assert bus.received_frames.wait_for_frame(0x087, after=1) == bytes(8)
        assert bus.read_object(0x1001, 0, "<B") == 0
        bus.write_object(0x1003, 0, 0, "<B")
        assert bus.read_object(0x1003, 0, "<B") == 0
        assert bus.abort_of(lambda: bus.write_object(0x1003, 0, 1, "<B")) == 0x06090030

    await on_the_bus(wire, check_beyond_end)


async def test_emergencies_can_be_asked_for_of_any_length(wire: FakeDrawWire, daemon_line: DaemonLine):
    """On a bare socket: canopen's receiver stumbles over an emergency of fewer than 8 bytes."""
    await wait_until(lambda: wire.daemon.ready_clients == 1)
    for length, data in ((8, "0042810000000000"), (2, "0042"), (0, "")):
        await cause_fault(wire, "emcy", code=0x4200, length=length)
        assert re.fullmatch(rf"< frame 087 \d+\.\d{{6}} {data} >", await daemon_line.read_frame())
    await cause_fault(wire, "emcy_clear")
    assert (await daemon_line.read_frame()).endswith(" 0000000000000000 >")


async def test_a_node_without_power_is_gone_and_boots_when_it_returns(wire: FakeDrawWire):
    loop = asyncio.get_running_loop()

    def inject_fault(name: str) -> None:
        asyncio.run_coroutine_threadsafe(cause_fault(wire, name), loop).result(WAIT_S)

    def check_power_loss(bus: CanopenBus) -> None:
        bus.node.sdo.RESPONSE_TIMEOUT = 0.1
        bus.send_nmt(1)
        bus.read_object(0x1000)
        inject_fault("node_off")
        with pytest.raises(canopen.SdoCommunicationError):
            bus.read_object(0x1000)
        inject_fault("node_on")
        assert bus.received_frames.wait_for_frame(0x707) == b"\x00"
        assert bus.read_object(0x1000) & 0xFFFF == 406
        assert wire.node.state == PRE_OPERATIONAL

    await on_the_bus(wire, check_power_loss)


async def test_sdo_faults(wire: FakeDrawWire):
    loop = asyncio.get_running_loop()

    def inject_fault(name: str, **parameters: Any) -> None:
        asyncio.run_coroutine_threadsafe(cause_fault(wire, name, **parameters), loop).result(WAIT_S)

    def check_sdo_faults(bus: CanopenBus) -> None:
        bus.node.sdo.RESPONSE_TIMEOUT = 0.1
        inject_fault("sdo_abort", code=0x08000022, count=1)
        assert bus.abort_of(lambda: bus.read_object(0x6004)) == 0x08000022
        inject_fault("sdo_silent", count=2)
        with pytest.raises(canopen.SdoCommunicationError):
            bus.read_object(0x6004)
        inject_fault("sdo_wrong_object", count=1)
        with pytest.raises(canopen.SdoCommunicationError):
            bus.read_object(0x6004)
        bus.node.sdo.RESPONSE_TIMEOUT = 2.0
        inject_fault("sdo_slow", delay_s=0.05, count=1)
        assert bus.read_object(0x6005, 1) == 10_000

    await on_the_bus(wire, check_sdo_faults)


async def test_heartbeat_and_telegrams_can_stop_or_freeze(wire: FakeDrawWire):
    loop = asyncio.get_running_loop()

    def inject_fault(name: str, **parameters: Any) -> None:
        asyncio.run_coroutine_threadsafe(cause_fault(wire, name, **parameters), loop).result(WAIT_S)

    def check_frozen_node(bus: CanopenBus) -> None:
        bus.write_object(0x1017, 0, 5, "<H")
        bus.write_object(0x6200, 0, 5, "<H")
        bus.send_nmt(1)
        bus.received_frames.wait_for_frame(0x707, after=1)
        bus.received_frames.wait_for_frame(0x187, after=1)
        inject_fault("heartbeat_stop")
        inject_fault("tpdo_frozen")
        beats, frozen = (
            bus.received_frames.count_frames(0x707),
            bus.received_frames.wait_for_frame(0x187, after=bus.received_frames.count_frames(0x187)),
        )
        wire.gauge.lengthen_readings(0.1)
        assert (
            bus.received_frames.wait_for_frame(0x187, after=bus.received_frames.count_frames(0x187) + 3)
            == frozen
        )
        assert bus.received_frames.count_frames(0x707) <= beats + 1
        inject_fault("tpdo_stop", duration_s=0.05)
        wire.clear_faults()
        newest = bus.received_frames.wait_for_frame(0x187, after=bus.received_frames.count_frames(0x187) + 1)
        assert struct.unpack("<i", newest)[0] - struct.unpack("<i", frozen)[0] == pytest.approx(
            10_000, abs=60
        )

    await on_the_bus(wire, check_frozen_node)


async def test_what_happens_to_the_wire_shows_in_the_position(wire: FakeDrawWire):
    loop = asyncio.get_running_loop()

    def inject_fault(name: str, **parameters: Any) -> None:
        asyncio.run_coroutine_threadsafe(cause_fault(wire, name, **parameters), loop).result(WAIT_S)

    def check_wire_faults(bus: CanopenBus) -> None:
        here = bus.read_position()
        inject_fault("wire_offset", m=0.005)
        assert bus.read_position() - here == pytest.approx(500, abs=60)
        inject_fault("wire_snap")
        assert bus.read_position() == pytest.approx(0, abs=100)
        inject_fault("wire_restore")
        assert bus.read_position() == pytest.approx(here, abs=60)
        inject_fault("wire_slack")
        assert bus.read_position() == pytest.approx(here, abs=60)
        assert wire.true_state()["snapped"] is False

    await on_the_bus(wire, check_wire_faults)
