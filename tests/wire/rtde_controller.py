"""An RTDE server of one page, written from the maker's guide: it says exactly what a test tells it to say."""

import asyncio
import random
import struct
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager, suppress

PORT = 30004
TYPES = "DOUBLE,VECTOR6D,VECTOR6D,VECTOR6D,VECTOR6D,DOUBLE,DOUBLE,INT32,UINT32,UINT32,UINT32,DOUBLE"
NAMES = (
    "timestamp,actual_q,actual_qd,actual_TCP_pose,tcp_offset,speed_scaling,target_speed_fraction,"
    "robot_mode,runtime_state,robot_status_bits,safety_status_bits,payload"
)
RECIPE = 7


def message(kind: str, payload: bytes) -> bytes:
    return struct.pack(">HB", 3 + len(payload), ord(kind)) + payload


def state(timestamp_s: float, joint_1_rad: float = 0.0) -> bytes:
    """Return one data message: an arm at rest, ready."""
    vectors = [joint_1_rad, *[0.0] * 23]
    return message(
        "U", struct.pack(">Bd24dddiIIId", RECIPE, timestamp_s, *vectors, 1.0, 1.0, 7, 1, 3, 1, 0.0)
    )


class Controller:
    """Answers the handshake from a table that a test may change; sends data only when told."""

    def __init__(self) -> None:
        self.address = ""
        self.asked: list[tuple[str, bytes]] = []
        self.answers: dict[str, bytes | None] = {
            "V": b"\x01",
            "v": struct.pack(">4I", 5, 11, 1, 108318),
            "O": bytes([RECIPE]) + TYPES.encode(),
            "S": b"\x01",
        }
        self.on_start: Callable[[], bytes] = lambda: state(1.0)
        self.started = asyncio.Event()
        self._writers: list[asyncio.StreamWriter] = []

    def send(self, data: bytes) -> None:
        """Send to whoever is connected."""
        for writer in self._writers:
            writer.write(data)

    def drop(self) -> None:
        """Cut every connection."""
        for writer in self._writers:
            writer.close()
        self._writers.clear()

    async def serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        self._writers.append(writer)
        with suppress(EOFError, ConnectionError):
            while True:
                size, kind = struct.unpack(">HB", await reader.readexactly(3))
                self._answer(chr(kind), await reader.readexactly(size - 3), writer)
        writer.close()

    def _answer(self, kind: str, payload: bytes, writer: asyncio.StreamWriter) -> None:
        self.asked.append((kind, payload))
        answer = self.answers[kind]
        if answer is None:
            return
        writer.write(message(kind, answer))
        if kind == "S":
            writer.write(self.on_start())
            self.started.set()


@asynccontextmanager
async def running_controller() -> AsyncIterator[Controller]:
    """Serve on a loopback address of its own; RTDE's port is fixed."""
    controller, dice = Controller(), random.SystemRandom()
    for _ in range(20):
        address = f"127.{dice.randint(1, 250)}.{dice.randint(0, 250)}.{dice.randint(1, 250)}"
        with suppress(OSError):
            server = await asyncio.start_server(controller.serve, address, PORT)
            break
    else:
        raise AssertionError("no free loopback address")
    controller.address = address
    try:
        yield controller
    finally:
        server.close()
        controller.drop()
        await server.wait_closed()
