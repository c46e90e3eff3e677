"""A cell process over a fake cell on real sockets, for tests: orders in, what screens would show out."""

import asyncio
import contextlib
import itertools
import re
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

from pydantic import TypeAdapter

from cellcal.service.cell_process.cell_controller import CellController
from cellcal.service.cell_process.messages import SessionCommand
from cellcal.service.configuration.cell_file import read_cell_file
from cellcal.service.demo.fake_cell import free_address, running_fakes, write_cell_file
from cellcal.service.demo.fake_cell_client import FakeCellClient
from cellcal.service.demo.technician_actions import perform_instruction
from tests.machine_speed import stretched_s

COMMAND: TypeAdapter[SessionCommand] = TypeAdapter(SessionCommand)
PATIENCE_S = stretched_s(240.0)  # a whole run, on a machine that has other work
_TYPED = """driver = "file_import"
source = "typed"
instrument = "a wire with a display of its own"
serial = "D-1"
unit = "mm"
range_m = 3.0
sigma_m = 0.0002
"""
RECORD = {"op": "start", "procedure": "mastering_record", "settings": {}}


class ScreenSession:
    """A person at a screen."""

    def __init__(self, cell_file: Path, fake_client: FakeCellClient) -> None:
        self.fake_client, self.cell_file = fake_client, cell_file
        self.messages: list[dict[str, Any]] = []
        self.live: dict[str, Any] = {}
        self.live_count = 0
        self._numbers = itertools.count(1)
        self.cell_process = CellController(read_cell_file(cell_file), self._on_message)

    def _on_message(self, kind: str, content: dict[str, Any]) -> None:
        if kind == "session":
            self.messages.append(content)
        else:
            self.live = content
            self.live_count += 1

    @property
    def session(self) -> dict[str, Any]:
        return self.cell_process.describe_session()

    async def send_order(
        self, order: dict[str, Any], *, rev: int | None = None, press: str = ""
    ) -> dict[str, Any]:
        request = {
            "id": press or f"press {next(self._numbers)}",
            "rev": self.cell_process.rev if rev is None else rev,
            "who": "Anna",
            "order": order,
        }
        return await self.cell_process.execute_command(COMMAND.validate_python(request))

    async def wait_until(self, true: Callable[[dict[str, Any]], Any]) -> Any:
        async with asyncio.timeout(PATIENCE_S):
            while not (found := true(self.session)):
                await asyncio.sleep(0.01)
        return found

    async def wait_for_live_values(self, count: int) -> None:
        """Wait until the cell process has polled its devices so many times more."""
        enough = self.live_count + count
        await self.wait_until(lambda _: self.live_count >= enough)

    async def answer_question(self, key: str, value: str = "yes") -> dict[str, Any]:
        prompt = await self.wait_until(
            lambda session: (session["prompt"] or {}).get("key") == key and session["prompt"]
        )
        return await self.send_order({"op": "answer", "prompt_id": prompt["id"], "value": value})

    async def read_joints(self) -> list[float]:
        truth = await self.fake_client.read_truth()
        return list(truth["robots"]["fanuc"]["counts_read"])


@asynccontextmanager
async def a_cell(folder: Path, *, time_factor: float = 500.0) -> AsyncIterator[tuple[Path, FakeCellClient]]:
    with free_address() as address:
        path = write_cell_file(folder, address, seed=3, time_factor=time_factor)
    longer = (
        f"deadline_s = {min(stretched_s(3.0), 60.0):.1f}"  # a machine that runs browsers beside may be slow
    )
    path.write_text(re.sub(r"deadline_s = \d\.0", longer, path.read_text(encoding="utf-8")), encoding="utf-8")
    async with running_fakes(path) as fake_client:
        yield path, fake_client


@asynccontextmanager
async def open_session(folder: Path, *, time_factor: float = 500.0) -> AsyncIterator[ScreenSession]:
    async with (
        a_cell(folder, time_factor=time_factor) as (path, fake_client),
        open_session_of(path, fake_client) as person,
    ):
        yield person


@asynccontextmanager
async def open_session_of(path: Path, fake_client: FakeCellClient) -> AsyncIterator[ScreenSession]:
    """Open a session with a cell process of a cell file."""
    person = ScreenSession(path, fake_client)
    attending = asyncio.create_task(person.cell_process.stay_connected())
    try:
        await person.wait_until(lambda session: session["connection"]["connected"])
        yield person
    finally:
        attending.cancel()
        with contextlib.suppress(asyncio.CancelledError):
            await attending


def without_a_wire_to_the_gauge(cell_file: Path) -> None:
    """Let the service know of the first robot's gauge only what a person types; the fakes go on as they are."""
    head, _, rest = cell_file.read_text(encoding="utf-8").partition("[[gauge]]")
    name, place = re.search(r'name = ".*"', rest), rest[rest.index('robot = "fanuc"') :]
    assert name is not None
    cell_file.write_text(f"{head}[[gauge]]\n{name[0]}\n{_TYPED}{place}", encoding="utf-8")


async def take_the_record(person: ScreenSession) -> None:
    await person.send_order(RECORD | {"hold_to_move": False})
    await person.answer_question("wire_is_hooked")
    await person.answer_question("accept_plan")
    assert (await run_outcome(person))["outcome"]["verdict"] == "passed"
    await person.send_order({"op": "dismiss"})


async def run_outcome(person: ScreenSession) -> dict[str, Any]:
    run: dict[str, Any] = await person.wait_until(
        lambda session: session["run"] and session["run"]["outcome"] and session["run"]
    )
    return run


async def confirm_until_end(person: ScreenSession) -> list[str]:
    """Do what the run asks for and say yes; return what was asked."""
    question_keys = []
    while prompt := await person.wait_until(
        lambda session: session["prompt"] or (session["run"]["outcome"] is not None and "over")
    ):
        if prompt == "over":
            return question_keys
        await perform_instruction(person.fake_client, prompt["key"], prompt["text"])
        await person.send_order({"op": "answer", "prompt_id": prompt["id"]})
        question_keys.append(prompt["key"])
        await person.wait_until(
            lambda session, last=prompt["id"]: (session["prompt"] or {}).get("id") != last
        )
    return question_keys
