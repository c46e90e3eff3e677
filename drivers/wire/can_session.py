"""One connection to a CAN bus and one node on it, from opening to its end. Runs in threads."""

import contextlib
import struct
import threading
import time
from dataclasses import dataclass
from typing import Any

import can
import canopen

from cellcal.calibration.message import make_message
from cellcal.drivers.errors import (
    DeviceError,
    DeviceTimeoutError,
    RefusedError,
    UnreachableError,
    WireProtocolError,
)
from cellcal.drivers.supervision import start_link_thread
from cellcal.drivers.wire.link_errors import find_reason
from cellcal.drivers.wire.socketcand import SafeSocketcandBus
from cellcal.drivers.wire.trace import FrameTrace

_POLL_S = 0.05
_HEARTBEATS_MISSED = 2.5
_BUS_OFF = 0x40  # CAN_ERR_BUSOFF in the identifier of an error frame, linux/can/error.h
FOREIGN_S = 2.0
# What the library raises of a broken bus and of frames that it cannot read; anything else is a fault of the program.
_UNREADABLE = (
    can.CanError,
    OSError,
    ValueError,
    LookupError,
    TypeError,
    AttributeError,
    ArithmeticError,
    struct.error,
)
_INTERFACE = "Check that the CAN interface of the cell file exists and is up (`ip link`), then try again."
_WIRING = "Check the power and the cable of the device, and the CAN termination; then try again."


@dataclass(frozen=True, slots=True)
class BusOptions:
    """The bus, in python-can's words."""

    interface: str
    channel: str
    host: str = ""
    port: int = 0

    def open(self, *, handshake_s: float) -> can.BusABC:
        """Open the bus; configuration files of python-can are not looked at."""
        if self.interface == "socketcand":
            return SafeSocketcandBus(self.channel, self.host, self.port, handshake_s=handshake_s)
        return can.Bus(channel=self.channel, interface=self.interface, ignore_config=True)


@dataclass(frozen=True, slots=True)
class Emergency:
    """An EMCY that the node has not taken back."""

    code: int
    register: int
    data: str  # hex, as it came


