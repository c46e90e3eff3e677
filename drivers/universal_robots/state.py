"""The arm's state from our own RTDE connection: every packet, in order, with the controller's time.

All decisions of the driver rest on this stream. ur-rtde keeps only the newest packet, serves old values after
a lost link, and says "running" of a program on a controller that is gone.
"""

import asyncio
import contextlib
import math
import struct
import time
from collections import deque
from dataclasses import dataclass
from typing import Any

from cellcal.calibration.message import make_message
from cellcal.drivers.errors import DeviceError, RefusedError, UnreachableError, WireProtocolError
from cellcal.drivers.universal_robots.rtde import PORT, MessageType, RtdeLink, pack_message
from cellcal.drivers.wire.link_errors import find_reason
from cellcal.drivers.wire.possible_values import are_possible_joints
from cellcal.drivers.wire.trace import FrameTrace

UPDATE = "Update the controller: CB3 to 3.12, PolyScope 5 to 5.6 or PolyScope X to 10.11, or later."
CABLE = "Check that the controller is switched on, the network cable plugged in and the address its own."

_KEPT_SAMPLES = 512
_HEX_SHOWN = 48
_WIDEST_RAD = 6.5  # limits are 363 deg; the sixth joint of some arms turns without an end
_MOST_REPLIES = 16  # that wait; each answers one question, and one is asked at a time

# Name and RTDE type: the order of the packet.
_RECIPE: tuple[tuple[str, str], ...] = (
    ("timestamp", "DOUBLE"),
    ("actual_q", "VECTOR6D"),
    ("actual_qd", "VECTOR6D"),
    ("actual_TCP_pose", "VECTOR6D"),
    ("tcp_offset", "VECTOR6D"),
    ("speed_scaling", "DOUBLE"),
    ("target_speed_fraction", "DOUBLE"),
    ("robot_mode", "INT32"),
    ("runtime_state", "UINT32"),
    ("robot_status_bits", "UINT32"),
    ("safety_status_bits", "UINT32"),
    ("payload", "DOUBLE"),  # since PolyScope 5.6, the oldest that we know
)
_NAMES = ",".join(name for name, _ in _RECIPE)
_TYPES = ",".join(kind for _, kind in _RECIPE)
_PACKET = struct.Struct(">Bd6d6d6d6dddiIIId")  # recipe id, then the fields

Six = tuple[float, float, float, float, float, float]


@dataclass(frozen=True, slots=True)
class StateSample:
    """One packet of the stream."""

    timestamp_s: float  # the controller's clock
    joints_rad: Six
    joint_speeds_rad_s: Six
    tcp_pose: Six  # base_tcp: x, y, z [m], rotation vector [rad]
    tcp_offset: Six  # flange_tcp, written alike
    speed_scaling: float
    speed_fraction: float  # the speed slider
    robot_mode: int
    runtime_state: int
    robot_status_bits: int
    safety_status_bits: int
    payload_kg: float  # the active one
    received_at_s: float  # host monotonic clock
    raw: bytes


@dataclass(frozen=True, slots=True)
class ControllerVersion:
    """Version of the controller's software."""

    major: int
    minor: int
    bugfix: int
    build: int

    def __str__(self) -> str:
        return f"{self.major}.{self.minor}.{self.bugfix}.{self.build}"


