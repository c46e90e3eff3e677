"""A person is asked without stopping the rest of the program, and may be interrupted."""

import asyncio
import io
import os
from collections.abc import Iterator
from pathlib import Path

import pytest
from rich.console import Console

from cellcal.drivers.errors import BusyError, NoOperatorError, RefusedError
from cellcal.drivers.interfaces import Answer, Instruction, Question
from cellcal.drivers.operator.scripted import ScriptedOperator
from cellcal.drivers.operator.terminal import TerminalOperator

HOOK = Instruction("hook_wire", "Hook the wire [to] the flange.")
NUMBER = Question("serial", "Which serial number is on the plate?", unit="")
LENGTH = Question("length", "How long is it?", unit="mm")


class PipeTerminal:
    """Both ends of a pipe as standard input, and what was shown."""

    def __init__(self) -> None:
        self.shown = io.StringIO()
        self.descriptor, self._keys = os.pipe()
        console = Console(file=self.shown, width=100)
        self.operator = TerminalOperator("anna", console=console, descriptor=self.descriptor)

    def type_text(self, text: str) -> None:
        os.write(self._keys, text.encode())

    def drop_connection(self) -> None:
        os.close(self._keys)
        self._keys = -1

    def close(self) -> None:
        os.close(self.descriptor)
        if self._keys >= 0:
            os.close(self._keys)


@pytest.fixture
def terminal() -> Iterator[PipeTerminal]:
    terminal = PipeTerminal()
    yield terminal
    terminal.close()


class TestTerminal:
    @pytest.mark.parametrize("keys", ["y\n", "YES\n", " y \r\n", "what?\n\ny\n"])
    async def test_confirms_on_yes_and_names_the_person(self, terminal: PipeTerminal, keys: str) -> None:
        terminal.type_text(keys)
        assert await terminal.operator.confirm(HOOK) == Answer("anna")
        assert "Hook the wire [to] the flange." in terminal.shown.getvalue()
        assert "[y/n]" in terminal.shown.getvalue()

    @pytest.mark.parametrize("keys", ["n\n", "No\n"])
    async def test_declines_on_no(self, terminal: PipeTerminal, keys: str) -> None:
        terminal.type_text(keys)
        with pytest.raises(RefusedError, match="the answer was no"):
            await terminal.operator.confirm(HOOK)

    async def test_a_closed_terminal_gives_no_answer(self, terminal: PipeTerminal) -> None:
        terminal.drop_connection()
        with pytest.raises(NoOperatorError, match="the input was closed"):
            await terminal.operator.confirm(HOOK)

    async def test_enters_what_was_typed_and_shows_the_unit(self, terminal: PipeTerminal) -> None:
        terminal.type_text("\n  12,5 \n")
        assert await terminal.operator.ask_question(LENGTH) == Answer("anna", "12,5")
        assert "mm" in terminal.shown.getvalue()

    async def test_lines_typed_ahead_are_kept_for_the_next_question(self, terminal: PipeTerminal) -> None:
        terminal.type_text("y\nF-10")
        assert await terminal.operator.confirm(HOOK) == Answer("anna")
        asking = asyncio.create_task(terminal.operator.ask_question(NUMBER))
        terminal.type_text("4711\n")
        assert await asking == Answer("anna", "F-104711")

    async def test_waiting_stops_nothing_else_and_can_be_cancelled(self, terminal: PipeTerminal) -> None:
        asking = asyncio.create_task(terminal.operator.confirm(HOOK))
        for _ in range(100):
            await asyncio.sleep(0)
        assert not asking.done()
        asking.cancel()
        with pytest.raises(asyncio.CancelledError):
            await asking
        terminal.type_text("y\n")
        assert await terminal.operator.confirm(HOOK) == Answer("anna")

    async def test_two_questions_at_once_are_a_bug(self, terminal: PipeTerminal) -> None:
        asking = asyncio.create_task(terminal.operator.confirm(HOOK))
        await asyncio.sleep(0)
        with pytest.raises(BusyError, match="hook_wire"):
            await terminal.operator.ask_question(NUMBER)
        terminal.type_text("y\n")
        assert await asking == Answer("anna")

    async def test_answers_may_come_from_a_file(self, tmp_path: Path) -> None:
        answers = tmp_path / "answers"
        answers.write_text("y\nF-104711")
        with answers.open() as file:
            operator = TerminalOperator("anna", console=Console(file=io.StringIO()), descriptor=file.fileno())
            assert await operator.confirm(HOOK) == Answer("anna")
            assert await operator.ask_question(NUMBER) == Answer("anna", "F-104711")
            with pytest.raises(NoOperatorError):
                await operator.confirm(HOOK)


class TestScript:
    async def test_answers_by_key(self) -> None:
        operator = ScriptedOperator({"hook_wire": "yes", "serial": "F-1"}, person="demo")
        assert await operator.confirm(HOOK) == Answer("demo", "yes")
        assert await operator.ask_question(NUMBER) == Answer("demo", "F-1")

    async def test_never_guesses(self) -> None:
        with pytest.raises(NoOperatorError, match="hook_wire"):
            await ScriptedOperator({}).confirm(HOOK)

    async def test_no_means_no_and_nothing_is_done(self) -> None:
        done: list[str] = []

        async def record_call() -> None:
            done.append("hooked")

        with pytest.raises(RefusedError):
            await ScriptedOperator({"hook_wire": "no"}, hooks={"hook_wire": record_call}).confirm(HOOK)
        assert done == []

    async def test_does_what_the_person_would_do_before_it_answers(self) -> None:
        done: list[str] = []

        async def record_call() -> None:
            await asyncio.sleep(0)
            done.append("hooked")

        operator = ScriptedOperator({"hook_wire": "yes", "serial": "1"}, hooks={"hook_wire": record_call})
        await operator.ask_question(NUMBER)
        assert done == []
        await operator.confirm(HOOK)
        assert done == ["hooked"]
