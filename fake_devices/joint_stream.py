"""What a stream of joint angles to a client can suffer, whatever its form.

Imitates
    A controller's cyclic task that sends its joints every few milliseconds, and the network behind it.
Source
    The fault table of the design: silent, doubled, out of order, foreign, spoiled, restarted.
Modelled
    Faults by name (``STREAM_FAULTS``); joints that are those of another arm; a restart with a new port and count.
Not modelled
    Jitter of the cycle: it is that of this process.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from cellcal.fake_devices.datagram_sender import DatagramSender
from cellcal.fake_devices.link_faults import LinkFaults

STREAM_FAULTS = (
    "stream_silent",
    "stream_doubled",
    "stream_swapped",
    "stream_stranger",
    "stream_spoiled",
    "stream_other_arm",
)
_EGM_PORT = 6510  # by convention
_OTHER_ADDRESS = "127.0.0.3"
_OTHER_DEG = 1.5
Encode = Callable[[int, float, Sequence[float]], bytes]  # count, real time [s], joints [deg]


class JointSender:
    """The cyclic task; where the cell file names no stream it does nothing."""

    def __init__(
        self, sender: DatagramSender | None, encode: Encode, faults: LinkFaults, real_s: Callable[[], float]
    ) -> None:
        self._sender = sender
        self._encode, self._faults, self._real_s = encode, faults, real_s
        self._count = 0
        self._held: bytes | None = None

    @classmethod
    def from_table(
        cls,
        robot: Mapping[str, Any],
        key: str,
        encode: Encode,
        faults: LinkFaults,
        real_s: Callable[[], float],
    ) -> "JointSender":
        """Build the stream that a robot's table names under a key."""
        settings = robot.get(key)
        if settings is None:
            return cls(None, encode, faults, real_s)
        address = str(settings.get("sender") or robot.get("address", "127.0.0.1"))
        target = str(settings["listen"]), int(settings.get("port", _EGM_PORT))
        return cls(DatagramSender(address, target), encode, faults, real_s)

    def answer_count(self) -> int:
        """Return how many datagrams have come back."""
        return 0 if self._sender is None else len(self._sender.received)

    def send_joints(self, joints_rad: Sequence[float]) -> None:
        """Send the joints of this cycle, as far as the faults let them through."""
        if self._sender is None:
            return
        self._count += 1
        joints_deg = [math.degrees(angle) for angle in joints_rad]
        if self._is_on("stream_other_arm"):
            joints_deg = [joints_deg[0] + _OTHER_DEG, *joints_deg[1:]]
        data = self._encode(self._count, self._real_s(), joints_deg)
        if self._is_on("stream_silent"):
            return
        if self._is_on("stream_stranger"):
            foreign = self._encode(self._count, self._real_s(), [0.0] * len(joints_deg))
            self._sender.send_from_other_address(_OTHER_ADDRESS, foreign)
        if self._is_on("stream_spoiled"):
            self._sender.send(data[: len(data) // 2])
        for one in self._in_order(data):
            self._sender.send(one)

    def restart(self) -> None:
        """Begin anew with another port and the count at zero, as a program that is started again."""
        self.close()
        self._count = 0

    def close(self) -> None:
        """Give the socket up."""
        if self._sender is not None:
            self._sender.close()

    def _in_order(self, data: bytes) -> list[bytes]:
        if self._is_on("stream_doubled"):
            return [data, data]
        if self._is_on("stream_swapped"):
            held, self._held = self._held, data if self._held is None else None
            return [] if held is None else [data, held]
        return [data]

    def _is_on(self, fault: str) -> bool:
        return self._faults.use_once(fault) is not None
