"""The Robot API of PolyScope X: JSON over plain HTTP, in place of the dashboard.

Source: the maker's C++ client library 2.14.0 (its Robot API client, tests and manual). Modes can be read from version
3.1.4 on (PolyScope X 10.12). Serial number and model are told from version 5.0.107 on (PolyScope X 10.14), as the
client of that library's development after 2.14.0 asks for them.
"""

import re
from collections.abc import Mapping
from typing import Any

import httpx

from cellcal.calibration.documents.errors import DocumentError
from cellcal.calibration.documents.json_text import parse_json
from cellcal.calibration.message import make_message
from cellcal.drivers.errors import DeviceTimeoutError, RefusedError, UnreachableError, WireProtocolError
from cellcal.drivers.wire.deadline import answer_deadline
from cellcal.drivers.wire.http_answers import STEP_SHARE, BoundedTransport, OversizedAnswerError
from cellcal.drivers.wire.link_errors import find_reason
from cellcal.drivers.wire.trace import FrameTrace

_BASE = "/universal-robots/robot-api"
_TELLS_MODES_SINCE, _TELLS_PLATE_SINCE = (3, 1, 4), (5, 0, 107)
_MOST_OCTETS = 8_000_000
_SHOWN = 500
_DONE = (200, 201, 202, 204)  # whole answers: a part of one (206) is none
_VERSION = re.compile(r"\s*v?(\d{1,4}(?:\.\d{1,6}){1,3})(?![.\d])", re.ASCII | re.IGNORECASE)
_ASK_TO_REPORT = "Report this with the controller's version; nothing in the cell is at fault."
_SWITCHED_ON = (
    "Check that the controller is switched on, that the network cable is plugged in, and that its settings allow "
    "the Robot API."
)


