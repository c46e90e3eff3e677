"""Checks before every route: which host is addressed, from which page, how much, how often, and who is signed in.

On loopback, too: a page of another site can make a browser there talk to this computer (DNS rebinding, forged
posts). What is not a page of ours or a way to sign in needs a session, so that a route added later is not open.
"""

import asyncio
import ipaddress
import json
import logging
import math
import re
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from urllib.parse import unquote_to_bytes

from starlette.datastructures import MutableHeaders
from starlette.requests import HTTPConnection
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from cellcal.calibration.documents import DocumentError
from cellcal.calibration.documents.json_text import parse_json
from cellcal.calibration.message import make_message
from cellcal.calibration.message_table import with_messages
from cellcal.service.path_redaction import without_paths
from cellcal.service.people.errors import PeopleError
from cellcal.service.people.roles import Right
from cellcal.service.unexpected_errors import explain_os_error, lacks_resources
from cellcal.service.web.dependencies import app_context, token_of

_log = logging.getLogger(__name__)
MOST_BYTES = 256 * 1024
BODY_S = 10.0
UPLOADS: Mapping[str, Right] = {  # bring files along, for those who have the right
    "/api/programs/jobs": Right.MAKE_PROGRAMS,
    "/api/measurements/jobs": Right.IDENTIFY,
}
MOST_UPLOAD_BYTES, UPLOAD_S = 9 * 1024 * 1024, 60.0
_SAFE = frozenset({"GET", "HEAD"})
_POLICY = (
    "default-src 'self'; base-uri 'none'; form-action 'self'; frame-ancestors 'none'; object-src 'none'; "
    "script-src 'self'; style-src 'self'; img-src 'self' data: blob:; connect-src 'self'"
)
_DOCUMENT_POLICY = (  # documents that procedures and people wrote: no script at all, no page of ours as their origin
    "sandbox; default-src 'none'; base-uri 'none'; frame-ancestors 'none'; style-src 'unsafe-inline'; "
    "img-src 'self' data:; font-src 'self' data:"
)
HEADERS: Mapping[str, str] = {
    "content-security-policy": _POLICY,
    "x-content-type-options": "nosniff",
    "x-frame-options": "DENY",
    "referrer-policy": "no-referrer",
    "cross-origin-opener-policy": "same-origin",
    "cross-origin-resource-policy": "same-origin",
    "permissions-policy": "camera=(self), microphone=(), geolocation=(), payment=(), usb=()",
}
_TLS_ONLY = "max-age=31536000"
_SIGN_IN = "/api/sign-in"
_HOST = re.compile(
    r"(?:\[(?P<six>[0-9A-Fa-f:.]{2,45})\]|(?P<name>[A-Za-z0-9](?:[A-Za-z0-9._-]{0,252}[A-Za-z0-9])?))"
    r"(?::(?P<port>[0-9]{1,5}))?",
    re.ASCII,
)
_LAST_PORT = 65535


@dataclass
class RequestBudget:
    """Requests of one address: ``burst`` at once, then ``rate_hz``."""

    burst: float
    rate_hz: float
    clock: Callable[[], float] = time.monotonic
    _remaining: dict[str, tuple[float, float]] = field(default_factory=dict)

    def spend_request(self, address: str) -> bool:
        """Take one; False when nothing is left."""
        now = self.clock()
        remaining, at_s = self._remaining.get(address, (self.burst, now))
        remaining = min(self.burst, remaining + (now - at_s) * self.rate_hz)
        if len(self._remaining) > 4096:
            self._remaining = {
                key: entry
                for key, entry in self._remaining.items()
                if now - entry[1] < self.burst / self.rate_hz
            }
        self._remaining[address] = (max(remaining - 1.0, 0.0) if remaining >= 1.0 else remaining, now)
        return remaining >= 1.0

    @property
    def wait_s(self) -> int:
        """Return after how many whole seconds the next request of a spent address may come."""
        return math.ceil(1.0 / self.rate_hz)


def _make_budgets() -> dict[str, RequestBudget]:
    return {  # orders have their own: whatever a page asks for too often, a stop still gets through
        "sign-in": RequestBudget(40.0, 1.0),
        "orders": RequestBudget(200.0, 50.0),
        "else": RequestBudget(400.0, 100.0),
    }


class RefusedRequestError(Exception):
    """A request that goes no further."""

    def __init__(self, status: int, code: str, message: str, remedy: str = "", *, wait_s: int = 0) -> None:
        super().__init__(message)
        self.status = status
        self.wait_s = wait_s
        self.body = {"code": code, "message": message, "remedy": remedy}


