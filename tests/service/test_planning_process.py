"""Runs are planned beside the web's process, and not for a client that has left; the list of them comes from memory."""

import asyncio
import gzip
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import pytest
from fastapi import Request

from cellcal.calibration.documents.json_text import parse_json
from cellcal.service.configuration.cell_file import CellConfig, read_cell_file
from cellcal.service.demo.fake_cell import free_address, write_cell_file
from cellcal.service.review.compute_client import ComputeClient, ComputeError
from cellcal.service.web.error_responses import respond_to_error
from cellcal.service.web.preview_worker import DRY_RUN, MODULE, make_handlers
from cellcal.service.web.procedures import ProcedureLists
from cellcal.service.web.waiting_clients import ClientGoneError, answer_while_awaited

QUICK = {"procedure": "mastering_recovery", "robot": None, "settings": {}}
LONG = {"procedure": "robot_calibration", "robot": None, "settings": {}}


@pytest.fixture(scope="module")
def config(tmp_path_factory: pytest.TempPathFactory) -> Iterator[CellConfig]:
    folder: Path = tmp_path_factory.mktemp("cell")
    with free_address() as address:
        yield read_cell_file(write_cell_file(folder, address, seed=1, time_factor=600.0))


def request_of(departure: asyncio.Event) -> Request:
    """Return a request whose client leaves when the event is set."""

    async def receive() -> dict[str, str]:
        await departure.wait()
        return {"type": "http.disconnect"}

    return Request({"type": "http", "method": "POST", "path": "/", "headers": []}, receive)


async def test_an_answer_comes_from_the_process_as_it_is_computed_here(config: CellConfig) -> None:
    planner = ComputeClient(config.path, MODULE)
    try:
        found = await answer_while_awaited(request_of(asyncio.Event()), planner.ask_worker(DRY_RUN, **QUICK))
        with pytest.raises(ComputeError, match="no procedure") as refused:
            await planner.ask_worker(DRY_RUN, **{**QUICK, "procedure": "no_such_procedure"})
    finally:
        await planner.stop_worker()
    assert found == make_handlers(config)[DRY_RUN](**QUICK)
    assert refused.value.code == "procedure.unknown"


async def test_planning_ends_when_the_client_leaves(config: CellConfig) -> None:
    planner, departure = ComputeClient(config.path, MODULE), asyncio.Event()
    try:
        await planner.ask_worker(DRY_RUN, **QUICK)
        working = planner._process
        question = asyncio.create_task(
            answer_while_awaited(request_of(departure), planner.ask_worker(DRY_RUN, **LONG))
        )
        departure.set()
        with pytest.raises(ClientGoneError) as broken_off:
            await question
        assert (
            respond_to_error(request_of(departure), broken_off.value).status_code == 499
        )  # no fault of the page
        assert working is not None
        assert working.returncode is not None
        assert (await planner.ask_worker(DRY_RUN, **QUICK))["procedure"] == "mastering_recovery"
    finally:
        await planner.stop_worker()


async def test_who_leaves_before_their_turn_ends_nothing_of_others(config: CellConfig) -> None:
    planner, departure = ComputeClient(config.path, MODULE), asyncio.Event()
    try:
        first = asyncio.create_task(planner.ask_worker(DRY_RUN, **QUICK))
        second = asyncio.create_task(
            answer_while_awaited(request_of(departure), planner.ask_worker(DRY_RUN, **LONG))
        )
        departure.set()
        with pytest.raises(ClientGoneError):
            await second
        assert (await first)["procedure"] == "mastering_recovery"
        assert planner._process is not None
        assert planner._process.returncode is None
    finally:
        await planner.stop_worker()


async def test_work_that_fails_says_so_to_the_client(config: CellConfig) -> None:
    async def fail() -> None:
        raise ComputeError("this cannot be computed.")

    with pytest.raises(ComputeError, match="cannot be computed"):
        await answer_while_awaited(request_of(asyncio.Event()), fail())


def test_the_list_comes_from_memory_until_something_changes(config: CellConfig) -> None:
    lists = ProcedureLists()
    first = lists.list_bytes(config, None, packs=False)
    assert lists.list_bytes(config, None, packs=False) is first
    packed = lists.list_bytes(config, None, packs=True)
    assert gzip.decompress(packed) == first
    rows = {row["name"]: row for row in parse_json(first)}
    assert rows["mastering_recovery"]["lacks"] != []
    assert "properties" in rows["mastering_recovery"]["settings"]
    other = parse_json(lists.list_bytes(config, "ur", packs=False))
    assert [row["lacks"] for row in other] != [row["lacks"] for row in parse_json(first)]
    assert lists.list_bytes(config, None, packs=False) is first


def test_what_a_cell_lacks_is_looked_up_for_each_request(tmp_path: Path) -> None:
    with free_address() as address:
        path = write_cell_file(tmp_path, address, seed=1, time_factor=600.0)
    config, lists = read_cell_file(path), ProcedureLists()
    names = [robot.name for robot in config.robots]
    without = lists.list_bytes(config, names[0], packs=False)
    less = replace(
        config, robots=tuple(robot for robot in config.robots if robot.name == names[0]), gauges=()
    )
    changed = lists.list_bytes(less, names[0], packs=False)
    assert changed != without
