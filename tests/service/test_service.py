"""The service as a process: killed at any moment it comes back to the same step; every screen sees the same."""

import asyncio
import json
import os
import signal
import socket
import sys
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager, suppress
from pathlib import Path
from typing import Any

import httpx
import pytest
from websockets.asyncio.client import connect

from cellcal.service.demo.fake_cell import write_cell_file
from cellcal.service.web.app import create_app
from cellcal.service.web.context import ServiceSettings
from tests.service.cell_process_session import PATIENCE_S, RECORD, a_cell
from tests.service.http_limits import NO_IDLE_CONNECTIONS
from tests.service.service_client import another_browser
from tests.soak.service_process import address_of


def free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


@asynccontextmanager
async def serve_cell(
    cell_file: Path, port: int
) -> AsyncIterator[tuple[asyncio.subprocess.Process, httpx.AsyncClient]]:
    process = await asyncio.create_subprocess_exec(
        sys.executable, "-m", "cellcal", "serve", str(cell_file), "--port", str(port),
        stderr=asyncio.subprocess.PIPE, env=os.environ | {"COLUMNS": "200"},
    )  # fmt: skip
    try:
        async with httpx.AsyncClient(
            base_url=f"http://127.0.0.1:{port}", timeout=PATIENCE_S, limits=NO_IDLE_CONNECTIONS
        ) as client:
            assert (await client.get(await address_of(process))).status_code == 303
            await _wait_connected(client)
            yield process, client
    finally:
        with suppress(ProcessLookupError):
            process.send_signal(signal.SIGINT)
        await process.communicate()


async def _wait_connected(client: httpx.AsyncClient) -> dict[str, Any]:
    async with asyncio.timeout(PATIENCE_S):
        while True:
            with suppress(httpx.TransportError):
                session = (await client.get("/api/session")).json()["session"]
                if session and session["connection"]["connected"]:
                    return dict(session)
            await asyncio.sleep(0.05)


async def _poll_until(client: httpx.AsyncClient, true: Any) -> dict[str, Any]:
    async with asyncio.timeout(PATIENCE_S):
        while True:
            session = (await client.get("/api/session")).json()["session"]
            if session and true(session):
                return dict(session)
            await asyncio.sleep(0.05)


async def _press_button(client: httpx.AsyncClient, press: str, order: dict[str, Any]) -> httpx.Response:
    rev = (await client.get("/api/session")).json()["session"]["rev"]
    return await client.post("/api/commands", json={"id": press, "rev": rev, "order": order})


async def test_a_killed_service_comes_back_to_the_same_step_with_every_point(tmp_path: Path) -> None:
    async with a_cell(tmp_path) as (path, _):
        port = free_port()
        async with serve_cell(path, port) as (process, client):
            assert (await _press_button(client, "1", RECORD | {"hold_to_move": False})).status_code == 200
            await _answer_question(client, "wire_is_hooked")
            await _answer_question(client, "accept_plan")
            session_before = await _poll_until(client, lambda session: "capture 1" in session["run"]["found"])
            process.kill()
            await process.wait()
        async with serve_cell(path, port) as (_, client):
            again = await _poll_until(
                client, lambda session: (session["prompt"] or {}).get("key") == "wire_is_hooked"
            )
            assert again["run"]["id"] == session_before["run"]["id"]
            shown = again["run"]["found"]  # before a person has agreed to a condition anew
            assert shown[: len(session_before["run"]["found"])] == session_before["run"]["found"]
            await _answer_question(client, "wire_is_hooked")
            goes_on = await _poll_until(
                client, lambda session: len(session["run"]["found"]) >= len(session_before["run"]["found"])
            )
            assert (
                goes_on["run"]["found"][: len(session_before["run"]["found"])]
                == session_before["run"]["found"]
            )
            await _press_button(client, "stop", {"op": "stop"})


async def test_two_screens_see_the_same_and_a_double_tap_counts_once(tmp_path: Path) -> None:
    async with a_cell(tmp_path) as (path, _), serve_cell(path, free_port()) as (_, client):
        url = str(client.base_url).replace("http", "ws") + "/api/screen"
        cookie_header = {"cookie": "; ".join(f"{name}={token}" for name, token in client.cookies.items())}
        async with (
            connect(url, additional_headers=cookie_header) as left,
            connect(url, additional_headers=cookie_header) as right,
        ):
            rev = (await _receive_until(left, lambda _: True))["rev"]
            tap = {"id": "tap", "rev": rev, "order": RECORD}
            answers = await asyncio.gather(*(client.post("/api/commands", json=tap) for _ in range(2)))
            other = await client.post("/api/commands", json=tap | {"id": "the other tablet"})
            assert [answer.status_code for answer in answers] == [200, 200]
            assert other.status_code == 409
            assert other.json()["session"]["run"]["procedure"] == "mastering_record"
            shown = [
                await _receive_until(screen, lambda session: session["prompt"]) for screen in (left, right)
            ]
            assert shown[0]["prompt"] == shown[1]["prompt"]
        await _press_button(client, "stop", {"op": "stop"})


@pytest.mark.parametrize(
    "body",
    [
        b"{",
        b"[]",
        b'{"id": "1", "rev": NaN, "order": {"op": "pause"}}',
        b'{"id": "1", "rev": 1, "order": {"op": "move", "joints": [0]}}',
        b'{"id": "1", "rev": 1, "order": {"op": "pause"}, "who": "the boss"}',
        json.dumps({"id": "1", "rev": 1, "order": {"op": "answer", "prompt_id": "x" * 9000}}).encode(),
    ],
)
async def test_a_malformed_order_is_refused_on_receipt(tmp_path: Path, body: bytes) -> None:
    async with client_without_cell_process(tmp_path) as client:
        answer = await client.post(
            "/api/commands", content=body, headers={"content-type": "application/json"}
        )
        assert answer.status_code == 422
        assert answer.json()["code"] in ("request", "guard.json")  # no order, or no JSON


async def test_questions_that_have_no_answer_say_so(tmp_path: Path) -> None:
    async with client_without_cell_process(tmp_path) as client:
        missing = await client.get("/api/runs/no-such-run")
        assert missing.status_code == 422
        assert "no-such-run" in missing.json()["message"]
        away = await client.post("/api/commands", json={"id": "1", "rev": 1, "order": {"op": "stop"}})
        assert (away.status_code, away.json()["code"]) == (503, "desk.stop_unconfirmed")


@asynccontextmanager
async def client_without_cell_process(folder: Path) -> AsyncIterator[httpx.AsyncClient]:
    path = write_cell_file(folder, "127.0.0.1", seed=1, time_factor=1.0)
    async with another_browser(create_app(ServiceSettings(path, open_access=True))) as client:
        yield client


async def _answer_question(client: httpx.AsyncClient, key: str) -> None:
    session = await _poll_until(client, lambda session: (session["prompt"] or {}).get("key") == key)
    prompt = session["prompt"]["id"]
    answer = await _press_button(client, f"answer {prompt}", {"op": "answer", "prompt_id": prompt})
    assert answer.status_code == 200, answer.text


async def _receive_until(screen: Any, true: Any) -> dict[str, Any]:
    async with asyncio.timeout(PATIENCE_S):
        while True:
            message = json.loads(await screen.recv())
            if message["kind"] == "session" and true(message["content"]):
                return dict(message["content"])
