"""python-can's socketcand client with its traps closed; written against the pinned 4.6.1.

* the handshake waits for ever for a silent daemon: here the socket has a time-out until the bus is open
* an answer that arrives together with a frame spoils the handshake: here it is cut at its own end
* a failed handshake leaves the socket open: here it is closed
* the death of the daemon is not noticed when receiving, and the reader spins: here it raises at once
"""

import math
import select
import socket
import time
from collections import deque

import can
from can.interfaces.socketcand import SocketCanDaemonBus

_LONGEST_ANSWER = 256


class SafeSocketcandBus(SocketCanDaemonBus):
    """A CAN bus behind a socketcand daemon that may be silent, slow or dead."""

    _SocketCanDaemonBus__socket: socket.socket  # python-can's own; there is no public way to them
    _SocketCanDaemonBus__message_buffer: deque[can.Message]

    def __init__(self, channel: str, host: str, port: int, *, handshake_s: float) -> None:
        self._handshake_s = handshake_s
        self._ends_s = math.inf
        try:
            super().__init__(channel=channel, host=host, port=port)  # type: ignore[no-untyped-call]
        except BaseException:
            self._daemon_socket.close()
            self._is_shutdown = True  # nothing is left that python-can could warn about
            raise
        self._daemon_socket.settimeout(None)

    @property
    def _daemon_socket(self) -> socket.socket:
        return self._SocketCanDaemonBus__socket

    def _expect_msg(self, msg: str) -> None:
        """Read one answer, and leave what follows it to the receiver."""
        if self._ends_s == math.inf:  # connected now: all answers together have this time
            self._ends_s = time.monotonic() + self._handshake_s
        answer = b""
        while not answer.endswith(b">") and len(answer) < _LONGEST_ANSWER:
            remaining_s = self._ends_s - time.monotonic()
            if remaining_s <= 0.0:
                raise TimeoutError("the daemon did not complete its greeting")
            self._daemon_socket.settimeout(remaining_s)
            byte = self._daemon_socket.recv(1)
            if not byte:
                raise can.CanInitializationError("the daemon closed the connection")
            answer += byte
        if answer.decode("ascii", "replace").strip() != msg:
            raise can.CanInitializationError(f"the daemon answered {answer!r} instead of {msg!r}")

    def _recv_internal(self, timeout: float | None) -> tuple[can.Message | None, bool]:
        readable, _, _ = select.select([self._daemon_socket], [], [], 0.0 if self._has_waiting() else timeout)
        if readable and not self._daemon_socket.recv(1, socket.MSG_PEEK):
            raise can.CanOperationError("the daemon closed the connection")
        found: tuple[can.Message | None, bool] = super()._recv_internal(0.0)  # type: ignore[no-untyped-call]
        return found

    def _has_waiting(self) -> bool:
        """Return whether messages of an earlier read are still to be handed out."""
        return bool(self._SocketCanDaemonBus__message_buffer)
