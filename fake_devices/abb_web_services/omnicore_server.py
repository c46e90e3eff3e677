"""The web server of an OmniCore: HTTPS, basic authentication, versioned media types, two forms of answers.

Imitates
    The web server of RobotWare 7.
Source
    ABB OmniCore App SDK 1.5.0 (media types, HAL form), rwswrap 0.1.0 and omnicorectl (basic authentication, headers);
    answers of a virtual controller with RobotWare 7.21 as a public client's tests keep them.
Modelled
    TLS with a certificate of its own; 401 with a basic challenge; 406 for a media type that it does not know, 415
    for a form without its version; the cookie ``ABBCX``; HAL-JSON and XHTML. Faults as http_port.py says.
Not modelled
    The request rate that a controller bears; subscriptions by websocket.
"""

import base64
import hmac
import json
from collections.abc import Mapping
from dataclasses import replace
from html import escape
from typing import Any

from cellcal.fake_devices.abb_web_services.http_port import (
    COOKIE,
    HttpAnswer,
    HttpPort,
    HttpRequest,
    SessionTable,
)
from cellcal.fake_devices.abb_web_services.omnicore_resources import OmnicoreResources
from cellcal.fake_devices.abb_web_services.own_certificate import make_server_context
from cellcal.fake_devices.link_faults import LinkFaults

USER, PASSWORD = "Default User", "robotics"
_HAL, _XHTML = "application/hal+json;v=2.0", "application/xhtml+xml;v=2.0"
_FORM = "application/x-www-form-urlencoded;v=2.0"


class OmnicorePort(HttpPort):
    """The port of the web server."""

    def __init__(self, host: str, port: int, resources: OmnicoreResources, faults: LinkFaults) -> None:
        super().__init__(host, port, faults, tls=make_server_context("omnicore"))
        self._resources = resources
        self.sessions = SessionTable(faults)

    def answer_request(self, request: HttpRequest) -> HttpAnswer:
        """Return the answer of the resources to a client that is known."""
        if not _is_known(request.headers.get("authorization", "")):
            return HttpAnswer(401, headers=('WWW-Authenticate: Basic realm="validusers@robapi.abb"',))
        session, is_new = self.sessions.find_or_begin(request)
        if not session:
            return HttpAnswer(503)
        more = (f"Set-Cookie: {COOKIE}={session}; path=/; Secure; HttpOnly",) if is_new else ()
        return replace(self._answer_session(request, session), headers=more)

    def _answer_session(self, request: HttpRequest, session: str) -> HttpAnswer:
        if request.path == "/logout":
            self.sessions.end(session)
            self._resources.end_session(session)
            return HttpAnswer(204)
        kind = _accepted_form(request.headers.get("accept", "*/*"))
        if kind is None:
            return HttpAnswer(406)
        if (
            request.method == "POST"
            and _plain_media_type(request.headers.get("content-type", _FORM)) != _FORM
        ):
            return HttpAnswer(415)
        status, content = self._resources.answer(request, session)
        if content is None or isinstance(content, bytes):
            return HttpAnswer(status, content or b"", "application/octet-stream")
        octets = json.dumps(content) if kind == _HAL else _as_xhtml(content)
        return HttpAnswer(status, octets.encode(), kind)


def _is_known(authorization: str) -> bool:
    expected = base64.b64encode(f"{USER}:{PASSWORD}".encode()).decode()
    return hmac.compare_digest(authorization.encode("latin-1"), f"Basic {expected}".encode())


def _plain_media_type(media_type: str) -> str:
    return media_type.replace(" ", "").lower().rstrip(";")


def _accepted_form(header: str) -> str | None:
    """Return the form of the answer that a client takes."""
    for one in header.split(","):
        if _plain_media_type(one) in ("*/*", _HAL):
            return _HAL
        if _plain_media_type(one) == _XHTML:
            return _XHTML
    return None


def _as_xhtml(content: Mapping[str, Any]) -> str:
    if "state" not in content and "_embedded" not in content:
        status = content["status"]
        inner = (
            f'<span class="code">{status["code"]}</span><span class="msg">{escape(str(status["msg"]))}</span>'
        )
        return f'{_HEAD}<div class="status">{inner}</div></body></html>'
    listed = content.get("_embedded", {}).get("resources", [])
    items = "".join(_as_item(one) for one in (*content.get("state", []), *listed))
    return f'{_HEAD}<div class="state"><ul>{items}</ul></div></body></html>'


def _as_item(table: Mapping[str, Any]) -> str:
    spans = "".join(
        f'<span class="{escape(key)}">{escape(str(value))}</span>'
        for key, value in table.items()
        if not key.startswith("_")
    )
    return f'<li class="{escape(table["_type"])}" title="{escape(table.get("_title", ""))}">{spans}</li>'


_HEAD = (
    '<?xml version="1.0" encoding="utf-8"?><html xmlns="http://www.w3.org/1999/xhtml"><head><title>rws</title></head>'
    "<body>"
)
