"""Answers of Robot Web Services that are none: they lead elsewhere, are of another robot, say a thing twice."""

import asyncio
import json
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from typing import Any

import pytest

from cellcal.drivers.abb.robot_web_services.config import AbbWebServicesConfig
from cellcal.drivers.abb.robot_web_services.robot import AbbRobot
from cellcal.drivers.errors import RefusedError, WireProtocolError
from cellcal.fake_devices.listening_port import ListeningPort

_UNIT = "/rw/motionsystem/mechunits/ROB_1"
_CHALLENGE = 'WWW-Authenticate: Digest realm="validusers@robapi.abb", nonce="1", qop="auth"\r\n'
_JOINTS = {f"rax_{axis}": "10.0" for axis in range(1, 7)}
_STATES: dict[str, dict[str, str]] = {
    "/rw/panel/opmode": {"opmode": "AUTO"},
    "/rw/panel/ctrlstate": {"ctrlstate": "motoron"},
    "/rw/panel/speedratio": {"speedratio": "100"},
    "/rw/system": {"rwversion": "6.15"},
    "/ctrl/identity": {"ctrl-type": "Virtual", "ctrl-id": "S1"},
    f"{_UNIT}/jointtarget": {"_title": "ROB_1", **_JOINTS},
}


def answer(states: Any, status: str = "200 OK", head: str = "", **links: Any) -> bytes:
    """Return an answer of the first generation; states of bytes are its text."""
    body = states
    if not isinstance(states, bytes):
        body = json.dumps({"_links": links, "_embedded": {"_state": states}}).encode()
    return f"HTTP/1.1 {status}\r\n{head}Content-Length: {len(body)}\r\n\r\n".encode() + body


class _Controller:
    """Answers from a table, unless ``special`` has an answer of its own."""

    def __init__(self) -> None:
        self.special: Callable[[str, str, str], bytes | None] = lambda _method, _path, _cookie: None
        self.asked: list[tuple[str, str, str]] = []

    async def serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        while head := await _read_head(reader):
            lines = head.split("\r\n")
            method, target = lines[0].split(" ")[:2]
            fields = {name.lower(): value for name, _, value in (line.partition(": ") for line in lines[1:])}
            await reader.readexactly(int(fields.get("content-length", 0)))
            path = target.partition("?")[0]
            writer.write(self._answer(method, path, fields))
            await writer.drain()

    def _answer(self, method: str, path: str, fields: dict[str, str]) -> bytes:
        if "authorization" not in fields:
            return answer(b"", "401 Unauthorized", _CHALLENGE)
        self.asked.append((method, path, fields.get("cookie", "")))
        special = self.special(method, path, fields.get("cookie", ""))
        if special is not None:
            return special
        if method == "POST":
            return b"HTTP/1.1 204 No Content\r\n\r\n"
        symbol = path.startswith("/rw/rapid/symbol")
        return answer([{"value": "0"} if symbol else _STATES[path]])


async def _read_head(reader: asyncio.StreamReader) -> str:
    try:
        return (await reader.readuntil(b"\r\n\r\n")).decode()
    except (asyncio.IncompleteReadError, ConnectionError):
        return ""


@asynccontextmanager
async def connected_robot() -> AsyncIterator[tuple[_Controller, AbbRobot]]:
    controller = _Controller()
    async with ListeningPort("127.0.0.1", 0, controller.serve) as port:
        config = AbbWebServicesConfig(
            driver="abb_web_services", name="abb", address="127.0.0.1", port=port.port, serial="S1",
            model="IRB1200", speed_limit_rad_s=0.3, deadline_s=60.0,
        )  # fmt: skip
        async with config.open() as robot:
            yield controller, robot


_DOUBLED = answer([{**_JOINTS, "rax_7": "11.0"}]).partition(b"\r\n\r\n")[2].replace(b"rax_7", b"rax_1")


@pytest.mark.parametrize(
    ("joints", "reason"),
    [
        (answer([{"_title": "ROB_2", **_JOINTS}]), "another robot"),
        (answer([_JOINTS], self={"href": "mechunits/ROB_2/jointtarget"}), "another robot"),
        (answer(_DOUBLED), "no JSON"),
        (answer([_JOINTS], "302 Found", "Location: http://127.0.0.9/\r\n"), "leads elsewhere"),
    ],
)
async def test_joints_of_another_robot_or_place_are_refused(joints: bytes, reason: str) -> None:
    async with connected_robot() as (controller, robot):
        await robot.read_joints()
        controller.special = lambda _method, path, _cookie: joints if path.endswith("jointtarget") else None
        with pytest.raises(WireProtocolError, match=reason):
            await robot.read_joints()


async def test_a_part_of_an_answer_is_none() -> None:
    async with connected_robot() as (controller, robot):
        controller.special = lambda _method, path, _cookie: (
            answer([_JOINTS], "206 Partial Content") if path.endswith("jointtarget") else None
        )
        with pytest.raises(RefusedError, match="status 206"):
            await robot.read_joints()


@pytest.mark.parametrize(
    "refusal", [answer(b"", "403 Forbidden"), answer(b"", "302 Found", "Location: /login\r\n")]
)
async def test_a_stop_that_is_not_written_stops_all_programs(refusal: bytes) -> None:
    """The right to write ends in mid motion: with the mode, with the session, or another client takes it."""
    async with connected_robot() as (controller, robot):
        controller.special = lambda method, path, _cookie: (
            refusal if method == "POST" and path.startswith("/rw/rapid/symbol") else None
        )
        await robot.stop()
        assert ("POST", "/rw/rapid/execution") in [(method, path) for method, path, _ in controller.asked]


async def test_a_session_that_has_ended_is_begun_anew() -> None:
    async with connected_robot() as (controller, robot):
        opmode = answer([{"opmode": "AUTO"}], head="Set-Cookie: ABBCX=1; Path=/\r\n")
        controller.special = lambda _method, path, _cookie: opmode if path.endswith("opmode") else None
        assert await robot.controller_mode() == "AUTO"
        controller.special = lambda _method, _path, cookie: (
            answer(b"", "401 Unauthorized", _CHALLENGE) if "ABBCX=1" in cookie else None
        )
        assert (await robot.read_joints()).joints_rad
        assert controller.asked[-1][2] == ""


async def test_ever_new_cookies_do_not_fill_the_requests() -> None:
    async with connected_robot() as (controller, robot):
        cookies = "".join(f"Set-Cookie: k{n}=1; Path=/\r\n" for n in range(100))
        opmode = answer([{"opmode": "AUTO"}], head=cookies)
        controller.special = lambda _method, path, _cookie: opmode if path.endswith("opmode") else None
        await robot.controller_mode()
        await robot.read_joints()
        assert max(len(cookie) for _, _, cookie in controller.asked) < 200
