"""A vendor library in a child process may hang, crash or spin: it stays one device's error."""

import asyncio
import contextlib
import os
import signal
import sys
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path

import pytest

from cellcal.drivers.errors import DeviceTimeoutError, RefusedError, UnreachableError, WireProtocolError
from cellcal.drivers.wire.process import ChildProcess
from tests.machine_speed import stretched_s

_MODULE = "tests.wire.naughty_child"
pytestmark = pytest.mark.timeout(stretched_s(60.0))


@asynccontextmanager
async def running_child(module: str = _MODULE) -> AsyncIterator[ChildProcess]:
    child = await ChildProcess.start("arm", module, title="the child", start_s=stretched_s(20.0))
    try:
        yield child
    finally:
        await child.close()
        assert not _process_exists(child.pid)


def _process_exists(pid: int) -> bool:
    with contextlib.suppress(ProcessLookupError, FileNotFoundError):
        os.kill(pid, 0)
        state = Path(f"/proc/{pid}/stat").read_text(encoding="ascii").rpartition(")")[2].split()[0]
        return state != "Z"  # a dead orphan may wait for a lazy init
    return False


async def _wait_until_gone(pid: int) -> None:
    async with asyncio.timeout(stretched_s(10.0)):
        while _process_exists(pid):
            await asyncio.sleep(0.02)


async def test_an_answer_comes_back_as_it_was_given() -> None:
    async with running_child() as child:
        value = {"q": [0.1, -2.5e-17, 3.0], "text": "Umlaute: äöü", "nothing": None}
        assert await child.call_verb("echo", deadline_s=stretched_s(10.0), value=value) == value


async def test_calls_made_together_are_each_answered_with_their_own_value() -> None:
    async with running_child() as child:
        values = await asyncio.gather(
            *(child.call_verb("echo", deadline_s=stretched_s(10.0), value=k) for k in range(200))
        )
        assert values == list(range(200))


async def test_a_no_of_the_library_is_a_refusal_with_its_words_and_the_child_lives_on() -> None:
    async with running_child() as child:
        with pytest.raises(RefusedError, match=r"arm: .*in use") as caught:
            await child.call_verb("refuse", deadline_s=stretched_s(10.0))
        assert caught.value.vendor_text == "One of the input registers is in use"
        assert await child.call_verb("echo", deadline_s=stretched_s(10.0), value=1) == 1


@pytest.mark.parametrize("verb", ["hang", "spin"])
async def test_a_child_that_hangs_is_ended_at_its_deadline(verb: str) -> None:
    async with running_child() as child:
        with pytest.raises(DeviceTimeoutError, match=r"arm: the child hung.*0\.3 s.*try again") as caught:
            async with asyncio.timeout(stretched_s(10.0)):
                await child.call_verb(verb, deadline_s=0.3)
        assert caught.value.device == "arm"
        await _wait_until_gone(child.pid)
        assert not child.is_alive


@pytest.mark.parametrize(("verb", "says"), [("segfault", "signal 11"), ("kill", "signal 9")])
async def test_a_crash_is_an_error_that_names_the_signal(verb: str, says: str) -> None:
    async with running_child() as child:
        with pytest.raises(UnreachableError, match=rf"arm: the child ended: {says}"):
            await child.call_verb(verb, deadline_s=stretched_s(30.0))
        assert not child.is_alive


async def test_a_crash_fails_every_call_under_way_at_once() -> None:
    async with running_child() as child:
        hanging = [
            asyncio.create_task(child.call_verb("hang", deadline_s=stretched_s(30.0))) for _ in range(3)
        ]
        os.kill(child.pid, signal.SIGSEGV)
        results = await asyncio.gather(*hanging, return_exceptions=True)
        assert [type(result) for result in results] == [UnreachableError] * 3


async def test_a_crash_between_requests_is_reported_to_the_next_caller() -> None:
    async with running_child() as child:
        os.kill(child.pid, signal.SIGKILL)
        with pytest.raises(UnreachableError, match=r"the child ended: signal 9 \(Killed\).*new process"):
            await child.call_verb("echo", deadline_s=stretched_s(10.0), value=1)


async def test_a_bug_in_the_child_ends_it_and_its_last_words_are_kept() -> None:
    async with running_child() as child:
        with pytest.raises(UnreachableError, match=r"exit code 1.*KeyError: 'a bug of ours'"):
            await child.call_verb("bug", deadline_s=stretched_s(10.0))


async def test_noise_on_the_channel_is_a_protocol_error_and_the_end_of_the_child() -> None:
    async with running_child() as child:
        with pytest.raises(WireProtocolError, match="4294967295 bytes"):
            await child.call_verb("shout", deadline_s=stretched_s(10.0))
        assert not child.is_alive


async def test_what_a_library_prints_is_no_answer() -> None:
    async with running_child() as child:
        await child.call_verb("print", deadline_s=stretched_s(10.0), text='{"number": 1, "value": "forged"}')
        assert await child.call_verb("echo", deadline_s=stretched_s(10.0), value="real") == "real"


async def test_a_cancelled_call_leaves_the_child_usable_and_its_late_answer_unused() -> None:
    async with running_child() as child:
        call = asyncio.create_task(child.call_verb("echo", deadline_s=stretched_s(10.0), value="late"))
        await asyncio.sleep(0)
        call.cancel()
        with pytest.raises(asyncio.CancelledError):
            await call
        assert await child.call_verb("echo", deadline_s=stretched_s(10.0), value="own") == "own"


async def test_a_module_that_does_not_exist_is_an_error_of_the_device() -> None:
    with pytest.raises(UnreachableError, match=r"arm: the child ended: exit code 1.*No module named"):
        await ChildProcess.start(
            "arm", "drivers.no_such_module", title="the child", start_s=stretched_s(20.0)
        )


async def test_closing_twice_and_closing_a_dead_child_are_harmless() -> None:
    async with running_child() as child:
        child.kill("the test says so")
        await child.close()
        await child.close()
        with pytest.raises(UnreachableError, match="the test says so"):
            await child.call_verb("echo", deadline_s=stretched_s(10.0), value=1)


@pytest.mark.parametrize("verb", ["idle", "hang", "spin"])
async def test_no_child_outlives_a_killed_parent(verb: str) -> None:
    parent = await asyncio.create_subprocess_exec(
        sys.executable, "-m", "tests.wire.orphan_parent", verb, stdout=asyncio.subprocess.PIPE
    )
    assert parent.stdout is not None
    try:
        async with asyncio.timeout(stretched_s(30.0)):
            pid = int(await parent.stdout.readline())
    finally:
        parent.kill()
        await parent.wait()
    await _wait_until_gone(pid)
