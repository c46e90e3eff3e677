"""Joint angles that a controller sends by itself, many times a second, over UDP: received, and never answered.

The socket is bound to one address of this computer. A datagram counts only from the controller's address, and from
the port that it first came from; each comes later than the one before in the controller's own count, and, where the
controller tells its time, not long after it was sent. Everything else is dropped, counted, and said in the log at
most once a second. When no datagram counted for a while, port and count are forgotten, so that a program that was
started anew is heard again.
"""

import asyncio
import logging
import time
from collections import Counter, deque
from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise
from typing import cast

from cellcal.calibration.message import make_message
from cellcal.drivers.errors import UnreachableError
from cellcal.drivers.interfaces import Joints
from cellcal.drivers.wire.joint_stream_settings import JointStreamSettings

_LOG = logging.getLogger(__name__)
_KEPT = 1000  # packets: four seconds at 250 Hz
_LOG_EVERY_S = 1.0
_CLOCK_DRIFT = 1e-3  # seconds that two clocks may part in a second
_LEAST_IN_WINDOW = 5
_SEVERAL_WINDOWS = 3
_PATIENCE_AFTER_SILENCE_S = 0.05  # what has come while the program was busy is taken within this time

Address = tuple[str, int]


@dataclass(frozen=True, slots=True)
class StreamPacket:
    """The contents of one datagram."""

    sequence: int  # rises with every packet
    sent_at_s: float | None  # the controller's clock; None where it sends none that surely keeps time
    joints_rad: Joints


@dataclass(frozen=True, slots=True)
class StreamReading:
    """The reading that the packets of a short time give together."""

    joints_rad: Joints  # their mean
    is_still: bool  # no joint moved in this time by more than the limit
    began_at_s: float  # host monotonic clock: when the first of these packets came
    taken_at_s: float  # ... and the last
    sent_at_s: float | None  # the last, by the controller's clock
    packets: int
    raw: str  # hex of the last


@dataclass(frozen=True, slots=True)
class _Received:
    at_s: float  # host monotonic clock
    packet: StreamPacket


