"""A length is either measured now by the right gauge, or it is an error (rows F21-F35)."""

import asyncio
import math
import socket
import struct
import threading
import time
from collections.abc import AsyncIterator
from contextlib import suppress
from typing import Any

import can
import pytest

from cellcal.drivers.draw_wire.gauge import DrawWire, GaugeOptions
from cellcal.drivers.draw_wire.objects import load_objects
from cellcal.drivers.errors import (
    DeviceError,
    DeviceTimeoutError,
    RefusedError,
    UnreachableError,
    WireProtocolError,
)
from cellcal.drivers.interfaces import Readiness
from cellcal.drivers.wire.can_session import BusOptions
from cellcal.drivers.wire.canopen import CanopenLink
from cellcal.drivers.wire.socketcand import SafeSocketcandBus
from cellcal.service.configuration.cell_file import CellConfig
from cellcal.service.demo.fake_cell_client import FakeCellClient
from tests.machine_speed import stretched_s
from tests.wire.driver_cases import GAUGES, GaugeCase, until_ready, wait_until


@pytest.fixture
def gauge_case() -> GaugeCase:
    """CANopen only: another bus has other ways to fail."""
    return GAUGES["draw_wire"]


def reader_threads() -> set[threading.Thread]:
    return {thread for thread in threading.enumerate() if thread.name.startswith("CAN receiver of")}


async def expected_m(fake_client: FakeCellClient) -> float:
    return float((await fake_client.read_truth())["gauges"]["wire"]["reading_m"])


async def check_healed(gauge: Any, fake_client: FakeCellClient) -> None:
    await GAUGES["draw_wire"].heal(fake_client)
    await until_ready(gauge, Readiness.READY)
    assert (await gauge.read_distance()).value_m == pytest.approx(await expected_m(fake_client), abs=0.001)


class TestTheNode:
    @pytest.mark.parametrize(
        ("fault", "parameters", "error"),
        [
            ("sdo_silent", {}, DeviceTimeoutError),
            ("sdo_slow", {"delay_s": 0.5}, DeviceTimeoutError),
            ("sdo_wrong_object", {}, WireProtocolError),
            ("sdo_abort", {"code": 0x06020000}, RefusedError),
            ("node_off", {}, DeviceError),
        ],
    )
    async def test_that_does_not_answer_rightly_is_an_error_with_a_remedy(
        self,
        gauge: Any,
        fake_client: FakeCellClient,
        fault: str,
        parameters: dict[str, Any],
        error: type[DeviceError],
    ) -> None:
        fault_parameters = {
            key: stretched_s(value) if key == "delay_s" else value for key, value in parameters.items()
        }
        await fake_client.inject_fault(fault, device="wire", **fault_parameters)
        with pytest.raises(error) as failure:
            await gauge.read_distance()
        assert str(failure.value).startswith("wire: ")
        assert failure.value.remedy
        await check_healed(gauge, fake_client)

    @pytest.mark.parametrize("delay_s", [0.4, 0.5, 0.6, 0.8])
    async def test_that_answers_late_is_never_taken_for_the_next_answer(
        self, gauge: Any, fake_client: FakeCellClient, delay_s: float
    ) -> None:
        await fake_client.inject_fault("sdo_slow", device="wire", delay_s=stretched_s(delay_s), count=1)
        with pytest.raises(DeviceTimeoutError):
            await gauge.read_distance()
        await fake_client.inject_fault("wire_offset", device="wire", m=0.04)
        found = []
        while not found:
            try:
                found.append((await gauge.read_distance()).value_m)
            except DeviceError:
                await asyncio.sleep(0.02)
        assert found[0] == pytest.approx(await expected_m(fake_client), abs=0.001)

    async def test_whose_heartbeat_stops_is_lost_even_without_a_request(
        self, gauge: Any, fake_client: FakeCellClient
    ) -> None:
        assert reader_threads()
        await fake_client.inject_fault("heartbeat_stop", device="wire")

        async def is_noticed() -> bool:
            return not reader_threads()

        await wait_until(is_noticed)
        await check_healed(gauge, fake_client)

    async def test_that_restarts_is_set_up_again(self, gauge: Any, fake_client: FakeCellClient) -> None:
        await gauge.read_distance()
        await fake_client.inject_fault("node_off", device="wire")
        await fake_client.inject_fault("node_on", device="wire")
        await until_ready(gauge, Readiness.READY)
        before = reader_threads()
        assert (await gauge.read_distance()).value_m == pytest.approx(
            await expected_m(fake_client), abs=0.001
        )
        assert reader_threads() == before, "the heartbeat was not switched on again"

    async def test_whose_zero_was_moved_is_not_trusted_until_it_is_opened_again(
        self, gauge: Any, cell: CellConfig, fake_client: FakeCellClient
    ) -> None:
        config = cell.gauges[0].device
        data = struct.pack("<BHBi", 0x23, 0x6003, 0, 100_000)
        bus = can.Bus(interface="socketcand", channel="can0", host=config.host, port=config.port)
        bus.send(can.Message(arbitration_id=0x600 + config.node_id, data=data, is_extended_id=False))
        assert await asyncio.to_thread(bus.recv, stretched_s(10.0)) is not None
        bus.shutdown()
        await gauge.close()  # the next call connects again, as after any interruption
        for _ in range(2):
            with pytest.raises(RefusedError, match="zero of the gauge moved"):
                await gauge.read_distance()
        async with config.open() as opened_again:
            assert (await opened_again.read_distance()).value_m == pytest.approx(1.0, abs=0.002)
        await fake_client.inject_fault("node_off", device="wire")
        await fake_client.inject_fault("node_on", device="wire")
        await check_healed(gauge, fake_client)


