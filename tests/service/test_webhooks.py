"""Alarms reach a real receiver that comes and goes: none is lost, none is doubled, and no other address is reached."""

import asyncio
import base64
import json
import os
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO, Any

import pytest

from cellcal.service.cli.app import run_command_line
from cellcal.service.configuration.cell_file import read_cell_file
from cellcal.service.exit_codes import ExitCode
from cellcal.service.export.cell_metrics import CellMetrics
from cellcal.service.export.webhook_outbox import WebhookOutbox
from cellcal.service.export.webhook_sender import WebhookDelivery, read_secret, run_sender
from cellcal.service.export.webhook_target import WebhookError, target_of
from cellcal.service.site.alarms import CellAlarm
from cellcal.service.web.app import create_app
from cellcal.service.web.context import ServiceSettings
from tests.procedures.certified_runs import cell_config
from tests.service.loopback_site import PATIENCE_S, free_port, live_of, session_of, wait_until
from tests.service.webhook_receiver import SECRET, WebhookReceiver, webhook_table


def secret_file(folder: Path) -> Path:
    path = folder / "secret"
    path.write_text("whsec_" + base64.b64encode(SECRET).decode() + "\n")
    path.chmod(0o600)
    return path


def cell_with_webhook(folder: Path, url: str) -> Path:
    config = cell_config(folder)
    secret_file(folder)
    with config.path.open("a", encoding="utf-8") as file:
        file.write(f'\n[webhook]\nurl = "{url}"\nsecret_file = "secret"\n')
    return config.path


Say = Callable[[str, dict[str, Any]], None]


def session_writer(stream: IO[bytes]) -> Say:
    """Return a function that writes a cell process's messages into a pipe."""

    def write_message(kind: str, content: dict[str, Any]) -> None:
        stream.write(json.dumps({"told": kind, "content": content}).encode() + b"\n")
        stream.flush()

    return write_message


@contextmanager
def sender_thread(cell: Path) -> Iterator[Say]:
    """Run the sender of a cell in a thread, as its process does."""
    reading, writing = os.pipe()
    failed: list[BaseException] = []

    def run_sender_loop() -> None:
        try:
            with os.fdopen(reading, "rb") as stream:
                run_sender(read_cell_file(cell), stream, threading.Event())
        except BaseException as error:
            failed.append(error)

    thread = threading.Thread(target=run_sender_loop)
    thread.start()
    try:
        with os.fdopen(writing, "wb") as stream:
            yield session_writer(stream)
    finally:
        thread.join(PATIENCE_S)
        assert not thread.is_alive(), "a sender whose service is gone must end"
        assert not failed, failed


def killed_while_it_waits(cell: Path) -> None:
    """Run the sender as a process, let it take an alarm in while the receiver is away, and kill it."""
    command = [sys.executable, "-m", "cellcal.service.export.webhook_sender", str(cell)]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stderr=subprocess.DEVNULL) as process:
        assert process.stdin is not None
        say = session_writer(process.stdin)
        say("session", session_of("cell-7"))
        say("live", live_of(state="stopped"))
        wait_until(lambda: waiting_count(cell) == 1)
        process.kill()


def waiting_count(cell: Path) -> int:
    with WebhookOutbox(cell.parent / "data") as outbox:
        return outbox.delivery_state().waiting


def last_error(cell: Path) -> str:
    with WebhookOutbox(cell.parent / "data") as outbox:
        return outbox.delivery_state().last_error


def test_down_and_up_again_and_killed_between_nothing_is_lost_and_nothing_doubled(tmp_path: Path) -> None:
    receiver = WebhookReceiver(free_port())
    cell = cell_with_webhook(tmp_path, f"http://127.0.0.1:{receiver.port}/alarms?of=cell-7")
    killed_while_it_waits(cell)
    with sender_thread(cell) as say:  # it finds the alarm up as it was, and does not say it again
        say(
            "session",
            session_of(
                "cell-7", losses=[{"robot": "fanuc", "what": "lost", "detected_by": "x", "words": "lost"}]
            ),
        )
        say("live", live_of(state="stopped"))
        wait_until(lambda: waiting_count(cell) == 2)
        receiver.answers = [500, 503]  # it takes an event in, and its answer gets lost
        with receiver.open_receiver():
            wait_until(lambda: (say("live", live_of(state="stopped")), waiting_count(cell) == 0)[1])
    with receiver.open_receiver(), sender_thread(cell) as say:
        say("session", session_of("cell-7"))
        say("live", live_of())
        wait_until(
            lambda: (say("live", live_of()), waiting_count(cell) == 0 and len(receiver.received_events) == 4)[
                1
            ]
        )
    assert receiver.received_events[:2] == [
        ("alarm.raised", "device.stopped"),
        ("alarm.raised", "position.lost"),
    ]
    assert sorted(receiver.received_events[2:]) == [
        ("alarm.cleared", "device.stopped"),
        ("alarm.cleared", "position.lost"),
    ]
    assert len(receiver.messages) == 6  # the first was sent three times, under one id
    assert receiver.messages[0] == receiver.messages[1] == receiver.messages[2]
    with WebhookOutbox(tmp_path / "data") as outbox:
        assert outbox.active_alarms() == []
        assert outbox.delivery_state().delivered == 4


