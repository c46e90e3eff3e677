"""The technician at a terminal: questions on standard error, answers from standard input."""

import sys
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from typing import Any

from rich.console import Console
from rich.panel import Panel
from rich.text import Text

from cellcal.calibration.message import make_message
from cellcal.drivers.errors import BusyError, NoOperatorError, RefusedError
from cellcal.drivers.interfaces import Answer, Instruction, Question
from cellcal.drivers.operator.lines import LineSource
from cellcal.drivers.operator.terminal_user import terminal_user

_YES, _NO = frozenset({"y", "yes"}), frozenset({"n", "no"})


class TerminalOperator:
    """Operator. Waiting for an answer never blocks the rest of the program and can be cancelled."""

    def __init__(
        self, person: str = "", *, console: Console | None = None, descriptor: int | None = None
    ) -> None:
        self._person = person or terminal_user()
        self._console = console or Console(stderr=True, emoji=False)
        self._descriptor = descriptor
        self._lines: LineSource | None = None
        self._asking = ""
        self._guidance: tuple[Any, ...] = ()

    async def confirm(self, instruction: Instruction) -> Answer:
        with self._exclusive_use(instruction.key):
            self._show_text(instruction.text, "Please do this")
            while True:
                line = (await self._read_line("Done? \\[y/n] ", instruction.text)).lower()
                if line in _YES:
                    return Answer(self._person)
                if line in _NO:
                    raise self._declined_error(instruction.text)
                self._console.print("Please answer y or n.")

    async def ask_question(self, question: Question) -> Answer:
        with self._exclusive_use(question.key):
            self._show_text(question.text, "Please tell")
            prompt = f"Value in {question.unit}: " if question.unit else "Answer: "
            while True:
                line = await self._read_line(prompt, question.text)
                if line:
                    return Answer(self._person, line)

    def show_guidance(self, text: str, values: Mapping[str, Any]) -> None:
        """Print what changed, a line each: the person looks at the robot, not at the cursor."""
        advice = (
            values.get("advice"),
            values.get("other_axis"),
            round(float(values.get("left_rad", 0.0)), 2),
        )
        if advice != self._guidance:
            self._guidance = advice
            self._console.print(Text(f"  {text}"))

    def _show_text(self, text: str, title: str) -> None:
        self._console.print(Panel(Text(text), title=title, expand=False))

    async def _read_line(self, prompt: str, question: str) -> str:
        self._console.print(prompt, end="")
        if self._lines is None:
            self._lines = LineSource(sys.stdin.fileno() if self._descriptor is None else self._descriptor)
        line = await self._lines.next_line()
        if line is None:
            self._console.print()
            raise NoOperatorError(
                "operator",
                make_message(
                    "it waits for a person, and there is none at this terminal (the input was closed): "
                    "{question}",
                    question=question,
                ),
                remedy="Resume the run where an operator can answer: cellcal resume, or a page of cellcal serve.",
            )
        return line.strip()

    @contextmanager
    def _exclusive_use(self, key: str) -> Iterator[None]:
        if self._asking:
            raise BusyError(
                "operator",
                make_message("{asking!r} is being asked, {key!r} has to wait.", asking=self._asking, key=key),
            )
        self._asking = key
        try:
            yield
        finally:
            self._asking = ""

    def _declined_error(self, question: str) -> RefusedError:
        return RefusedError(
            "operator",
            make_message("the answer was no: {question}", question=question),
            remedy="Resume the run when it can be done.",
        )
