"""A desk over a fake cell on real sockets, for tests: orders in, what screens would see out."""

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


class AtDesk:
    """Somebody at a screen."""

    def __init__(self, cell_file: Path, door: FakeCellClient) -> None:
        self.door, self.cell_file = door, cell_file
        self.seen: list[dict[str, Any]] = []
        self.live: dict[str, Any] = {}
        self.looks = 0
        self._numbers = itertools.count(1)
        self.desk = CellController(read_cell_file(cell_file), self._told)

    def _told(self, kind: str, content: dict[str, Any]) -> None:
        if kind == "session":
            self.seen.append(content)
        else:
            self.live = content
            self.looks += 1

    @property
    def session(self) -> dict[str, Any]:
        return self.desk.describe_session()

    async def order(
        self, order: dict[str, Any], *, rev: int | None = None, press: str = ""
    ) -> dict[str, Any]:
        asked = {
            "id": press or f"press {next(self._numbers)}",
            "rev": self.desk.rev if rev is None else rev,
            "who": "Anna",
            "order": order,
        }
        return await self.desk.execute_command(COMMAND.validate_python(asked))

    async def until(self, true: Callable[[dict[str, Any]], Any]) -> Any:
        async with asyncio.timeout(PATIENCE_S):
            while not (found := true(self.session)):
                await asyncio.sleep(0.01)
        return found

    async def further_looks(self, count: int) -> None:
        """Wait until the desk has looked at its devices so many times more."""
        enough = self.looks + count
        await self.until(lambda _: self.looks >= enough)

    async def answer(self, key: str, value: str = "yes") -> dict[str, Any]:
        prompt = await self.until(
            lambda session: (session["prompt"] or {}).get("key") == key and session["prompt"]
        )
        return await self.order({"op": "answer", "prompt_id": prompt["id"], "value": value})

    async def joints(self) -> list[float]:
        truth = await self.door.read_truth()
        return list(truth["robots"]["fanuc"]["counts_read"])


@asynccontextmanager
async def a_cell(folder: Path, *, time_factor: float = 500.0) -> AsyncIterator[tuple[Path, FakeCellClient]]:
    with free_address() as address:
        path = write_cell_file(folder, address, seed=3, time_factor=time_factor)
    longer = (
        f"deadline_s = {min(stretched_s(3.0), 60.0):.1f}"  # a machine that runs browsers beside may be slow
    )
    path.write_text(re.sub(r"deadline_s = \d\.0", longer, path.read_text(encoding="utf-8")), encoding="utf-8")
    async with running_fakes(path) as door:
        yield path, door


@asynccontextmanager
async def at_desk(folder: Path, *, time_factor: float = 500.0) -> AsyncIterator[AtDesk]:
    async with a_cell(folder, time_factor=time_factor) as (path, door), at_the_desk_of(path, door) as person:
        yield person


@asynccontextmanager
async def at_the_desk_of(path: Path, door: FakeCellClient) -> AsyncIterator[AtDesk]:
    """Stand at a desk that is opened on a cell file."""
    person = AtDesk(path, door)
    attending = asyncio.create_task(person.desk.stay_connected())
    try:
        await person.until(lambda session: session["connection"]["connected"])
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


async def take_the_record(person: AtDesk) -> None:
    await person.order(RECORD | {"hold_to_move": False})
    await person.answer("wire_is_hooked")
    await person.answer("accept_plan")
    assert (await ended(person))["outcome"]["verdict"] == "passed"
    await person.order({"op": "dismiss"})


async def ended(person: AtDesk) -> dict[str, Any]:
    run: dict[str, Any] = await person.until(
        lambda session: session["run"] and session["run"]["outcome"] and session["run"]
    )
    return run


async def say_yes_until_it_ends(person: AtDesk) -> list[str]:
    """Do what the run asks for and say yes; return what was asked."""
    asked = []
    while prompt := await person.until(
        lambda session: session["prompt"] or (session["run"]["outcome"] is not None and "over")
    ):
        if prompt == "over":
            return asked
        await perform_instruction(person.door, prompt["key"], prompt["text"])
        await person.order({"op": "answer", "prompt_id": prompt["id"]})
        asked.append(prompt["key"])
        await person.until(lambda session, last=prompt["id"]: (session["prompt"] or {}).get("id") != last)
    return asked
