"""A Yaskawa arm over the High Speed Ethernet Server: pulses, status, alarms, tools, moves in short steps."""

import logging
import math
import time
from dataclasses import dataclass
from functools import partial

import numpy as np

from cellcal.calibration.geometry import Array, Pose
from cellcal.calibration.mastering.counts import DriveTrain
from cellcal.calibration.mastering.position_record import ShownValue
from cellcal.calibration.message import join_messages, make_message
from cellcal.drivers.errors import (
    DeviceError,
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
    PositionCure,
    PositionHistory,
    RobotCapabilities,
    ShownExternalAxis,
)
from cellcal.drivers.wire.possible_values import check_joints
from cellcal.drivers.wire.serial_number import describe_second_robot, describe_untold_serial
from cellcal.drivers.wire.stepwise_motion import IsFinished, StepwiseMotion, StepwiseOptions
from cellcal.drivers.yaskawa.absolute_data import read_absolute_data
from cellcal.drivers.yaskawa.alarm_history import read_position_history
from cellcal.drivers.yaskawa.condition import condition_of
from cellcal.drivers.yaskawa.hses_link import HsesLink
from cellcal.drivers.yaskawa.motion import PulseScale, hold_order, move_order, speed_share
from cellcal.drivers.yaskawa.state import (
    AXES,
    StationGroup,
    find_station_groups,
    read_alarms,
    read_cartesian,
    read_pulses,
    read_station_axes,
    read_status,
    read_system,
)
from cellcal.drivers.yaskawa.tool_file import ToolData, pose_of, read_tools

_LOG = logging.getLogger(__name__)
VERIFIED_ON: tuple[str, ...] = ()  # controller software this driver has run on; none yet, see README.md
_DITHER_PULSES = 2  # of an axis that its servo holds
_TOOL_FILE, _HOME_FILE = "TOOL.CND", "ABSO.DAT"

CAPABILITIES = RobotCapabilities(
    axes=AXES,
    axis_names=("S", "L", "U", "R", "B", "T"),
    reads_encoder_counts=True,
    tells_lost_position=True,
    tells_active_frames=True,
    tells_mode=True,
    position_cure=PositionCure.ABSOLUTE_DATA,
    shows_position_data=True,
    keeps_position_history=True,
)


@dataclass(frozen=True, slots=True)
class YaskawaOptions:
    """The cell file's options of the robot and its motion."""

    controller_type: str
    serial: str
    scale: PulseScale
    fastest_axis_rad_s: float
    motion: StepwiseOptions


