"""The demo's pair of hands: does at the control door what a technician does at the cabinet."""

import asyncio
from collections.abc import Awaitable, Callable

from drivers.interfaces import Answer, Instruction, Question
from service.demo.door import Door


class DemoTechnician:
    """Says yes, and does what the instruction asks. ``say`` shows what he was asked."""

    name = "technician"

    def __init__(self, door: Door, say: Callable[[str], None]) -> None:
        self._door, self._say = door, say
        self._hands: dict[str, Callable[[], Awaitable[object]]] = {
            "new_battery": lambda: door.fault("new_battery"),
            "power_cycle": lambda: door.fault("power_cycle"),
        }

    async def confirm(self, instruction: Instruction) -> Answer:
        """Do it, then say yes."""
        self._say(f"to the technician: {instruction.text}")
        hands = self._hands.get(instruction.key)
        if hands is not None:
            await hands()
            await asyncio.sleep(0)
        return Answer(self.name)

    async def enter(self, question: Question) -> Answer:
        """Answer nothing: the demo asks no question that only a person can answer."""
        self._say(f"to the technician: {question.text}")
        return Answer(self.name, "")
