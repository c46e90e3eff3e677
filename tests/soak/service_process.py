"""`cellcal serve` as a process, and one browser at it: what it is shown, what it presses."""

import asyncio
import itertools
import json
import os
import signal
import socket
import sys
from collections.abc import AsyncIterator, Callable, Iterator
from contextlib import asynccontextmanager, suppress
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import httpx
from websockets.asyncio.client import connect

from tests.service.http_limits import NO_IDLE_CONNECTIONS
from tests.stories.technician_actions import TechnicianActions

RECORD: dict[str, Any] = {"procedure": "mastering_record", "settings": {}}
PATIENCE_S = 180.0
_presses = itertools.count(1)


def free_port() -> int:
    """Return a port that is free at present."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


class ServiceProcess:
    """One life of the service."""

    def __init__(self, process: asyncio.subprocess.Process) -> None:
        self.process = process

    @property
    def web_pid(self) -> int:
        """Of the web process."""
        return self.process.pid

    def cell_process_pid(self) -> int | None:
        """Return the cell process, None while there is none."""
        child_pids = Path(f"/proc/{self.web_pid}/task/{self.web_pid}/children").read_text().split()
        for child in child_pids:
            with suppress(OSError):
                if "cellcal.service.cell_process" in Path(f"/proc/{child}/cmdline").read_text():
                    return int(child)
        return None

    def kill_process(self, pid: int) -> None:
        """End a process as a power cut does."""
        with suppress(ProcessLookupError):
            os.kill(pid, signal.SIGKILL)


@asynccontextmanager
async def serve_cell(cell_file: Path, port: int) -> AsyncIterator[tuple[ServiceProcess, httpx.AsyncClient]]:
    """Serve a cell, and sign a browser in with the address that the console shows."""
    process = await asyncio.create_subprocess_exec(
        sys.executable, "-m", "cellcal", "serve", str(cell_file), "--port", str(port),
        stderr=asyncio.subprocess.PIPE, env=os.environ | {"COLUMNS": "200"},
    )  # fmt: skip
    try:
        address = await address_of(process)
        async with httpx.AsyncClient(
            base_url=f"http://127.0.0.1:{port}", timeout=60.0, limits=NO_IDLE_CONNECTIONS
        ) as client:
            assert (await client.get(address)).status_code == 303
            reading = asyncio.create_task(_discard_output(process))
            yield ServiceProcess(process), client
            reading.cancel()
    finally:
        with suppress(ProcessLookupError):
            process.send_signal(signal.SIGINT)
        await process.wait()


async def _discard_output(process: asyncio.subprocess.Process) -> None:
    assert process.stderr is not None
    while await process.stderr.readline():
        pass


async def address_of(process: asyncio.subprocess.Process) -> str:
    """Read the address that opens the service once, when it answers."""
    assert process.stderr is not None
    async with asyncio.timeout(PATIENCE_S):
        while b"Open once: " not in (line := await process.stderr.readline()):
            assert line, "the service ended"
        address = line.decode().partition("Open once: ")[2].strip()
        while True:
            with suppress(OSError):
                _, writer = await asyncio.open_connection("127.0.0.1", urlsplit(address).port)
                writer.close()
                return address
            await asyncio.sleep(0.02)


class ScriptedBrowser:
    """What a page does: it keeps the newest session, says yes to what is asked, and remembers what it was shown.

    ``starts`` are the runs that are begun one after the other; ``actions`` bring the arm where a touch wants it.
    """

    def __init__(
        self,
        client: httpx.AsyncClient,
        starts: Iterator[dict[str, Any]] | None = None,
        actions: TechnicianActions | None = None,
    ) -> None:
        self.client = client
        self.session: dict[str, Any] | None = None
        self.count = 0  # sessions that it was shown
        self._starts = starts or itertools.repeat(RECORD)
        self._actions = actions
        self._fresh = False  # whether the session was not acted on yet
        self._record: dict[str, Any] | None = None  # whether what is asked for may be recorded
        self._handled_prompt_id = ""  # the question that the hands have done
        self.taught: list[str] = []  # keys of the points that were asked for, in turn

    async def look_until(self, done: Callable[[], bool], *, orders: bool = True) -> None:
        """Follow the service until something is so; ``orders``: keep runs going, one after another."""
        async with asyncio.timeout(PATIENCE_S), self._connect_screen() as screen:
            async for text in screen:
                self._take_message(json.loads(text))
                if done():
                    return
                if orders and self.session is not None:
                    await self._act_on_session(self.session)

    def _take_message(self, message: dict[str, Any]) -> None:
        kind, content = message["kind"], message["content"]
        if kind == "gone":
            self.session = self._record = None
            self._handled_prompt_id = ""
        elif kind == "session":
            self.session, self._fresh = content, True
            self.count += 1
        elif kind == "live":
            self._record = content.get("record")  # not told while only other robots are reached

    def _connect_screen(self) -> connect:
        cookie_header = "; ".join(f"{name}={token}" for name, token in self.client.cookies.items())
        url = str(self.client.base_url).replace("http", "ws").rstrip("/") + "/api/screen"
        return connect(url, additional_headers={"cookie": cookie_header}, max_queue=None)

    async def _act_on_session(self, session: dict[str, Any]) -> None:
        """Do the one thing that a session asks for, once."""
        prompt = session["prompt"]
        if not (self._fresh and session["connection"]["connected"]):
            return
        if prompt is not None and not await self._is_ready(prompt, session["robot"]):
            return
        self._fresh = False
        if prompt is not None:
            await self.press_button({"op": "answer", "prompt_id": prompt["id"], "value": "yes"})
        elif session["run"] is None:
            await self.press_button({"op": "start", "hold_to_move": False} | next(self._starts))
        elif session["run"]["state"] == "ended":
            await self.press_button({"op": "dismiss"})

    async def _is_ready(self, prompt: dict[str, Any], robot: str) -> bool:
        """Whether yes may be said: where something is recorded, the page's button waits until that is worth it."""
        if prompt["page"] != "teach":
            return True
        if self._handled_prompt_id != prompt["id"]:
            self._handled_prompt_id = prompt["id"]
            self.taught.append(prompt["key"])
            if self._actions is not None:
                await self._actions.jog_to_touch(prompt["key"], robot)
        record = self._record or {}
        return bool(record.get("prompt_id") == prompt["id"] and record["ready"])

    async def press_button(self, order: dict[str, Any]) -> None:
        """Press a button; one that is out of date is pressed again by a reader of the next session."""
        assert self.session is not None
        envelope = {"id": f"press {next(_presses)}", "rev": self.session["rev"], "order": order}
        with suppress(httpx.TransportError):  # the service was killed meanwhile
            answer = await self.client.post("/api/commands", json=envelope)
            assert answer.status_code in (200, 409, 503), answer.text
