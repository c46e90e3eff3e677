"""The state stream against a server written from the document: nothing lost, stale or guessed."""

import asyncio
import math
import struct
from collections.abc import AsyncIterator

import pytest

from cellcal.drivers.errors import DeviceError, RefusedError, UnreachableError, WireProtocolError
from cellcal.drivers.universal_robots.state import StateClient
from tests.machine_speed import stretched_s
from tests.wire.rtde_controller import (
    NAMES,
    RECIPE,
    TYPES,
    RtdeController,
    rtde_message,
    running_controller,
    state_message,
)

pytestmark = pytest.mark.timeout(stretched_s(180.0))
LONG_S = stretched_s(10.0)
SHORT_S = 0.2


@pytest.fixture
async def controller() -> AsyncIterator[RtdeController]:
    async with running_controller() as controller:
        yield controller


@pytest.fixture
async def client(controller: RtdeController) -> AsyncIterator[StateClient]:
    client = StateClient("arm", controller.address, rate_hz=125.0, stale_s=LONG_S)
    yield client
    client.close()


async def until_newest(client: StateClient, timestamp_s: float) -> None:
    while client.samples[-1].timestamp_s != timestamp_s:
        await client.read_fresh()


async def test_the_handshake_is_the_one_of_the_document(
    controller: RtdeController, client: StateClient
) -> None:
    version = await client.connect(deadline_s=LONG_S)
    assert str(version) == "5.11.1.108318"
    assert [kind for kind, _ in controller.requests] == ["V", "v", "O", "S"]
    assert controller.requests[0][1] == b"\x00\x02"
    assert controller.requests[2][1] == struct.pack(">d", 125.0) + NAMES.encode()


async def test_each_field_comes_from_its_place(controller: RtdeController, client: StateClient) -> None:
    numbers = [float(k) for k in range(1, 28)]
    data = struct.pack(">Bd24dddiIIId", RECIPE, *numbers[:25], 0.5, 0.25, -1, 2, 3, 1 << 2, 1.25)
    controller.on_start = lambda: rtde_message("U", data)
    await client.connect(deadline_s=LONG_S)
    sample = client.samples[-1]
    assert sample.timestamp_s == 1.0
    assert sample.joints_rad == (2, 3, 4, 5, 6, 7)
    assert sample.joint_speeds_rad_s == (8, 9, 10, 11, 12, 13)
    assert sample.tcp_pose == (14, 15, 16, 17, 18, 19)
    assert sample.tcp_offset == (20, 21, 22, 23, 24, 25)
    assert (sample.speed_scaling, sample.speed_fraction) == (0.5, 0.25)
    assert (sample.robot_mode, sample.runtime_state, sample.robot_status_bits) == (-1, 2, 3)
    assert sample.safety_status_bits == 4
    assert sample.payload_kg == 1.25
    assert sample.raw == data


@pytest.mark.parametrize("cut", [1, 2, 3, 5, 233, 1000])
async def test_no_packet_is_lost_however_the_stream_is_cut(
    controller: RtdeController, client: StateClient, cut: int
) -> None:
    await client.connect(deadline_s=LONG_S)
    stream = b"".join(state_message(2.0 + k, 0.001 * k) for k in range(100)) + rtde_message(
        "M", b"\x02hi\x00\x03"
    )
    for start in range(0, len(stream), cut):
        controller.send_data(stream[start : start + cut])
        await asyncio.sleep(0)
    await until_newest(client, 101.0)
    assert [sample.timestamp_s for sample in client.samples] == [float(k) for k in range(1, 102)]
    assert client.samples[-1].joints_rad[0] == pytest.approx(0.099)


async def test_fresh_waits_for_a_state_that_is_sent_after_the_call(
    controller: RtdeController, client: StateClient
) -> None:
    await client.connect(deadline_s=LONG_S)
    reading = asyncio.create_task(client.read_fresh())
    await asyncio.sleep(0)
    assert not reading.done()
    controller.send_data(state_message(2.0))
    assert (await reading).timestamp_s == 2.0


async def test_a_silent_controller_is_unreachable_and_says_what_to_check(controller: RtdeController) -> None:
    client = StateClient("arm", controller.address, rate_hz=125.0, stale_s=SHORT_S)
    await client.connect(deadline_s=LONG_S)
    with pytest.raises(UnreachableError, match=r"arm: .*no new state for 0\.2 s.*cable"):
        await client.read_fresh()
    assert not client.is_alive


async def test_a_clock_that_stands_still_brings_no_news(controller: RtdeController) -> None:
    client = StateClient("arm", controller.address, rate_hz=125.0, stale_s=SHORT_S)
    await client.connect(deadline_s=LONG_S)

    async def repeat_state() -> None:
        while True:
            controller.send_data(state_message(1.0))
            await asyncio.sleep(0.01)

    repeating = asyncio.create_task(repeat_state())
    with pytest.raises(UnreachableError, match="no new state"):
        await client.read_fresh()
    repeating.cancel()
    await asyncio.wait({repeating})


