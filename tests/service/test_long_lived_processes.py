"""The router, the solver and the demo's tasks: what fails in them is named, and they are back."""

import asyncio
import contextlib
import os
import signal
import threading
from collections.abc import AsyncIterator, Callable, Iterator
from contextlib import asynccontextmanager, suppress
from functools import partial
from pathlib import Path
from typing import Any

import pytest
import zenoh

from cellcal.drivers.supervision import SUPERVISOR
from cellcal.service.demo.demo_server import HOST, DemoOptions, _serve_demo
from cellcal.service.demo.fake_cell import write_cell_file
from cellcal.service.review.compute_client import TASK as COMPUTES
from cellcal.service.review.compute_client import ComputeClient, ComputeError, SolverEndedError
from cellcal.service.site import router
from cellcal.service.site.link_files import close_session
from cellcal.service.site.router import TASK as ROUTER
from cellcal.service.site.router import host_router
from cellcal.service.web.server import bind_address
from tests.service.long_lived_tasks import InjectedError, is_back, raise_in
from tests.service.loopback_site import PATIENCE_S, LoopbackSite, wait_until
from tests.service.test_supervision import poll_until


def reached(site: LoopbackSite) -> bool:
    """Whether a cell of the site gets a session at its router."""
    try:
        close_session(zenoh.open(site.zenoh_of("cell-07")))
    except zenoh.ZError:
        return False
    return True


@contextlib.contextmanager
def hosting(site: LoopbackSite) -> Iterator[list[str]]:
    """Host the router in a thread of this process."""
    leave, output = threading.Event(), list[str]()
    thread = threading.Thread(target=host_router, args=(site.folder / "router", leave, output.append))
    thread.start()
    try:
        wait_until(lambda: output)
        yield output
    finally:
        leave.set()
        thread.join(PATIENCE_S)
        assert not thread.is_alive()


def test_the_router_goes_on_with_its_rules_when_its_work_raises(tmp_path: Path) -> None:
    site = LoopbackSite(tmp_path, "cell-07")
    with hosting(site) as output:
        before = SUPERVISOR.failure_counts().get(ROUTER, 0)
        wait_until(lambda: raise_in(ROUTER))
        wait_until(lambda: is_back(ROUTER, before, lambda: True))
        assert reached(site)
        site.add_cells("cell-08")  # and it takes in what is enrolled afterwards
        wait_until(lambda: "The rules have changed." in output[-1] and "2 cells" in output[-1])
        wait_until(lambda: reached(site))
    assert ROUTER not in SUPERVISOR.task_names()


def test_a_router_that_cannot_listen_again_is_named_and_tries_until_it_can(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    site, opens = LoopbackSite(tmp_path, "cell-07"), router._open_session
    refusing = threading.Event()

    def opened(*positional: Any, **named: Any) -> zenoh.Session:
        if refusing.is_set():
            raise OSError(28, "No space left on device")
        return opens(*positional, **named)

    monkeypatch.setattr(router, "_open_session", opened)
    with hosting(site) as output:
        before = SUPERVISOR.failure_counts().get(ROUTER, 0)
        refusing.set()
        site.add_cells("cell-08")
        wait_until(lambda: SUPERVISOR.failure_counts().get(ROUTER, 0) > before + 1)  # and again
        assert "No space left" in next(
            one.message for one in SUPERVISOR.list_troubles() if one.task == ROUTER
        )
        refusing.clear()
        wait_until(lambda: len(output) > 1)
        wait_until(lambda: reached(site))


async def test_a_solver_that_dies_says_how_and_the_next_question_has_an_answer(tmp_path: Path) -> None:
    path = write_cell_file(tmp_path, HOST, seed=1, time_factor=1.0)
    solver = ComputeClient(path)
    try:
        with pytest.raises(ComputeError) as refused:
            await solver.ask_worker("review", run_id="none", config={})  # it lives
        assert not isinstance(refused.value, SolverEndedError)
        for number in (signal.SIGKILL, signal.SIGSEGV):
            before = SUPERVISOR.failure_counts().get(COMPUTES, 0)
            process = solver._process
            assert process is not None
            os.kill(process.pid, signal.SIGSTOP)
            asking = asyncio.create_task(solver.ask_worker("review", run_id="none", config={}))
            await poll_until(solver._turn.locked)
            os.kill(process.pid, number)
            with suppress(ProcessLookupError):  # SIGKILL ends a stopped process, too
                os.kill(process.pid, signal.SIGCONT)
            with pytest.raises(SolverEndedError, match=f"signal {int(number)}"):
                await asking
            assert SUPERVISOR.failure_counts()[COMPUTES] == before + 1
            with pytest.raises(ComputeError) as refused:
                await solver.ask_worker("review", run_id="none", config={})  # another one answers
            assert not isinstance(refused.value, SolverEndedError)
    finally:
        await solver.stop_worker()


@asynccontextmanager
async def the_demo(folder: Path, say: Callable[[str], None]) -> AsyncIterator[None]:
    staging = DemoOptions(seed=3, time_factor=50.0, port=None, browser=False, say=say)
    with bind_address(HOST, 0) as listening:
        serving = asyncio.create_task(_serve_demo(folder, staging, listening))
        try:
            yield
        finally:
            serving.cancel()
            await asyncio.wait({serving})


async def test_the_demos_tasks_are_named_and_come_back(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    output: list[str] = []

    def record_line(line: str) -> None:
        output.append(line)
        if len(output) == 1:
            raise InjectedError("a terminal that is gone")

    async with the_demo(tmp_path, record_line):
        await poll_until(lambda: "address of the demo failed: InjectedError" in caplog.text)
        await poll_until(lambda: len(output) > 2)
        assert output[0] == output[1]  # told again
        await poll_until(partial(raise_in, "opening of the demo"))
        await poll_until(lambda: "opening of the demo failed: InjectedError" in caplog.text)
        await poll_until(lambda: SUPERVISOR.holder_of("opening of the demo"))
