"""Requests to Robot Web Services of either generation: JSON over HTTP or HTTPS, one session.

The session's cookies are sent back, or every request would take a new session and the controller would refuse with
503 soon. An answer carries no number: what was read counts once a question of another kind is answered after it
(``confirmed_answers``), since answers keep their order and one too many has shown itself by then.
"""

import asyncio
import re
from collections.abc import AsyncIterator, Mapping
from contextlib import asynccontextmanager
from typing import Any

import httpx

from cellcal.calibration.documents.errors import DocumentError
from cellcal.calibration.documents.json_text import parse_json
from cellcal.calibration.message import make_message
from cellcal.drivers.abb.robot_web_services.dialects import Dialect
from cellcal.drivers.abb.robot_web_services.generation import (
    CABLE,
    NO_SESSION,
    FoundService,
    ServiceAddress,
    find_service,
)
from cellcal.drivers.errors import (
    DeviceError,
    DeviceTimeoutError,
    RefusedError,
    UnreachableError,
    WireProtocolError,
)
from cellcal.drivers.wire.deadline import answer_deadline, timeout_error
from cellcal.drivers.wire.http_answers import STEP_SHARE, BoundedTransport, OversizedAnswerError
from cellcal.drivers.wire.link_errors import find_reason, unreadable_answer_error
from cellcal.drivers.wire.trace import FrameTrace

_MOST_OCTETS = 4_000_000
_MOST_COOKIES = 20  # two are in the maker's document; more than these would fill each request
_DONE = (
    httpx.codes.OK,
    httpx.codes.CREATED,
    httpx.codes.ACCEPTED,
    httpx.codes.NO_CONTENT,
)  # whole answers; one that leads elsewhere has done nothing
_CONFIRMING = {
    "/rw/panel/opmode": "opmode",
    "/rw/panel/speedratio": "speedratio",
}  # and what the answer holds
_WHY = {
    401: ("the controller does not accept user and password.", "Correct user and password in the cell file."),
    403: (
        "the controller does not allow it.",
        "Check the rights of the user, the mode, and that nothing else has control.",
    ),
    404: ("the controller does not know what was asked for.", "Check the names in the cell file."),
    410: (
        "the controller gives write access to control stations only (RobotWare 8); this driver only reads it.",
        "Move the robot at the pendant.",
    ),
    503: NO_SESSION,
}
_ROBOT = re.compile(r"(?:\bROB_|\bT_ROB)(\d+)")
State = Mapping[str, Any]


