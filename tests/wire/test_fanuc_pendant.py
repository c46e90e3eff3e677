"""A person at the pendant of a controller that neither jogs nor is mastered by wire, read over the wire meanwhile."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from cellcal.drivers.interfaces import Answer, Instruction, MasteringData, Question
from cellcal.procedures.motion.guided_jog import HandJog, jog_by_hand
from cellcal.procedures.motors import motor_store
from cellcal.service.configuration.cell_file import read_cell_file
from cellcal.service.demo.fake_cell_client import FakeCellClient
from cellcal.service.runs.open_cell import open_cell
from tests.wire.contract_robot import wait_for_motion
from tests.wire.driver_cases import open_retrying
from tests.wire.fake_devices_process import run_fakes
from tests.wire.tp_cell import TP_CELL

AXIS = 3
MISTYPED = 400


@dataclass
class PendantHands:
    """Turns an axis, then types a count, wrongly at first; remembers what was shown."""

    fake_cell: FakeCellClient
    robot: Any
    turns: list[tuple[int, float]]  # for each instruction: axis, rad
    typed: list[int]  # for each instruction: counts that are added to J3
    texts: list[str] = field(default_factory=list)
    guidance: list[dict[str, Any]] = field(default_factory=list)

    async def confirm(self, instruction: Instruction) -> Answer:
        self.texts.append(instruction.text)
        if instruction.key == "jog_by_hand":
            axis, rad = self.turns.pop(0)
            await self.fake_cell.inject_fault("jog_by_hand", axis=f"J{axis + 1}", rad=rad, speed_rad_s=0.5)
            await wait_for_motion(self.robot, moving=False)
        if instruction.key == "type_mastering":
            await self.fake_cell.inject_fault("old_backup", axis="J3", counts=self.typed.pop(0))
        return Answer("anna")

    async def ask_question(self, question: Question) -> Answer:
        raise AssertionError(question)

    def show_guidance(self, text: str, values: Mapping[str, Any]) -> None:
        self.guidance.append(dict(values))
