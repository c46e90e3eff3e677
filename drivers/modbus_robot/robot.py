"""A robot whose controller is reached through registers. See ``program.py`` for how it is made to move."""

import asyncio
import logging
import math
import time
from collections.abc import Iterator, Sequence
from contextlib import AbstractAsyncContextManager, contextmanager
from dataclasses import dataclass, replace

import numpy as np

from cellcal.calibration.geometry import Pose
from cellcal.calibration.mastering.counts import DriveTrain
from cellcal.calibration.message import make_message
from cellcal.drivers.errors import (
    DeviceError,
    MotionStoppedError,
    RefusedError,
    WrongDeviceError,
)
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
from cellcal.drivers.modbus_robot.cell_program import CellProgram, ProgramRequest, ProgramState
from cellcal.drivers.modbus_robot.condition import condition_of, read_alarms
from cellcal.drivers.modbus_robot.frames import active_frames, flange_pose, read_frame, write_frame
from cellcal.drivers.modbus_robot.joint_speed import read_speed_share
from cellcal.drivers.modbus_robot.mastering import (
    read_drive_train,
    read_mastering,
    restore_mastering,
    write_mastering,
)
from cellcal.drivers.modbus_robot.profile import ControllerProfile, Operation
from cellcal.drivers.modbus_robot.register_client import RegisterBlock, RegisterClient
from cellcal.drivers.wire.busy import refuse_second_action
from cellcal.drivers.wire.deadline import answer_deadline
from cellcal.drivers.wire.possible_values import check_joints, check_override

_LOG = logging.getLogger(__name__)
VERIFIED_ON: tuple[str, ...] = ()  # controller software this driver has run on; none yet, see README.md
_SIMULATED = "(simulated)"  # in the software's name of the simulated controller
_SLOWER = 1.5  # acceleration and joint coupling make a move longer than distance over speed
_RESET_NEEDS_MORE = (2, 6, 11)  # reasons after which condition() says what is still to be done


@dataclass(frozen=True, slots=True)
class ModbusMotionOptions:
    """The cell file's options of motion."""

    deadline_s: float
    speed_limit_rad_s: float
    settle_s: float
    motion_margin_s: float
    has_second_group: bool


def capabilities_of(profile: ControllerProfile) -> RobotCapabilities:
    """Return what a robot of this profile can do, known before it is reached."""
    return RobotCapabilities(
        axes=profile.axes,
        jogs_single_axes=profile.abilities.jogs_single_axes,
        reads_encoder_counts=True,
        tells_lost_position=True,
        reads_mastering=True,
        writes_mastering=profile.abilities.writes_mastering,
        writes_tool_frame=True,
        writes_user_frame=True,
        tells_active_frames=True,
        tells_mode=True,
        tells_speed_override=True,
    )


