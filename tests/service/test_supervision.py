"""What raises in a long-lived task is named, and the task is back: every one, as found in the source."""

import asyncio
import contextlib
import json
import logging
import os
import re
import signal
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from fastapi import FastAPI

from cellcal.drivers import supervision
from cellcal.drivers.supervision import (
    LONGEST_PAUSE_S,
    SUPERVISOR,
    Supervisor,
    start_link_task,
    start_task,
    start_thread,
)
from cellcal.fake_devices.cell import FakeCell
from cellcal.fake_devices.keep_running import keep_running
from cellcal.service.configuration.cell_file import read_cell_file
from cellcal.service.demo.fake_cell import free_address, write_cell_file
from cellcal.service.export.webhook_sender import run_sender
from cellcal.service.site.forwarding_process import ForwardingProcess
from cellcal.service.site.listener import FleetListener
from cellcal.service.watching.follow import RobotListener as Hearer
from cellcal.service.watching.follow import RobotWatches, follow_robots
from cellcal.service.web.cell_client import TASK as CELL_PROCESS
from cellcal.service.web.cell_client import CellProcessClient
from cellcal.service.web.fleet import create_fleet_app
from tests.service.browser_pages import serve_app
from tests.service.cell_process_session import a_cell, open_session
from tests.service.long_lived_tasks import (
    is_back,
    raise_in,
    raise_in_task,
    running_like,
    shown_task_names,
    started_tasks,
    supervised_names,
)
from tests.service.loopback_site import PATIENCE_S, LoopbackSite, free_port, wait_until
from tests.service.test_fleet import PlayedFleet
from tests.service.test_webhooks import cell_with_webhook
from tests.service.webhook_receiver import WebhookReceiver

# What goes on beside its caller without supervision, and why that may be: it ends by itself and is awaited, or the
# one who began it looks at its end. Anything else belongs into drivers/supervision.py.
SHORT_LIVED = {
    ("service/cell_process/__main__.py", "_answer_lines"): "one order each: it answers whatever it raises",
    ("service/cell_process/order_replies.py", "reply_once"): "one order, awaited by its caller",
    ("service/cell_process/run_control.py", "_launch_run"): "the run: what it raises is its outcome",
    ("service/cell_process/hold_to_move.py", "_move_while_held"): "one move, awaited",
    ("service/cell_process/live_values.py", "poll_once"): "one look at an instrument; its end is looked at",
    ("service/watching/follow.py", "follow_robots"): "supervised inside",
    ("service/web/cell_client.py", "_begin_process"): "supervised by start",
    ("service/web/cell_client.py", "_break_off"): "one note on the disk; its failure is named",
    ("service/web/cell_client.py", "_run_once"): "the cell's process and its last words; supervised by start",
    ("service/site/forwarding_process.py", "_run_once"): "a process of the outlets; supervised by start",
    ("service/web/fleet.py", "send_live"): "one page, awaited",
    ("service/web/websocket_hub.py", "serve_screen"): "one screen, awaited",
    ("service/web/server.py", "_accept_connections"): "one connection's beginning; its end is looked at",
    (
        "service/review/compute_client.py",
        "_start_worker",
    ): "the solver: one that ends is begun anew with the next question",
    ("service/engineering/page_jobs.py", "_start_job"): "one job: its end is its state",
    ("service/engineering/identification/jobs/work.py", "identify_upload"): "ends a job with the service",
    ("service/engineering/job_processes.py", "run_job_process"): "the process of one job, awaited",
    ("service/engineering/programs/jobs/work.py", "main"): "ends the job's process with the service's",
    ("service/engineering/forked_processes.py", "prepare_process"): "ends a process with the command's",
    (
        "service/engineering/identification/forked_parts.py",
        "share_parts",
    ): "processes of one command, awaited",
    ("service/web/waiting_clients.py", "answer_while_awaited"): "one answer, awaited or cancelled",
    ("service/engineering/programs/worker_processes.py", "run_in_processes"): "processes of one command",
    ("service/engineering/programs/files.py", "write_all"): "threads of one command",
    ("service/demo/fake_cell.py", "running_fakes"): "the fakes' process: its end is told by every device",
    ("service/demo/recovery_demo.py", "_lose_and_notice"): "a task group: what it raises ends the demo",
    ("service/demo/demo_server.py", "_serve_demo"): "loading, awaited",
    ("drivers/wire/worker.py", "__init__"): "hands whatever a call raises to its caller",
    ("drivers/wire/process.py", "_spawn_child"): "a device's process: its end is told to every caller",
    ("drivers/wire/modbus.py", "_first_result"): "one request, awaited",
    ("drivers/wire/cancellation.py", "run_to_end"): "one stop, awaited",
    ("drivers/wire/cancellation.py", "run_in_thread_to_end"): "one call, awaited",
    ("service/engineering/controller_files/nightly_watch.py", "watch_controllers"): "threads of one command",
    ("procedures/robot_stop.py", "finish_cleanup"): "one clean-up, awaited",
    ("service/export/webhook_target.py", "deliver_event"): "cuts one delivery off, and is cancelled with it",
    ("fake_devices/universal_robots/ports.py", "open"): "a port of a fake",
    (
        "fake_devices/listening_port.py",
        "_accept_client",
    ): "one client of a fake: its failure is told when it ends",
    ("procedures/motion/guarded_move.py", "*"): "one move, awaited",
    ("procedures/questions.py", "ask_while_watching"): "one instruction, awaited",
    ("fake_devices/laser_tracker/controller.py", "*"): "one command of a fake",
    ("fake_devices/laser_tracker/server.py", "*"): "one answer of a fake",
}