class YaskawaRobot(StepwiseMotion):
    """Robot, KnowsActiveFrames and KnowsMode. Mastering is pendant work on this controller."""

    def __init__(self, link: HsesLink, files: HsesLink, options: YaskawaOptions) -> None:
        super().__init__(link.device, options.motion)
        self._link, self._files, self._options = link, files, options
        self._stations: tuple[StationGroup, ...] | None = None  # not looked for yet

    @property
    def capabilities(self) -> RobotCapabilities:
        return CAPABILITIES

    async def connect(self) -> None:
        """Make both sockets and check the type of the robot. Nothing is ordered."""
        await self._link.open()
        await self._files.open()
        found = await self.identify()
        if found.model != self._options.controller_type:
            raise WrongDeviceError(
                self.name,
                make_message(
                    "the controller names its robot {model!r}, the cell file {controller_type!r}.",
                    model=found.model,
                    controller_type=self._options.controller_type,
                ),
                remedy="Check the address, or correct controller_type in the cell file.",
            )
        if not found.firmware.startswith(VERIFIED_ON):
            _LOG.warning("%s: not verified on controller software %r", self.name, found.firmware)

    async def close(self) -> None:
        """Close both sockets."""
        self._link.close()
        self._files.close()

    async def identify(self) -> Identity:
        """Return who answers; the serial number is the one of the cell file, the controller tells none."""
        async with self._answer_deadline("asking who it is"):
            version, model = await read_system(self._link)
        return Identity("Yaskawa", model, self._options.serial, version)

    async def identity_doubts(self) -> str:
        """Say that no serial number is told, and where another robot is on the same controller."""
        doubts = [describe_untold_serial(self._options.serial)]
        async with self._answer_deadline("asking who it is"):
            try:
                _, second = await read_system(self._link, number=2)
            except RefusedError:
                second = ""
        return join_messages(" ", [*doubts, describe_second_robot("R1")] if second else doubts)

    async def _request_condition(self) -> Condition:
        status = await read_status(self._link)
        alarms = await read_alarms(self._link) if status.has_alarm else ()
        return condition_of(status, alarms)

    async def read_joints(self) -> JointReading:
        async with self._answer_deadline("reading the joints"):
            before = (await read_pulses(self._link)).pulses
            await self._let_cycles_pass()
            status = await read_status(self._link)
            position = await read_pulses(self._link)
        joints = check_joints(self.name, self._options.scale.to_joints(position.pulses))
        turned = max(abs(a - b) for a, b in zip(position.pulses, before, strict=True))
        moving = (
            bool(self._doing) or status.is_running or turned > _DITHER_PULSES
        )  # no status tells of jogging
        return JointReading(joints, moving, time.monotonic(), raw=position.raw)

    async def flange_pose(self) -> Pose:
        async with self._answer_deadline("reading the pose"):
            tip = await read_cartesian(self._link)
            tool = await self._read_tool(tip.tool_number)
        return pose_of(tip.position_m, tip.rotation_deg) @ tool.flange_tool.inverse()

    async def active_frames(self) -> ActiveFrames:
        async with self._answer_deadline("reading the active tool"):
            tip = await read_cartesian(self._link)
            tool = await self._read_tool(tip.tool_number)
            external_axes = await self._read_external_axes()
        return ActiveFrames(
            tip.tool_number, tool.flange_tool, tip.user_frame_number, tool.mass_kg, external_axes
        )

    async def controller_mode(self) -> str:
        async with self._answer_deadline("reading the mode"):
            return (await read_status(self._link)).mode_name

    async def encoder_counts(self) -> Counts:
        """Return the motor pulses: the encoder counts less the home position's, which stay in the controller."""
        async with self._answer_deadline("reading the pulses"):
            return (await read_pulses(self._link)).pulses

    async def drive_train(self) -> DriveTrain:
        """Return how pulses turn joints. A motor turn is not told by this controller: one degree stands for it."""
        per_degree = self._options.scale.pulses_per_degree
        matrix = np.diag([math.radians(1.0) / value for value in per_degree])
        return DriveTrain(
            tuple(tuple(row) for row in matrix.tolist()),
            tuple(max(1, round(abs(value))) for value in per_degree),
        )

    async def encoder_epoch(self) -> int:
        """Return 0: the controller tells nothing that changes with a lost position but its alarms."""
        return 0

    async def position_data(self) -> tuple[ShownValue, ...]:
        """Return the pulses, which are the encoder counts less the home position's, that position, and the alarms."""
        async with self._answer_deadline("reading the position"):
            pulses = (await read_pulses(self._link)).pulses
            status = await read_status(self._link)
            alarms = await read_alarms(self._link) if status.has_alarm else ()
        shown = [ShownValue("pulse", str(value), axis, "pulse") for axis, value in enumerate(pulses)]
        shown += [
            ShownValue(_HOME_FILE, "none" if value is None else str(value), axis, "pulse", is_set=True)
            for axis, value in enumerate(await self._read_absolute_data())
        ]
        return (*shown, *(ShownValue("alarm", f"{alarm.code} {alarm.name}") for alarm in alarms))

    async def position_history(self, since: tuple[str, ...]) -> PositionHistory:
        async with self._answer_deadline("reading the alarm history", times=10):
            return await read_position_history(self._link, since)

    # a move

    async def _read_angles(self) -> Joints:
        return check_joints(self.name, self._options.scale.to_joints((await read_pulses(self._link)).pulses))

    async def _begin_motion(self, speed_rad_s: float) -> None:
        """Do nothing: the controller takes orders as it stands."""

    async def _order_step(self, target_rad: Array, duration_s: float, speed_rad_s: float) -> IsFinished:
        try:
            pulses = self._options.scale.to_pulses(target_rad)
        except ValueError as error:
            raise RefusedError(
                self.name, make_message("{error}.", error=error), remedy="Targets are radians."
            ) from error
        share = speed_share(speed_rad_s, self._options.fastest_axis_rad_s)
        tool_number = (await read_pulses(self._link)).tool_number
        try:
            await self._link.ask(move_order(pulses, share, tool_number))
        except RefusedError as refused:
            await self._raise_unless_ready()  # what stops the robot says more than its refusal
            raise refused from None
        return partial(self._has_arrived, target_rad)

    async def _has_arrived(self, target: Array) -> bool:
        """Return whether the arm stands at the end of a step; raise what stops it."""
        status = await read_status(self._link)
        if status.is_running and status.has_servo_power and not status.has_alarm:
            return False
        errors = np.abs(np.array(await self._read_angles()) - target)
        if float(errors.max()) <= self._motion.tolerance_rad:
            return True
        await self._raise_unless_ready()
        return False

    async def _halt_arm(self) -> None:
        await self._link.ask(hold_order(on=True))

    async def _release_arm(self) -> None:
        await self._link.ask(hold_order(on=False))

    # inside

    async def _read_absolute_data(self) -> tuple[int | None, ...]:
        """Return the encoder counts of the home positions; none where the controller does not give the file."""
        try:
            async with self._answer_deadline("reading the position"):
                content = await self._files.read_file(_HOME_FILE)
        except DeviceError as error:
            _LOG.info("%s: %s is not kept: %s", self.name, _HOME_FILE, error)
            return ()
        values = read_absolute_data(content.decode("ascii", "replace"))
        return values if len(values) == AXES else ()

    async def _read_external_axes(self) -> tuple[ShownExternalAxis, ...]:
        if self._stations is None:
            self._stations = await find_station_groups(self._link)
        return tuple(
            [axis for group in self._stations for axis in await read_station_axes(self._link, group)]
        )

    async def _read_tool(self, number: int) -> ToolData:
        text = (await self._files.read_file(_TOOL_FILE)).decode("ascii", "replace")
        tool = read_tools(text).get(number)
        if tool is None:
            raise RefusedError(
                self.name,
                make_message(
                    "tool {number} is active, and {tool_file} does not hold it.",
                    number=number,
                    tool_file=_TOOL_FILE,
                ),
                remedy="Teach the tool at the pendant, or select another one.",
            )
        return tool
