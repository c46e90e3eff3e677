"""The demo with pages: buttons that make things go wrong, hands that help, and an end that leaves nothing."""

import asyncio
import os
import pty
import signal
import socket
import subprocess
import sys
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager, suppress
from pathlib import Path
from typing import Any

import httpx
import pytest

from cellcal.service.cli.demo import is_for_pages
from cellcal.service.demo import faults
from cellcal.service.demo.fake_cell_client import FakeCellClient
from cellcal.service.demo.faults import DEMO_FAULTS
from cellcal.service.demo.web_routes import DemoCellProcessClient, DemoWorld
from cellcal.service.web.app import create_app
from cellcal.service.web.context import ServiceSettings
from tests.machine_speed import stretched_s
from tests.service.cell_process_session import a_cell
from tests.service.http_limits import NO_IDLE_CONNECTIONS

PATIENCE_S = stretched_s(240.0)  # a whole record is taken


@asynccontextmanager
async def a_demo(*arguments: str) -> AsyncIterator[tuple[asyncio.subprocess.Process, httpx.AsyncClient]]:
    process = await asyncio.create_subprocess_exec(
        sys.executable, "-m", "cellcal", "demo", "--no-browser", *arguments,
        stderr=asyncio.subprocess.PIPE, env=os.environ | {"COLUMNS": "200"}, start_new_session=True,
    )  # fmt: skip
    try:
        async with httpx.AsyncClient(
            base_url=await _address_of(process), timeout=PATIENCE_S, limits=NO_IDLE_CONNECTIONS
        ) as client:
            yield process, client
    finally:
        with suppress(ProcessLookupError):
            process.kill()
        await process.communicate()


async def _address_of(process: asyncio.subprocess.Process) -> str:
    assert process.stderr is not None
    async with asyncio.timeout(PATIENCE_S):
        while b"fake cell at " not in (line := await process.stderr.readline()):
            assert line
    return line.decode().partition("fake cell at ")[2].strip()


async def poll_until(client: httpx.AsyncClient, path: str, true: Any) -> dict[str, Any]:
    async with asyncio.timeout(PATIENCE_S):
        while True:
            answer: dict[str, Any] = (await client.get(path)).json()
            if true(answer):
                return answer
            await asyncio.sleep(0.3)


def _descendants_of(pid: int) -> set[int]:
    """Return the processes that a process started, and those that they started."""
    pairs = []
    for stat in Path("/proc").glob("[0-9]*/stat"):
        with suppress(OSError):  # it has ended meanwhile
            pairs.append((int(stat.parent.name), int(stat.read_text().rpartition(")")[2].split()[1])))
    found, new = set[int](), {pid}
    while new:
        new = {child for child, parent in pairs if parent in new} - found
        found |= new
    return found


async def _are_gone(pids: set[int]) -> None:
    async with asyncio.timeout(PATIENCE_S):
        while any(_is_alive(pid) for pid in pids):
            await asyncio.sleep(0.05)


def _is_alive(pid: int) -> bool:
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False


async def test_a_loss_pressed_is_noticed_and_offered_for_recovery_and_ctrl_c_ends_all() -> None:
    async with a_demo("--port", "0", "--time-factor", "600") as (process, client):
        shown = await poll_until(client, "/api/demo", lambda session_answer: not session_answer["preparing"])
        assert shown["tcp_error_m"]["max"] < 1e-9
        assert {each["name"] for each in shown["faults"]} == {each.name for each in DEMO_FAULTS}
        assert (await client.get("/api/session")).json()["demo"] is True
        runs = (await client.get("/api/runs")).json()
        assert [(run["procedure"], run["state"]) for run in runs] == [("mastering_record", "passed")]
        pressed = (await client.post("/api/demo/faults", json={"name": "battery"})).json()
        assert [each["name"] for each in pressed["pressed"]] == ["battery", "hand_wire_home"]
        session_answer = await poll_until(
            client, "/api/session", lambda session_answer: session_answer["session"]["losses"]
        )
        loss = session_answer["session"]["losses"][0]
        assert (loss["mode"], loss["procedure"]) == ("M1", "mastering_recovery")
        assert "[watch] recover_alone is not set" in loss["reasons"]  # it is offered: a person presses
        assert (await client.get("/api/demo")).json()["tcp_error_m"]["max"] > 1e-3
        unknown = await client.post("/api/demo/faults", json={"name": "earthquake"})
        assert unknown.status_code == 422
        assert "battery" in unknown.json()["remedy"]
        children = _descendants_of(process.pid)
        assert len(children) >= 2  # the cell process and the fakes
        process.send_signal(signal.SIGINT)
        assert await process.wait() == 0
        await _are_gone(children)


