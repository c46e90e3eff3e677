"""A technician at the pendant who misjudges every jog by up to a fifth, and sometimes does something else."""

import re
from dataclasses import dataclass, field

import numpy as np

from cellcal.drivers.interfaces import Answer, Instruction, MasteringData
from tests.procedures.ideal_devices import IdealArm, ScriptedTechnician

JOG_RAD_S = float(np.deg2rad(2.0))
INSTRUCTION_S = 15.0
MISJUDGED = 0.2
_TURN = re.compile(r"turn J(\d) alone by ([+-][\d.]+) deg")
_BACK = re.compile(r"turn it back by ([+-][\d.]+) deg")
_JOINTS = re.compile(r"J(\d) (-?[\d.]+)")
_COUNTS = re.compile(r"J(\d) (-?\d+)")


@dataclass
class MisjudgingTechnician(ScriptedTechnician):
    """Jogs an ideal arm as the words say, wrongly; keeps the time that it takes. Seeded."""

    arm: IdealArm = field(default_factory=IdealArm)
    seed: int = 0
    wrong_axis: float = 0.03  # share of the instructions
    wrong_way: float = 0.03
    mistyped: float = 0.3
    guided_s: float = 0.0
    slips: list[str] = field(default_factory=list)

    def __post_init__(self) -> None:
        self._rng = np.random.default_rng([self.seed, 181])

    async def confirm(self, instruction: Instruction) -> Answer:
        """Do it more or less, then say yes."""
        self.guided_s += INSTRUCTION_S
        if instruction.key == "jog_by_hand":
            await self._jog_one(instruction.text)
        elif instruction.key == "move_by_hand":
            await self._jog_all(instruction.text)
        elif instruction.key == "type_mastering":
            self._type_counts(instruction.text)
        elif instruction.key == "clear_mastered_by_hand":
            self.arm.data = MasteringData(self.arm.data.counts_at_zero, mastered=False)
        return await super().confirm(instruction)

    async def _jog_one(self, text: str) -> None:
        turn = _TURN.search(text)
        assert turn is not None, text
        axis, angle_rad = int(turn[1]) - 1, np.deg2rad(float(turn[2]))
        if self._rng.random() < self.wrong_axis:
            axis = (axis + int(self._rng.integers(1, 6))) % 6
            self.slips.append("wrong axis")
        if self._rng.random() < self.wrong_way:
            angle_rad = -angle_rad
            self.slips.append("wrong way")
        await self._turn_axis(axis, angle_rad * self._misjudgement())
        if back := _BACK.search(text):
            await self._turn_axis(axis, np.deg2rad(float(back[1])) * self._misjudgement())

    async def _jog_all(self, text: str) -> None:
        """Bring all joints to the angles that the pendant shows, by way of the corners."""
        for corner in re.split(r"; (?:to|then) ", text.rpartition("bring the robot ")[2]):
            joints = dict(_JOINTS.findall(corner.removeprefix("by way of ")))
            shown = (await self.arm.read_joints()).joints_rad
            for name, angle in joints.items():
                axis = int(name) - 1
                left_rad = np.deg2rad(float(angle)) - shown[axis]
                if abs(left_rad) > np.deg2rad(0.1):
                    await self._turn_axis(axis, left_rad * self._misjudgement())

    def _type_counts(self, text: str) -> None:
        table = text.partition("type the master counts ")[2].partition(". Make")[0]
        counts = [int(count) for _, count in _COUNTS.findall(table)]
        assert len(counts) == 6
        if self._rng.random() < self.mistyped:
            digits = [*str(counts[axis := int(self._rng.integers(6))])]
            place = int(self._rng.integers(1, len(digits)))
            digits[place] = str((int(digits[place]) + 1) % 10)
            counts[axis] = int("".join(digits))
            self.slips.append("mistyped")
        self.arm.data = MasteringData(tuple(counts), mastered=True)

    def _misjudgement(self) -> float:
        return 1.0 + float(self._rng.uniform(-MISJUDGED, MISJUDGED))

    async def _turn_axis(self, axis: int, angle_rad: float) -> None:
        commanded = list(self.arm.moves)
        self.guided_s += abs(angle_rad) / JOG_RAD_S
        await self.arm.jog_axis(axis, float(angle_rad), speed_rad_s=JOG_RAD_S)
        self.arm.moves = commanded  # by hand: not commanded
