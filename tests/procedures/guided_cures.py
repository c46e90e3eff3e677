"""Lost positions of an ABB, a Yaskawa and a KUKA, brought back by a technician at the simulated pendant over the wire."""

import asyncio
import math
import re
from collections.abc import AsyncIterator, Iterator
from contextlib import asynccontextmanager, contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from cellcal.calibration.errors import CellError
from cellcal.calibration.mastering.position_record import ArmPositionRecord
from cellcal.calibration.uncertainty import Verdict
from cellcal.drivers.interfaces import Answer, Instruction, Question
from cellcal.procedures.cell import Cell
from cellcal.procedures.position_cure import DEFINITION, PositionCureSpec, position_cure
from cellcal.procedures.position_record import position_record
from cellcal.procedures.recovery.cure_result import PositionCureResult
from cellcal.procedures.run import Run
from cellcal.procedures.verdict import ProcedureVerdict
from cellcal.service.configuration.cell_file import CellConfig, read_cell_file
from cellcal.service.demo.fake_cell_client import FakeCellClient
from cellcal.service.runs.open_cell import open_cell
from cellcal.service.runs.settings import build_spec
from tests.cell_tables import cell_head, draw_wire_table, fake_table, robot_table
from tests.procedures.memory_ledgers import MemoryLedger
from tests.wire.fake_devices_process import run_fakes

_AXIS = re.compile(r"Axis (\w+):")
_JOINT = re.compile(r"\b[A-Z]\d?\s(-?[\d.]+)(?=,|$)")
_TURN = re.compile(r"turn (\w+) alone by ([+-][\d.]+) deg")
_BACK = re.compile(r"turn it back by ([+-][\d.]+) deg")
LOOK_S = 0.02  # between the looks of the guidance
_FORMS: dict[str, dict[str, Any]] = {
    "abb": {
        "driver": "abb_web_services",
        "port": 8080,
        "model": "abb_irb1600_6_12",
        "serial": "1600-500123",
    },
    "kuka": {
        "driver": "kuka_variables",
        "model": "kuka_kr10r1420",
        "serial": "864231",
        "fastest_axis_deg_s": 410.0,
    },
    "yaskawa": {
        "driver": "yaskawa",
        "model": "yaskawa_gp25",
        "serial": "Y-230815",
        "controller_type": "1-06VX25-A0*",
        "pulses_per_degree": [1341.4, 1341.4, -1341.4, 1000.0, 1000.0, -622.2],
        "fastest_axis_deg_s": 885.0,
    },
}
BRANDS = tuple(_FORMS)
AXES = {
    "abb": ("1", "2", "3", "4", "5", "6"),
    "yaskawa": tuple("SLURBT"),
    "kuka": ("A1", "A2", "A3", "A4", "A5", "A6"),
}
JOINT_NAMES = AXES | {"abb": ("J1", "J2", "J3", "J4", "J5", "J6")}  # where a sentence tells a turn or a place
MOTION = {"abb": "commanded", "yaskawa": "commanded", "kuka": "observe"}  # KUKA moves no slower than 1 %
LOSS = {"abb": "counters_lost", "yaskawa": "battery_loss", "kuka": "mastering_lost"}