async def test_two_demos_at_once_and_a_killed_one_leaves_no_orphan() -> None:
    async with a_demo("--port", "0") as (one, first), a_demo("--port", "0") as (_, second):
        for client in (first, second):
            connected = lambda value: value["session"] and value["session"]["connection"]["connected"]  # noqa: E731
            await poll_until(client, "/api/session", connected)
        children = _descendants_of(one.pid)
        assert len(children) >= 2
        one.kill()
        await one.wait()
        await _are_gone(children)
        assert (await second.get("/api/demo")).status_code == 200


async def test_the_simulated_technician_does_exactly_what_a_yes_confirms(tmp_path: Path) -> None:
    async with a_cell(tmp_path) as (path, fake_client):
        link = DemoCellProcessClient(path, lambda _kind, _content: None, DemoWorld(fake_client))
        await fake_client.inject_fault("battery_loss")
        prompt = {"id": "r:1", "kind": "confirm", "key": "new_battery", "text": "Exchange the batteries."}
        link.session = {"rev": 5, "prompt": prompt}
        yes = {"op": "answer", "prompt_id": "r:1", "value": "yes"}
        wrong: list[dict[str, Any]] = [
            {"rev": 4, "order": yes},
            {"rev": 5, "order": yes | {"prompt_id": "r:2"}},
            {"rev": 5, "order": {"op": "decline", "prompt_id": "r:1"}},
        ]
        for command in wrong:
            await _without_cell_process(link, command)
        assert not link.world.pressed
        await _without_cell_process(link, {"rev": 5, "order": yes})
        assert [each.name for each in link.world.pressed] == ["hand_new_battery"]


async def _without_cell_process(link: DemoCellProcessClient, command: dict[str, Any]) -> None:
    with pytest.raises(Exception, match="does not answer"):
        await link.send_order(command)


async def test_every_fault_happens_and_clearing_takes_back_all_but_the_lost_zero(tmp_path: Path) -> None:
    async with a_cell(tmp_path) as (_, fake_client):
        before = await _read_state(fake_client)
        for fault in DEMO_FAULTS:
            if fault.kind != "loss":
                await faults.trigger_fault(fake_client, fault.name)
        assert await _read_state(fake_client) != before
        await faults.clear_faults(fake_client)
        assert await _read_state(fake_client) == before
        await faults.trigger_fault(fake_client, "battery")
        await faults.clear_faults(fake_client)
        assert (await fake_client.send_command("tcp_error", robot="fanuc"))["max"] > 1e-3


async def _read_state(fake_client: FakeCellClient) -> dict[str, Any]:
    truth = await fake_client.read_truth()
    fanuc, ur, wire = truth["robots"]["fanuc"], truth["robots"]["ur"], truth["gauges"]["wire"]
    return {
        "fanuc": {key: fanuc[key] for key in ("active", "mode", "emergency_stop", "alarms", "mastered")},
        "ur": {key: ur[key] for key in ("tcp", "safety_mode", "robot_mode", "remote")},
        "wire": {key: wire[key] for key in ("snapped", "slipped_m", "powered", "error_register")},
    }


async def test_a_real_cells_service_has_no_such_buttons(tmp_path: Path) -> None:
    async with a_cell(tmp_path) as (path, _):
        paths = create_app(ServiceSettings(path)).openapi()["paths"]
    assert not [name for name in paths if "demo" in name]


async def test_the_pace_of_the_world_changes_without_a_leap(tmp_path: Path) -> None:
    async with a_cell(tmp_path, time_factor=1000.0) as (_, fake_client):
        before_s = (await fake_client.read_truth())["time_s"]
        assert (await fake_client.send_command("pace", time_factor=1.0))["time_factor"] == 1.0
        after_s = (await fake_client.read_truth())["time_s"]
        assert before_s <= after_s
        await asyncio.sleep(0.05)
        assert (await fake_client.read_truth())[
            "time_s"
        ] - after_s < 20.0  # 1000 times as fast it would be 50 and more
        with pytest.raises(Exception, match="refused"):
            await fake_client.send_command("pace", time_factor=-1.0)


def test_pages_are_for_a_terminal_where_no_ci_runs(monkeypatch: pytest.MonkeyPatch) -> None:
    master, slave = pty.openpty()
    with open(master, "rb"), open(slave, "w") as terminal, open(os.devnull, "w") as no_terminal:  # noqa: PTH123
        monkeypatch.delenv("CI", raising=False)
        assert is_for_pages(None, terminal)
        assert not is_for_pages(None, no_terminal)
        assert is_for_pages(8471, no_terminal)
        monkeypatch.setenv("CI", "true")
        assert not is_for_pages(None, terminal)


def test_a_taken_port_that_was_asked_for_is_refused(tmp_path: Path) -> None:
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = str(taken.getsockname()[1])
        ended = subprocess.run(
            [sys.executable, "-m", "cellcal", "demo", "--port", port], capture_output=True, text=True,
            timeout=stretched_s(280.0), check=False, cwd=tmp_path,
        )  # fmt: skip
    assert ended.returncode == 2
    assert port in ended.stderr
