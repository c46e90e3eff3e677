"""The demo's technician: does through the control port what a technician does at the cabinet."""

import asyncio
from collections.abc import Callable

from cellcal.drivers.errors import RefusedError
from cellcal.drivers.interfaces import Answer, Instruction, Question
from cellcal.service.demo.fake_cell_client import FakeCellClient
from cellcal.service.demo.technician_actions import perform_instruction


class SimulatedTechnician:
    """Says yes but to ``says_no``, and does what the instruction asks. ``say`` shows what he was asked."""

    name = "technician"

    def __init__(
        self,
        fake_cell: FakeCellClient,
        say: Callable[[str], None],
        wire: str | None = None,
        says_no: frozenset[str] = frozenset(),
    ) -> None:
        self._says_no = says_no  # to which instructions
        self.fake_cell, self._say, self._wire = (
            fake_cell,
            say,
            wire,
        )  # which wire his hands are on; None: the only one

    async def confirm(self, instruction: Instruction) -> Answer:
        """Do it, then say yes."""
        self._say(f"to the technician: {instruction.text}")
        if instruction.key in self._says_no:
            raise RefusedError(self.name, "no")
        if await perform_instruction(self.fake_cell, instruction.key, instruction.text, self._wire):
            await asyncio.sleep(0)
        return Answer(self.name)

    async def ask_question(self, question: Question) -> Answer:
        """Answer nothing: the demo asks no question that only a person can answer."""
        self._say(f"to the technician: {question.text}")
        return Answer(self.name, "")
