"""A process of the cell that lives and does not answer is named, killed and begun anew; a stop meanwhile says so."""

import asyncio
import os
import signal
import subprocess
import sys
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

import numpy as np
import orjson
import pytest

from cellcal.drivers.supervision import SUPERVISOR
from cellcal.service import child_processes
from cellcal.service.cell_process.lines import LineWriter, whole_lines
from cellcal.service.cell_process.messages import LONGEST_LINE
from cellcal.service.configuration.cell_file import read_cell_file
from cellcal.service.exit_codes import ExitCode
from cellcal.service.web import cell_client
from cellcal.service.web.cell_client import TASK, CellProcessClient, StopUnconfirmedError
from cellcal.service.web.liveness import (
    HANGS_AFTER_S,
    TICK_S,
    ProcessState,
    UnansweredTime,
    read_process_state,
)
from tests.service.cell_process_session import PATIENCE_S, RECORD, a_cell

HANGS_S = 1.0
ORDER = {"id": "1", "rev": 0, "who": "Anna", "people": []}
SAYS_A_SESSION = (
    "import sys, json; print(json.dumps({'told': 'session', 'content': {'troubles': []}}), flush=True)\n"
)


async def comes(true: Callable[[], Any]) -> Any:
    async with asyncio.timeout(PATIENCE_S):
        while not (found := true()):
            await asyncio.sleep(0.01)
    return found


@asynccontextmanager
async def linked(link: CellProcessClient) -> AsyncIterator[CellProcessClient]:
    keeping = link.start_process()
    try:
        await comes(lambda: link.session)
        yield link
    finally:
        keeping.cancel()
        await asyncio.wait({keeping})


def words() -> str:
    return " ".join(trouble.message for trouble in SUPERVISOR.list_troubles() if trouble.task == TASK)


def session_of(link: CellProcessClient) -> dict[str, Any]:
    return link.session or {}


