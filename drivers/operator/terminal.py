"""The technician at a terminal: questions on standard error, answers from standard input."""

import getpass
import sys
from collections.abc import Iterator
from contextlib import contextmanager

from rich.console import Console
from rich.panel import Panel
from rich.text import Text

from cellcal.drivers.errors import BusyError, NobodyThereError, RefusedError
from cellcal.drivers.interfaces import Answer, Instruction, Question
from cellcal.drivers.operator.lines import LineSource

_YES, _NO = frozenset({"y", "yes"}), frozenset({"n", "no"})


class TerminalOperator:
    """Operator. Waiting for an answer never blocks the rest of the program and can be cancelled."""

    def __init__(
        self, who: str = "", *, console: Console | None = None, descriptor: int | None = None
    ) -> None:
        self._who = who or getpass.getuser()
        self._console = console or Console(stderr=True, emoji=False)
        self._descriptor = descriptor
        self._lines: LineSource | None = None
        self._asking = ""

    async def confirm(self, instruction: Instruction) -> Answer:
        with self._alone(instruction.key):
            self._show(instruction.text, "Please do this")
            while True:
                line = (await self._line("Done? \\[y/n] ", instruction.text)).lower()
                if line in _YES:
                    return Answer(self._who)
                if line in _NO:
                    raise self._declined(instruction.text)
                self._console.print("Please answer y or n.")

    async def enter(self, question: Question) -> Answer:
        with self._alone(question.key):
            self._show(question.text, "Please tell")
            prompt = f"Value in {question.unit}: " if question.unit else "Answer: "
            while True:
                line = await self._line(prompt, question.text)
                if line:
                    return Answer(self._who, line)

    def _show(self, text: str, title: str) -> None:
        self._console.print(Panel(Text(text), title=title, expand=False))

    async def _line(self, prompt: str, asked: str) -> str:
        self._console.print(prompt, end="")
        if self._lines is None:
            self._lines = LineSource(sys.stdin.fileno() if self._descriptor is None else self._descriptor)
        line = await self._lines.next_line()
        if line is None:
            self._console.print()
            raise NobodyThereError(
                "operator",
                f"it waits for a person, and nobody is at this terminal (the input was closed): {asked}",
                remedy="Resume the run where somebody can answer: cellcal resume, or a page of cellcal serve.",
            )
        return line.strip()

    @contextmanager
    def _alone(self, key: str) -> Iterator[None]:
        if self._asking:
            raise BusyError("operator", f"{self._asking!r} is being asked, {key!r} has to wait.")
        self._asking = key
        try:
            yield
        finally:
            self._asking = ""

    def _declined(self, asked: str) -> RefusedError:
        return RefusedError(
            "operator", f"the answer was no: {asked}", remedy="Resume the run when it can be done."
        )