class StateClient:
    """One RTDE connection that only reads. Connect once; a lost one is replaced by a new object."""

    def __init__(self, device: str, address: str, *, rate_hz: float, stale_s: float) -> None:
        self.device, self.address, self.stale_s = device, address, stale_s
        self.samples: deque[StateSample] = deque(maxlen=_KEPT_SAMPLES)
        self.trace = FrameTrace(device, keep=20)
        self._rate_hz = rate_hz
        self._transport: asyncio.Transport | None = None
        self._replies: asyncio.Queue[tuple[int, bytes]] = asyncio.Queue()
        self._arrived = asyncio.Event()
        self._error: DeviceError | None = None
        self._loss_reported = False
        self._recipe_id = -1
        self._newest_s = -math.inf

    @property
    def is_alive(self) -> bool:
        """Whether the connection stands, as known without waiting."""
        return self._transport is not None and self._error is None

    async def connect(self, *, deadline_s: float) -> ControllerVersion:
        """Connect, agree on the fields, wait for the first state; return the controller's version."""
        loop = asyncio.get_running_loop()
        try:
            async with asyncio.timeout(deadline_s):
                self._transport, _ = await loop.create_connection(
                    lambda: RtdeLink(self._on_message, self._on_lost), self.address, PORT
                )
                version = await self._negotiate_version()
                if not self.samples:
                    await self.read_fresh()
        except TimeoutError:
            self.close()
            raise self._unreachable_error(
                make_message("did not answer within {deadline_s:g} s", deadline_s=deadline_s)
            ) from None
        except OSError as error:
            raise self._unreachable_error(
                make_message("cannot be reached ({error})", error=find_reason(error))
            ) from error
        except BaseException:
            self.close()
            raise
        return version

    def close(self) -> None:
        """Hang up; readers that wait raise. Harmless when done twice."""
        self._fail_with(UnreachableError(self.device, "the connection was closed."))
        if self._transport is not None:
            self._transport.abort()

    async def read_fresh(self) -> StateSample:
        """Return a sample that arrives after this call; raise if none does within ``stale_s``."""
        before_s = self._newest_s
        deadline_s = asyncio.get_running_loop().time() + self.stale_s
        while self._newest_s <= before_s:
            self.report_loss(again=True)
            if not await self._wait_for_sample(deadline_s) and self._newest_s <= before_s:
                self._fail_with(
                    self._unreachable_error(
                        make_message("sent no new state for {stale_s:g} s", stale_s=self.stale_s)
                    )
                )
                self.close()
        return self.samples[-1]

    def report_loss(self, *, again: bool = False) -> None:
        """Raise why the connection was lost; only if not raised before, unless ``again``."""
        if self._error is None or (self._loss_reported and not again):
            return
        self._loss_reported = True
        raise self._error

    async def _wait_for_sample(self, deadline_s: float) -> bool:
        self._arrived.clear()
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout_at(deadline_s):
                return await self._arrived.wait()
        return False

    async def _negotiate_version(self) -> ControllerVersion:
        if await self._send_request(MessageType.PROTOCOL, struct.pack(">H", 2)) != b"\x01":
            raise self._refused_error("does not speak version 2 of RTDE", UPDATE)
        version = await self._send_request(MessageType.VERSION)
        if len(version) != 16:
            raise self._protocol_error("a version of another size", version)
        recipe_request = struct.pack(">d", self._rate_hz) + _NAMES.encode()
        self._accept_recipe(await self._send_request(MessageType.OUTPUTS, recipe_request))
        if await self._send_request(MessageType.START) != b"\x01":
            raise self._refused_error(
                "refused to send its state", "Disconnect other RTDE clients, or restart it."
            )
        return ControllerVersion(*struct.unpack(">4I", version))

    def _accept_recipe(self, reply: bytes) -> None:
        types = reply[1:].decode("ascii", errors="replace").rstrip(",")
        if types == _TYPES:
            self._recipe_id = reply[0]
            return
        pairs = zip(_RECIPE, types.split(","), strict=False)
        unknown = [name for (name, _), kind in pairs if kind == "NOT_FOUND"]
        if not unknown:
            raise self._protocol_error(make_message("fields of other types ({types})", types=types), reply)
        raise self._refused_error(
            make_message("does not know {unknown}", unknown=", ".join(unknown)),
            UPDATE,
        )

    async def _send_request(self, kind: MessageType, payload: bytes = b"") -> bytes:
        assert self._transport is not None
        self.trace.add_frame(">", f"{chr(kind)} {payload.hex()}")
        self._transport.write(pack_message(kind, payload))
        answered, reply = await self._replies.get()
        self.report_loss(again=True)
        if answered != kind:
            raise self._protocol_error(
                make_message(
                    "{answer_type!r} in answer to {request_type!r}",
                    answer_type=chr(answered),
                    request_type=chr(kind),
                ),
                reply,
            )
        return reply

    def _on_message(self, kind: int, payload: bytes) -> None:
        if kind == MessageType.DATA:
            self._on_data(payload)
            return
        self.trace.add_frame("<", f"{chr(kind)} {payload.hex()}")
        if kind == MessageType.TEXT:  # the controller's remarks may come at any time
            return
        if self._replies.qsize() >= _MOST_REPLIES:
            self._fail_with(self._protocol_error("answers to nothing that was asked", payload))
            self.close()
            return
        self._replies.put_nowait((kind, payload))

    def _on_data(self, payload: bytes) -> None:
        if len(payload) != _PACKET.size or payload[0] != self._recipe_id:
            self._fail_with(
                self._protocol_error(
                    make_message("a state of {payload_count} bytes", payload_count=len(payload)), payload
                )
            )
            self.close()
            return
        sample = _decode_sample(payload)
        if not all(map(math.isfinite, (sample.timestamp_s, *sample.joints_rad, *sample.joint_speeds_rad_s))):
            self._fail_with(self._protocol_error("a joint state that is not a number", payload))
            self.close()
            return
        if not are_possible_joints(sample.joints_rad) or max(map(abs, sample.joints_rad[:5])) > _WIDEST_RAD:
            self._fail_with(self._protocol_error("a joint angle where no axis can stand", payload))
            self.close()
            return
        if sample.timestamp_s > self._newest_s:  # a clock that stands still brings no news
            self._newest_s = sample.timestamp_s
            self.samples.append(sample)
            self._arrived.set()

    def _on_lost(self, error: Exception | None) -> None:
        self._fail_with(
            self._unreachable_error(
                make_message(
                    "closed the connection{error}", error=f" ({find_reason(error)})" if error else ""
                )
            )
        )

    def _fail_with(self, error: DeviceError) -> None:
        if self._error is None:
            self._error = error
            self._replies.put_nowait((0, b""))
        self._arrived.set()

    def _unreachable_error(self, what: str) -> UnreachableError:
        return UnreachableError(
            self.device,
            make_message("the controller at {address} {what}.", address=self.address, what=what),
            remedy=CABLE,
        )

    def _refused_error(self, what: str, remedy: str) -> RefusedError:
        return RefusedError(
            self.device,
            make_message("the controller at {address} {what}.", address=self.address, what=what),
            remedy=remedy,
        )

    def _protocol_error(self, what: str, frame: bytes) -> WireProtocolError:
        return WireProtocolError(
            self.device,
            make_message("the controller sent {what}.", what=what),
            remedy="Report this with the controller's version; nothing in the cell is at fault.",
            frame=frame[:_HEX_SHOWN].hex(),
        )


def _decode_sample(payload: bytes) -> StateSample:
    values = _PACKET.unpack(payload)
    return StateSample(
        timestamp_s=values[1],
        joints_rad=_six_values(values, 2),
        joint_speeds_rad_s=_six_values(values, 8),
        tcp_pose=_six_values(values, 14),
        tcp_offset=_six_values(values, 20),
        speed_scaling=values[26],
        speed_fraction=values[27],
        robot_mode=values[28],
        runtime_state=values[29],
        robot_status_bits=values[30],
        safety_status_bits=values[31],
        payload_kg=values[32],
        received_at_s=time.monotonic(),
        raw=payload,
    )


def _six_values(values: tuple[Any, ...], start: int) -> Six:
    a, b, c, d, e, f = values[start : start + 6]
    return (a, b, c, d, e, f)
