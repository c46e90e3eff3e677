"""The demo's pair of hands: does at the control door what a technician does at the cabinet."""

import asyncio
import re
from collections.abc import Awaitable, Callable

from drivers.errors import RefusedError
from drivers.interfaces import Answer, Instruction, Question
from service.demo.door import Door

_MOUNT = re.compile(r"mount_wire_(\d+)")
_HOOK = re.compile(r"hook_wire_(\d+)")
_MOUTH = re.compile(r"towards x (-?\d+), y (-?\d+), z (-?\d+) mm")


class DemoTechnician:
    """Says yes but to ``says_no``, and does what the instruction asks. ``say`` shows what he was asked."""

    name = "technician"

    def __init__(
        self,
        door: Door,
        say: Callable[[str], None],
        wire: str | None = None,
        says_no: frozenset[str] = frozenset(),
    ) -> None:
        self._says_no = says_no  # to which instructions
        self._door, self._say, self._wire = door, say, wire  # which wire his hands are on; None: the only one
        self._hands: dict[str, Callable[[], Awaitable[object]]] = {
            "new_battery": lambda: door.fault("new_battery"),
            "power_cycle": lambda: door.fault("power_cycle"),
        }

    async def confirm(self, instruction: Instruction) -> Answer:
        """Do it, then say yes."""
        self._say(f"to the technician: {instruction.text}")
        if instruction.key in self._says_no:
            raise RefusedError(self.name, "no")
        hands = self._hands.get(instruction.key)
        if hands is not None:
            await hands()
            await asyncio.sleep(0)
        await self._move_the_wire(instruction)
        return Answer(self.name)

    async def _move_the_wire(self, instruction: Instruction) -> None:
        """Put exit or hook where an alignment wants them; the wire's mouth looks where the text says."""
        if mount := _MOUNT.fullmatch(instruction.key):
            mouth = _MOUTH.search(instruction.text)
            told = {} if mouth is None else {"mouth_at_m": [int(value) * 1e-3 for value in mouth.groups()]}
            await self._door.fault("mount_wire", point=int(mount[1]), **told, **self._gauge())
        elif hook := _HOOK.fullmatch(instruction.key):
            await self._door.fault("hook_wire", target=int(hook[1]), **self._gauge())

    def _gauge(self) -> dict[str, str]:
        return {} if self._wire is None else {"device": self._wire}

    async def enter(self, question: Question) -> Answer:
        """Answer nothing: the demo asks no question that only a person can answer."""
        self._say(f"to the technician: {question.text}")
        return Answer(self.name, "")