@dataclass
class PendantWorker:
    """Operator at the pendant of one simulated robot. ``slips_rad`` is how far beside its mark an axis is left."""

    brand: str
    fake_client: FakeCellClient
    slips_rad: dict[int, float] = field(default_factory=dict)
    by_dial: set[int] = field(default_factory=set)  # KUKA: mastered where it stands, no notch is looked for
    zero: str = "kept"
    forgets: set[int] = field(default_factory=set)  # says yes once without having done the work
    instructions: list[tuple[str, str]] = field(default_factory=list)
    rng: np.random.Generator = field(default_factory=lambda: np.random.default_rng(26))

    async def confirm(self, instruction: Instruction) -> Answer:
        self.instructions.append((instruction.key, str(instruction.text)))
        if instruction.key.startswith("bring_back_"):
            await self._bring_back(str(instruction.text))
        elif instruction.key == "near_record_pose":
            await self._bring_near(str(instruction.text))
        elif instruction.key == "position_still_lost":
            await self._send("reset_alarm")
        elif instruction.key == "jog_by_hand":
            await self._jog_one(str(instruction.text))
        elif instruction.key == "move_by_hand":
            await self._show(str(instruction.text).rpartition(" to ")[2])
        return Answer("anna")

    async def ask_question(self, question: Question) -> Answer:
        raise AssertionError(question)

    async def _bring_back(self, text: str) -> None:
        named = _AXIS.search(text)
        assert named is not None, text
        axis = AXES[self.brand].index(named[1])
        if axis in self.forgets:
            self.forgets.discard(axis)
            return
        await self._send({"abb": "manual_mode", "yaskawa": "teach_mode", "kuka": "t1_mode"}[self.brand])
        joints = (await self.read_truth())["joints_rad"]
        joints[axis] = self.slips_rad.get(axis, 0.0)
        await self._send("hand_moves", joints=joints)
        work = {
            "abb": "update_counter" if self.zero == "kept" else "fine_calibrate",
            "yaskawa": "type_absolute_data" if self.zero == "kept" else "make_home",
            "kuka": "master_with_dial" if axis in self.by_dial else "master_with_gauge",
        }
        await self._send(work[self.brand], axis=named[1])

    async def _bring_near(self, text: str) -> None:
        await self._show(text.partition("shows the joints: ")[2])
        if self.brand == "yaskawa":
            await self._send("remote_mode")
            await self._send("reset_alarm")
        elif self.brand == "abb":
            await self._send("auto_mode")

    async def _show(self, text: str) -> None:
        """Jog until the pendant shows the joints with which the text begins."""
        shown = np.radians([float(word) for word in _JOINT.findall(text.partition(" deg")[0])])
        error = np.array((await self.read_truth())["error_rad"])
        await self._send("hand_moves", joints=(shown - error).tolist())

    async def _jog_one(self, text: str) -> None:
        turn, back = _TURN.search(text), _BACK.search(text)
        assert turn is not None, text
        axis, wrong = self._axis_of(turn[1]), float(self.rng.uniform(0.9, 1.1))
        legs = [math.radians(float(turn[2])) * wrong]
        if back is not None:
            legs.append(math.radians(float(back[1])) * wrong)
        for leg in legs:
            joints = (await self.read_truth())["joints_rad"]
            joints[axis] += leg
            await self._send("hand_moves", joints=joints)
            await asyncio.sleep(5 * LOOK_S)  # an arm that turns is seen on its way

    def _axis_of(self, name: str) -> int:
        """Return the axis that an instruction names as the maker's pendant does."""
        return JOINT_NAMES[self.brand].index(name)

    async def read_truth(self) -> dict[str, Any]:
        """Return the truth about the robot."""
        return dict((await self.fake_client.read_truth())["robots"]["robot"])

    async def lose_position(self, axes: tuple[int, ...]) -> None:
        """Let the position of some axes be lost."""
        await self._send(LOSS[self.brand], axes=[AXES[self.brand][axis] for axis in axes])

    async def mend(self) -> None:
        """Make the robot healthy again, whatever was done to it."""
        if self.brand == "yaskawa":
            for event in ("confirm_positions", "remote_mode", "release_emergency_stop", "reset_alarm"):
                await self._send(event)
        else:
            await self._send("mend")

    async def _send(self, event: str, **parameters: Any) -> None:
        await self.fake_client.inject_fault(event, device="robot", **parameters)


@dataclass
class GuidedBench:
    """One simulated robot with its technician, its opened cell and its record."""

    config: CellConfig
    cell: Cell
    hands: PendantWorker
    record: ArmPositionRecord | None = None

    async def take_record(self, **settings: Any) -> ArmPositionRecord:
        """Take the position record of the healthy robot."""
        spec = build_spec(self.config, "robot", "position_record", {"poses": 24, "samples": 2, **settings})
        result = await position_record(Run(self.cell, MemoryLedger()), spec)
        self.record = result.record
        return result.record

    async def turn_rad(self) -> np.ndarray:
        """Return by how much one turn of each motor turns its joint."""
        assert self.cell.shown_motors is not None
        drive = await self.cell.shown_motors.drive_train()
        return np.abs(np.diag(drive.radians_per_turn()))

    async def bring_back(self, **settings: Any) -> tuple[PositionCureResult, ProcedureVerdict]:
        """Run the cure; return its result and what it claims."""
        spec = build_spec(self.config, "robot", "position_cure", {"samples": 2, **settings})
        cell = replace(self.cell, position_record=self.record)
        result = await position_cure(Run(cell, MemoryLedger()), spec)
        assert DEFINITION.verdict is not None
        return result, DEFINITION.verdict(spec, result)