async def test_one_that_is_stopped_by_a_signal_is_killed_and_a_stop_meanwhile_is_not_said_to_be_done(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    async with (
        a_cell(tmp_path) as (path, _),
        linked(CellProcessClient(path, lambda *_: None, hangs_after_s=HANGS_S)) as link,
    ):
        under_way = read_cell_file(path).cell.data_dir / "under_way.json"
        await comes(lambda: session_of(link).get("connection", {}).get("connected"))
        started = await link.send_order(ORDER | {"rev": session_of(link)["rev"], "order": RECORD})
        assert started["ok"]
        await comes(lambda: session_of(link).get("prompt") and under_way.exists())
        process = link._process
        assert process is not None
        os.kill(process.pid, signal.SIGSTOP)
        with pytest.raises(StopUnconfirmedError) as refusal:
            await link.send_order(ORDER | {"order": {"op": "stop"}})
        assert "emergency stop" in refusal.value.remedy
        assert "started again" not in refusal.value.message
        await comes(lambda: process.returncode is not None and link._process not in (None, process))
        await comes(lambda: session_of(link).get("connection", {}).get("connected"))
        assert process.returncode == -signal.SIGKILL
        assert "stopped by a signal" in words()
        assert "stopped by a signal" in caplog.text
        assert session_of(link)["run"] is None, "a person wanted it to stop"
        assert not under_way.exists()


@pytest.mark.parametrize("how", ["a stop without an answer", "the end of the service"])
async def test_after_a_hang_no_run_goes_on_by_itself_in_the_next_service_either(
    tmp_path: Path, how: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(child_processes, "_LEAVE_S", 0.5)
    async with a_cell(tmp_path) as (path, _):
        under_way = read_cell_file(path).cell.data_dir / "under_way.json"
        async with linked(CellProcessClient(path, lambda *_: None)) as link:
            await comes(lambda: session_of(link).get("connection", {}).get("connected"))
            await link.send_order(ORDER | {"rev": session_of(link)["rev"], "order": RECORD})
            await comes(lambda: session_of(link).get("prompt") and under_way.exists())
            process = link._process
            assert process is not None
            os.kill(process.pid, signal.SIGSTOP)
            if how == "a stop without an answer":
                with pytest.raises(StopUnconfirmedError):
                    await link.send_order(ORDER | {"order": {"op": "stop"}})
                await comes(lambda: not under_way.exists())
        assert not under_way.exists()
        async with linked(CellProcessClient(path, lambda *_: None)) as link:
            await comes(lambda: session_of(link).get("connection", {}).get("connected"))
            assert session_of(link)["run"] is None


class Played(CellProcessClient):
    """A link whose process is a few lines of Python."""

    def __init__(self, program: str, hangs_after_s: float = HANGS_S) -> None:
        super().__init__(Path("cell.toml"), lambda *_: None, hangs_after_s=hangs_after_s)
        self._program = program

    async def _begin_process(self) -> asyncio.subprocess.Process:
        pipe = asyncio.subprocess.PIPE
        return await asyncio.create_subprocess_exec(
            sys.executable, "-c", self._program, stdin=pipe, stdout=pipe, stderr=pipe
        )


@pytest.mark.parametrize(
    ("hang", "how"),
    [("while True: pass", "without an end"), ("import threading; threading.Event().wait()", "waits")],
)
async def test_one_that_loops_or_waits_for_ever_is_killed_and_begun_anew(hang: str, how: str) -> None:
    async with linked(Played(SAYS_A_SESSION + hang)) as link:
        process = link._process
        await comes(lambda: how in words())
        await comes(lambda: link._process not in (None, process) and link.session)


async def test_a_line_that_is_too_long_is_named_and_the_process_goes_on() -> None:
    program = (
        f"import sys; print('x' * {LONGEST_LINE + 1}); print('broken {{')\n"
        + SAYS_A_SESSION
        + "sys.stdin.read()"
    )
    async with linked(Played(program, hangs_after_s=HANGS_AFTER_S)) as link:
        assert link._process is not None
        assert link._process.returncode is None
        named = [trouble for trouble in SUPERVISOR.list_troubles() if trouble.task == cell_client._LINES]
        assert named
        assert SUPERVISOR.failure_counts()[cell_client._LINES] == 2  # both lines


def test_one_that_gets_no_processor_is_not_blamed_and_one_that_computes_is() -> None:
    starved, computes, cpu_s = UnansweredTime(), UnansweredTime(), 0.0
    for unanswered in (starved, computes):
        unanswered.note_message()
    for _ in range(100_000):
        starved.count(ProcessState("R", 5.0))
    assert not starved.hangs
    ticks = 0
    while not computes.hangs:
        cpu_s, ticks = cpu_s + TICK_S / 10, ticks + 1  # a tenth of a processor
        computes.count(ProcessState("R", cpu_s))
    assert ticks * TICK_S == pytest.approx(10 * HANGS_AFTER_S, rel=0.02)
    computes.note_message()
    assert not computes.hangs


def test_one_that_loads_its_libraries_has_more_time_and_a_disk_too() -> None:
    def ticks_until_it_hangs(does: str, *, answered: bool) -> int:
        unanswered, ticks = UnansweredTime(), 0
        if answered:
            unanswered.note_message()
        while not unanswered.hangs:
            unanswered.count(ProcessState(does, 0.0))
            ticks += 1
        return ticks

    asleep = ticks_until_it_hangs("S", answered=True)
    assert ticks_until_it_hangs("T", answered=True) == asleep
    assert ticks_until_it_hangs("D", answered=True) > 3 * asleep
    assert ticks_until_it_hangs("S", answered=False) > 5 * asleep


@pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="this system tells it elsewhere")
def test_what_a_process_does_is_read_from_the_system() -> None:
    with subprocess.Popen(
        [sys.executable, "-c", "import sys; sys.stdin.read()"], stdin=subprocess.PIPE
    ) as child:
        os.kill(child.pid, signal.SIGSTOP)
        os.waitid(os.P_PID, child.pid, os.WSTOPPED | os.WNOWAIT)
        state = read_process_state(child.pid)
        assert state is not None
        assert state.does == "T"
        os.kill(child.pid, signal.SIGKILL)
    assert read_process_state(child.pid) is None


HUGE = {
    "events": {"run": {"events": ["x" * 400] * 10_000}},
    "text": {"prompt": {"text": "é" * 3 * LONGEST_LINE}},
    "numbers": {"run": {"outcome": {"result": np.zeros(10**6)}}},
    "fields": {"run": {"outcome": {"result": {f"field {n}": n for n in range(10**5)}}}},
    "deep": {"run": [[["x" * 1000] * 20] * 20] * 20},
}


@pytest.mark.parametrize("what", HUGE)
def test_no_line_is_ever_longer_than_the_reader_takes(what: str) -> None:
    writer = LineWriter()
    session = {"rev": 7, "troubles": [], **HUGE[what]}
    for message in (
        {"told": "session", "content": session},
        {"number": 3, "reply": {"ok": False, "session": session}},
    ):
        line = writer.line_of(message)
        assert len(line) <= LONGEST_LINE
        written = orjson.loads(line)
        shown = written["content"] if "told" in written else written["reply"]["session"]
        assert shown["rev"] == 7
        assert "shortened" in shown["troubles"][0]["message"]
    small = {"told": "live", "content": {"devices": []}}
    assert orjson.loads(writer.line_of(small)) == small


async def test_a_reader_tells_of_each_line_that_it_drops() -> None:
    reader, dropped = asyncio.StreamReader(), []
    for part in (b"x" * (LONGEST_LINE + 1) + b"\n", b"a\n", b"y" * (3 * LONGEST_LINE), b"\nb\n"):
        reader.feed_data(part)
    reader.feed_eof()
    assert [line async for line in whole_lines(reader, lambda: dropped.append(1))] == [b"a", b"b"]
    assert len(dropped) == 2


IGNORES_ITS_END = """
import asyncio, sys
from cellcal.service.cell_process import __main__ as process
from cellcal.service.cell_process.cell_controller import CellController

async def wait_for_ever(self):
    while True:
        try:
            await asyncio.Event().wait()
        except asyncio.CancelledError:
            pass

CellController.stay_connected = wait_for_ever
process.LONGEST_END_S = 0.1
process.main(sys.argv[1])
"""


async def test_a_process_whose_devices_do_not_end_leaves_when_its_parent_is_gone(tmp_path: Path) -> None:
    async with a_cell(tmp_path) as (path, _):
        process = await asyncio.create_subprocess_exec(
            sys.executable,
            *("-c", IGNORES_ITS_END, str(path)),
            stdin=subprocess.PIPE,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE,
        )
        async with asyncio.timeout(PATIENCE_S):  # no orders: standard input ends
            _, errors = await process.communicate(b"")
    assert process.returncode == ExitCode.INTERNAL
    assert b"the devices were not released within 0.1 s" in errors
    assert b"wait_for_ever" in errors
