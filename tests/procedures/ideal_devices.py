"""Hand-written devices for fast tests of procedures: an arm that obeys exactly, a wire, and willing hands.

They implement the interfaces and keep a truth that no procedure can reach. What they leave out (sockets,
flexible links, noise that a model does not know) is the business of the fake devices.
"""

import asyncio
import hashlib
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from cellcal.calibration.arm.kinematics import RobotModel, load_model
from cellcal.calibration.geometry import Pose
from cellcal.calibration.mastering.counts import DriveTrain
from cellcal.drivers.errors import RefusedError
from cellcal.drivers.interfaces import (
    ActiveFrames,
    Alarm,
    AlarmKind,
    Answer,
    Condition,
    Counts,
    GaugeCapabilities,
    Identity,
    Instruction,
    JointReading,
    Joints,
    LengthReading,
    MasteringData,
    PointReading,
    Question,
    Readiness,
    RobotCapabilities,
    TrackerCapabilities,
)

COUNTS = 2**19
RATIOS = (121.0, 153.0, 160.5, 80.25, 80.0, 50.0)
ZERO: Counts = (1_000_003, -500_007, 250_013, 125_017, -62_501, 31_259)


def drive_train() -> DriveTrain:
    """Return gears with the wrist coupling of an ordinary arm."""
    per_turn = np.diag(2 * np.pi / np.array(RATIOS))
    per_turn[4, 3], per_turn[5, 3], per_turn[5, 4] = 0.0125, -0.0111, 0.0213
    rows = per_turn / COUNTS
    return DriveTrain(tuple(tuple(float(v) for v in row) for row in rows), (COUNTS,) * 6)