class JointStream(asyncio.DatagramProtocol):
    """The receiving end of one stream of joint angles.

    ``read_packet`` turns a datagram into a packet, or raises ``ValueError`` with what is wrong.
    """

    def __init__(
        self,
        device: str,
        link: str,
        settings: JointStreamSettings,
        sender: str,
        read_packet: Callable[[bytes], StreamPacket],
    ) -> None:
        self.device, self.link, self.settings = device, link, settings
        self.dropped: Counter[str] = Counter()
        self._sender, self._read_packet = sender, read_packet
        self._transport: asyncio.DatagramTransport | None = None
        self._port: int | None = None  # of the controller, from its first datagram
        self._received: deque[_Received] = deque(maxlen=_KEPT)
        self._quickest_s = float("inf")  # host clock less controller's clock, of the quickest packet
        self._last_raw = b""
        self._arrived = asyncio.Event()
        self._opened_at_s = float("-inf")
        self._logged_at_s: dict[str, float] = {}

    async def open(self) -> None:
        """Listen on the address of the cell file. Nothing is sent, neither now nor later."""
        where = (self.settings.listen, self.settings.port)
        try:
            loop = asyncio.get_running_loop()
            await loop.create_datagram_endpoint(lambda: self, local_addr=where)
        except OSError as error:
            raise UnreachableError(
                self.device,
                make_message(
                    "{link} cannot be received at {address} port {port}: {strerror}.",
                    link=self.link,
                    address=where[0],
                    port=where[1],
                    strerror=error.strerror or error,
                ),
                remedy="Give an address of this computer as listen, and a port that no other program uses.",
            ) from error

    def close(self) -> None:
        """Stop listening."""
        if self._transport is not None:
            self._transport.close()
            self._transport = None

    # what comes

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        self._transport, self._opened_at_s = cast(asyncio.DatagramTransport, transport), time.monotonic()

    def datagram_received(self, data: bytes, addr: Address) -> None:
        now_s = time.monotonic()
        self._forget_old_sender(now_s)
        if addr[0] != self._sender or self._port not in (None, addr[1]):
            self._drop("foreign sender", now_s, f"{addr[0]}:{addr[1]}")
            return
        try:
            packet = self._read_packet(data)
        except ValueError as problem:
            self._drop("unreadable", now_s, str(problem))
            return
        if self._received and packet.sequence <= self._received[-1].packet.sequence:
            self._drop("out of sequence", now_s, str(packet.sequence))
            return
        if self._is_late(packet, now_s):
            self._drop("late", now_s, str(packet.sequence))
            return
        self._port, self._last_raw = addr[1], data
        self._received.append(_Received(now_s, packet))
        self._arrived.set()

    def error_received(self, exc: Exception) -> None:
        _LOG.debug("%s: %s: %s", self.device, self.link, exc)

    def _forget_old_sender(self, now_s: float) -> None:
        """Let a stream that begins anew count, after a silence."""
        if self._received and now_s - self._received[-1].at_s > self.settings.silent_s:
            self._received.clear()
            self._port, self._quickest_s = None, float("inf")

    def _is_late(self, packet: StreamPacket, now_s: float) -> bool:
        """Whether a packet was much longer under way than the quickest; clocks that drift apart are followed."""
        if packet.sent_at_s is None:
            return False
        way_s = now_s - packet.sent_at_s
        if self._received:
            self._quickest_s += _CLOCK_DRIFT * (now_s - self._received[-1].at_s)
        self._quickest_s = min(self._quickest_s, way_s)
        return way_s - self._quickest_s > self.settings.late_s

    def _drop(self, why: str, now_s: float, what: str) -> None:
        self.dropped[why] += 1
        if now_s - self._logged_at_s.get(why, float("-inf")) >= _LOG_EVERY_S:
            self._logged_at_s[why] = now_s
            _LOG.warning(
                "%s: %s: dropped a datagram (%s: %.80s), %d so far", self.device, self.link, why, what,
                self.dropped[why],
            )  # fmt: skip

    # what is asked for

    async def read(self) -> StreamReading | None:
        """Return what the last moment says, with a packet that came after this call; None where none comes.

        An arm that moves is looked at for one more window, so that a motion that has just ended is not taken for one
        that goes on.
        """
        asked_at_s = time.monotonic()
        if not await self._wait_for_packet(self._patience_s(asked_at_s)):
            return None
        reading = self._sum_up(self._received[-1].at_s - self.settings.window_s)
        give_up_at_s = asked_at_s + _SEVERAL_WINDOWS * self.settings.window_s
        while not reading.is_still and time.monotonic() < give_up_at_s:
            if not await self._wait_for_packet(self.settings.silent_s):
                return None
            reading = self._sum_up(self._received[-1].at_s - self.settings.window_s)
            if self._received[-1].at_s - asked_at_s > self.settings.window_s:
                break
        return reading

    def stood_since(self, since_s: float) -> StreamReading:
        """Return what all packets since a moment of the host's monotonic clock say, one window at least."""
        return self._sum_up(min(since_s, self._received[-1].at_s - self.settings.window_s))

    def rate_hz(self) -> float:
        """Return how many packets counted in a second, over those that are kept; 0 where there are too few."""
        if len(self._received) < _LEAST_IN_WINDOW:
            return 0.0
        span_s = self._received[-1].at_s - self._received[0].at_s
        return (len(self._received) - 1) / span_s if span_s > 0 else 0.0

    def _patience_s(self, now_s: float) -> float:
        """Return how long to wait for a packet: of a stream that has been silent for long, hardly at all."""
        last_received_at_s = self._received[-1].at_s if self._received else self._opened_at_s
        return (
            _PATIENCE_AFTER_SILENCE_S
            if now_s - last_received_at_s > self.settings.silent_s
            else self.settings.silent_s
        )

    async def _wait_for_packet(self, within_s: float) -> bool:
        self._arrived.clear()
        try:
            async with asyncio.timeout(within_s):
                await self._arrived.wait()
        except TimeoutError:
            return False
        return True

    def _sum_up(self, since_s: float) -> StreamReading:
        chosen: list[_Received] = []
        for received in reversed(self._received):
            if received.at_s < since_s and len(chosen) >= _LEAST_IN_WINDOW:
                break
            chosen.append(received)
        last, first = chosen[0], chosen[-1]
        columns = list(zip(*(received.packet.joints_rad for received in chosen), strict=True))
        spread_rad = max(max(column) - min(column) for column in columns)
        at_s = [received.at_s for received in chosen]
        longest_gap_s = max((later - sooner for later, sooner in pairwise(at_s)), default=0.0)
        is_whole = (
            len(chosen) >= _LEAST_IN_WINDOW
            and at_s[0] - at_s[-1] >= 0.8 * self.settings.window_s
            and longest_gap_s <= 0.5 * self.settings.window_s  # also after this program stood still
        )
        return StreamReading(
            joints_rad=tuple(sum(column) / len(chosen) for column in columns),
            is_still=is_whole and spread_rad <= self.settings.still_rad,
            began_at_s=first.at_s,
            taken_at_s=last.at_s,
            sent_at_s=last.packet.sent_at_s,
            packets=len(chosen),
            raw=self._last_raw.hex(),
        )
