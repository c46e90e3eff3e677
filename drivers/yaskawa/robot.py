"""A Yaskawa arm over the High Speed Ethernet Server: pulses, status, alarms, tools, moves in short steps."""

import asyncio
import contextlib
import logging
import math
import time
from collections.abc import Iterator
from contextlib import AbstractAsyncContextManager, contextmanager
from dataclasses import dataclass

import numpy as np

from cellcal.calibration.geometry import Array, Pose
from cellcal.calibration.mastering.counts import DriveTrain
from cellcal.drivers.errors import (
    BusyError,
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
    Readiness,
    RobotCapabilities,
)
from cellcal.drivers.wire.cancellation import run_to_end
from cellcal.drivers.wire.deadline import answer_deadline
from cellcal.drivers.wire.joint_steps import step_targets
from cellcal.drivers.yaskawa.condition import condition_of
from cellcal.drivers.yaskawa.hses_link import HsesLink
from cellcal.drivers.yaskawa.motion import PulseScale, hold_order, move_order, speed_share
from cellcal.drivers.yaskawa.state import (
    AXES,
    read_alarms,
    read_cartesian,
    read_pulses,
    read_status,
    read_system,
)
from cellcal.drivers.yaskawa.tool_file import ToolData, pose_of, read_tools

_LOG = logging.getLogger(__name__)
VERIFIED_ON: tuple[str, ...] = ()  # controller software this driver has run on; none yet, see README.md
_POLL_S = 0.01
_TOOL_FILE = "TOOL.CND"
_LOOK = "Look at the robot first: it should have stopped. Use the emergency stop if it has not."

CAPABILITIES = RobotCapabilities(
    axes=AXES, reads_encoder_counts=True, tells_active_frames=True, tells_mode=True
)


@dataclass(frozen=True, slots=True)
class YaskawaOptions:
    """What the cell file says about the robot and its motion."""

    controller_type: str
    serial: str
    scale: PulseScale
    deadline_s: float
    speed_limit_rad_s: float
    fastest_axis_rad_s: float
    step_s: float
    settle_s: float
    stuck_s: float
    tolerance_rad: float


