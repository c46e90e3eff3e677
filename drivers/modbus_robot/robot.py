"""A robot whose controller is reached through registers. See ``program.py`` for how it is made to move."""

import asyncio
import logging
import math
import time
from collections.abc import Iterator, Sequence
from contextlib import AbstractAsyncContextManager, contextmanager
from dataclasses import dataclass

import numpy as np

from cellcal.calibration.geometry import Pose
from cellcal.calibration.mastering.counts import DriveTrain
from cellcal.drivers.errors import BusyError, DeviceError, MotionStoppedError, RefusedError
from cellcal.drivers.interfaces import (
    ActiveFrames,
    Condition,
    Counts,
    Identity,
    JointReading,
    Joints,
    MasteringData,
    Readiness,
    RobotCapabilities,
)
from cellcal.drivers.modbus_robot.condition import judge, read_alarms
from cellcal.drivers.modbus_robot.frames import active_frames, flange_pose, read_frame, write_frame
from cellcal.drivers.modbus_robot.mastering import (
    read_drive_train,
    read_mastering,
    restore_mastering,
    write_mastering,
)
from cellcal.drivers.modbus_robot.panel import Block, Panel
from cellcal.drivers.modbus_robot.profile import Operation, Profile
from cellcal.drivers.modbus_robot.program import CellProgram, ProgramState, Request
from cellcal.drivers.wire.deadline import deadline

_LOG = logging.getLogger(__name__)
VERIFIED_ON: tuple[str, ...] = ()  # controller software this driver has run on; none yet, see README.md
_SLOWER = 1.5  # acceleration and joint coupling make a move longer than distance over speed
_RESET_NEEDS_MORE = (2, 6, 11)  # reasons after which condition() says what is still to be done


@dataclass(frozen=True, slots=True)
class MotionOptions:
    """What the cell file says about motion."""

    deadline_s: float
    speed_limit_rad_s: float
    settle_s: float
    motion_margin_s: float


def capabilities_of(profile: Profile) -> RobotCapabilities:
    """Return what a robot of this profile can do, known before it is reached."""
    return RobotCapabilities(
        axes=profile.axes,
        jogs_single_axes=True,
        reads_encoder_counts=True,
        writes_mastering=True,
        writes_tool_frame=True,
        writes_user_frame=True,
        tells_active_frames=True,
        tells_mode=True,
        tells_speed_override=True,
    )


