"""An RTDE server of one page, written from the maker's guide: it says exactly what a test tells it to say."""

import asyncio
import random
import struct
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager, suppress

from cellcal.fake_devices.listening_port import ListeningPort

PORT = 30004
TYPES = "DOUBLE,VECTOR6D,VECTOR6D,VECTOR6D,VECTOR6D,DOUBLE,DOUBLE,INT32,UINT32,UINT32,UINT32,DOUBLE"
NAMES = (
    "timestamp,actual_q,actual_qd,actual_TCP_pose,tcp_offset,speed_scaling,target_speed_fraction,"
    "robot_mode,runtime_state,robot_status_bits,safety_status_bits,payload"
)
RECIPE = 7


def rtde_message(kind: str, payload: bytes) -> bytes:
    return struct.pack(">HB", 3 + len(payload), ord(kind)) + payload


def state_message(timestamp_s: float, joint_1_rad: float = 0.0) -> bytes:
    """Return one data message: an arm at rest, ready."""
    vectors = [joint_1_rad, *[0.0] * 23]
    return rtde_message(
        "U", struct.pack(">Bd24dddiIIId", RECIPE, timestamp_s, *vectors, 1.0, 1.0, 7, 1, 3, 1, 0.0)
    )


class RtdeController:
    """Answers the handshake from a table that a test may change; sends data only when told."""

    def __init__(self) -> None:
        self.address = ""
        self.requests: list[tuple[str, bytes]] = []
        self.answers: dict[str, bytes | None] = {
            "V": b"\x01",
            "v": struct.pack(">4I", 5, 11, 1, 108318),
            "O": bytes([RECIPE]) + TYPES.encode(),
            "S": b"\x01",
        }
        self.on_start: Callable[[], bytes] = lambda: state_message(1.0)
        self.started = asyncio.Event()
        self._writers: list[asyncio.StreamWriter] = []

    def send_data(self, data: bytes) -> None:
        """Send to the connected client."""
        for writer in self._writers:
            writer.write(data)

    def drop_connections(self) -> None:
        """Cut every connection."""
        for writer in self._writers:
            writer.close()
        self._writers.clear()

    async def serve_connection(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        self._writers.append(writer)
        with suppress(EOFError, ConnectionError):
            while True:
                size, kind = struct.unpack(">HB", await reader.readexactly(3))
                self._answer_request(chr(kind), await reader.readexactly(size - 3), writer)

    def _answer_request(self, kind: str, payload: bytes, writer: asyncio.StreamWriter) -> None:
        self.requests.append((kind, payload))
        answer = self.answers[kind]
        if answer is None:
            return
        writer.write(rtde_message(kind, answer))
        if kind == "S":
            writer.write(self.on_start())
            self.started.set()


@asynccontextmanager
async def running_controller() -> AsyncIterator[RtdeController]:
    """Serve on a loopback address of its own; RTDE's port is fixed."""
    controller, rng = RtdeController(), random.SystemRandom()
    for _ in range(20):
        address = f"127.{rng.randint(1, 250)}.{rng.randint(0, 250)}.{rng.randint(1, 250)}"
        server = ListeningPort(address, PORT, controller.serve_connection)
        with suppress(OSError):
            await server.open()
            break
    else:
        raise AssertionError("no free loopback address")
    controller.address = address
    try:
        yield controller
    finally:
        await server.wait_closed()