@dataclass
class IdealArm:
    """An arm with encoders that can lose their turns. ``true_counts`` never lie; the controller may."""

    model: RobotModel = field(default_factory=lambda: load_model("fanuc_m6ib"))
    drive: DriveTrain = field(default_factory=drive_train)
    serial: str = "F-1"
    name: str = "arm"
    true_zero: Counts = ZERO
    true_counts: Counts = ZERO
    lost_turns: Counts = (0,) * 6
    data: MasteringData = field(default_factory=lambda: MasteringData(ZERO, True))
    epoch: int = 3
    battery_flat: bool = False
    unestablished: set[int] = field(default_factory=set)
    tools: dict[int, Pose] = field(default_factory=dict)
    frames: dict[int, Pose] = field(default_factory=dict)
    active_tool: int = 1
    user_frame: int = 0
    payload_kg: float | None = 1.5
    taught: Pose | None = None  # where the technician has put the flange
    moves: list[str] = field(default_factory=list)
    stops: int = 0
    writes: int = 0
    override: float = 1.0
    moving: bool = False
    axis_names: tuple[str, ...] = ()
    midway: Callable[[int], None] | None = None  # told the number of a move, from 1, in the middle of it

    @property
    def capabilities(self) -> RobotCapabilities:
        return RobotCapabilities(
            axes=6,
            axis_names=self.axis_names,
            jogs_single_axes=True,
            reads_encoder_counts=True,
            reads_mastering=True,
            writes_mastering=True,
            writes_tool_frame=True,
            writes_user_frame=True,
            tells_active_frames=True,
            tells_mode=True,
            tells_speed_override=True,
        )

    def lose_encoders(self, turns: Counts) -> None:
        """Let the battery die: turns are forgotten; each motor must pass its index before it is believed."""
        self.lost_turns = tuple(a + b for a, b in zip(self.lost_turns, turns, strict=True))
        self.data = MasteringData(self.data.counts_at_zero, mastered=False)
        self.battery_flat, self.unestablished = True, set(range(6))
        self.epoch += 1

    def power_cycle(self) -> None:
        """Switch off and on: a new battery holds, and the controller counts a new epoch."""
        self.battery_flat = False
        self.epoch += 1

    @property
    def true_joints(self) -> np.ndarray:
        return self.drive.to_joints(np.array(self.true_counts), np.array(self.true_zero))

    def write_program(self, joints_rad: np.ndarray) -> None:
        """Place the arm, as a technician would with the pendant."""
        turns = np.linalg.solve(np.array(self.drive.radians_per_count), joints_rad)
        self.true_counts = tuple(int(c) for c in np.rint(turns) + np.array(self.true_zero))

    async def identify(self) -> Identity:
        await asyncio.sleep(0)
        return Identity("ideal", self.model.name, self.serial, "1.0")

    async def read_condition(self) -> Condition:
        await asyncio.sleep(0)
        if self.battery_flat:
            alarms = tuple(
                Alarm("SRVO-062", f"BZAL alarm (Group:1 Axis:{k + 1})", k, AlarmKind.TURNS) for k in range(6)
            )
            return Condition(Readiness.POSITION_LOST, "encoder battery", "exchange it", alarms)
        if self.unestablished:
            alarms = tuple(
                Alarm("SRVO-075", "Pulse not established", k, AlarmKind.TURNS)
                for k in sorted(self.unestablished)
            )
            return Condition(Readiness.POSITION_LOST, "pulse not established", "jog", alarms)
        if not self.data.mastered:
            return Condition(Readiness.POSITION_LOST, "not mastered", "master it")
        return Condition(Readiness.READY)

    async def read_joints(self) -> JointReading:
        believed = self.drive.to_joints(
            np.array(await self.encoder_counts()), np.array(self.data.counts_at_zero)
        )
        now_s = asyncio.get_running_loop().time()
        return JointReading(tuple(float(v) for v in believed), self.moving, now_s)

    async def flange_pose(self) -> Pose:
        if self.taught is not None:
            return self.taught
        joints = np.array((await self.read_joints()).joints_rad)
        return Pose.from_matrix(self.model.base_flange(joints[None])[0])

    async def move_joints(self, target_rad: Joints, *, speed_rad_s: float) -> None:
        if not self.data.mastered:
            raise RefusedError(self.name, "not mastered")
        believed = np.array((await self.read_joints()).joints_rad)
        await self._travel_by(np.array(target_rad) - believed, "move")

    async def jog_axis(self, axis: int, delta_rad: float, *, speed_rad_s: float) -> None:
        if self.battery_flat:
            raise RefusedError(self.name, "battery alarm")
        delta = np.zeros(6)
        delta[axis] = delta_rad
        before = np.array(self.true_counts)
        await self._travel_by(delta, f"jog {axis}")
        if abs(self.true_counts[axis] - before[axis]) >= COUNTS:
            self.unestablished.discard(axis)

    async def _travel_by(self, delta: np.ndarray, name: str) -> None:
        self.moves.append(name)
        start = self.true_joints
        self.moving = True
        try:
            await asyncio.sleep(0)
            self.write_program(start + delta / 2)
            if self.midway is not None:
                self.midway(len(self.moves))
            await asyncio.sleep(0)
            self.write_program(start + delta)
        finally:
            self.moving = False

    async def stop(self) -> None:
        self.stops += 1
        await asyncio.sleep(0)

    async def encoder_counts(self) -> Counts:
        await asyncio.sleep(0)
        lost = zip(self.true_counts, self.lost_turns, self.drive.counts_per_turn, strict=True)
        return tuple(count - turns * per_turn for count, turns, per_turn in lost)

    async def read_mastering(self) -> MasteringData:
        await asyncio.sleep(0)
        return self.data

    async def drive_train(self) -> DriveTrain:
        await asyncio.sleep(0)
        return self.drive

    async def encoder_epoch(self) -> int:
        await asyncio.sleep(0)
        return self.epoch

    async def write_mastering(self, counts_at_zero: Counts) -> MasteringData:
        if self.battery_flat or self.unestablished:
            raise RefusedError(self.name, "pulse not established")
        self.writes += 1
        self.data = MasteringData(tuple(counts_at_zero), mastered=True)
        return self.data

    async def restore_mastering(self, data: MasteringData) -> MasteringData:
        await asyncio.sleep(0)
        self.writes += 1
        self.data = data
        return self.data

    async def reset_position_alarms(self) -> None:
        await asyncio.sleep(0)

    async def read_tool_frame(self, number: int) -> Pose:
        await asyncio.sleep(0)
        return self.tools.get(number, Pose((0.0, 0.0, 0.0)))

    async def write_tool_frame(self, number: int, flange_tool: Pose) -> Pose:
        self.writes += 1
        self.tools[number] = flange_tool
        return flange_tool

    async def active_frames(self) -> ActiveFrames:
        tool = await self.read_tool_frame(self.active_tool)
        return ActiveFrames(self.active_tool, tool, self.user_frame, self.payload_kg)

    async def controller_mode(self) -> str:
        return "AUTO"

    async def speed_override(self) -> float:
        await asyncio.sleep(0)
        return self.override

    async def read_user_frame(self, number: int) -> Pose:
        await asyncio.sleep(0)
        return self.frames.get(number, Pose((0.0, 0.0, 0.0)))

    async def write_user_frame(self, number: int, base_user: Pose) -> Pose:
        self.writes += 1
        self.frames[number] = base_user
        return base_user


