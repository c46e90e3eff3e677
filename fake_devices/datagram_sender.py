"""The socket that a simulated controller sends a stream of datagrams from.

Imitates
    A UDP client: it sends whether or not anything listens.
Source
    Ours.
Modelled
    Datagrams from an address of its own; a second socket for what a stranger sends; what comes back is counted.
Not modelled
    Anything that a network does to datagrams.
"""

import socket
from contextlib import suppress

Target = tuple[str, int]
_MOST_OCTETS = 2048


class DatagramSender:
    """Sends to one target; a restart takes another port."""

    def __init__(self, address: str, target: Target) -> None:
        self._address, self._target = address, target
        self._socket: socket.socket | None = None
        self.received: list[bytes] = []

    def send(self, data: bytes) -> None:
        """Send one datagram, and take what has come back."""
        if self._socket is None:
            self._socket = self._open_socket(self._address)
        with suppress(OSError):  # nothing listens there
            self._socket.sendto(data, self._target)
        with suppress(OSError):
            while True:
                self.received.append(self._socket.recv(_MOST_OCTETS))

    def send_from_other_address(self, address: str, data: bytes) -> None:
        """Send one datagram from another address."""
        with self._open_socket(address) as other_sender, suppress(OSError):
            other_sender.sendto(data, self._target)

    def close(self) -> None:
        """Give the port up; the next datagram comes from another."""
        if self._socket is not None:
            self._socket.close()
            self._socket = None

    def _open_socket(self, address: str) -> socket.socket:
        found = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        found.setblocking(False)
        found.bind((address, 0))
        return found
