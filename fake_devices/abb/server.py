"""The web server: HTTP/1.1 with digest authentication and cookies.

Imitates
    The web server of an IRC5.
Source
    RFC 7616 and 6265; ABB 3HAC050973-001 rev M on realm, cookies and their limit.
Modelled
    Digest with qop=auth and one nonce; cookies ``-http-session-`` and ``ABBCX``; a request without cookies takes a
    session, and with none left the answer is 503. Faults ``silent``, ``refuse``, ``reset``, ``garbage``, ``page``
    (HTML in place of JSON), ``no_session``.
Not modelled
    XML; TLS; subscriptions by websocket.
"""

import asyncio
import hashlib
import json
import re
import secrets
from collections.abc import Mapping
from contextlib import suppress
from urllib.parse import parse_qsl, unquote, urlsplit

from cellcal.fake_devices.abb.resources import ResourceTable
from cellcal.fake_devices.link_faults import LinkFaults
from cellcal.fake_devices.listening_port import ListeningPort

LINK_FAULTS = ("silent", "refuse", "reset", "garbage", "page", "no_session")
USER, PASSWORD = "Default User", "robotics"
_REALM = "validusers@robapi.abb"
_PAIR = re.compile(r'(\w+)=(?:"([^"]*)"|([^",\s]+))')
_SESSIONS = 70
_PHRASES = {
    200: "OK",
    204: "No Content",
    400: "Bad Request",
    401: "Unauthorized",
    404: "Not Found",
    503: "Busy",
}


class ServicePort(ListeningPort):
    """The port of the web server."""

    def __init__(self, host: str, port: int, table: ResourceTable, faults: LinkFaults) -> None:
        super().__init__(host, port, self._serve_requests)
        self._table, self._faults = table, faults
        self._nonce = secrets.token_hex(16)
        self._sessions: set[str] = set()

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
        body = await reader.readexactly(int(headers.get("content-length", "0")))
        if self._faults.use_once("silent") is not None:
            return True
        if self._faults.use_once("reset") is not None:
            writer.transport.abort()
            return False
        await self._answer(method, target, headers, body, writer)
        return True

    async def _answer(
        self, method: str, target: str, headers: Mapping[str, str], body: bytes, writer: asyncio.StreamWriter
    ) -> None:
        more: list[str] = []
        if not self._is_known(method, headers.get("authorization", "")):
            challenge = (
                f'Digest realm="{_REALM}", domain="/", qop="auth", nonce="{self._nonce}", algorithm=MD5'
            )
            await self._send(writer, 401, None, [f"WWW-Authenticate: {challenge}"])
            return
        if not self._has_session(headers.get("cookie", ""), more):
            await self._send(writer, 503, None, [])
            return
        parts = urlsplit(target)
        query = dict(parse_qsl(parts.query))
        form = dict(parse_qsl(body.decode("latin-1"), keep_blank_values=True))
        status, content = self._table.answer(method, unquote(parts.path), query, form)
        await self._send(writer, status, content, more)

    async def _send(
        self, writer: asyncio.StreamWriter, status: int, content: object, more: list[str]
    ) -> None:
        octets = b"" if content is None else json.dumps(content).encode()
        kind = "application/json"
        if self._faults.use_once("garbage") is not None:
            octets = b"{not json"
        if self._faults.use_once("page") is not None:
            octets, kind = b"<html>welcome</html>", "text/html"
        lines = [
            f"HTTP/1.1 {status} {_PHRASES[status]}",
            f"Content-Type: {kind}",
            f"Content-Length: {len(octets)}",
        ]
        writer.write("\r\n".join([*lines, *more, "", ""]).encode("latin-1") + octets)
        await writer.drain()

    def _has_session(self, cookie: str, more: list[str]) -> bool:
        found = re.search(r"ABBCX=(\w+)", cookie)
        if found is not None and found[1] in self._sessions:
            return True
        if len(self._sessions) >= _SESSIONS or self._faults.use_once("no_session") is not None:
            return False
        session = secrets.token_hex(8)
        self._sessions.add(session)
        more += [f"Set-Cookie: -http-session-={session}; path=/", f"Set-Cookie: ABBCX={session}; path=/"]
        return True

    def _is_known(self, method: str, authorization: str) -> bool:
        claims = {name: quoted or plain for name, quoted, plain in _PAIR.findall(authorization)}
        if claims.get("username") != USER or claims.get("nonce") != self._nonce:
            return False
        first = _digest(f"{USER}:{_REALM}:{PASSWORD}")
        second = _digest(f"{method}:{claims.get('uri', '')}")
        parts = (self._nonce, claims.get("nc", ""), claims.get("cnonce", ""), claims.get("qop", ""))
        return claims.get("response") == _digest(f"{first}:{':'.join(parts)}:{second}")


def _digest(text: str) -> str:
    return hashlib.md5(text.encode(), usedforsecurity=False).hexdigest()
