"""The technician at a screen: questions become a prompt that every person with the right may answer."""

import asyncio
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

from cellcal.calibration.message import make_message
from cellcal.drivers.errors import BusyError, RefusedError
from cellcal.drivers.interfaces import Answer, Instruction, Question
from cellcal.procedures.instruction_page import InstructionPage, StepKind, page_of
from cellcal.procedures.prompt_answers import answers_for
from cellcal.service.session_documents import GuidanceDocument, PromptDocument


@dataclass(frozen=True, slots=True)
class Prompt:
    """The question that is asked just now. ``id`` names this very asking: an answer to another one does not count."""

    id: str
    kind: str  # confirm, enter
    key: str
    text: str
    unit: str
    step: str
    page: StepKind = "ask"
    data: Mapping[str, Any] = field(default_factory=dict)

    def as_json(self) -> PromptDocument:
        """Return it for a screen."""
        answers = answers_for(self.key)
        return {
            "id": self.id,
            "kind": self.kind,
            "key": self.key,
            "text": self.text,
            "unit": self.unit,
            "step": self.step,
            "page": self.page,
            "data": dict(self.data),
            "yes": answers.yes,
            "no": answers.no,
            "question": answers.question,
            "is_folded": answers.is_folded,
            "drawing": answers.drawing,
        }


class StalePromptError(RefusedError):
    """An answer to what is no longer asked."""

    code = "desk.stale"

    def __init__(self) -> None:
        super().__init__("operator", "this is no longer asked.", remedy="Look at the present step.")


class ScreenOperator:
    """Operator. Waits for an answer from a screen; one question at a time."""

    def __init__(self, changed: Callable[[], None]) -> None:
        self._changed = changed
        self._count = 0
        self._answer: asyncio.Future[Answer] | None = None
        self.prompt: Prompt | None = None
        self.guidance: GuidanceDocument | None = None  # newest, of what is asked
        self.run_id = ""
        self.step = ""

    async def confirm(self, instruction: Instruction) -> Answer:
        return await self._show_prompt("confirm", instruction.key, instruction.text, "", page_of(instruction))

    async def ask_question(self, question: Question) -> Answer:
        page = InstructionPage("enter", {"count": question.count})
        return await self._show_prompt("enter", question.key, question.text, question.unit, page)

    def show_guidance(self, text: str, values: Mapping[str, Any]) -> None:
        """Remember it for the next live message: ten times a second is no news of the session."""
        if self.prompt is not None:
            self.guidance = {"prompt_id": self.prompt.id, "text": text, "values": dict(values)}

    def answer_prompt(self, prompt_id: str, who: str, value: str) -> None:
        """Answer what is asked; StalePromptError where something else, or nothing, is."""
        self._pending_answer(prompt_id).set_result(Answer(who, value))

    def decline_prompt(self, prompt_id: str) -> None:
        """Say no to what is asked."""
        pending = self._pending_answer(prompt_id)
        assert self.prompt is not None
        text = self.prompt.text
        pending.set_exception(
            RefusedError(
                "operator",
                make_message("the answer was no: {question}", question=text),
                remedy="Resume the run when it can be done.",
            )
        )

    def _pending_answer(self, prompt_id: str) -> "asyncio.Future[Answer]":
        if self.prompt is None or self._answer is None or self._answer.done() or self.prompt.id != prompt_id:
            raise StalePromptError
        return self._answer

    async def _show_prompt(self, kind: str, key: str, text: str, unit: str, page: InstructionPage) -> Answer:
        if self.prompt is not None:
            raise BusyError(
                "operator",
                make_message(
                    "{asking!r} is being asked, {key!r} has to wait.", asking=self.prompt.key, key=key
                ),
            )
        self._count += 1
        self._answer = asyncio.get_running_loop().create_future()
        name = f"{self.run_id}:{self._count}"
        self.prompt = Prompt(name, kind, key, text, unit, self.step, page.kind, page.data)
        self._changed()
        try:
            return await self._answer
        finally:
            self.prompt, self._answer, self.guidance = None, None, None
            self._changed()
