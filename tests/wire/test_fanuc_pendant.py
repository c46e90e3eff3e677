"""A person at the pendant of a controller that neither jogs nor is mastered by wire, read over the wire meanwhile."""

import asyncio
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
from tests.wire.tp_cell import TP_CASE, TP_CELL

AXIS = 3
MISTYPED = 400


@dataclass
class PendantHands:
    """Turns an axis, then types a count, wrongly at first; remembers what was shown."""

    fake_cell: FakeCellClient
    turns: list[tuple[int, float]]  # for each instruction: axis, rad
    typed: list[int]  # for each instruction: counts that are added to J3
    texts: list[str] = field(default_factory=list)
    guidance: list[dict[str, Any]] = field(default_factory=list)
    shown: asyncio.Event = field(default_factory=asyncio.Event)

    async def confirm(self, instruction: Instruction) -> Answer:
        self.texts.append(instruction.text)
        if instruction.key == "jog_by_hand":
            axis, rad = self.turns.pop(0)
            await self.fake_cell.inject_fault("jog_by_hand", axis=f"J{axis + 1}", rad=rad, speed_rad_s=0.5)
            await wait_for_motion(self.fake_cell, TP_CASE, expected=False)
            self.shown.clear()
            await self.shown.wait()  # the person looks at the screen before saying yes
        if instruction.key == "type_mastering":
            await self.fake_cell.inject_fault("old_backup", axis="J3", counts=self.typed.pop(0))
        return Answer("anna")

    async def ask_question(self, question: Question) -> Answer:
        raise AssertionError(question)

    def show_guidance(self, text: str, values: Mapping[str, Any]) -> None:
        self.guidance.append(dict(values))
        self.shown.set()


async def test_a_person_jogs_and_types_what_no_program_may(tmp_path: Path) -> None:
    with run_fakes(tmp_path, TP_CELL) as (path, fake_client):
        config = read_cell_file(path)
        async with open_retrying(config.robot_named("fanuc")):
            pass  # the controller answers
        quarter = math.radians(25.0)
        hands = PendantHands(
            fake_client, [(AXIS + 1, 0.1), (AXIS + 1, -0.1), (AXIS, quarter)], [MISTYPED, 600]
        )
        async with open_cell(config, hands, "fanuc") as cell:
            assert cell.jogs is None
            await jog_by_hand(cell, HandJog(AXIS, quarter, 0.035, math.radians(0.5)))
            assert "J5 turned by +5.73 deg and should have stood." in hands.texts[1]
            assert len(hands.texts) == 3
            assert {values["axis"] for values in hands.guidance} == {AXIS, AXIS + 1}
            assert "wrong_axis" in {values["advice"] for values in hands.guidance}

            store = motor_store(cell)
            before = (await store.read_mastering()).counts_at_zero
            goal = (*before[:2], before[2] + MISTYPED + 600, *before[3:])
            assert await store.write_mastering(goal) == MasteringData(goal, mastered=True)
            assert f"J3 reads {goal[2] - 600}, not {goal[2]}" in hands.texts[-1]
