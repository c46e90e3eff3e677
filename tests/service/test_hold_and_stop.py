"""Held counts only when fresh, ids and revisions are strict, and nothing swallows a stop."""

import asyncio
import time
from pathlib import Path
from typing import Any

import orjson
import pytest
from pydantic import ValidationError

from cellcal.service.cell_process.hold_to_move import DEAD_MAN_S
from cellcal.service.cell_process.lines import whole_lines
from cellcal.service.cell_process.messages import LONGEST_LINE
from cellcal.service.web.commands import PressedOrder
from cellcal.service.web.websocket import HoldMessage
from tests.service.cell_process_session import COMMAND, RECORD, open_session
from tests.service.service_client import open_service_client

ODD_NUMBERS = [True, 1.0, "1", -1, 2**53, 10**30, float("nan"), float("inf"), None, [1]]
ODD_IDS = ["", "x" * 101, "a\nb", "\ud800", 5, None, True, ["a"]]


@pytest.mark.parametrize("rev", ODD_NUMBERS)
def test_a_revision_that_is_none_is_refused(rev: Any) -> None:
    order = {"op": "pause"}
    with pytest.raises(ValidationError):
        COMMAND.validate_python({"id": "1", "rev": rev, "who": "Anna", "order": order})
    with pytest.raises(ValidationError):
        PressedOrder.model_validate({"id": "1", "rev": rev, "order": order})
    with pytest.raises(ValidationError):
        HoldMessage.model_validate({"op": "hold", "held": True, "beat": rev})


@pytest.mark.parametrize("name", ODD_IDS)
def test_an_id_that_is_none_is_refused(name: Any) -> None:
    with pytest.raises(ValidationError):
        PressedOrder.model_validate({"id": name, "rev": 1, "order": {"op": "pause"}})


@pytest.mark.parametrize("held_value", [1, "true", "yes", None, 1.0])
def test_held_is_true_or_false_and_nothing_like_it(held_value: Any) -> None:
    with pytest.raises(ValidationError):
        HoldMessage.model_validate({"op": "hold", "held": held_value, "beat": 1})


@pytest.mark.parametrize(
    "broken",
    [{"rev": rev} for rev in ODD_NUMBERS]
    + [{"id": name} for name in ODD_IDS]
    + [{"order": {"op": "stop", "x": 1}}, {"new_field": [1]}],
)
def test_no_flaw_of_its_id_or_revision_swallows_a_stop(broken: dict[str, Any]) -> None:
    envelope = {"id": "1", "rev": 1, "order": {"op": "stop"}} | broken
    assert PressedOrder.model_validate(envelope).order.op == "stop"
    assert COMMAND.validate_python(envelope | {"who": "Anna"}).order.op == "stop"


async def test_a_stop_with_the_id_of_another_order_stops_and_the_other_way_round_is_refused(
    tmp_path: Path,
) -> None:
    async with open_session(tmp_path) as person:
        assert (await person.send_order(RECORD, press="one"))["ok"]
        used = await person.send_order({"op": "pause"}, press="one")
        assert (used["ok"], used["code"]) == (False, "desk.id_used")
        await person.wait_until(lambda session: session["prompt"])
        stopped = await person.send_order({"op": "stop"}, press="one", rev=1)
        assert stopped["ok"]
        await person.wait_until(lambda session: session["run"]["outcome"])
        assert (await person.send_order({"op": "dismiss"}))["ok"]
        assert (await person.send_order(RECORD, press="two"))["ok"]
        await person.wait_until(lambda session: session["prompt"])
        assert (await person.send_order({"op": "stop"}, press="one", rev=1))["ok"]  # again, at another run
        await person.wait_until(lambda session: session["run"]["outcome"])


async def test_a_stop_stops_also_where_the_disk_cannot_forget_the_run(tmp_path: Path) -> None:
    async with open_session(tmp_path) as person:
        assert (await person.send_order(RECORD))["ok"]
        await person.wait_until(lambda session: session["prompt"])
        note = next(tmp_path.rglob("under_way.json"))  # noqa: ASYNC240  a test
        note.unlink()
        note.mkdir()  # cannot be removed as a file is
        refused = await person.send_order({"op": "stop"})
        assert "the run was ended" in refused["message"]
        assert person.session["run"]["state"] == "ended"
        note.rmdir()


async def test_held_from_a_moment_ago_counts_less_and_from_nowhere_not_at_all(tmp_path: Path) -> None:
    async with open_session(tmp_path) as person:
        hold = person.cell_process._hold
        for late in (DEAD_MAN_S + 0.01, 3600.0):
            await person.send_order({"op": "hold", "held": True, "at_s": time.monotonic() - late})
            assert not hold.is_held
        future = await person.send_order({"op": "hold", "held": True, "at_s": time.monotonic() + 5.0})
        assert not future["ok"]
        assert not hold.is_held
        with pytest.raises(ValidationError):
            await person.send_order({"op": "hold", "held": True})
        await person.send_order({"op": "hold", "held": True, "at_s": time.monotonic()})
        assert hold._last_received_s > 0
        await person.send_order({"op": "hold", "held": False})
        assert not hold.is_held


async def test_over_http_the_button_can_be_let_go_and_never_held(tmp_path: Path) -> None:
    async with open_service_client(tmp_path) as service_client:
        await service_client.from_console()
        await service_client.sign_in("Tom")
        for hold_message in ({"held": True, "at_s": time.monotonic()}, {"held": True, "at_s": 1e300}):
            answer = await service_client.send_order({"op": "hold", **hold_message})
            assert (answer.status_code, answer.json()["code"]) == (422, "hold.not_fresh")
        assert (await service_client.send_order({"op": "hold", "held": True})).status_code == 422
        assert (await service_client.send_order({"op": "hold", "held": False})).json()["code"] == "desk.gone"


async def test_a_too_long_line_is_dropped_and_the_stop_behind_it_is_obeyed() -> None:
    reader = asyncio.StreamReader()
    stop = orjson.dumps({"number": 1, "command": {"order": {"op": "stop"}}})
    for part in (b"x" * (LONGEST_LINE + 5), b"y" * 70_000, b"\n", b"{broken\n", stop + b"\n"):
        reader.feed_data(part)
    reader.feed_eof()
    assert [line async for line in whole_lines(reader)] == [b"{broken", stop]