@dataclass
class RequestFilter:
    """ASGI middleware. ``pages`` are the paths of built files, ``hosts`` the names that the service answers to."""

    app: ASGIApp
    pages: frozenset[str]
    hosts: tuple[str, ...] = ()
    tls: bool = False
    budgets: dict[str, RequestBudget] = field(default_factory=_make_budgets)

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Let a request through, or say why not."""
        if scope["type"] == "lifespan":
            await self.app(scope, receive, send)
            return
        answer = _ResponseSender(send, scope["path"], tls=self.tls)
        try:
            connection = HTTPConnection(scope)
            self._check_request(connection)
            if scope["type"] == "http" and scope["method"] not in _SAFE:
                receive = await _whole_body(connection, receive, *self._body_limits(connection))
            await self.app(scope, receive, answer.send_message if scope["type"] == "http" else send)
        except RefusedRequestError as refused:
            await self._reject(scope, answer, send, refused)
        except Exception as error:
            if scope["type"] != "http" or answer.begun:
                raise
            if isinstance(error, OSError) and lacks_resources(error):
                _log.warning("%s %s: %s", scope["method"], scope["path"], error)
                message, remedy = map(without_paths, explain_os_error(error))
                await answer.send_refusal(503, {"code": "store.io", "message": message, "remedy": remedy})
                return
            _log.exception("%s %s broke", scope["method"], scope["path"])
            await answer.send_refusal(
                500, {"code": "broken", "message": "The program failed; its log has the cause."}
            )

    async def _reject(
        self, scope: Scope, answer: "_ResponseSender", send: Send, refused: RefusedRequestError
    ) -> None:
        if scope["type"] == "websocket":  # before it is accepted: the browser sees 403
            await send({"type": "websocket.close", "code": 4401 if refused.status == 401 else 4403})
        else:
            await answer.send_refusal(refused.status, refused.body, refused.wait_s)

    def _check_request(self, connection: HTTPConnection) -> None:
        path = connection.scope["path"]
        self._refuse_other_hosts(connection)
        self._refuse_other_pages(connection)
        _reject_path_traversal(connection)
        self._refuse_too_many(connection, path)
        if path in self.pages or path == _SIGN_IN or path.startswith(f"{_SIGN_IN}/"):
            return
        try:
            authenticator, token = app_context(connection).authenticator, token_of(connection)
            authenticator.authenticate(token)
        except PeopleError as error:
            raise RefusedRequestError(error.status, error.code, error.message, error.remedy) from error
        if connection.scope.get("method", "GET") not in _SAFE:
            authenticator.note_activity(token)

    @staticmethod
    def _body_limits(connection: HTTPConnection) -> tuple[int, float]:
        """Return how many bytes a body may have, and how long it may take [s]; files need a right."""
        right = UPLOADS.get(connection.scope["path"])
        if right is not None:
            who = app_context(connection).authenticator.authenticate(token_of(connection))
            if who.has_right(right):
                return MOST_UPLOAD_BYTES, UPLOAD_S
        return MOST_BYTES, BODY_S

    def _refuse_other_hosts(self, connection: HTTPConnection) -> None:
        hosts = connection.headers.getlist("host")
        name = _host_name(hosts[0]) if len(hosts) == 1 else ""
        if name not in self.hosts and not is_loopback(name):
            raise RefusedRequestError(
                421, "guard.host", "this service does not answer to that name.",
                "Use the address that the service printed, or serve with --allow-host.",
            )  # fmt: skip

    def _refuse_other_pages(self, connection: HTTPConnection) -> None:
        headers = connection.headers
        own = f"{'https' if self.tls else 'http'}://{headers['host'].lower()}"
        origins = [origin.lower() for origin in headers.getlist("origin")]
        asks = headers.get("sec-fetch-site", "none")
        arrives = headers.get("sec-fetch-mode") == "navigate" and connection.scope.get("method") in _SAFE
        if any(origin != own for origin in origins) or (asks not in ("same-origin", "none") and not arrives):
            raise RefusedRequestError(
                403, "guard.origin", "a page of another address asks.", "Open the service's own page."
            )

    def _refuse_too_many(self, connection: HTTPConnection, path: str) -> None:
        asks = connection.scope.get("method", "GET") not in _SAFE
        kind = "sign-in" if path.startswith(_SIGN_IN) and asks else "orders" if asks else "else"
        address = connection.client.host if connection.client else ""
        budget = self.budgets[kind]
        if not budget.spend_request(address):
            raise RefusedRequestError(
                429, "guard.often", "too many requests.", "Wait a few seconds.", wait_s=budget.wait_s
            )


class _ResponseSender:
    """The way out: security headers on everything, and one place for refusals."""

    def __init__(self, send: Send, path: str, *, tls: bool) -> None:
        self._send, self._path, self._tls = send, path, tls
        self.begun = False

    async def send_message(self, message: Message) -> None:
        """Send on, with the headers."""
        if message["type"] == "http.response.start":
            self.begun = True
            headers = MutableHeaders(scope=message)
            if self._path.startswith("/api"):
                self._of_service(headers)
            for name, value in HEADERS.items():
                headers.setdefault(name, value)
            if self._tls:
                headers["strict-transport-security"] = _TLS_ONLY
        await self._send(message)

    @staticmethod
    def _of_service(headers: MutableHeaders) -> None:
        headers.setdefault("cache-control", "no-store")
        if headers.get("content-type", "").startswith(("text/html", "image/svg")):
            headers.setdefault("content-security-policy", _DOCUMENT_POLICY)

    async def send_refusal(self, status: int, body: Mapping[str, object], wait_s: int = 0) -> None:
        """Answer with a short JSON object, never with what was sent; ``wait_s`` says when to try again."""
        payload = json.dumps(with_messages(body)).encode()
        headers = [(b"content-type", b"application/json"), (b"content-length", str(len(payload)).encode())]
        if wait_s:
            headers.append((b"retry-after", str(wait_s).encode()))
        await self.send_message({"type": "http.response.start", "status": status, "headers": headers})
        await self.send_message({"type": "http.response.body", "body": payload})


def is_loopback(host: str) -> bool:
    """Whether a name or address is this computer alone, as no other site can make its own name be."""
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return host == "localhost"


def _host_name(header: str) -> str:
    """Return the name in a Host header; nothing where it is written in another way than RFC 9110 has it."""
    found = _HOST.fullmatch(header)
    if found is None or not 0 < int(found["port"] or 1) <= _LAST_PORT:
        return ""
    if found["six"] is None:
        return found["name"].lower()
    try:
        return str(ipaddress.IPv6Address(found["six"]))
    except ValueError:
        return ""


def _reject_path_traversal(connection: HTTPConnection) -> None:
    """Refuse paths that another server behind this one would read differently, and control characters."""
    raw: bytes = connection.scope.get("raw_path") or connection.scope["path"].encode()
    path = raw.partition(b"?")[0]
    for _ in range(3):  # also what is encoded twice
        parts = path.split(b"/")
        odd = any(part in (b"..", b".") for part in parts) or b"//" in path or b"\\" in path
        if odd or any(byte < 0x20 or byte == 0x7F for byte in path):
            raise RefusedRequestError(404, "guard.path", "there is nothing here.")
        path = unquote_to_bytes(path)


async def _whole_body(
    connection: HTTPConnection, receive: Receive, most_bytes: int, most_s: float
) -> Receive:
    """Read the body, no more than is allowed and no slower, and return what hands it on."""
    kind = connection.headers.get("content-type", "").partition(";")[0].strip().lower()
    if kind != "application/json":
        raise RefusedRequestError(
            415, "guard.json", "only JSON is taken.", "Send content-type application/json."
        )
    chunks: list[bytes] = []
    size = 0
    try:
        async with asyncio.timeout(most_s):
            more = True
            while more:
                message = await receive()
                if message["type"] == "http.disconnect":
                    raise RefusedRequestError(400, "guard.gone", "the request broke off.")
                chunks.append(message.get("body", b""))
                more = message.get("more_body", False)
                size += len(chunks[-1])
                _refuse_long(size, most_bytes)
    except TimeoutError as error:
        raise RefusedRequestError(408, "guard.slow", "the request did not arrive in time.") from error
    body = b"".join(chunks)
    _refuse_what_is_no_json(body)
    handed = False

    async def replay_body() -> Message:
        nonlocal handed
        if handed:
            return await receive()
        handed = True
        return {"type": "http.request", "body": body, "more_body": False}

    return replay_body


def _refuse_what_is_no_json(body: bytes) -> None:
    """Let only JSON within the limits of the guarded reader through; a route may ask for none."""
    try:
        if body:
            parse_json(body)
    except DocumentError as error:
        raise RefusedRequestError(
            422,
            "guard.json",
            make_message("the request is not understood: {why}", why=error.why),
            "Load the page again.",
        ) from error


def _refuse_long(size: int, most_bytes: int) -> None:
    if size > most_bytes:
        raise RefusedRequestError(
            413,
            "guard.size",
            make_message("more than {most_bytes} KiB are not taken.", most_bytes=most_bytes // 1024),
        )