class TestEmergencies:
    @pytest.mark.parametrize("length", [2, 3, 5, 8])
    async def test_of_any_length_are_latched_until_the_node_takes_them_back(
        self, gauge: Any, fake_client: FakeCellClient, length: int
    ) -> None:
        await fake_client.inject_fault("emcy", device="wire", code=0x5200, length=length)

        async def is_latched() -> bool:
            return (await gauge.read_condition()).readiness is Readiness.NOT_READY

        await wait_until(is_latched)
        condition = await gauge.read_condition()
        assert [alarm.code for alarm in condition.alarms] == ["EMCY-5200"]
        with pytest.raises(RefusedError, match="sensor hardware") as failure:
            await gauge.read_distance()
        assert failure.value.vendor_code == 0x5200
        await check_healed(gauge, fake_client)

    async def test_survive_a_lost_link(self, gauge: Any, fake_client: FakeCellClient) -> None:
        await fake_client.inject_fault("emcy", device="wire", code=0x4210)
        await fake_client.inject_fault("daemon_stop", device="wire", duration_s=0.3)
        condition = await until_ready(gauge, Readiness.NOT_READY)
        assert [alarm.code for alarm in condition.alarms] == ["EMCY-4210"]
        assert condition.message.endswith("wire speed too high")

    async def test_end_with_the_other_faults(self, gauge: Any, fake_client: FakeCellClient) -> None:
        await fake_client.inject_fault("emcy", device="wire", code=0x4210)
        await until_ready(gauge, Readiness.NOT_READY)
        await fake_client.send_command("clear")
        await until_ready(gauge, Readiness.READY)


class TestTheWire:
    async def test_that_has_snapped_gives_no_length(self, gauge: Any, fake_client: FakeCellClient) -> None:
        await fake_client.inject_fault("wire_snap", device="wire")
        with pytest.raises(RefusedError) as failure:
            await gauge.read_distance()
        assert failure.value.remedy
        await check_healed(gauge, fake_client)

    async def test_at_the_end_of_its_range_gives_no_length(
        self, gauge: Any, fake_client: FakeCellClient
    ) -> None:
        await fake_client.inject_fault("wire_offset", device="wire", m=2.5)
        with pytest.raises(RefusedError):
            await gauge.read_distance()
        await check_healed(gauge, fake_client)


