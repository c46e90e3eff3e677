"""The library's protocol with an end to every answer: by itself it gathers whatever length a server claims.

Its limits are those that the server names in its Acknowledge; a chunk is held against them once it has come whole.
"""

from asyncua.client import ua_client
from asyncua.client.ua_client import UASocketProtocol

_MOST_CHUNK = 1_000_000  # octets; 65 535 are agreed on
_MOST_ANSWER = 16_000_000


class BoundedProtocol(UASocketProtocol):  # type: ignore[misc]  # the library is not typed for us
    """Ends the connection where a chunk, or all that comes between two requests, is longer than any answer."""

    receive_buffer: bytes | None
    _since_request = 0

    def data_received(self, data: bytes) -> None:
        self._since_request += len(data)
        super().data_received(data)
        if len(self.receive_buffer or b"") > _MOST_CHUNK or self._since_request > _MOST_ANSWER:
            self.receive_buffer = None
            self._fail_all_pending(ValueError("it is too long"))
            self.disconnect_socket()

    @property
    def is_half(self) -> bool:
        """Whether a chunk has begun to come, and has not come to its end."""
        return bool(self.receive_buffer)

    def note_request(self) -> None:
        """Count anew: what comes next is another answer."""
        self._since_request = 0


def bound_answers() -> None:
    """Have every client of the library use this protocol, which it finds in its module by name."""
    ua_client.UASocketProtocol = BoundedProtocol
