"""How screens and a terminal show a turn while a person makes it."""

import asyncio
import io
import os

import pytest
from rich.console import Console

from cellcal.drivers.interfaces import Answer, GuidesPerson, Instruction
from cellcal.drivers.operator.terminal import TerminalOperator
from cellcal.procedures.instruction_page import with_page
from cellcal.service.cell_process.screen_operator import ScreenOperator

TURN = with_page(Instruction("jog_by_hand", "Turn J3 alone."), "ask", jog={"axis": 2})
LEFT = {"axis": 2, "key": "+", "left_rad": 0.1, "advice": "turn", "other_axis": None}


async def test_a_screen_shows_the_turn_of_the_present_question_only() -> None:
    changes: list[int] = []
    screen = ScreenOperator(lambda: changes.append(1))
    assert isinstance(screen, GuidesPerson)
    screen.show_guidance("too early", LEFT)
    assert screen.guidance is None
    confirmation = asyncio.create_task(screen.confirm(TURN))
    while screen.prompt is None:
        await asyncio.sleep(0)
    assert screen.prompt.data["jog"] == {"axis": 2}
    notices = len(changes)
    screen.show_guidance("Turn J3 with the + key, 5.7 deg are left.", LEFT)
    assert screen.guidance == {
        "prompt_id": screen.prompt.id,
        "text": "Turn J3 with the + key, 5.7 deg are left.",
        "values": LEFT,
    }
    assert (
        len(changes) == notices
    )  # it goes with the live values: ten times a second is no news of the session
    screen.answer_prompt(screen.prompt.id, "anna", "yes")
    assert await confirmation == Answer("anna")
    assert screen.guidance is None


async def test_a_terminal_prints_what_changed_and_no_more() -> None:
    out = io.StringIO()
    reading, writing = os.pipe()
    try:
        terminal = TerminalOperator("anna", console=Console(file=out, width=100), descriptor=reading)
        for left_rad, advice in (
            (0.1, "turn"),
            (0.101, "turn"),
            (0.02, "slow"),
            (0.0, "stop"),
            (0.0, "stop"),
        ):
            terminal.show_guidance(f"{advice} {left_rad}", {**LEFT, "left_rad": left_rad, "advice": advice})
    finally:
        os.close(reading)
        os.close(writing)
    assert [line.strip() for line in out.getvalue().splitlines()] == ["turn 0.1", "slow 0.02", "stop 0.0"]


@pytest.mark.parametrize("advice", ["stop", "wrong_axis"])
async def test_a_mistake_is_printed_at_once(advice: str) -> None:
    out = io.StringIO()
    terminal = TerminalOperator("anna", console=Console(file=out, width=100), descriptor=0)
    terminal.show_guidance("turn", LEFT)
    terminal.show_guidance(advice, {**LEFT, "advice": advice, "other_axis": 4})
    assert advice in out.getvalue()