class ModbusRobot:
    """Robot and all its optional abilities over one profile."""

    def __init__(self, panel: Panel, program: CellProgram, options: MotionOptions) -> None:
        self._panel, self._program, self._options = panel, program, options
        self._tolerance_rad = math.radians(panel.profile.limits.position_tolerance_deg)
        self._doing = ""

    @property
    def name(self) -> str:
        return self._panel.device

    @property
    def capabilities(self) -> RobotCapabilities:
        return capabilities_of(self._panel.profile)

    async def connect(self) -> None:
        """Connect, check the serial number, and note a controller nobody has tried yet."""
        await self._panel.link.open()
        firmware = (await self.identify()).firmware
        if not firmware.startswith(VERIFIED_ON):
            _LOG.warning("%s: not verified on controller software %r", self.name, firmware)

    async def close(self) -> None:
        """Hang up."""
        await self._panel.link.close()

    async def identify(self) -> Identity:
        async with self._deadline("asking who it is"):
            block = await self._panel.read("serial", "model", "firmware")
        return Identity(
            self._panel.profile.vendor, block.text("model"), block.text("serial"), block.text("firmware")
        )

    async def condition(self) -> Condition:
        try:
            async with self._deadline("asking its condition"):
                position, program = await self._status()
                return judge(position, program, await read_alarms(self._panel))
        except DeviceError as error:
            return Condition(Readiness.UNREACHABLE, error.message, error.remedy)

    async def joints(self) -> JointReading:
        async with self._deadline("reading the joints"):
            position, program = await self._status()
        return self._reading(position, program)

    async def flange_pose(self) -> Pose:
        async with self._deadline("reading the pose"):
            position, _ = await self._status()
            return await flange_pose(self._panel, position)

    async def move_joints(self, target_rad: Joints, *, speed_rad_s: float) -> None:
        with self._alone("move"):
            self._check_numbers(target_rad, self._panel.profile.axes, "target")
            speed = self._capped(speed_rad_s)
            position, _ = await self._status()
            distance = max(abs(np.subtract(target_rad, position.numbers("joints"))))
            await self._program.run(self._motion("move", 0, target_rad, speed, float(distance)))
            await self._settle(target_rad)

    async def stop(self) -> None:
        async with self._deadline("stopping", times=2):
            await self._program.halt()

    async def jog_axis(self, axis: int, delta_rad: float, *, speed_rad_s: float) -> None:
        with self._alone("jog"):
            self._check_numbers((delta_rad,), 1, "angle")
            if not 0 <= axis < self._panel.profile.axes:
                raise self._panel.refusal(f"there is no axis {axis + 1}.")
            drive = await read_drive_train(self._panel)
            position, _ = await self._status()
            speed = self._jog_speed(speed_rad_s, position)
            finding_index = any(entry.kind == "index" for _, entry in await read_alarms(self._panel))
            await self._program.run(self._motion("jog", axis, (delta_rad,), speed, abs(delta_rad)))
            turn_rad = float(np.abs(drive.radians_per_turn()[axis]).sum()) if finding_index else 0.0
            moved_rad = await self._moved(axis, drive, position.integers("counts"))
            if abs(moved_rad - delta_rad) > self._tolerance_rad + turn_rad:
                raise self._short(axis, abs(moved_rad - delta_rad))

    async def encoder_counts(self) -> Counts:
        async with self._deadline("reading the counts"):
            position, _ = await self._status()
        return position.integers("counts")

    async def mastering(self) -> MasteringData:
        async with self._deadline("reading the mastering"):
            return await read_mastering(self._panel)

    async def drive_train(self) -> DriveTrain:
        async with self._deadline("reading the drive data"):
            return await read_drive_train(self._panel)

    async def encoder_epoch(self) -> int:
        async with self._deadline("reading the encoder epoch"):
            return (await self._panel.read("epoch")).integer("epoch")

    async def write_mastering(self, counts_at_zero: Counts) -> MasteringData:
        with self._alone("mastering"):
            self._check_numbers(counts_at_zero, self._panel.profile.axes, "counts")
            within_s = self._options.deadline_s
            return await write_mastering(self._panel, self._program, counts_at_zero, within_s=within_s)

    async def restore_mastering(self, data: MasteringData) -> MasteringData:
        with self._alone("mastering"):
            self._check_numbers(data.counts_at_zero, self._panel.profile.axes, "counts")
            within_s = self._options.deadline_s
            return await restore_mastering(self._panel, self._program, data, within_s=within_s)

    async def reset_position_alarms(self) -> None:
        with self._alone("reset"):
            if any(entry.kind == "lost" for _, entry in await read_alarms(self._panel)):
                await self._panel.write({"acknowledge": (1,)})
            try:
                await self._program.run(Request("reset_alarms", within_s=self._options.deadline_s))
            except RefusedError as error:
                if error.vendor_code not in _RESET_NEEDS_MORE:
                    raise

    async def read_tool_frame(self, number: int) -> Pose:
        async with self._deadline("reading a tool frame"):
            return await read_frame(self._panel, "tool", number)

    async def write_tool_frame(self, number: int, flange_tool: Pose) -> Pose:
        with self._alone("tool frame"):
            async with self._deadline("writing a tool frame"):
                return await write_frame(self._panel, "tool", number, flange_tool)

    async def read_user_frame(self, number: int) -> Pose:
        async with self._deadline("reading a user frame"):
            return await read_frame(self._panel, "user", number)

    async def write_user_frame(self, number: int, base_user: Pose) -> Pose:
        with self._alone("user frame"):
            async with self._deadline("writing a user frame"):
                return await write_frame(self._panel, "user", number, base_user)

    async def active_frames(self) -> ActiveFrames:
        async with self._deadline("reading the active tool"):
            # selections need no look at the program's counter: a run also begins while it does not run
            return await active_frames(self._panel, await self._panel.block("position"))

    async def controller_mode(self) -> str:
        async with self._deadline("reading the mode"):
            _, program = await self._status()
            return program.mode_name

    async def speed_override(self) -> float:
        async with self._deadline("reading the speed override"):
            return (await self._panel.read("override")).numbers("override")[0]

    async def _status(self) -> tuple[Block, ProgramState]:
        """Read position and counts between two looks at the program's counter."""
        before = await self._program.look()
        position = await self._panel.block("position")
        return position, await self._program.newer_than(before)

    def _reading(self, position: Block, program: ProgramState) -> JointReading:
        if position.integer("joints_valid") != 1:
            raise RefusedError(
                self.name,
                "the controller does not know its joint angles.",
                remedy="Recover the mastering first.",
            )
        return JointReading(
            joints_rad=position.numbers("joints"),
            moving=program.moving,
            taken_at_s=time.monotonic(),
            raw=position.hex("joints") + position.hex("counts"),
        )

    async def _settle(self, target_rad: Joints) -> None:
        await asyncio.sleep(self._options.settle_s)
        reading = await self.joints()
        errors = np.abs(np.subtract(reading.joints_rad, target_rad))
        if reading.moving or float(errors.max()) > self._tolerance_rad:
            raise self._short(int(errors.argmax()), float(errors.max()))

    async def _moved(self, axis: int, drive: DriveTrain, before: Counts) -> float:
        """Return how far an axis has turned, by the counts: they are there without mastering too.

        While a motor has not found its index, its count may jump by a part of a turn when it does.
        """
        await asyncio.sleep(self._options.settle_s)
        position, program = await self._status()
        if program.moving:
            raise MotionStoppedError(
                self.name,
                "the arm moves although its jog is done.",
                remedy="Make sure that nobody else commands the robot, then repeat the step.",
            )
        return float(drive.joints(np.array(position.integers("counts")), np.array(before))[axis])

    def _short(self, axis: int, error_rad: float) -> MotionStoppedError:
        return MotionStoppedError(
            self.name,
            f"axis {axis + 1} ended {math.degrees(error_rad):.2f} deg from its target.",
            remedy="Look whether something blocks the arm, then repeat the step.",
        )

    def _capped(self, speed_rad_s: float) -> float:
        self._check_numbers((speed_rad_s,), 1, "speed")
        if speed_rad_s <= 0:
            raise self._panel.refusal("a speed must be above zero.")
        return min(speed_rad_s, self._options.speed_limit_rad_s)

    def _jog_speed(self, speed_rad_s: float, position: Block) -> float:
        speed = self._capped(speed_rad_s)
        if position.integer("mastered") == 1:
            return speed
        return min(speed, math.radians(self._panel.profile.limits.jog_speed_unmastered_deg_s))

    def _motion(
        self,
        operation: Operation,
        axis: int,
        arguments_rad: Sequence[float],
        speed_rad_s: float,
        far_rad: float,
    ) -> Request:
        """Return a request to move so far, with the time that it may take."""
        full_override_s = _SLOWER * far_rad / speed_rad_s
        margin_s = self._options.motion_margin_s
        return Request(operation, axis, arguments_rad, speed_rad_s, margin_s, full_override_s)

    def _check_numbers(self, values: Sequence[float], count: int, what: str) -> None:
        if len(values) != count or not all(math.isfinite(value) for value in values):
            raise self._panel.refusal(f"{what}: {count} finite numbers are needed.")

    @contextmanager
    def _alone(self, doing: str) -> Iterator[None]:
        if self._doing:
            raise BusyError(self.name, f"a {self._doing} is under way, a {doing} was asked for.")
        self._doing = doing
        try:
            yield
        finally:
            self._doing = ""

    def _deadline(self, doing: str, *, times: int = 1) -> AbstractAsyncContextManager[None]:
        return deadline(self.name, times * self._options.deadline_s, doing)