class RobotApiClient:
    """The Robot API requests that are used, and no more: it could also switch power and clear stops."""

    def __init__(self, device: str, address: str, port: int, *, deadline_s: float) -> None:
        self._device, self._address, self._deadline_s = device, address, deadline_s
        self._version: tuple[int, ...] = ()
        self._client = httpx.AsyncClient(
            base_url=f"http://{address}:{port}{_BASE}",
            timeout=deadline_s * STEP_SHARE,
            trust_env=False,
            follow_redirects=True,  # the maker moves paths from version to version
            transport=BoundedTransport(
                _MOST_OCTETS,
                verify=False,  # plain HTTP; with it every client loads certificates
                limits=httpx.Limits(
                    max_keepalive_connections=0
                ),  # an answer too many ends with its connection
            ),
        )
        self._host = self._client.base_url.host
        self.trace = FrameTrace(device)

    async def connect(self) -> None:
        """Ask for the version of the interface; a reply of anything else is refused."""
        reply = await self._request("GET", "/openapi.json")
        info = reply.get("info")
        version = info.get("version") if isinstance(info, dict) else None
        self._version = self.read_version(version)

    def read_version(self, text: object) -> tuple[int, ...]:
        """Return the numbers of a version, whatever follows them; raise WireProtocolError where it is none."""
        found = _VERSION.match(text) if isinstance(text, str) else None
        if found is None:
            raise self._unreadable_error(make_message("{name} is missing", name="version"))
        return tuple(int(part) for part in found[1].split("."))

    @property
    def tells_modes(self) -> bool:
        """Whether the modes can be read."""
        return self._version >= _TELLS_MODES_SINCE

    async def name_plate(self) -> tuple[str | None, str | None]:
        """Return serial number and model; None for both where the controller does not tell them."""
        if self._version < _TELLS_PLATE_SINCE:
            return None, None
        path = "/system/v1/information"
        try:
            reply = await self._request("GET", path)
        except RefusedError:
            return None, None
        serial, model = (reply.get(key) for key in ("serialNumber", "robotType"))
        if not (isinstance(serial, str) and serial.strip() and isinstance(model, str) and model.strip()):
            raise self._unreadable_error(make_message("{path} holds no serial number or no model", path=path))
        return serial.strip(), model.strip()

    async def in_remote_control(self) -> bool:
        """Whether the pendant has handed control to the network."""
        path = "/system/v1/controlmode"
        mode = await self._read_mode(path)
        if mode not in ("REMOTE", "LOCAL"):
            raise self._unreadable_error(
                make_message("{path} holds the mode {mode}", path=path, mode=mode[:40])
            )
        return mode == "REMOTE"

    async def operational_mode(self) -> str:
        """Return the operational mode, MANUAL or AUTOMATIC."""
        return await self._read_mode("/system/v1/operationalmode")

    async def stop_program(self) -> None:
        """Stop whatever program runs; the arm decelerates and stays where it is."""
        await self._request("PUT", "/program/v1/state", {"action": "stop"})

    async def close(self) -> None:
        """Hang up."""
        await self._client.aclose()

    async def _read_mode(self, path: str) -> str:
        if not self.tells_modes:
            raise RefusedError(
                self._device,
                "the controller does not tell its modes over the network.",
                remedy="Update it to PolyScope X 10.12 or later.",
            )
        mode = (await self._request("GET", path)).get("mode")
        if not isinstance(mode, str) or not mode:
            raise self._unreadable_error(make_message("{path} holds no mode", path=path))
        return mode

    async def _request(
        self, method: str, path: str, fields: Mapping[str, str] | None = None
    ) -> dict[str, Any]:
        self.trace.add_frame(">", f"{method} {path} {dict(fields or {})}")
        try:
            async with answer_deadline(self._device, self._deadline_s, "waiting for an answer"):
                response = await self._client.request(method, path, json=fields)
        except OversizedAnswerError as error:
            raise self._unreadable_error(str(error)) from error
        except (httpx.TimeoutException, DeviceTimeoutError) as error:
            what = make_message("did not answer within {deadline_s:g} s", deadline_s=self._deadline_s)
            raise self._unreachable_error(what) from error
        except (httpx.HTTPError, httpx.InvalidURL, RuntimeError) as error:  # RuntimeError: closed by us
            what = make_message("cannot be reached ({error})", error=find_reason(error))
            raise self._unreachable_error(what) from error
        self.trace.add_frame("<", f"{response.status_code} {response.text[:_SHOWN]}")
        if response.request.method != method or response.url.host != self._host:
            raise self._unreadable_error(make_message("{path} leads elsewhere", path=path))
        if response.status_code not in _DONE:
            raise self._refused_error(response)
        return self.decode_answer(response.content) if response.content else {}

    def decode_answer(self, content: bytes) -> dict[str, Any]:
        """Return the JSON object of an answer; raise WireProtocolError where it is none."""
        try:
            reply = parse_json(content)
        except (DocumentError, ValueError) as error:
            raise self._unreadable_error("it is no JSON") from error
        if not isinstance(reply, dict):
            raise self._unreadable_error("it is no JSON object")
        return reply

    def _refused_error(self, response: httpx.Response) -> RefusedError:
        return RefusedError(
            self._device,
            make_message(
                "the Robot API refuses with status {status_code}.", status_code=response.status_code
            ),
            remedy="Look at the pendant: it says what stands against it. Stop the robot there if it moves.",
            vendor_code=response.status_code,
            vendor_text=response.text[:_SHOWN],
        )

    def _unreachable_error(self, what: str) -> UnreachableError:
        return UnreachableError(
            self._device,
            make_message(
                "the Robot API of the controller at {address} {what}.", address=self._address, what=what
            ),
            remedy=_SWITCHED_ON,
        )

    def _unreadable_error(self, what: str) -> WireProtocolError:
        return WireProtocolError(
            self._device,
            make_message("an answer of the Robot API cannot be read: {what}.", what=what),
            remedy=_ASK_TO_REPORT,
            frame=self.trace.last_received(),
        )
