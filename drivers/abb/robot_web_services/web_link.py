"""Requests to Robot Web Services 1 (RobotWare 6): JSON over HTTP with digest authentication, one session.

Source: ABB 3HAC050973-001 rev M. The session's cookies are sent back, or every request would take a new session and
the controller would refuse with 503 soon.
"""

from collections.abc import Mapping
from typing import Any

import httpx

from cellcal.calibration.documents.errors import DocumentError
from cellcal.calibration.documents.json_text import parse_json
from cellcal.calibration.message import make_message
from cellcal.drivers.errors import (
    DeviceTimeoutError,
    RefusedError,
    UnreachableError,
    WireProtocolError,
)
from cellcal.drivers.wire.deadline import answer_deadline, timeout_error
from cellcal.drivers.wire.trace import FrameTrace

_MOST_OCTETS = 4_000_000
_CABLE = "Check that the controller is on, the cable is in its WAN or service port, and the address is right."
_WHY = {
    401: ("the controller does not accept user and password.", "Correct user and password in the cell file."),
    403: (
        "the controller does not allow it.",
        "Check the rights of the user, the mode, and that nothing else has control.",
    ),
    404: ("the controller does not know what was asked for.", "Check the names in the cell file."),
    503: (
        "the controller has no session left.",
        "End other clients of Robot Web Services, or wait ten minutes.",
    ),
}
State = Mapping[str, Any]


class WebLink:
    """One HTTP session with a controller."""

    def __init__(self, device: str, base_url: str, user: tuple[str, str], *, deadline_s: float) -> None:
        self.device, self._deadline_s = device, deadline_s
        self._client = httpx.AsyncClient(
            base_url=base_url,
            auth=httpx.DigestAuth(*user),
            timeout=deadline_s,
            trust_env=False,
            limits=httpx.Limits(max_connections=1),
        )
        self.trace = FrameTrace(device)

    async def close(self) -> None:
        """Give the session back and hang up."""
        if self._client.is_closed:
            return
        try:
            async with answer_deadline(self.device, self._deadline_s, "stopping"):
                await self._client.get("/logout")
        except (httpx.HTTPError, DeviceTimeoutError):
            pass  # the controller ends it by itself
        await self._client.aclose()

    async def get_state(self, path: str, **query: str) -> State:
        """Return the first state of a resource.

        Raises
        ------
        RefusedError
            The controller refuses; its status is in ``vendor_code``.
        DeviceError
            No connection, no answer, or an answer that is none.
        """
        reply = await self._request("GET", path, {"json": "1", **query}, None)
        states = (
            reply.get("_embedded", {}).get("_state") if isinstance(reply.get("_embedded"), dict) else None
        )
        if not isinstance(states, list) or not states or not isinstance(states[0], dict):
            raise self._unreadable(f"{path} holds no state")
        return dict(states[0])

    async def post_action(self, path: str, action: str, **fields: str) -> None:
        """Ask for an action; errors as for ``get_state``."""
        await self._request("POST", path, {"action": action, "json": "1"}, fields)

    async def _request(
        self, method: str, path: str, query: Mapping[str, str], fields: Mapping[str, str] | None
    ) -> dict[str, Any]:
        if self._client.is_closed:
            raise UnreachableError(self.device, "the connection is closed.", remedy=_CABLE)
        self.trace.add_frame(">", f"{method} {path} {dict(fields or {})}")
        try:
            async with answer_deadline(self.device, self._deadline_s, "waiting for an answer"):
                response = await self._client.request(method, path, params=dict(query), data=fields)
        except httpx.TimeoutException as error:
            raise timeout_error(self.device, self._deadline_s, "waiting for an answer") from error
        except httpx.HTTPError as error:
            raise UnreachableError(
                self.device,
                "no connection to the controller, or it was lost.",
                remedy=_CABLE,
            ) from error
        self.trace.add_frame("<", f"{response.status_code} {response.text[:500]}")
        if response.status_code >= 400:
            raise self._refused(response)
        return self._decode(response)

    def _decode(self, response: httpx.Response) -> dict[str, Any]:
        if response.status_code == 204 or not response.content:
            return {}
        if len(response.content) > _MOST_OCTETS:
            raise self._unreadable("it is too long")
        try:
            reply = parse_json(response.content)
        except (DocumentError, ValueError) as error:
            raise self._unreadable("it is no JSON") from error
        if not isinstance(reply, dict):
            raise self._unreadable("it is no JSON object")
        return reply

    def _refused(self, response: httpx.Response) -> RefusedError:
        text, remedy = _WHY.get(
            response.status_code,
            (
                f"the controller answers with status {response.status_code}.",
                "Read the event log at the pendant.",
            ),
        )
        return RefusedError(
            self.device,
            text,
            remedy=remedy,
            vendor_code=response.status_code,
            vendor_text=response.text[:500],
        )

    def _unreadable(self, what: str) -> WireProtocolError:
        return WireProtocolError(
            self.device,
            make_message("an answer cannot be read: {what}.", what=what),
            remedy="Check that the address is that of a controller with RobotWare 6.",
            frame=self.trace.last_received(),
        )