@dataclass
class IdealWire:
    """A draw-wire from a fixed point to the arm. Its noise depends on the place: a run can be repeated."""

    arm: IdealArm
    anchor_in_base_m: tuple[float, float, float] = (0.903, -0.696, -0.447)
    hook_in_flange_m: tuple[float, float, float] = (0.0605, 0.0493, 0.1208)
    zero_m: float = 0.0021
    noise_m: float = 0.0001
    name: str = "wire"
    serial: str = "W-1"
    kink_m: dict[int, float] = field(default_factory=dict)  # added to the n-th reading
    kink_at: tuple[tuple[float, ...], float] | None = None  # joints [rad], and what is added there [m]
    readings: int = 0

    @property
    def capabilities(self) -> GaugeCapabilities:
        return GaugeCapabilities(range_m=3.0, resolution_m=1e-5, sigma_m=2e-4)

    async def identify(self) -> Identity:
        await asyncio.sleep(0)
        return Identity("ideal", "wire", self.serial, "1.0")

    async def read_condition(self) -> Condition:
        await asyncio.sleep(0)
        return Condition(Readiness.READY)

    async def read_distance(self) -> LengthReading:
        await asyncio.sleep(0)
        joints = self.arm.true_joints
        tip = self.arm.model.tip_positions(joints[None], np.array(self.hook_in_flange_m))[0]
        length = float(np.linalg.norm(tip - np.array(self.anchor_in_base_m))) + self.zero_m
        digest = hashlib.sha256(repr([round(float(q), 4) for q in joints]).encode()).digest()
        noise = (sum(digest[:12]) - 12 * 127.5) / (12**0.5 * 73.9) * self.noise_m
        value = length + noise + self.kink_m.get(self.readings, 0.0)
        if self.kink_at is not None and np.allclose(joints, self.kink_at[0], atol=1e-3):
            value += self.kink_at[1]
        self.readings += 1
        return LengthReading(value, 2e-4, 0.0, round(value * 1e5))


@dataclass
class IdealTracker:
    """A tracker beside the arm. Its noise depends on the place: a run can be repeated."""

    arm: IdealArm
    target_in_flange_m: tuple[float, float, float] = (0.0806, 0.0393, 0.1004)
    base_tracker: Pose = field(default_factory=lambda: Pose((2.5, -1.5, 0.6), (0.8, 0.0, 0.0, 0.6)))
    noise_m: float = 0.00002
    station: int = 1
    name: str = "tracker"
    serial: str = "T-1"
    readings: int = 0

    @property
    def capabilities(self) -> TrackerCapabilities:
        return TrackerCapabilities(measures_poses=False, range_m=20.0, sigma_m=2e-5)

    async def identify(self) -> Identity:
        await asyncio.sleep(0)
        return Identity("ideal", "tracker", self.serial, "1.0")

    async def read_condition(self) -> Condition:
        await asyncio.sleep(0)
        return Condition(Readiness.READY)

    async def measure_point(self) -> PointReading:
        await asyncio.sleep(0)
        joints = self.arm.true_joints
        target = self.arm.model.tip_positions(joints[None], np.array(self.target_in_flange_m))[0]
        digest = hashlib.sha256(repr([round(float(q), 4) for q in joints]).encode()).digest()
        noise = (np.frombuffer(digest[:12], dtype=np.uint8).reshape(3, 4).sum(axis=1) - 510.0) / 148.0
        there = target + noise * self.noise_m - np.array(self.base_tracker.position_m)
        x, y, z = (float(v) for v in self.base_tracker.rotation_matrix().T @ there)
        self.readings += 1
        return PointReading((x, y, z), (2e-5, 2e-5, 2e-5), 0.0, self.station)


@dataclass
class ScriptedTechnician:
    """A technician. ``does`` maps an instruction's key to an action; ``refuses`` are the noes."""

    does: dict[str, Callable[[], object]] = field(default_factory=dict)
    refuses: set[str] = field(default_factory=set)
    knows: dict[str, str] = field(default_factory=dict)
    instructions: list[str] = field(default_factory=list)
    read: dict[str, str] = field(default_factory=dict)  # the words last read under each key

    async def confirm(self, instruction: Instruction) -> Answer:
        self.instructions.append(instruction.key)
        self.read[instruction.key] = instruction.text
        await asyncio.sleep(0)
        if instruction.key in self.refuses:
            raise RefusedError("operator", "no")
        self.does.get(instruction.key, lambda: None)()
        return Answer("anna")

    async def ask_question(self, question: Question) -> Answer:
        self.instructions.append(question.key)
        self.read[question.key] = question.text
        return Answer("anna", self.knows[question.key])
