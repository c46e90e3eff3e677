"""HTTP/1.1 as the web servers of both generations use it: requests in, answers out, and what can go wrong.

Imitates
    The web server of an ABB controller, without its authentication.
Source
    RFC 9110 and 9112.
Modelled
    Requests with a Content-Length, persistent connections. Faults ``silent``, ``refuse``, ``reset``, ``garbage``,
    ``page`` (HTML in place of JSON), ``no_session``, ``cut_upload`` (the connection ends when half of a file's
    content has come; that half is stored).
Not modelled
    Chunked requests, pipelining.
"""

import asyncio
import secrets
import ssl
from abc import abstractmethod
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass
from urllib.parse import parse_qsl, unquote, urlsplit

from cellcal.fake_devices.link_faults import LinkFaults
from cellcal.fake_devices.listening_port import ListeningPort

LINK_FAULTS = ("silent", "refuse", "reset", "garbage", "page", "no_session", "cut_upload", "doubled")
COOKIE = "ABBCX"
_SESSIONS = 70  # at one time
_PHRASES = {
    200: "OK",
    201: "Created",
    204: "No Content",
    400: "Bad Request",
    401: "Unauthorized",
    403: "Forbidden",
    404: "Not Found",
    405: "Method Not Allowed",
    406: "Not Acceptable",
    409: "Conflict",
    410: "Gone",
    415: "Unsupported Media Type",
    503: "Busy",
}


@dataclass(frozen=True)
class HttpRequest:
    """One request; header names in lower case."""

    method: str
    path: str
    target: str  # as it was sent, with the query
    query: Mapping[str, str]
    headers: Mapping[str, str]
    body: bytes

    @property
    def form(self) -> dict[str, str]:
        """The fields of a form."""
        return dict(parse_qsl(self.body.decode("latin-1"), keep_blank_values=True))


@dataclass(frozen=True)
class HttpAnswer:
    """One answer; no content is no body."""

    status: int
    content: bytes = b""
    content_type: str = "application/json"
    headers: tuple[str, ...] = ()


class HttpPort(ListeningPort):
    """A port that answers one request after the other."""

    sessions: "SessionTable"

    def __init__(
        self, host: str, port: int, faults: LinkFaults, *, tls: ssl.SSLContext | None = None
    ) -> None:
        super().__init__(host, port, self._serve_requests, tls=tls)
        self._faults = faults

    @abstractmethod
    def answer_request(self, request: HttpRequest) -> HttpAnswer:
        """Return what is sent back."""

    async def _serve_requests(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        with suppress(asyncio.LimitOverrunError, ValueError):
            while await self._serve_request(reader, writer):
                pass

    async def _serve_request(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> bool:
        head = (await reader.readuntil(b"\r\n\r\n")).decode("latin-1").split("\r\n")
        method, target, _ = head[0].split(" ", 2)
        headers = {
            name.lower(): value.strip() for name, _, value in (line.partition(":") for line in head[1:])
        }
        length = int(headers.get("content-length", "0"))
        is_cut = method == "PUT" and self._faults.use_once("cut_upload") is not None
        body = await reader.readexactly(length // 2 if is_cut else length)
        if self._faults.use_once("silent") is not None:
            return True
        if self._faults.use_once("reset") is not None:
            writer.transport.abort()
            return False
        parts = urlsplit(target)
        query = dict(parse_qsl(parts.query))
        answer = self.answer_request(HttpRequest(method, unquote(parts.path), target, query, headers, body))
        if is_cut:
            writer.transport.abort()
            return False
        await self._send_answer(writer, answer, with_body=method != "HEAD")
        return True

    async def _send_answer(
        self, writer: asyncio.StreamWriter, answer: HttpAnswer, *, with_body: bool
    ) -> None:
        octets, kind = answer.content, answer.content_type
        if self._faults.use_once("garbage") is not None:
            octets = b"{not json"
        if self._faults.use_once("page") is not None:
            octets, kind = b"<html>welcome</html>", "text/html"
        lines = [
            f"HTTP/1.1 {answer.status} {_PHRASES[answer.status]}",
            f"Content-Type: {kind}",
            f"Content-Length: {len(octets)}",
        ]
        body = octets if with_body else b""
        times = 2 if self._faults.use_once("doubled") is not None else 1
        writer.write(times * ("\r\n".join([*lines, *answer.headers, "", ""]).encode("latin-1") + body))
        await writer.drain()


class SessionTable:
    """The sessions of a web server; a request without the cookie of one takes a new one."""

    def __init__(self, faults: LinkFaults) -> None:
        self._faults = faults
        self._open: set[str] = set()

    def find_or_begin(self, request: HttpRequest) -> tuple[str, bool]:
        """Return a request's session and whether it is new; "" where none is left: the answer is 503 then."""
        pairs = (part.strip().partition("=") for part in request.headers.get("cookie", "").split(";"))
        found = next((value for key, _, value in pairs if key == COOKIE and value in self._open), None)
        if found is not None:
            return found, False
        if len(self._open) >= _SESSIONS or self._faults.use_once("no_session") is not None:
            return "", False
        session = secrets.token_hex(8)
        self._open.add(session)
        return session, True

    def end(self, session: str) -> None:
        """Close a session."""
        self._open.discard(session)

    def end_all(self) -> None:
        """Close all, as idle ones are after some minutes."""
        self._open.clear()
