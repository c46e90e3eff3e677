"""Technicians with a pendant: they bring an ideal arm to where an instruction asks for it, more or less well."""

import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from cellcal.drivers.interfaces import Answer, Instruction
from tests.procedures.ideal_devices import IdealArm, ScriptedTechnician

_JOINTS = re.compile(r"J(\d) (-?[\d.]+)")
_TURN = re.compile(r"turn J(\d) alone by ([+-][\d.]+) deg")
_SCRIPT = re.compile(r"movej\(\[([^\]]*)\]")


@dataclass
class PendantTechnician(ScriptedTechnician):
    """Does what it is told with the arm, a little beside it; or runs the program that it is told to load."""

    arm: IdealArm | None = None
    beside_rad: float = 0.0
    texts: tuple[str, ...] = ()

    async def confirm(self, instruction: Instruction) -> Answer:
        """Move first, then say yes."""
        assert self.arm is not None
        self.texts += (instruction.text,)
        if instruction.key == "move_by_hand":
            self.arm.write_program(self._target_joints(instruction.text) + self.beside_rad)
        elif turn := _TURN.search(instruction.text):
            await self._turn_axis(int(turn[1]) - 1, np.deg2rad(float(turn[2])))
        return await super().confirm(instruction)

    def _target_joints(self, text: str) -> np.ndarray:
        if loaded := re.search(r"Load the program (\S+)", text):
            corners = _SCRIPT.findall(Path(loaded[1]).read_text())
            return np.array([float(q) for q in corners[-1].split(",")])
        joints = _JOINTS.findall(text.rpartition(" to ")[2])
        assert [axis for axis, _ in joints] == list("123456")
        return np.deg2rad([float(angle) for _, angle in joints])

    async def _turn_axis(self, axis: int, angle_rad: float) -> None:
        assert self.arm is not None
        jogged = list(self.arm.moves)
        await self.arm.jog_axis(axis, float(angle_rad), speed_rad_s=0.03)
        self.arm.moves = jogged  # by hand: not commanded
