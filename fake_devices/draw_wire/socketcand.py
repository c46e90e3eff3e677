"""The socketcand daemon: a CAN bus behind a TCP port.

Imitates
    linux-can's socketcand in raw mode.
Source
    linux-can/socketcand doc/protocol.md; the python-can client's habits as collected in the project's wire
    facts: handshake answers must arrive each by itself, a frame without data needs two blanks before ``>``.
Modelled
    ``< hi >``, open, rawmode, echo, send, frame; several clients, that receive each other's frames as on a real bus;
    error frames; a daemon that ends or hangs.
Not modelled
    Broadcast-manager and control mode (answered with an error), the UDP beacon, statistics, CAN FD, bit
    timing.
"""

import asyncio
import logging
from collections.abc import Callable
from dataclasses import dataclass

from cellcal.fake_devices.listening_port import ListeningPort

log = logging.getLogger(__name__)

_QUIET_S = 0.02  # between the last handshake answer and the first frame, so that they are separate reads
_BUFFER_LIMIT = 4096


def frame_text(can_id: int, data: bytes, seconds: float) -> str:
    """Return one received frame as the daemon prints it."""
    return f"< frame {can_id:03X} {seconds:.6f} {data.hex().upper()} >"


def parse_send(words: list[str]) -> tuple[int, bytes] | None:
    """Return identifier and data of ``send ID dlc b0 b1 …``; None for nonsense."""
    try:
        can_id, length = int(words[1], 16), int(words[2], 16)
        data = bytes(int(word, 16) for word in words[3:])
    except (ValueError, IndexError):
        return None
    return (can_id, data) if len(data) == length <= 8 else None


@dataclass(eq=False)
class _CanClient:
    writer: asyncio.StreamWriter
    opened: bool = False
    raw_from_s: float | None = None


class SocketCanDaemon(ListeningPort):
    """Carries frames between TCP clients and the nodes of one bus."""

    def __init__(self, host: str, port: int, channel: str, real: Callable[[], float]) -> None:
        super().__init__(host, port, self._serve_client)
        self.channel = channel
        self.hung = False
        self.on_frame: Callable[[int, bytes], None] = lambda _can_id, _data: None
        self._real = real
        self._clients: list[_CanClient] = []

    @property
    def ready_clients(self) -> int:
        """The number of clients that receive frames by now."""
        now_s = self._real()
        return sum(client.raw_from_s is not None and now_s >= client.raw_from_s for client in self._clients)

    def send_frame(self, can_id: int, data: bytes, *, sender: object = None) -> None:
        """Put a frame on the bus: every client but the sender reads it."""
        self._send_text(frame_text(can_id, data, self._real()), sender)

    def send_error_frame(self) -> None:
        """Put an error frame on the bus."""
        self._send_text(f"< error 020 {self._real():.6f} >", None)

    def _send_text(self, text: str, sender: object) -> None:
        now_s = self._real()
        for client in self._clients:
            if (
                client is not sender
                and client.raw_from_s is not None
                and now_s >= client.raw_from_s
                and not self.hung
            ):
                client.writer.write(text.encode())

    async def _serve_client(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        client = _CanClient(writer)
        self._clients.append(client)
        try:
            await self._answer_client(client, "< hi >")
            await self._read_commands(client, reader)
        except ConnectionError as error:
            log.debug("client gone: %s", error)
        finally:
            self._clients.remove(client)

    async def _read_commands(self, client: _CanClient, reader: asyncio.StreamReader) -> None:
        buffer = ""
        while chunk := await reader.read(4096):
            buffer += chunk.decode("ascii", "replace")
            while (end := buffer.find(">")) >= 0:
                start = buffer.rfind("<", 0, end)
                command, buffer = buffer[start + 1 : end] if start >= 0 else "", buffer[end + 1 :]
                if not self.hung:
                    await self._obey_command(client, command.split())
            buffer = buffer[-_BUFFER_LIMIT:]

    async def _obey_command(self, client: _CanClient, words: list[str]) -> None:
        match words:
            case ["open", channel] if channel == self.channel:
                client.opened = True
                await self._answer_client(client, "< ok >")
            case ["open", _]:
                await self._answer_client(client, "< error could not open bus >")
            case ["rawmode"] if client.opened:
                client.raw_from_s = self._real() + _QUIET_S
                await self._answer_client(client, "< ok >")
            case ["echo"]:
                await self._answer_client(client, "< echo >")
            case ["send", *_] if client.raw_from_s is not None and (frame := parse_send(words)) is not None:
                client.raw_from_s = 0.0  # who sends has read the last handshake answer
                self.send_frame(*frame, sender=client)
                self.on_frame(*frame)
            case _:
                await self._answer_client(client, "< error unknown command >")

    async def _answer_client(self, client: _CanClient, text: str) -> None:
        client.writer.write(text.encode())
        await client.writer.drain()