def test_whatever_goes_on_beside_its_caller_is_supervised_or_awaited() -> None:
    unknown = sorted(
        (file, function, call)
        for file, function, call in started_tasks()
        if not {(file, function), (file, "*")} & SHORT_LIVED.keys()
    )
    assert not unknown, "begin it with drivers/supervision.py, or say in SHORT_LIVED why it need not be"


def test_every_supervised_task_is_made_to_raise_here() -> None:
    assert supervised_names() - TRIED == set(), "add it to a test below, and to TRIED"


@pytest.mark.parametrize("locale", ["de", "es", "zh"])
def test_names_of_tasks_are_shown_in_the_language_of_the_page(locale: str) -> None:
    words = json.loads(
        (Path(__file__).parents[2] / f"web/src/locales/refusals/{locale}.json").read_text(encoding="utf-8")
    )
    translated = {re.sub(r"\{\w+\}", "{}", key) for key in words}
    names = shown_task_names()
    assert len(names) > 30
    assert names - translated - {"{}"} == set()


async def failed_and_back(name: str, healthy: Callable[[], object] = lambda: True) -> None:
    """Make a task raise, and wait until it was named and does its work again."""
    before = SUPERVISOR.failure_counts().get(name, 0)
    async with asyncio.timeout(PATIENCE_S):
        while not raise_in(name):
            await asyncio.sleep(0.01)
        while not is_back(name, before, healthy):
            await asyncio.sleep(0.01)
    named = {trouble.task: trouble for trouble in SUPERVISOR.list_troubles()}
    assert "Injected" in named[name].message
    assert named[name].remedy