async def test_a_busy_event_loop_is_not_a_silent_robot(controller: RtdeController) -> None:
    import time

    client = StateClient("arm", controller.address, rate_hz=125.0, stale_s=SHORT_S)
    await client.connect(deadline_s=LONG_S)
    reading = asyncio.create_task(client.read_fresh())
    await asyncio.sleep(0)
    controller.send_data(state_message(2.0))
    time.sleep(2 * SHORT_S)  # noqa: ASYNC251 - blocks the loop on purpose
    assert (await reading).timestamp_s == 2.0
    client.close()


async def test_a_lost_link_is_reported_to_every_waiting_caller(
    controller: RtdeController, client: StateClient
) -> None:
    await client.connect(deadline_s=LONG_S)
    readings = [asyncio.create_task(client.read_fresh()) for _ in range(3)]
    await asyncio.sleep(0)
    controller.drop_connections()
    results = await asyncio.gather(*readings, return_exceptions=True)
    assert [type(result) for result in results] == [UnreachableError] * 3


async def test_an_unnoticed_lost_link_is_reported_once(
    controller: RtdeController, client: StateClient
) -> None:
    await client.connect(deadline_s=LONG_S)
    controller.drop_connections()
    async with asyncio.timeout(LONG_S):
        while client.is_alive:
            await asyncio.sleep(0.001)
    with pytest.raises(UnreachableError, match="closed the connection"):
        client.report_loss()
    client.report_loss()


@pytest.mark.parametrize(
    ("data", "says"),
    [
        (rtde_message("U", b"\x07" + bytes(10)), "a state of 11 bytes"),
        (rtde_message("U", bytes([RECIPE + 1]) + bytes(244)), "a state of 245 bytes"),
        (struct.pack(">HB", 2, ord("U")), "a message of 2 bytes"),
        (state_message(2.0, math.nan), "not a number"),
        (state_message(2.0, math.inf), "not a number"),
        (state_message(2.0, 1e5), "where no axis can stand"),
        (state_message(2.0, 57.3), "where no axis can stand"),
    ],
    ids=["short", "foreign recipe", "impossible size", "nan", "inf", "impossible angle", "degrees"],
)
async def test_a_malformed_state_never_becomes_a_reading(
    controller: RtdeController, client: StateClient, data: bytes, says: str
) -> None:
    await client.connect(deadline_s=LONG_S)
    controller.send_data(data)
    with pytest.raises((WireProtocolError, UnreachableError), match=says):
        await client.read_fresh()
    assert [sample.timestamp_s for sample in client.samples] == [1.0]


@pytest.mark.parametrize(
    ("kind", "answer", "error", "says"),
    [
        ("V", b"\x00", RefusedError, "version 2 of RTDE"),
        ("v", b"\x00", WireProtocolError, "a version of another size"),
        ("O", b"\x07" + TYPES.replace("VECTOR6D", "NOT_FOUND", 1).encode(), RefusedError, "actual_q"),
        ("O", b"\x07" + TYPES.replace("VECTOR6D", "VECTOR3D", 1).encode(), WireProtocolError, "VECTOR3D"),
        ("S", b"\x00", RefusedError, "refused to send its state"),
        ("O", None, UnreachableError, "did not answer within"),
        ("S", None, UnreachableError, "did not answer within"),
    ],
)
async def test_a_handshake_that_goes_wrong_says_how(
    controller: RtdeController, kind: str, answer: bytes | None, error: type[DeviceError], says: str
) -> None:
    controller.answers[kind] = answer
    client = StateClient("arm", controller.address, rate_hz=125.0, stale_s=LONG_S)
    with pytest.raises(error, match=says) as caught:
        await client.connect(deadline_s=SHORT_S if answer is None else LONG_S)
    assert caught.value.remedy
    assert not client.is_alive


async def test_a_flood_of_answers_ends_the_link_and_fills_no_memory(
    controller: RtdeController, client: StateClient
) -> None:
    await client.connect(deadline_s=LONG_S)
    controller.send_data(rtde_message("V", bytes(1000)) * 100)
    with pytest.raises(WireProtocolError, match="answers to nothing that was asked"):
        await client.read_fresh()
    assert client._replies.qsize() < 20


async def test_an_address_without_a_listener_is_unreachable() -> None:
    async with running_controller() as controller:
        address = controller.address
    client = StateClient("arm", address, rate_hz=125.0, stale_s=LONG_S)
    with pytest.raises(UnreachableError, match=r"cannot be reached.*cable"):
        await client.connect(deadline_s=LONG_S)