class YaskawaRobot:
    """Robot, KnowsActiveFrames and KnowsMode. Mastering is pendant work on this controller."""

    def __init__(self, link: HsesLink, files: HsesLink, options: YaskawaOptions) -> None:
        self._link, self._files, self._options = link, files, options
        self._doing = ""
        self._stop_ordered = False
        self._idle = asyncio.Event()
        self._idle.set()

    @property
    def name(self) -> str:
        return self._link.device

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
                f"the controller names its robot {found.model!r}, the cell file {self._options.controller_type!r}.",
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

    async def read_condition(self) -> Condition:
        try:
            async with self._answer_deadline("asking its condition"):
                status = await read_status(self._link)
                alarms = await read_alarms(self._link) if status.has_alarm else ()
                return condition_of(status, alarms)
        except DeviceError as error:
            return Condition(Readiness.UNREACHABLE, error.message, error.remedy)

    async def read_joints(self) -> JointReading:
        async with self._answer_deadline("reading the joints"):
            status = await read_status(self._link)
            position = await read_pulses(self._link)
        joints = self._options.scale.to_joints(position.pulses)
        return JointReading(joints, status.is_running, time.monotonic(), raw=position.raw)

    async def flange_pose(self) -> Pose:
        async with self._answer_deadline("reading the pose"):
            tip = await read_cartesian(self._link)
            tool = await self._read_tool(tip.tool_number)
        return pose_of(tip.position_m, tip.rotation_deg) @ tool.flange_tool.inverse()

    async def active_frames(self) -> ActiveFrames:
        async with self._answer_deadline("reading the active tool"):
            tip = await read_cartesian(self._link)
            tool = await self._read_tool(tip.tool_number)
        return ActiveFrames(tip.tool_number, tool.flange_tool, tip.user_frame_number, tool.mass_kg)

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

    async def move_joints(self, target_rad: Joints, *, speed_rad_s: float) -> None:
        target, speed_rad_s = self._check_target(target_rad, speed_rad_s)
        with self._exclusive_use():
            try:
                await self._move_in_steps(target, speed_rad_s)
            except asyncio.CancelledError:
                await run_to_end(self._halt_after_cancel())
                raise
            except DeviceError as error:
                _LOG.warning("%s: the move failed: %s", self.name, error)
                with contextlib.suppress(DeviceError):
                    await run_to_end(self._hold_arm())
                raise error from None

    async def stop(self) -> None:
        self._stop_ordered = not self._idle.is_set()
        await run_to_end(self._halt_for_stop())

    # a move

    def _check_target(self, target_rad: Joints, speed_rad_s: float) -> tuple[Array, float]:
        if len(target_rad) != AXES or not all(map(math.isfinite, target_rad)):
            raise RefusedError(self.name, "a target needs six finite joint angles.")
        if not (math.isfinite(speed_rad_s) and speed_rad_s > 0):
            raise RefusedError(self.name, "a speed must be finite and above zero.")
        try:
            self._options.scale.to_pulses(np.array(target_rad))
        except ValueError as error:
            raise RefusedError(self.name, f"{error}.", remedy="Targets are radians.") from error
        return np.array(target_rad, dtype=float), min(speed_rad_s, self._options.speed_limit_rad_s)

    async def _move_in_steps(self, target: Array, speed_rad_s: float) -> None:
        await self._raise_unless_ready()
        async with self._answer_deadline("reading the joints"):
            position = await read_pulses(self._link)
        start = np.array(self._options.scale.to_joints(position.pulses))
        share = speed_share(speed_rad_s, self._options.fastest_axis_rad_s)
        for step in step_targets(start, target, speed_rad_s * self._options.step_s):
            self._raise_if_stopped()
            pulses = self._options.scale.to_pulses(step)
            await self._order_step(pulses, share, position.tool_number)
            await self._follow_step(step)
        await asyncio.sleep(self._options.settle_s)
        await self._check_arrival(target)

    async def _order_step(self, pulses: tuple[int, ...], share: int, tool_number: int) -> None:
        try:
            async with self._answer_deadline("ordering a move"):
                await self._link.ask(move_order(pulses, share, tool_number))
        except RefusedError as refused:
            await self._raise_unless_ready()  # what stops the robot says more than its refusal
            raise refused from None

    async def _follow_step(self, target: Array) -> None:
        """Wait until the arm stands at the end of a step; as long as it moves, however slowly."""
        loop = asyncio.get_running_loop()
        before: tuple[int, ...] = ()
        moved_at_s = loop.time()
        while True:
            async with self._answer_deadline("following the move"):
                status = await read_status(self._link)
                pulses = (await read_pulses(self._link)).pulses
            if not (status.is_running and status.has_servo_power) or status.has_alarm:
                if self._distance_rad(pulses, target) <= self._options.tolerance_rad:
                    return
                await self._raise_unless_ready()
            self._raise_if_stopped()
            now_s = loop.time()
            if pulses != before:
                before, moved_at_s = pulses, now_s
            elif now_s - moved_at_s > self._options.stuck_s:
                raise self._short_of_target_error(pulses, target)
            await asyncio.sleep(_POLL_S)

    async def _check_arrival(self, target: Array) -> None:
        async with self._answer_deadline("reading the joints"):
            pulses = (await read_pulses(self._link)).pulses
        if self._distance_rad(pulses, target) > self._options.tolerance_rad:
            raise self._short_of_target_error(pulses, target)

    def _distance_rad(self, pulses: tuple[int, ...], target: Array) -> float:
        return float(np.abs(np.array(self._options.scale.to_joints(pulses)) - target).max())

    async def _raise_unless_ready(self) -> None:
        condition = await self.read_condition()
        if condition.readiness is Readiness.READY:
            return
        kinds: dict[Readiness, type[DeviceError]] = {Readiness.STOPPED: MotionStoppedError}
        kind = kinds.get(condition.readiness, RefusedError)
        raise kind(self.name, condition.message, remedy=condition.remedy)

    def _raise_if_stopped(self) -> None:
        if self._stop_ordered:
            raise MotionStoppedError(
                self.name,
                "the move was stopped because a stop was asked for.",
                remedy="Repeat the step when the arm may move on.",
            )

    def _short_of_target_error(self, pulses: tuple[int, ...], target: Array) -> MotionStoppedError:
        errors = np.abs(np.array(self._options.scale.to_joints(pulses)) - target)
        axis = int(errors.argmax())
        return MotionStoppedError(
            self.name,
            f"the arm stands, but joint {axis + 1} is {math.degrees(errors[axis]):.2f} deg from its target.",
            remedy="Look whether something blocks the arm or its speed is at zero, then repeat the step.",
        )

    # ending a move

    async def _halt_after_cancel(self) -> None:
        try:
            await self._hold_arm()
        except DeviceError as error:
            _LOG.warning("%s: the move failed: %s", self.name, error)

    async def _halt_for_stop(self) -> None:
        try:
            await self._hold_arm()
        except DeviceError as error:
            error.remedy = f"{_LOOK} {error.remedy}".strip()
            raise
        finally:
            if self._stop_ordered:
                with contextlib.suppress(TimeoutError):
                    async with asyncio.timeout(self._options.deadline_s):
                        await self._idle.wait()
            self._stop_ordered = False

    async def _hold_arm(self) -> None:
        """Hold, wait for standstill, release the hold: what was ordered before is given up by the controller."""
        async with self._answer_deadline("stopping", times=2):
            await self._link.ask(hold_order(on=True))
            before: tuple[int, ...] = ()
            while (pulses := (await read_pulses(self._link)).pulses) != before:
                before = pulses
                await asyncio.sleep(_POLL_S)
            await self._link.ask(hold_order(on=False))

    # inside

    async def _read_tool(self, number: int) -> ToolData:
        text = (await self._files.read_file(_TOOL_FILE)).decode("ascii", "replace")
        tool = read_tools(text).get(number)
        if tool is None:
            raise RefusedError(
                self.name,
                f"tool {number} is active, and {_TOOL_FILE} does not hold it.",
                remedy="Teach the tool at the pendant, or select another one.",
            )
        return tool

    @contextmanager
    def _exclusive_use(self) -> Iterator[None]:
        if self._doing:
            raise BusyError(self.name, "a move is under way, another was asked for.")
        self._doing, self._stop_ordered = "move", False
        self._idle.clear()
        try:
            yield
        finally:
            self._doing = ""
            self._idle.set()

    def _answer_deadline(self, doing: str, *, times: int = 1) -> AbstractAsyncContextManager[None]:
        return answer_deadline(self.name, times * self._options.deadline_s, doing)
