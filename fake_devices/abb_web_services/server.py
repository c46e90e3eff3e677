"""The web server: HTTP/1.1 with digest authentication and cookies.

Imitates
    The web server of an IRC5.
Source
    RFC 7616 and 6265; ABB 3HAC050973-001 rev M on realm, cookies and their limit.
Modelled
    Digest with qop=auth and one nonce; cookies ``-http-session-`` and ``ABBCX``; a request without cookies takes a
    session until it logs out, and with none left the answer is 503. Faults as http_port.py says.
Not modelled
    XML; TLS; subscriptions by websocket.
"""

import hashlib
import json
import re
import secrets

from cellcal.fake_devices.abb_web_services.http_port import (
    COOKIE,
    HttpAnswer,
    HttpPort,
    HttpRequest,
    SessionTable,
)
from cellcal.fake_devices.abb_web_services.resources import ResourceTable
from cellcal.fake_devices.link_faults import LinkFaults

USER, PASSWORD = "Default User", "robotics"
_REALM = "validusers@robapi.abb"
_PAIR = re.compile(r'(\w+)=(?:"([^"]*)"|([^",\s]+))')


class ServicePort(HttpPort):
    """The port of the web server."""

    def __init__(self, host: str, port: int, table: ResourceTable, faults: LinkFaults) -> None:
        super().__init__(host, port, faults)
        self._table = table
        self._nonce = secrets.token_hex(16)
        self.sessions = SessionTable(faults)

    def answer_request(self, request: HttpRequest) -> HttpAnswer:
        """Return the answer of the resources to a client that is known."""
        if not self._is_known(request.method, request.headers.get("authorization", "")):
            challenge = (
                f'Digest realm="{_REALM}", domain="/", qop="auth", nonce="{self._nonce}", algorithm=MD5'
            )
            return HttpAnswer(401, headers=(f"WWW-Authenticate: {challenge}",))
        session, is_new = self.sessions.find_or_begin(request)
        if not session:
            return HttpAnswer(503)
        cookies = ("-http-session-", COOKIE) if is_new else ()
        more = tuple(f"Set-Cookie: {cookie}={session}; path=/" for cookie in cookies)
        if request.path == "/logout":
            self.sessions.end(session)
        status, content = self._table.answer(request)
        if isinstance(content, bytes):
            return HttpAnswer(status, content, "application/octet-stream", more)
        return HttpAnswer(status, b"" if content is None else json.dumps(content).encode(), headers=more)

    def _is_known(self, method: str, authorization: str) -> bool:
        claims = {name: quoted or plain for name, quoted, plain in _PAIR.findall(authorization)}
        if claims.get("username") != USER or claims.get("nonce") != self._nonce:
            return False
        first = _md5_digest(f"{USER}:{_REALM}:{PASSWORD}")
        second = _md5_digest(f"{method}:{claims.get('uri', '')}")
        parts = (self._nonce, claims.get("nc", ""), claims.get("cnonce", ""), claims.get("qop", ""))
        return claims.get("response") == _md5_digest(f"{first}:{':'.join(parts)}:{second}")


def _md5_digest(text: str) -> str:
    return hashlib.md5(text.encode(), usedforsecurity=False).hexdigest()