async def test_the_tasks_of_the_cells_process_are_named_on_the_screen_and_come_back(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    async with open_session(tmp_path) as person:

        def connected() -> Any:
            return person.session["connection"]["connected"]

        for name in ("devices of the cell", "news of other robots", *running_like("watch of {}")):
            await failed_and_back(name, connected)
            assert name in [trouble["task"] for trouble in person.session["troubles"]]
            assert f"{name} failed" in caplog.text
        for name in running_like("CAN receiver of {}"):
            await poll_until(lambda: raise_in(name))  # noqa: B023
            await person.wait_until(lambda session: SUPERVISOR.failure_counts().get(name))  # noqa: B023
            await person.wait_until(lambda _: SUPERVISOR.holder_of(name) is not None and connected())  # noqa: B023


async def test_a_disk_that_is_full_while_connecting_is_reported_and_tried_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Real ``OSError`` where the lease is written: its folder is a file until the fault is over."""
    async with a_cell(tmp_path) as (path, fake_client):
        config = read_cell_file(path)
        config.cell.data_dir.mkdir(parents=True, exist_ok=True)
        blocked = config.cell.data_dir / "leases"
        blocked.write_text("no folder")
        from tests.service.cell_process_session import ScreenSession

        person = ScreenSession(path, fake_client)
        attending = asyncio.create_task(person.cell_process.stay_connected())
        try:
            await person.wait_until(
                lambda session: session["connection"]["message"] not in ("", "connecting")
            )
            assert not person.session["connection"]["connected"]
            blocked.unlink()
            await person.wait_until(lambda session: session["connection"]["connected"])
        finally:
            attending.cancel()
            with contextlib.suppress(asyncio.CancelledError):
                await attending


async def test_the_cells_process_is_named_when_it_dies_and_begun_again(tmp_path: Path) -> None:
    async with a_cell(tmp_path) as (path, _):
        messages: list[str] = []
        link = CellProcessClient(path, lambda kind, _content: messages.append(kind))
        keeping = link.start_process()
        try:
            await poll_until(lambda: link.session)
            for deed in ("killed", "babbles"):
                before, process = SUPERVISOR.failure_counts().get(CELL_PROCESS, 0), link._process
                if deed == "killed":
                    assert process is not None
                    os.kill(process.pid, signal.SIGKILL)
                else:
                    await poll_until(lambda: raise_in_task(keeping))
                await poll_until(lambda: is_back(CELL_PROCESS, before, lambda: link.session))  # noqa: B023
                assert "gone" in messages
            words = [
                trouble.message for trouble in SUPERVISOR.list_troubles() if trouble.task == CELL_PROCESS
            ]
            assert words
        finally:
            keeping.cancel()
            await asyncio.wait({keeping})


async def test_a_process_of_the_outlets_is_named_with_its_last_words_and_begun_again(tmp_path: Path) -> None:
    path = write_cell_file(
        tmp_path, "127.0.0.1", seed=1, time_factor=1.0
    )  # no [webhook]: the sender cannot begin
    feed = ForwardingProcess("cellcal.service.export.webhook_sender", path)
    feed.on_event("session", {"rev": 1})
    tasks = feed.start_tasks()
    try:
        await poll_until(lambda: SUPERVISOR.failure_counts().get(feed.title, 0) > 1)  # and again
        words = next(trouble.message for trouble in SUPERVISOR.list_troubles() if trouble.task == feed.title)
        assert "no [webhook] table" in words
        await failed_and_back(f"words for {feed.title}")
    finally:
        for task in tasks:
            task.cancel()
        await asyncio.wait(tasks)


async def test_the_threads_of_the_sender_of_alarms_come_back(tmp_path: Path) -> None:
    with WebhookReceiver(free_port()).open_receiver() as receiver:
        config = read_cell_file(cell_with_webhook(tmp_path, f"http://127.0.0.1:{receiver.port}/"))
        reading, writing = os.pipe()
        leave = threading.Event()
        stream = os.fdopen(reading, "rb")
        sending = threading.Thread(target=run_sender, args=(config, stream, leave))
        sending.start()
        try:
            await failed_and_back("webhook: delivery")
            before = SUPERVISOR.failure_counts().get("cell process tap", 0)
            await poll_until(lambda: raise_in("cell process tap"))
            while not is_back(
                "cell process tap", before, lambda: True
            ):  # it waits for a line, and raises at the next
                os.write(writing, json.dumps({"told": "gone", "content": {}}).encode() + b"\n")
                await asyncio.sleep(0.05)
        finally:
            leave.set()
            os.close(writing)
            sending.join(PATIENCE_S)
            stream.close()


def test_the_monitors_threads_come_back(tmp_path: Path) -> None:
    site = LoopbackSite(tmp_path, "cell-07")
    with (
        site.start_router(),
        FleetListener(site.monitor_folder, tmp_path / "s.sqlite", patience_s=PATIENCE_S) as listener,
    ):
        for name in ("monitor: receiving", "monitor: hearing", "monitor: asking"):
            before = SUPERVISOR.failure_counts().get(name, 0)
            wait_until(lambda: raise_in(name))  # noqa: B023
            wait_until(lambda: is_back(name, before, lambda: True))  # noqa: B023
        assert any("cannot go on" in flaw["what"] for flaw in listener.fleet.flaws)


NUMBERS = [
    {"outbox": {"first": 1, "last": 10**30}},
    {"outbox": {"first": 1, "last": 2**63}},
    {
        "run": {
            "procedure": "p",
            "state": "s",
            "step": "x",
            "index": 10**30,
            "expected": 2**64,
            "verdict": None,
        }
    },
    {
        "drift": [
            {"run_id": "r", "ended_utc": "x", "change_rms_m": 1e300, "change_max_m": None, "word": "pass"}
        ]
    },
    {"due": [{"what": 5, "due": []}]},
]


@pytest.mark.parametrize("odd", NUMBERS)
async def test_one_cell_that_says_what_cannot_be_does_not_blind_the_view_of_the_others(
    tmp_path: Path, odd: dict[str, Any]
) -> None:
    hall = PlayedFleet(tmp_path, 3)
    app = create_fleet_app(hall, tmp_path)
    async with app.router.lifespan_context(app):
        hall.publish_state(hall.names[0])
        hall.publish_state(hall.names[0], **odd)
        hall.publish_state(hall.names[1], asks={"key": "k", "step": "now"})
        app_context = app.state.context
        await poll_until(lambda: b'"step":"now"' in app_context.rows.get(hall.names[1], b""))
        assert hall.names[0] in {flaw["cell"] for flaw in hall.fleet.flaws}
        await failed_and_back("monitor: view of the cells")


async def test_the_web_servers_tasks_come_back() -> None:
    async with serve_app(FastAPI()) as address:
        host, port = address.removeprefix("http://").split(":")

        async def answers() -> None:
            reader, writer = await asyncio.open_connection(host, int(port))
            writer.write(b"GET / HTTP/1.1\r\nhost: localhost\r\nconnection: close\r\n\r\n")
            assert (await reader.read()).startswith(b"HTTP/1.1 404")
            writer.close()

        for name in ("web server: accepting", "web server: idle connections"):
            await failed_and_back(name)
            await answers()


async def test_the_watch_command_goes_on_with_each_robot(tmp_path: Path) -> None:
    async with a_cell(tmp_path) as (path, _):
        lines: list[str] = []

        async def on_loss(_: object) -> None:
            return None

        following = asyncio.create_task(
            follow_robots(RobotWatches(read_cell_file(path), on_loss), Hearer(lines.append))
        )
        try:
            await poll_until(lambda: len(lines) >= 2)
            for name in running_like("watch of {}"):
                await failed_and_back(name)
        finally:
            following.cancel()
            with contextlib.suppress(asyncio.CancelledError):
                await following


async def test_the_fakes_go_on_when_their_time_fails(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    with free_address() as address:
        path = write_cell_file(tmp_path, address, seed=3, time_factor=50.0)
    async with FakeCell.from_file(path):
        clocks = [task for task in asyncio.all_tasks() if task.get_name().startswith("time of")]
        assert len(clocks) >= 3
        for task in clocks:
            await poll_until(lambda: raise_in_task(task))  # noqa: B023
            await poll_until(lambda: f"{task.get_name()} failed" in caplog.text)  # noqa: B023
            await poll_until(lambda: getattr(task, "_fut_waiter", None) is not None)  # noqa: B023
            assert not task.done()


async def test_a_task_that_fails_at_every_start_is_shown_as_such_and_one_that_ends_is_forgotten() -> None:
    register = Supervisor()
    changes: list[int] = []
    register.add_listener(lambda: changes.append(1))

    async def fail_at_start() -> None:
        raise InjectedHereError

    task = start_task("always", fail_at_start, register)
    await poll_until(lambda: register.failure_counts().get("always", 0) >= 3)
    trouble = register.list_troubles()[0]
    assert (trouble.task, trouble.failures >= 3) == ("always", True)
    assert changes
    task.cancel()
    await asyncio.wait({task})
    assert (register.task_names(), register.list_troubles()) == ([], [])
    assert register.note_failure("always", InjectedHereError()) <= LONGEST_PAUSE_S


async def test_a_link_that_failed_is_shown_for_a_while_and_then_reported_as_gone(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(supervision, "SHOWN_S", 0.2)
    register, shown_tasks = Supervisor(), list[list[str]]()
    unlisten = register.add_listener(
        lambda: shown_tasks.append([trouble.task for trouble in register.list_troubles()])
    )
    register.note_start("CAN receiver of x")
    register.broke("CAN receiver of x", InjectedHereError())
    assert register.holder_of("CAN receiver of x") is None
    await poll_until(lambda: shown_tasks and shown_tasks[0] == ["CAN receiver of x"])
    await poll_until(lambda: shown_tasks[-1] == [])  # without a request: listeners are notified
    assert register.task_names() == []
    register.note_start("CAN receiver of x")
    register.broke("CAN receiver of x", InjectedHereError())
    register.note_start("CAN receiver of x")  # connected anew
    assert [trouble.running for trouble in register.list_troubles()] == [True]
    await poll_until(lambda: shown_tasks[-1] == [])
    assert register.task_names() == ["CAN receiver of x"]
    assert register.holder_of("CAN receiver of x") is not None
    unlisten()


@pytest.mark.parametrize("begin", [start_task, keep_running])
async def test_what_raises_while_it_leaves_is_not_begun_again(
    begin: Callable[..., asyncio.Task[None]],
) -> None:
    begun_at: list[asyncio.Event] = []

    async def raise_on_leaving() -> None:
        begun_at.append(asyncio.Event())
        try:
            begun_at[-1].set()
            await asyncio.Event().wait()
        finally:
            raise BrokenPipeError

    task = begin("leaves", raise_on_leaving)
    await poll_until(lambda: begun_at and begun_at[0].is_set())
    task.cancel()
    async with asyncio.timeout(PATIENCE_S):
        await asyncio.wait({task})
    assert len(begun_at) == 1


async def test_a_task_that_raises_is_reported_to_its_link() -> None:
    errors: list[Exception] = []

    async def fail_task() -> None:
        raise InjectedHereError

    await start_link_task("answers of x", fail_task, errors.append)
    assert isinstance(errors[0], InjectedHereError)
    assert SUPERVISOR.failure_counts()["answers of x"] >= 1


def test_a_thread_is_begun_anew_until_it_may_leave(caplog: pytest.LogCaptureFixture) -> None:
    register, leave, count = Supervisor(), threading.Event(), iter(range(100))

    def raise_in_thread() -> None:
        if next(count) < 2:
            raise InjectedHereError
        leave.wait(PATIENCE_S)

    with caplog.at_level(logging.ERROR):
        thread = start_thread("worker", raise_in_thread, leave, register)
        wait_until(lambda: register.failure_counts().get("worker") == 2 and register.holder_of("worker"))
    leave.set()
    thread.join(PATIENCE_S)
    assert "worker failed: InjectedHere" in caplog.text


class InjectedHereError(RuntimeError):
    """What a test raises by itself."""


async def poll_until(true: Callable[[], object]) -> None:
    async with asyncio.timeout(PATIENCE_S):
        while not true():
            await asyncio.sleep(0.01)


TRIED = {
    "devices of the cell", "news of other robots", "watch of {}", "CAN receiver of {}", "process of the cell",
    "words for {}", "{}", "webhook: delivery", "cell process tap", "monitor: receiving", "monitor: hearing", "monitor: asking",
    "monitor: view of the cells", "web server: accepting", "web server: idle connections", "time of {}",
    "time of the control box", "motions of {}", "ports of {}", "programs of {}", "port of {}",
    # in test_long_lived_processes
    "router of the site",
    # the mechanism of a link's task alone, in test_a_links_task_that_raises_is_told_to_the_link
    "answers of {}", "prints of {}", "control of {}",
    # supervised with the same call as all others; played by tests of the demo
    "opening of the demo", "address of the demo",
}  # fmt: skip