def test_an_event_that_is_never_understood_does_not_hold_up_the_others(tmp_path: Path) -> None:
    receiver = WebhookReceiver(free_port(), answers=[400] * 5)
    target = target_of(webhook_table(f"http://127.0.0.1:{receiver.port}/", tmp_path))
    with WebhookOutbox(tmp_path) as outbox, receiver.open_receiver():
        outbox.add_changes(
            "cell-7", [(CellAlarm("a", "1", "first"), True), (CellAlarm("b", "2", "second"), True)]
        )
        delivery = WebhookDelivery(outbox, target, SECRET)
        waits = [delivery.deliver_next() for _ in range(6)]
        assert [wait > 0 for wait in waits] == [True] * 4 + [False, False]
        assert waits[:4] == sorted(waits[:4])
        assert receiver.received_events == [("alarm.raised", "b")]
        standing = outbox.delivery_state()
        assert (standing.waiting, standing.delivered, standing.refused) == (0, 1, 1)


@pytest.mark.parametrize("status", [301, 307, 401, 404, 429, 500])
def test_what_is_wrong_with_the_receiver_is_waited_for_and_no_redirect_is_followed(
    tmp_path: Path, status: int
) -> None:
    receiver = WebhookReceiver(free_port(), answers=[status] * 7)
    target = target_of(webhook_table(f"http://127.0.0.1:{receiver.port}/", tmp_path))
    with WebhookOutbox(tmp_path) as outbox, receiver.open_receiver():
        outbox.add_changes("cell-7", [(CellAlarm("a", "1", "first"), True)])
        delivery = WebhookDelivery(outbox, target, SECRET)
        assert all(delivery.deliver_next() > 0 for _ in range(7))
        assert outbox.delivery_state().waiting == 1
        assert str(status) in outbox.delivery_state().last_error
        assert delivery.deliver_next() == 0.0
        assert outbox.delivery_state().last_error == ""
    assert len(receiver.messages) == 8


def test_a_long_outage_keeps_the_newest_and_counts_what_it_had_to_drop(tmp_path: Path) -> None:
    with WebhookOutbox(tmp_path, kept_rows=10) as outbox:
        for k in range(12):
            outbox.add_changes(
                "cell-7", [(CellAlarm("a", str(k), "x"), True), (CellAlarm("a", str(k), "x"), False)]
            )
        standing, oldest = outbox.delivery_state(), outbox.next_event()
        assert (standing.waiting, standing.dropped) == (10, 14)
        assert oldest is not None
        assert json.loads(oldest.body)["data"]["source"] == "7"


def test_a_secret_is_made_once_kept_from_others_and_read_back(tmp_path: Path) -> None:
    path = tmp_path / "new"
    assert run_command_line(["webhooks", "secret", str(path)]) == 0
    secret = read_secret(path)
    assert len(secret) == 32
    assert run_command_line(["webhooks", "secret", str(path)]) == ExitCode.USAGE
    assert read_secret(path) == secret
    path.chmod(0o644)
    with pytest.raises(WebhookError, match="may read"):
        read_secret(path)
    for wrong in ("", "whsec_", "whsec_c2hvcnQ=", "whsec_not base64!"):
        path.write_text(wrong)
        path.chmod(0o600)
        with pytest.raises(WebhookError, match="no secret"):
            read_secret(path)


def test_the_commands(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    receiver = WebhookReceiver(free_port())
    cell = cell_with_webhook(tmp_path, f"http://127.0.0.1:{receiver.port}/")
    assert run_command_line(["webhooks", "test", str(cell)]) == ExitCode.UNREACHABLE
    with sender_thread(cell) as say:
        say("session", session_of("cell-7"))
        say("live", live_of(state="stopped"))
        wait_until(lambda: waiting_count(cell) == 1 and last_error(cell))
        with pytest.raises(WebhookError, match="another process already sends"):
            run_sender(read_cell_file(cell), None, threading.Event())
    capsys.readouterr()
    assert run_command_line(["webhooks", "show", str(cell), "--json"]) == 0
    output = json.loads(capsys.readouterr().out)
    assert (output["waiting"], output["delivered"]) == (1, 0)
    assert "does not take the event" in output["last_error"]
    figures = CellMetrics(read_cell_file(cell)).render_metrics()
    assert "\ncellcal_webhook_waiting 1.0\n" in figures
    with receiver.open_receiver():
        receiver.answers = [204]
        assert run_command_line(["webhooks", "test", str(cell)]) == 0
    assert [output["type"] for _, output in receiver.messages] == ["test"]


async def test_the_service_sends_alarms_by_itself(tmp_path: Path) -> None:
    receiver = WebhookReceiver(free_port())
    cell = cell_with_webhook(tmp_path, f"http://127.0.0.1:{receiver.port}/")
    app = create_app(ServiceSettings(cell))  # of a cell whose devices are not there
    with receiver.open_receiver():
        async with app.router.lifespan_context(app), asyncio.timeout(2 * PATIENCE_S):
            while not receiver.received_events:
                await asyncio.sleep(0.1)
            while "\ncellcal_desk_up 1.0\n" not in (
                figures := await asyncio.to_thread(app.state.meter.render_metrics)
            ):
                await asyncio.sleep(0.1)
    assert receiver.received_events[0] == ("alarm.raised", "cell.unreachable")
    assert '\ncellcal_alarms{code="cell.unreachable"} 1.0\n' in figures
    assert "\ncellcal_cell_up 0.0\n" in figures
