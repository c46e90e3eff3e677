"""A technician who answers from a script: for demos, tests and runs without a person."""

from collections.abc import Awaitable, Callable, Mapping

from cellcal.drivers.errors import NoOperatorError, RefusedError
from cellcal.drivers.interfaces import Answer, Instruction, Question

Hook = Callable[[], Awaitable[None]]


class ScriptedOperator:
    """Operator. Answers by key; ``hooks`` do what the person would do, before the answer is given.

    An instruction or question without an answer raises, it is never guessed; ``"no"`` declines.
    """

    def __init__(
        self, answers: Mapping[str, str], *, hooks: Mapping[str, Hook] | None = None, person: str = "script"
    ) -> None:
        self._answers, self._hooks, self._person = dict(answers), dict(hooks or {}), person

    async def confirm(self, instruction: Instruction) -> Answer:
        return await self._answer_for(instruction.key, instruction.text)

    async def ask_question(self, question: Question) -> Answer:
        return await self._answer_for(question.key, question.text)

    async def _answer_for(self, key: str, text: str) -> Answer:
        value = self._answers.get(key)
        if value is None:
            raise NoOperatorError(
                "operator",
                f"the script has no answer to {key!r}: {text}",
                remedy="Add one to the script, then resume the run.",
            )
        if value.strip().lower() in ("n", "no"):
            raise RefusedError(
                "operator",
                f"the script says no to {key!r}: {text}",
                remedy="Resume the run when it can be done.",
            )
        if key in self._hooks:
            await self._hooks[key]()
        return Answer(self._person, value)