class ModbusRobot:
    """Robot and all its optional abilities over one profile."""

    def __init__(self, panel: RegisterClient, program: CellProgram, options: ModbusMotionOptions) -> None:
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
        """Connect, check the serial number, and note a controller that is untested."""
        await self._panel.link.open()
        firmware = (await self.identify()).firmware
        if self._panel.profile.is_simulated and _SIMULATED not in firmware:
            raise WrongDeviceError(
                self.name,
                make_message(
                    "profile {profile_name} is for the simulated controller, and {firmware!r} is none.",
                    profile_name=self._panel.profile.name,
                    firmware=firmware,
                ),
                remedy='Write profile = "fanuc_tp" for a real controller; see deploy/controller_setup/fanuc_tp.md.',
            )
        if not firmware.startswith(VERIFIED_ON):
            _LOG.warning("%s: not verified on controller software %r", self.name, firmware)

    async def close(self) -> None:
        """Hang up."""
        await self._panel.link.close()

    async def identify(self) -> Identity:
        async with self._answer_deadline("asking who it is"):
            block = await self._panel.read_registers("serial", "model", "firmware")
        return Identity(
            self._panel.profile.vendor,
            block.text_of("model"),
            block.text_of("serial"),
            block.text_of("firmware"),
        )

    async def read_condition(self) -> Condition:
        try:
            async with self._answer_deadline("asking its condition"):
                position, program = await self._read_status()
                return condition_of(position, program, await read_alarms(self._panel))
        except DeviceError as error:
            return Condition(Readiness.UNREACHABLE, error.message, error.remedy)

    async def read_joints(self) -> JointReading:
        async with self._answer_deadline("reading the joints"):
            position, program = await self._read_status()
        return self._joint_reading(position, program)

    async def flange_pose(self) -> Pose:
        async with self._answer_deadline("reading the pose"):
            position, _ = await self._read_status()
            return await flange_pose(self._panel, position)

    async def move_joints(self, target_rad: Joints, *, speed_rad_s: float) -> None:
        with self._exclusive_use("move"):
            self._check_numbers(target_rad, self._panel.profile.axes, "target")
            speed = self._cap_speed(speed_rad_s)
            position, _ = await self._read_status()
            way_rad = np.subtract(target_rad, position.numbers_of("joints"))
            share = await read_speed_share(self._panel, way_rad, speed)
            if share is not None:
                speed = share.speed_rad_s
            request = self._motion_request("move", 0, target_rad, speed, float(max(abs(way_rad))))
            share_alone = None if share is None else share.share
            await self._program.run_request(replace(request, speed_share=share_alone))
            await self._settle_at(target_rad)

    async def stop(self) -> None:
        async with self._answer_deadline("stopping", times=2):
            await self._program.hold_arm()

    async def jog_axis(self, axis: int, delta_rad: float, *, speed_rad_s: float) -> None:
        with self._exclusive_use("jog"):
            self._check_numbers((delta_rad,), 1, "angle")
            if not 0 <= axis < self._panel.profile.axes:
                raise self._panel.refused_error(make_message("there is no axis {axis}.", axis=axis + 1))
            drive = await read_drive_train(self._panel)
            position, _ = await self._read_status()
            speed = self._jog_speed(speed_rad_s, position)
            finding_index = any(entry.kind == "index" for _, entry in await read_alarms(self._panel))
            await self._program.run_request(
                self._motion_request("jog", axis, (delta_rad,), speed, abs(delta_rad))
            )
            turn_rad = float(np.abs(drive.radians_per_turn()[axis]).sum()) if finding_index else 0.0
            moved_rad = await self._axis_travel(axis, drive, position.integers_of("counts"))
            if abs(moved_rad - delta_rad) > self._tolerance_rad + turn_rad:
                raise self._short_of_target_error(axis, abs(moved_rad - delta_rad))

    async def encoder_counts(self) -> Counts:
        async with self._answer_deadline("reading the counts"):
            position, _ = await self._read_status()
        return position.integers_of("counts")

    async def read_mastering(self) -> MasteringData:
        async with self._answer_deadline("reading the mastering"):
            return await read_mastering(self._panel)

    async def drive_train(self) -> DriveTrain:
        async with self._answer_deadline("reading the drive data"):
            return await read_drive_train(self._panel)

    async def encoder_epoch(self) -> int:
        async with self._answer_deadline("reading the encoder epoch"):
            return (await self._panel.read_registers("epoch")).integer_of("epoch")

    async def write_mastering(self, counts_at_zero: Counts) -> MasteringData:
        with self._exclusive_use("mastering"):
            self._check_numbers(counts_at_zero, self._panel.profile.axes, "counts")
            within_s = self._options.deadline_s
            return await write_mastering(self._panel, self._program, counts_at_zero, within_s=within_s)

    async def restore_mastering(self, data: MasteringData) -> MasteringData:
        with self._exclusive_use("mastering"):
            self._check_numbers(data.counts_at_zero, self._panel.profile.axes, "counts")
            within_s = self._options.deadline_s
            return await restore_mastering(self._panel, self._program, data, within_s=within_s)

    async def reset_position_alarms(self) -> None:
        with self._exclusive_use("reset"):
            if any(entry.kind == "lost" for _, entry in await read_alarms(self._panel)):
                await self._panel.write_registers({"acknowledge": (1,)})
            try:
                await self._program.run_request(
                    ProgramRequest("reset_alarms", within_s=self._options.deadline_s)
                )
            except RefusedError as error:
                if error.vendor_code not in _RESET_NEEDS_MORE:
                    raise

    async def read_tool_frame(self, number: int) -> Pose:
        async with self._answer_deadline("reading a tool frame"):
            return await read_frame(self._panel, "tool", number)

    async def write_tool_frame(self, number: int, flange_tool: Pose) -> Pose:
        with self._exclusive_use("tool frame"):
            async with self._answer_deadline("writing a tool frame"):
                return await write_frame(self._panel, "tool", number, flange_tool)

    async def read_user_frame(self, number: int) -> Pose:
        async with self._answer_deadline("reading a user frame"):
            return await read_frame(self._panel, "user", number)

    async def write_user_frame(self, number: int, base_user: Pose) -> Pose:
        with self._exclusive_use("user frame"):
            async with self._answer_deadline("writing a user frame"):
                return await write_frame(self._panel, "user", number, base_user)

    async def active_frames(self) -> ActiveFrames:
        async with self._answer_deadline("reading the active tool"):
            # selections need no look at the program's counter: a run also begins while it does not run
            position = await self._panel.read_block("position")
            return await active_frames(self._panel, position, group_2=self._options.has_second_group)

    async def controller_mode(self) -> str:
        async with self._answer_deadline("reading the mode"):
            _, program = await self._read_status()
            return program.mode_name

    async def speed_override(self) -> float:
        async with self._answer_deadline("reading the speed override"):
            share = (await self._panel.read_registers("override")).numbers_of("override")[0]
        return check_override(self.name, share)

    async def _read_status(self) -> tuple[RegisterBlock, ProgramState]:
        """Read position and counts between two looks at the program's counter."""
        before = await self._program.read_state()
        position = await self._panel.read_block("position")
        return position, await self._program.newer_than(before)

    def _joint_reading(self, position: RegisterBlock, program: ProgramState) -> JointReading:
        if position.integer_of("joints_valid") != 1:
            raise RefusedError(
                self.name,
                "the controller does not know its joint angles.",
                remedy="Recover the mastering first.",
            )
        return JointReading(
            joints_rad=check_joints(self.name, position.numbers_of("joints")),
            moving=program.moving,
            taken_at_s=time.monotonic(),
            raw=position.to_hex("joints") + position.to_hex("counts"),
        )

    async def _settle_at(self, target_rad: Joints) -> None:
        await asyncio.sleep(self._options.settle_s)
        reading = await self.read_joints()
        errors = np.abs(np.subtract(reading.joints_rad, target_rad))
        if reading.moving or float(errors.max()) > self._tolerance_rad:
            raise self._short_of_target_error(int(errors.argmax()), float(errors.max()))

    async def _axis_travel(self, axis: int, drive: DriveTrain, before: Counts) -> float:
        """Return how far an axis has turned, by the counts: they are there without mastering too.

        While a motor has not found its index, its count may jump by a part of a turn when it does.
        """
        await asyncio.sleep(self._options.settle_s)
        position, program = await self._read_status()
        if program.moving:
            raise MotionStoppedError(
                self.name,
                "the arm moves although its jog is done.",
                remedy="Make sure that no other client commands the robot, then repeat the step.",
            )
        return float(drive.to_joints(np.array(position.integers_of("counts")), np.array(before))[axis])

    def _short_of_target_error(self, axis: int, error_rad: float) -> MotionStoppedError:
        return MotionStoppedError(
            self.name,
            make_message(
                "axis {axis} ended {error_deg:.2f} deg from its target.",
                axis=axis + 1,
                error_deg=math.degrees(error_rad),
            ),
            remedy="Look whether something blocks the arm, then repeat the step.",
        )

    def _cap_speed(self, speed_rad_s: float) -> float:
        self._check_numbers((speed_rad_s,), 1, "speed")
        if speed_rad_s <= 0:
            raise self._panel.refused_error("a speed must be above zero.")
        return min(speed_rad_s, self._options.speed_limit_rad_s)

    def _jog_speed(self, speed_rad_s: float, position: RegisterBlock) -> float:
        speed = self._cap_speed(speed_rad_s)
        if position.integer_of("mastered") == 1:
            return speed
        return min(speed, math.radians(self._panel.profile.limits.jog_speed_unmastered_deg_s))

    def _motion_request(
        self,
        operation: Operation,
        axis: int,
        arguments_rad: Sequence[float],
        speed_rad_s: float,
        far_rad: float,
    ) -> ProgramRequest:
        """Return a request to move so far, with the time that it may take."""
        full_override_s = _SLOWER * far_rad / speed_rad_s
        margin_s = self._options.motion_margin_s
        return ProgramRequest(operation, axis, arguments_rad, speed_rad_s, margin_s, full_override_s)

    def _check_numbers(self, values: Sequence[float], count: int, what: str) -> None:
        if len(values) != count or not all(math.isfinite(value) for value in values):
            raise self._panel.refused_error(
                make_message("{what}: {count} finite numbers are needed.", what=what, count=count)
            )

    @contextmanager
    def _exclusive_use(self, doing: str) -> Iterator[None]:
        refuse_second_action(self.name, self._doing, doing)
        self._doing = doing
        try:
            yield
        finally:
            self._doing = ""

    def _answer_deadline(self, doing: str, *, times: int = 1) -> AbstractAsyncContextManager[None]:
        return answer_deadline(self.name, times * self._options.deadline_s, doing)