class TestTheBus:
    async def test_with_another_master_is_not_used(self, gauge: Any, fake_client: FakeCellClient) -> None:
        async def is_noticed() -> bool:
            await fake_client.inject_fault(
                "foreign_master", device="wire"
            )  # again and again: it is told for two seconds only
            return (await gauge.read_condition()).readiness is Readiness.NOT_READY

        async def is_refused() -> bool:
            await fake_client.inject_fault("foreign_master", device="wire")
            with suppress(WireProtocolError):  # its answer came between ours
                try:
                    await gauge.read_distance()
                except RefusedError as failure:
                    return "another program" in str(failure)
            return False

        await wait_until(is_noticed)
        await wait_until(is_refused)

    async def test_survives_an_error_frame(self, gauge: Any, fake_client: FakeCellClient) -> None:
        await fake_client.inject_fault("error_frame", device="wire")
        assert (await gauge.read_distance()).value_m == pytest.approx(
            await expected_m(fake_client), abs=0.001
        )

    async def test_whose_daemon_dies_is_noticed_without_a_request(
        self, gauge: Any, fake_client: FakeCellClient
    ) -> None:
        assert reader_threads()
        await fake_client.inject_fault("daemon_stop", device="wire")

        async def is_noticed() -> bool:
            return not reader_threads()

        await wait_until(is_noticed)
        await check_healed(gauge, fake_client)

    async def test_is_left_without_threads(self, cell: CellConfig, fake_client: FakeCellClient) -> None:
        await GAUGES["draw_wire"].heal(fake_client)
        before = set(threading.enumerate())
        for _ in range(3):
            async with cell.gauges[0].device.open() as gauge:
                await gauge.read_distance()

        async def has_ended() -> bool:
            return set(threading.enumerate()) <= before

        await wait_until(has_ended)


class ScriptedDaemon:
    """A socketcand daemon that says byte for byte what it is told to."""

    def __init__(self, *answers: bytes) -> None:
        self._answers, self._server = answers, socket.create_server(("127.0.0.1", 0))
        self.port = int(self._server.getsockname()[1])
        self.connection: socket.socket | None = None
        self._thread = threading.Thread(target=self._serve_script, daemon=True)
        self._thread.start()

    def _serve_script(self) -> None:
        self.connection, _ = self._server.accept()
        for number, answer in enumerate(self._answers):
            if number:
                self.connection.recv(256)
            self.connection.sendall(answer)

    def stop_daemon(self) -> None:
        self._server.close()
        self._thread.join(5.0)
        if self.connection is not None:
            self.connection.close()


class TestTheTrapsOfSocketcand:
    """python-can 4.6.1 falls into each of these by itself."""

    def test_a_frame_may_arrive_with_the_last_handshake_answer(self) -> None:
        daemon = ScriptedDaemon(b"< hi >", b"< ok >", b"< ok >< frame 707 1.000000 05 >")
        bus = SafeSocketcandBus("can0", "127.0.0.1", daemon.port, handshake_s=stretched_s(5.0))
        message = bus.recv(stretched_s(5.0))
        assert message is not None
        assert (message.arbitration_id, bytes(message.data)) == (0x707, b"\x05")
        bus.shutdown()
        daemon.stop_daemon()

    def test_a_silent_daemon_is_given_up(self) -> None:
        daemon = ScriptedDaemon(b"< hi >")
        with pytest.raises(TimeoutError):
            SafeSocketcandBus("can0", "127.0.0.1", daemon.port, handshake_s=0.1)
        daemon.stop_daemon()

    def test_a_greeting_that_trickles_is_given_up(self, monkeypatch: pytest.MonkeyPatch) -> None:
        now_s = 0.0

        class TricklingSocket:
            def settimeout(self, timeout_s: float) -> None:
                assert timeout_s <= 1.0

            def recv(self, size: int) -> bytes:
                nonlocal now_s
                now_s += 0.3  # each octet comes before its own wait has ended
                return b"<"[:size]

        monkeypatch.setattr(time, "monotonic", lambda: now_s)
        bus = SafeSocketcandBus.__new__(SafeSocketcandBus)
        bus._SocketCanDaemonBus__socket = TricklingSocket()  # type: ignore[assignment]
        bus._handshake_s, bus._ends_s, bus._is_shutdown = 1.0, math.inf, True
        with pytest.raises(TimeoutError):
            bus._expect_msg("< hi >")
        assert now_s < 1.5

    def test_a_daemon_that_says_no_is_an_error(self) -> None:
        daemon = ScriptedDaemon(b"< hi >", b"< error could not open bus >")
        with pytest.raises(can.CanError, match="could not open bus"):
            SafeSocketcandBus("can9", "127.0.0.1", daemon.port, handshake_s=stretched_s(5.0))
        daemon.stop_daemon()

    @pytest.mark.parametrize("malformed", [b"< frame 707 1.0 >", b"< frame 707 1.0 5 >", b""])
    def test_nonsense_and_the_end_are_errors_and_not_silence(self, malformed: bytes) -> None:
        daemon = ScriptedDaemon(b"< hi >", b"< ok >", b"< ok >" + malformed)
        bus = SafeSocketcandBus("can0", "127.0.0.1", daemon.port, handshake_s=stretched_s(5.0))
        daemon.stop_daemon()
        with pytest.raises(can.CanError):
            bus.recv(stretched_s(5.0))
        bus.shutdown()