class WebLink:
    """One HTTP session with a controller."""

    def __init__(self, address: ServiceAddress, user: tuple[str, str], *, deadline_s: float) -> None:
        self.device, self._deadline_s = address.device, deadline_s
        self._address, self._user = address, user
        self._found: FoundService | None = None
        self._client: httpx.AsyncClient | None = None
        self._transport: BoundedTransport | None = None
        self._login: httpx.Auth = httpx.Auth()
        self._earliest_s = 0.0  # of the next request, by the loop's clock
        self._last_path = ""
        self.trace = FrameTrace(address.device)

    @property
    def dialect(self) -> Dialect:
        """The controller's dialect; raise UnreachableError before it was found out."""
        if self._found is None:
            raise self._closed_error()
        return self._found.dialect

    async def connect(self) -> None:
        """Find out the generation. The session begins with the first request."""
        self._found = await find_service(self._address, self._deadline_s)
        first = self._found.dialect.generation == 1
        self._login = httpx.DigestAuth(*self._user) if first else httpx.BasicAuth(*self._user)
        self._client = self._make_client(self._found)

    def _make_client(self, found: FoundService, cookies: httpx.Cookies | None = None) -> httpx.AsyncClient:
        """Return a client that connects with its first request; with cookies it goes on in their session."""
        self._transport = BoundedTransport(
            _MOST_OCTETS, verify=found.tls, limits=httpx.Limits(max_connections=1)
        )
        return httpx.AsyncClient(
            base_url=found.base_url,
            cookies=cookies,
            auth=self._login,
            headers={"Accept": found.dialect.accept},
            timeout=self._deadline_s * STEP_SHARE,
            trust_env=False,
            transport=self._transport,
        )

    @asynccontextmanager
    async def confirmed_answers(self) -> AsyncIterator[None]:
        """Check that the answers read inside belong to their questions: nothing of it counts where this raises.

        Raises
        ------
        WireProtocolError
            An answer too many has come; the connection is made anew.
        DeviceError
            As for ``get_state``.
        """
        try:
            yield
            path, key = next(each for each in _CONFIRMING.items() if each[0] != self._last_path)
            if key not in await self.get_state(path):
                raise self._unreadable_error("it answers another question than was asked")
        except WireProtocolError:
            await self._renew_connection()
            raise

    async def _renew_connection(self) -> None:
        """Give up the connection, and whatever answers are still under way on it; the session stays."""
        if self._client is not None and self._found is not None and not self._client.is_closed:
            old, self._client = self._client, self._make_client(self._found, self._client.cookies)
            await old.aclose()

    async def close(self) -> None:
        """Give the session back and hang up."""
        if self._client is None or self._client.is_closed:
            return
        try:
            async with answer_deadline(self.device, self._deadline_s, "stopping"):
                await self._client.get("/logout")
        except (httpx.HTTPError, DeviceTimeoutError, NotImplementedError, KeyError):
            pass  # the controller ends it by itself; no login of the library's has opened it
        finally:
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
        return (await self.get_states(path, **query))[0]

    async def get_states(self, path: str, **query: str) -> list[State]:
        """Return all states of a resource, at least one; errors as for ``get_state``."""
        dialect = self.dialect
        response = await self._request("GET", path, {**dialect.query, **query})
        reply = self._decode(response)
        states = dialect.states_in(reply)
        if not states:
            raise self._unreadable_error(make_message("{path} holds no state", path=path))
        if is_of_another_robot(path, reply, states):
            raise self._unreadable_error(make_message("{path} holds the state of another robot", path=path))
        return [dict(state) for state in states]

    async def get_document(self, path: str, **query: str) -> Mapping[str, Any]:
        """Return a whole answer; errors as for ``get_state``."""
        return self._decode(await self._request("GET", path, {**self.dialect.query, **query}))

    async def get_content(self, path: str) -> bytes:
        """Return a file of the controller; errors as for ``get_state``."""
        return (await self._request("GET", path, {})).content

    async def put_content(self, path: str, content: bytes) -> None:
        """Write a file of the controller; errors as for ``get_state``."""
        await self._request("PUT", path, {}, content, self.dialect.file_type)

    async def delete(self, path: str) -> None:
        """Delete a file of the controller; errors as for ``get_state``."""
        await self._request("DELETE", path, {})

    async def post_action(self, path: str, action: str, **fields: str) -> None:
        """Ask for an action; "" is a plain write. Errors as for ``get_state``."""
        dialect = self.dialect
        target, query = dialect.action_target(path, action)
        body = httpx.QueryParams(fields)
        response = await self._request(
            "POST", target, {**query, **dialect.query}, str(body).encode(), dialect.form_type
        )
        self._decode(response)

    async def read_symbol(self, name: str) -> str:
        """Return the value of a RAPID symbol of the motion task, as text."""
        value = (await self.get_state(self.dialect.symbol_path(name))).get("value")
        if not isinstance(value, str) or not value:
            raise self._unreadable_error(make_message("{name} is missing", name="value"))
        return value

    async def write_symbol(self, name: str, value: str) -> None:
        """Write a RAPID symbol of the motion task."""
        await self.post_action(self.dialect.symbol_path(name), self.dialect.symbol_action(), value=value)

    async def _request(
        self,
        method: str,
        path: str,
        query: Mapping[str, str],
        body: bytes | None = None,
        content_type: str = "",
    ) -> httpx.Response:
        if self._client is None or self._client.is_closed:
            raise self._closed_error()
        await self._keep_pace()
        self._last_path = path
        self.trace.add_frame(">", f"{method} {path} {(body or b'')[:500]!r}")
        headers = {"Content-Type": content_type} if content_type else {}
        try:
            async with answer_deadline(
                self.device, self._deadline_s, "waiting for an answer", is_half=self._is_half
            ):
                response = await self._ask_client(
                    method, path, params=dict(query), content=body, headers=headers
                )
        except OversizedAnswerError as error:
            raise self._unreadable_error(str(error)) from error
        except httpx.TimeoutException as error:
            raise timeout_error(
                self.device, self._deadline_s, "waiting for an answer", is_half=self._is_half()
            ) from error
        except httpx.HTTPError as error:
            raise UnreachableError(
                self.device,
                make_message("the connection was lost: {reason}.", reason=find_reason(error)),
                remedy=CABLE,
            ) from error
        except (
            NotImplementedError,
            KeyError,
        ) as error:  # of the library's digest: protection or hash of another kind
            raise RefusedError(
                self.device,
                make_message(
                    "the controller asks for a digest login of a kind that is not known here: {reason}.",
                    reason=str(error).strip("'\""),
                ),
                remedy="Check the address; a proxy in between may ask so.",
            ) from error
        self.trace.add_frame("<", f"{response.status_code} {response.text[:500]}")
        self._bound_cookies()
        if response.has_redirect_location:
            raise self._unreadable_error(make_message("{path} leads elsewhere", path=path))
        if response.status_code not in _DONE:
            raise self._refused(response)
        return response

    async def _ask_client(self, method: str, path: str, **fields: Any) -> httpx.Response:
        """Return the answer; where a session has ended, one more time in a new one: what was refused was not done."""
        assert self._client is not None
        response = await self._client.request(method, path, **fields)
        if response.status_code == httpx.codes.UNAUTHORIZED and len(self._client.cookies.jar):
            self._client.cookies.clear()
            response = await self._client.request(method, path, **fields)
        return response

    def _bound_cookies(self) -> None:
        """Forget the cookies of a server that sends ever new ones; the session begins anew."""
        if self._client is not None and len(self._client.cookies.jar) > _MOST_COOKIES:
            self._client.cookies.clear()

    def _is_half(self) -> bool:
        return self._transport is not None and self._transport.is_half

    async def _keep_pace(self) -> None:
        """Wait until the controller may be asked again."""
        now_s = asyncio.get_running_loop().time()
        begins_s = max(now_s, self._earliest_s)
        self._earliest_s = begins_s + self.dialect.pause_s
        if begins_s > now_s:
            await asyncio.sleep(begins_s - now_s)

    def _closed_error(self) -> DeviceError:
        return UnreachableError(self.device, "the connection is closed.", remedy=CABLE)

    def _decode(self, response: httpx.Response) -> dict[str, Any]:
        if response.status_code == 204 or not response.content:
            return {}
        try:
            reply = parse_json(response.content)
        except (DocumentError, ValueError) as error:
            raise self._unreadable_error("it is no JSON") from error
        if not isinstance(reply, dict):
            raise self._unreadable_error("it is no JSON object")
        return reply

    def _refused(self, response: httpx.Response) -> RefusedError:
        text, remedy = _WHY.get(
            response.status_code,
            (
                make_message("the controller answers with status {status}.", status=response.status_code),
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

    def _unreadable_error(self, what: str) -> WireProtocolError:
        return unreadable_answer_error(
            self.device,
            what,
            "Check that the address is that of an ABB controller with RobotWare 6 or 7.",
            self.trace.last_received(),
        )


def is_of_another_robot(path: str, reply: Mapping[str, Any], states: list[State]) -> bool:
    """Return whether an answer names itself, or a state of it, by another robot than the one that was asked for."""
    asked = _robots_in(path)
    links = reply.get("_links")
    own = links.get("self") if isinstance(links, dict) else None
    names = [own.get("href") if isinstance(own, dict) else None, *(state.get("_title") for state in states)]
    named = {number for name in names if isinstance(name, str) for number in _robots_in(name)}
    return bool(asked) and not named <= asked


def _robots_in(name: str) -> set[str]:
    return set(_ROBOT.findall(name))
