"""A technician at the control port of the fake cell, who finds places again as the instructions ask."""

import asyncio
import math
import re
from dataclasses import dataclass, field

from cellcal.drivers.interfaces import Answer, Instruction, Question
from cellcal.service.demo.fake_cell_client import FakeCellClient

_VISIT = re.compile(r"visit_(point|seat|target|nest)_(\d+)")
_NEAR = re.compile(r"at about (.*?) deg")
_SETTLE_S = 0.15  # of real time: the probe's electronics look again


@dataclass
class FakeTechnician:
    """Operator. Does what a person does; ``kit`` is what is answered where a kit is chosen."""

    fake_client: FakeCellClient
    kit: str = ""
    instructions: list[str] = field(default_factory=list)
    text: dict[str, str] = field(default_factory=dict)

    async def confirm(self, instruction: Instruction) -> Answer:
        self.instructions.append(instruction.key)
        self.text[instruction.key] = instruction.text
        if visit := _VISIT.fullmatch(instruction.key):
            await self._go_to_place(visit[1], int(visit[2]), instruction.text)
        elif instruction.key in ("new_battery", "power_cycle"):
            await self.fake_client.inject_fault(instruction.key)
        return Answer("anna")

    async def ask_question(self, question: Question) -> Answer:
        self.instructions.append(question.key)
        self.text[question.key] = question.text
        return Answer("anna", self.kit)

    async def _go_to_place(self, what: str, number: int, text: str) -> None:
        if what == "nest":
            await self.fake_client.inject_fault("reflector_to_nest", nest=number)
            return
        if what == "target":
            await self.fake_client.inject_fault("reflector_to_flange")
        near = _NEAR.search(text)
        near_joints = (
            {} if near is None else {"joints": [_parse_radians(word) for word in near[1].split(",")]}
        )
        hand = "bring_to_seat" if what == "seat" else "bring_tip"
        await self.fake_client.inject_fault(hand, place=number, **near_joints)
        await asyncio.sleep(_SETTLE_S)


def _parse_radians(word: str) -> float:
    return math.radians(float(word.split()[1]))
