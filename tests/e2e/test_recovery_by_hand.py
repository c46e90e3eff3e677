"""A recovery of a controller that neither jogs nor takes a mastering by wire: a person at its pendant does both."""

import asyncio
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from cellcal.drivers.interfaces import Answer, Instruction, Readiness
from cellcal.service.configuration.cell_file import CellConfig, read_cell_file
from cellcal.service.demo.fake_cell import free_address, running_fakes, write_cell_file
from cellcal.service.demo.fake_cell_client import FakeCellClient
from cellcal.service.demo.simulated_technician import SimulatedTechnician
from cellcal.service.record.journal import Journal
from cellcal.service.record.journal_files import open_journal
from cellcal.service.record.run_outcome import RunOutcome, RunVerdict
from cellcal.service.runs.open_cell import open_cell, with_robot_history
from cellcal.service.runs.run_procedure import run_procedure
from cellcal.service.runs.settings import build_spec
from tests.wire.driver_cases import until_ready, wait_until

MISJUDGED = 0.2
_TURN = re.compile(r"turn J(\d) alone by ([+-][\d.]+) deg")
_BACK = re.compile(r"turn it back by ([+-][\d.]+) deg")
_JOINTS = re.compile(r"J(\d) (-?[\d.]+)")
_COUNTS = re.compile(r"J(\d) (-?\d+)")


class PendantPerson(SimulatedTechnician):
    """Jogs as the words say, up to a fifth too far or too little; mistypes the first mastering."""

    def __init__(self, fake_cell: FakeCellClient) -> None:
        super().__init__(fake_cell, lambda _: None)
        self.keys: list[str] = []
        self.marks_rad: tuple[float, ...] = ()
        self._looked = asyncio.Event()
        self._rng = np.random.default_rng(5)

    async def confirm(self, instruction: Instruction) -> Answer:
        """Do it at the pendant, then say yes."""
        self.keys.append(instruction.key)
        if instruction.key == "jog_by_hand":
            await self._jog_axis(instruction.text)
        elif instruction.key == "at_reference":
            await self._bring_to_marks()
        elif instruction.key == "move_by_hand":
            await self._move_arm(instruction.text)
        elif instruction.key == "type_mastering":
            await self._type_counts(instruction.text)
        elif instruction.key == "reset_alarms_by_hand":
            await self.fake_cell.inject_fault("acknowledge_lost_position")
        return await super().confirm(instruction)

    def show_guidance(self, text: str, values: Mapping[str, Any]) -> None:
        """See what the screen says about the turn."""
        del text, values
        self._looked.set()

    async def _jog_axis(self, text: str) -> None:
        turn = _TURN.search(text)
        assert turn is not None, text
        for angle in (turn[2], *_BACK.findall(text)):
            wrongly = 1.0 + float(self._rng.uniform(-MISJUDGED, MISJUDGED))
            rad = float(np.radians(float(angle))) * wrongly
            await self.fake_cell.inject_fault("jog_by_hand", axis=f"J{turn[1]}", rad=rad)
            await wait_until(self._is_standing)
            self._looked.clear()
            await self._looked.wait()  # the screen shows what was turned before the key is changed

    async def _bring_to_marks(self) -> None:
        """Jog every axis to its witness mark, to about half a degree; possible only with drive power."""
        truth = (await self.fake_cell.read_truth())["robots"]["fanuc"]
        assert {alarm["code"] for alarm in truth["alarms"]} <= {"SRVO-075"}, "the drives have no power yet"
        for axis, (marked, stands) in enumerate(zip(self.marks_rad, truth["joints_rad"], strict=True), 1):
            rad = marked - stands + float(np.radians(self._rng.uniform(-0.5, 0.5)))
            await self.fake_cell.inject_fault("jog_by_hand", axis=f"J{axis}", rad=rad)
            await wait_until(self._is_standing)

    async def _move_arm(self, text: str) -> None:
        """Go by way of the corners: the last one makes every joint come from below."""
        for corner in re.split(r"; (?:to )?", text.rpartition("bring the robot ")[2]):
            joints = _JOINTS.findall(corner)
            assert [axis for axis, _ in joints] == list("123456"), text
            rad = [float(np.radians(float(angle))) for _, angle in joints]
            await self.fake_cell.inject_fault("hand_moves", joints=rad)

    async def _type_counts(self, text: str) -> None:
        counts = [int(count) for _, count in _COUNTS.findall(text.partition("type the master counts ")[2])]
        assert len(counts) == 6, text
        if self.keys.count("type_mastering") == 1:
            counts[4] += 10
        await self.fake_cell.inject_fault("type_mastering", counts=counts)

    async def _is_standing(self) -> bool:
        return not (await self.fake_cell.read_truth())["robots"]["fanuc"]["moving"]


def _cell_without_a_hand_on_the_axes(folder: Path, address: str) -> Path:
    path = write_cell_file(folder, address, seed=8, time_factor=1000.0)
    text = path.read_text(encoding="utf-8")
    changed = text.replace('"fanuc_hmi"', '"fanuc_tp"').replace(
        'motion = "commanded"', 'motion = "observe"', 1
    )
    path.write_text(changed, encoding="utf-8")
    return path


async def _run_procedure(config: CellConfig, cell: Any, journal: Journal, name: str) -> RunOutcome:
    with_history = await with_robot_history(cell, journal)
    return await run_procedure(with_history, name, build_spec(config, "fanuc", name, {}), journal)


async def test_lost_turns_are_recovered_by_jogging_and_typing_alone(tmp_path: Path) -> None:
    with free_address() as address:
        path = _cell_without_a_hand_on_the_axes(tmp_path, address)
    config = read_cell_file(path)
    async with running_fakes(path) as fake_cell:
        person = PendantPerson(fake_cell)
        with open_journal(config) as journal:
            async with open_cell(config, person, "fanuc") as cell:
                assert cell.is_jogged_by_hand
                record = await _run_procedure(config, cell, journal, "mastering_record")
                assert record.verdict is RunVerdict.PASSED, record.reason
                stored = (await with_robot_history(cell, journal)).record
                assert stored is not None
                person.marks_rad = stored.reference_joints_rad
                await fake_cell.inject_fault("battery_loss", device="fanuc")
                await until_ready(cell.robot, Readiness.POSITION_LOST)
                recovery = await _run_procedure(config, cell, journal, "mastering_recovery")
        truth = (await fake_cell.read_truth())["robots"]["fanuc"]
    assert recovery.verdict is RunVerdict.PASSED, recovery.reason
    assert truth["mastered"]
    assert truth["counts_at_zero"] == truth["true_counts_at_zero"]
    assert person.keys.count("type_mastering") == 2
    assert "jog_by_hand" in person.keys