@asynccontextmanager
async def guided_bench(folder: Path, brand: str, seed: int = 1) -> AsyncIterator[GuidedBench]:
    """Play a robot with its wire in another process and open its cell."""
    with guided_fakes(folder, brand, seed) as (path, hands):
        config = read_cell_file(path)
        async with open_cell(config, hands) as cell:
            watched = replace(cell, limits=replace(cell.limits, look_s=LOOK_S))
            yield GuidedBench(config, watched, hands)


@contextmanager
def guided_fakes(folder: Path, brand: str, seed: int = 1) -> Iterator[tuple[Path, PendantWorker]]:
    """Play a robot with its wire in another process; yields the cell file and who stands at the pendant."""
    robot = robot_table(
        name="robot",
        motion=MOTION[brand],
        motor_turns_per_joint_turn=[120.0, -100.0, 105.0, 80.0, -81.0, 50.0],
        deadline_s=6.0,
        step_s=5.0,
        settle_s=0.01,
        **_FORMS[brand],
    )
    wire = draw_wire_table(deadline_s=3.0, heartbeat_s=2.0, robot="robot")
    world = fake_table(watchdog_factor=10.0, seed=seed, time_factor=600.0)
    text = cell_head("guided") + robot + wire + world
    with run_fakes(folder, text) as (path, fake_client):
        yield path, PendantWorker(brand, fake_client)


@dataclass(frozen=True, slots=True)
class CureScenario:
    """What is lost and how the work at the pendant goes wrong; turns and angles by 0-based axis."""

    lost: tuple[int, ...]
    slips_rad: dict[int, float]
    wrong: tuple[int, ...]


@dataclass(frozen=True, slots=True)
class CureOutcome:
    """How a scenario ended, told against the truth."""

    word: str  # pass, fail, undecided, or refused
    is_wrong_accept: bool
    names_truth: bool  # every axis is told as it is
    captures: int
    reason: str = ""


def draw_scenario(brand: str, seed: int, turn_rad: np.ndarray, *, goes_wrong: bool) -> CureScenario:
    """Return what happens in a seed: the axes lost, how each mark is misjudged, and what is whole turns off."""
    rng = np.random.default_rng([seed, BRANDS.index(brand), 26])
    lost = tuple(sorted(int(a) for a in rng.choice(6, int(rng.integers(1, 7)), replace=False)))
    slips = {axis: float(rng.uniform(-0.35, 0.35) * turn_rad[axis]) for axis in lost}
    wrong: tuple[int, ...] = ()
    if brand == "kuka":
        slips = {axis: float(rng.uniform(-0.01, 0.01)) for axis in lost}
    if goes_wrong:
        wrong = tuple(
            sorted(int(a) for a in rng.choice(lost, min(len(lost), int(rng.integers(1, 3))), replace=False))
        )
        for axis in wrong:
            turns = int(rng.integers(1, 3)) * int(rng.choice([-1, 1]))
            whole = brand != "kuka" or rng.random() < 0.5
            slips[axis] = turns * turn_rad[axis] * (1.0 if whole else float(rng.uniform(0.2, 0.8))) + (
                0.0 if brand == "kuka" else slips[axis]
            )
    return CureScenario(lost, slips, wrong)


async def play_scenario(bench: GuidedBench, scenario: CureScenario, **settings: Any) -> CureOutcome:
    """Bring a robot back as the scenario has it, and compare what is claimed with the truth."""
    hands = bench.hands
    hands.slips_rad, hands.by_dial = dict(scenario.slips_rad), set(scenario.wrong)
    try:
        result, verdict = await bench.bring_back(**settings)
    except CellError as error:
        return CureOutcome("refused", False, True, 0, f"{error.code}: {error.message}")
    error_rad = np.array((await hands.read_truth())["error_rad"])
    limit = PositionCureSpec().limit_rad
    is_off = np.abs(error_rad) > (limit if hands.brand == "kuka" else 1e-9)
    word = verdict.overall_decision.value
    events = [
        abs(axis.offset_rad + error) <= max(2.0 * axis.u_rad, axis.hidden_rad, 1e-6)
        for axis, error in zip(result.axes, error_rad, strict=True)
    ]
    accepted_wrong = verdict.overall_decision is Verdict.PASS and bool(is_off.any())
    return CureOutcome(
        word, accepted_wrong, all(events), result.captures + result.check_captures, result.reason
    )


def degrees_text(values: Any) -> str:
    """Return angles in degrees for a message."""
    return ", ".join(f"{math.degrees(value):+.3f}" for value in values)