class CanSession:
    """One open bus. When it fails, ``dead`` holds the reason and it closes itself; it is never opened again."""

    def __init__(self, device: str, node_id: int, trace: FrameTrace, *, answer_s: float) -> None:
        self.device, self._id, self._trace, self._answer_s = device, node_id, trace, answer_s
        self.dead = ""
        self.emergency: Emergency | None = None
        self.emergencies_cleared = 0
        self.foreign_at_s = float("-inf")
        self._heartbeat_s = 0.0  # period that is watched; 0 while it is not
        self._last_received_s = time.monotonic()
        self._odd_frame = ""
        self._answers = 0
        self._closing = threading.Event()
        self._reader: threading.Thread | None = None

    def open(self, options: BusOptions) -> None:
        """Open the bus and begin to listen. Blocks."""
        try:
            self._bus = options.open(handshake_s=self._answer_s)
        except (can.CanError, OSError, ValueError) as error:
            message = make_message("the CAN bus cannot be opened ({error}).", error=find_reason(error))
            raise UnreachableError(self.device, message, remedy=_INTERFACE) from error
        self._network = _CountingNetwork(self._bus, 0x600 + self._id)
        nothing_known = canopen.ObjectDictionary()  # type: ignore[no-untyped-call]  # objects are our data
        self._node = self._network.add_node(canopen.RemoteNode(self._id, nothing_known))
        self._node.sdo.RESPONSE_TIMEOUT = self._answer_s
        self._reader = start_link_thread(
            make_message("CAN receiver of {device}", device=self.device), self._read_frames, self._end_broken
        )

    def close(self) -> None:
        """End the reader; it closes the bus. Blocks for a moment; may be called twice."""
        self._closing.set()
        reader = self._reader
        if reader is not None and reader.is_alive() and threading.current_thread() is not reader:
            reader.join(10 * _POLL_S)

    def watch_heartbeat(self, period_s: float) -> None:
        """From here on the node has to be heard within 2.5 periods."""
        self._last_received_s = time.monotonic()
        self._heartbeat_s = period_s

    def heartbeat_age_s(self) -> float:
        """Return how long ago the node was heard."""
        return time.monotonic() - self._last_received_s

    def has_foreign_master(self) -> bool:
        """Return whether another master has commanded this node lately."""
        return time.monotonic() - self.foreign_at_s < FOREIGN_S

    def upload_object(self, index: int, subindex: int) -> bytes:
        """Read one object (SDO). Blocks until its answer or the deadline."""
        return bytes(self._run_sdo(lambda: self._node.sdo.upload(index, subindex)))

    def download_object(self, index: int, subindex: int, data: bytes) -> None:
        """Write one object (SDO)."""
        self._run_sdo(lambda: self._node.sdo.download(index, subindex, data))

    def _run_sdo(self, transfer: Any) -> Any:
        self._require_alive()
        self._odd_frame = ""
        try:
            result = transfer()
        except canopen.SdoAbortedError as error:
            raise RefusedError(
                self.device,
                make_message("the device refused: {error}.", error=error),
                remedy="Check that model and object table in cell.toml fit this device.",
                vendor_code=error.code,
                vendor_text=str(error),
            ) from error
        except canopen.SdoCommunicationError as error:
            raise self._no_answer(error) from error
        except (can.CanError, OSError) as error:
            self._mark_dead(make_message("sending failed ({error})", error=error))
            raise UnreachableError(
                self.device, make_message("{dead}.", dead=self.dead), remedy=_WIRING
            ) from error
        except (
            struct.error,
            ValueError,
            LookupError,
            TypeError,
        ) as error:  # of an answer that no standard has
            raise self._odd_answer_error(str(error) or type(error).__name__) from error
        self._require_alive()
        if self.has_foreign_master():  # its answers look like ours; who asks for a value is told of it
            self._answers = self._network.questions
        if self._answers > self._network.questions:
            self._mark_dead("the node answered more often than it was asked")
            raise self._odd_answer_error("an answer to an earlier request came late")
        return result

    def _no_answer(self, error: Exception) -> DeviceError:
        self._require_alive()
        self._mark_dead("an answer of the node is outstanding, and it must not be taken for the next one")
        if "No SDO response" not in str(error):
            return self._odd_answer_error(str(error))
        if self._odd_frame:
            return self._odd_answer_error(
                make_message("an answer of {count} bytes instead of 8", count=len(self._odd_frame) // 2)
            )
        return DeviceTimeoutError(
            self.device,
            make_message(
                "no answer from node {id} within {answer_s:g} s.", id=self._id, answer_s=self._answer_s
            ),
            remedy=_WIRING,
        )

    def _odd_answer_error(self, what: str) -> WireProtocolError:
        return WireProtocolError(
            self.device,
            make_message(
                "node {id} answered what the standard does not allow: {what}.", id=self._id, what=what
            ),
            remedy="Make sure that no other program talks to the device; the reading was not used.",
            frame=self._odd_frame or self._trace.last_received(),
        )

    def _require_alive(self) -> None:
        if self.dead:
            raise UnreachableError(self.device, make_message("{dead}.", dead=self.dead), remedy=_WIRING)

    # ---- reader thread ----

    def _read_frames(self) -> None:
        while not self._closing.is_set() and not self.dead:
            try:
                message = self._bus.recv(_POLL_S)
                if message is not None:
                    self._take_message(message)
            except _UNREADABLE as error:
                self._mark_dead(
                    make_message(
                        "receiving from the CAN bus failed ({error_type})", error_type=type(error).__name__
                    )
                )
                break
            self._check_heartbeat(idle=message is None)
        self._bus.shutdown()

    def _end_broken(self, why: str) -> None:
        """Leave the bus; the receiver's error is raised by the next request, which connects anew."""
        self._mark_dead(make_message("the program failed while it received ({why})", why=why))
        with contextlib.suppress(can.CanError, OSError):
            self._bus.shutdown()

    def _check_heartbeat(self, *, idle: bool) -> None:
        """Judge the silence only once everything received has been looked at."""
        limit_s = _HEARTBEATS_MISSED * self._heartbeat_s * (1 if idle else 4)
        if self._heartbeat_s and self.heartbeat_age_s() > limit_s:
            self._mark_dead(
                make_message(
                    "node {id} has not been heard for {age_s:.2f} s",
                    id=self._id,
                    age_s=self.heartbeat_age_s(),
                )
            )

    def _take_message(self, message: can.Message) -> None:
        if message.is_error_frame:
            if message.arbitration_id & _BUS_OFF:
                self._mark_dead("the CAN controller is bus-off: check termination and bit rate")
            return
        function, node = message.arbitration_id & ~0x7F, message.arbitration_id & 0x7F
        if message.is_extended_id or (node != self._id and message.arbitration_id != 0):
            return
        data = bytes(message.data)
        self._trace.add_frame("<", f"{message.arbitration_id:03x}#{data.hex()}")
        handle = {0x700: self._take_heartbeat, 0x080: self._take_emergency, 0x580: self._take_answer}.get(
            function
        )
        if handle is not None:
            handle(data)
        elif function == 0x600 or message.arbitration_id == 0:
            self.foreign_at_s = time.monotonic()

    def _take_heartbeat(self, data: bytes) -> None:
        self._last_received_s = time.monotonic()
        if data[:1] == b"\0":
            self._mark_dead(
                make_message("node {id} has restarted; what it was told before is lost", id=self._id)
            )

    def _take_emergency(self, data: bytes) -> None:
        code = int.from_bytes(data[:2], "little")
        if code == 0 and len(data) >= 2:
            self.emergency = None
            self.emergencies_cleared += 1
            return
        self.emergency = Emergency(code, data[2] if len(data) > 2 else 0, data.hex())

    def _take_answer(self, data: bytes) -> None:
        self._answers += 1
        if len(data) == 8:
            self._network.notify(0x580 + self._id, bytearray(data), time.time())
        else:
            self._odd_frame = data.hex()

    def _mark_dead(self, reason: str) -> None:
        self.dead = self.dead or reason


class _CountingNetwork(canopen.Network):
    """Counts the SDO requests, so that an answer too many is seen."""

    def __init__(self, bus: can.BusABC, can_id: int) -> None:
        super().__init__(bus)
        self._can_id = can_id
        self.questions = 0

    def send_message(self, can_id: int, data: bytes, remote: bool = False) -> None:
        if can_id == self._can_id:
            self.questions += 1
        super().send_message(can_id, data, remote)