@pytest.fixture
async def virtual_gauge() -> AsyncIterator[tuple[DrawWire, can.BusABC]]:
    """A gauge on an in-process bus, and the bus as a node sees it; only the test answers."""
    channel = f"bus {id(asyncio.get_running_loop())}"
    node = can.Bus(interface="virtual", channel=channel)
    link = CanopenLink(
        "wire", BusOptions("virtual", channel), 7, deadline_s=stretched_s(1.0), heartbeat_s=60.0
    )
    gauge = DrawWire(link, load_objects(), GaugeOptions(4711, 3.0, 2e-4, 0.005, stretched_s(1.0)))
    yield gauge, node
    await gauge.close()
    node.shutdown()


async def answer_with(node: can.BusABC, frames: list[tuple[int, bytes]]) -> None:
    """Wait for one request, then send these frames."""
    request = await asyncio.to_thread(node.recv, stretched_s(10.0))
    assert request is not None
    for can_id, data in frames:
        node.send(can.Message(arbitration_id=can_id, data=data, is_extended_id=False))


async def test_a_short_answer_is_not_a_value(virtual_gauge: tuple[DrawWire, can.BusABC]) -> None:
    gauge, node = virtual_gauge
    answering = asyncio.create_task(answer_with(node, [(0x587, bytes.fromhex("60171000"))]))
    with pytest.raises(WireProtocolError, match="4 bytes instead of 8") as failure:
        await gauge.read_distance()
    assert failure.value.frame == "60171000"
    await answering


async def test_an_answer_that_is_one_too_many_ends_the_session(
    virtual_gauge: tuple[DrawWire, can.BusABC],
) -> None:
    """A late answer for the same object looks right; only the count of answers gives it away."""
    gauge, node = virtual_gauge
    late, right = b"\x43\x04\x60\x00" + struct.pack("<i", 1), b"\x43\x04\x60\x00" + struct.pack("<i", 100_000)
    expedited = {
        0x1017: b"\x60\x17\x10\x00" + bytes(4),
        0x1000: b"\x43\x00\x10\x00" + struct.pack("<I", 0x196),
        0x1018: b"\x43\x18\x10\x04" + struct.pack("<I", 4711),
        0x6005: b"\x43\x05\x60\x01" + struct.pack("<I", 10_000),
        0x6509: b"\x80\x09\x65\x00" + struct.pack("<I", 0x06020000),
        0x1001: b"\x4f\x01\x10\x00" + bytes(4),
    }

    over = threading.Event()

    async def serve_extra_answer() -> None:
        while not over.is_set():
            request = await asyncio.to_thread(node.recv, 0.05)
            if request is None:
                continue
            (index,) = struct.unpack_from("<H", request.data, 1)
            for data in (late, right) if index == 0x6004 else (expedited[index],):
                node.send(can.Message(arbitration_id=0x587, data=data, is_extended_id=False))

    serving = asyncio.create_task(serve_extra_answer())
    with pytest.raises(WireProtocolError):
        await gauge.read_distance()
    await gauge.close()
    over.set()
    await serving


async def test_bus_off_is_reported_as_such(virtual_gauge: tuple[DrawWire, can.BusABC]) -> None:
    gauge, node = virtual_gauge
    asking = asyncio.create_task(gauge.read_distance())
    assert await asyncio.to_thread(node.recv, stretched_s(10.0)) is not None
    node.send(can.Message(arbitration_id=0x40, is_error_frame=True, is_extended_id=True, data=bytes(8)))
    with pytest.raises(UnreachableError, match="bus-off"):
        await asking
