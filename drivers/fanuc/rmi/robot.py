"""A FANUC arm over the Remote Motion Interface (option R912): joints, frames, moves, stop, alarms."""

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
from cellcal.drivers.errors import BusyError, DeviceError, MotionStoppedError, RefusedError
from cellcal.drivers.fanuc.rmi.rmi_link import RmiLink
from cellcal.drivers.fanuc.rmi.rmi_state import (
    AXES,
    RmiStatus,
    condition_of,
    read_active_numbers,
    read_alarm_texts,
    read_frame,
    read_joint_angles,
    read_pose,
    read_status,
    write_frame,
)
from cellcal.drivers.interfaces import (
    ActiveFrames,
    Condition,
    Identity,
    JointReading,
    Joints,
    Readiness,
    RobotCapabilities,
)
from cellcal.drivers.wire.cancellation import run_to_end
from cellcal.drivers.wire.deadline import answer_deadline
from cellcal.drivers.wire.joint_steps import step_targets

_LOG = logging.getLogger(__name__)
VERIFIED_ON: tuple[str, ...] = ()  # controller software this driver has run on; none yet, see README.md
_POLL_S = 0.05
_SAME_M, _SAME_RAD = 2e-6, 2e-5  # the interface reads to 0.001 mm and 0.001 deg
_LOOK = "Look at the robot first: it should have stopped. Use the emergency stop if it has not."

CAPABILITIES = RobotCapabilities(
    axes=AXES,
    writes_tool_frame=True,
    writes_user_frame=True,
    tells_active_frames=True,
    tells_mode=True,
    tells_speed_override=True,
)


@dataclass(frozen=True, slots=True)
class RmiOptions:
    """What the cell file says about the robot and its motion."""

    serial: str
    model: str
    deadline_s: float
    speed_limit_rad_s: float
    step_s: float
    settle_s: float
    stuck_s: float
    tolerance_rad: float


class FanucRmiRobot:
    """Robot with frames, mode and override. Mastering is not reached over this link."""

    def __init__(self, link: RmiLink, options: RmiOptions) -> None:
        self._link, self._options = link, options
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
        """Connect for reading; nothing is initialised, so hand guiding and the pendant are not disturbed."""
        await self._link.open()
        if not VERIFIED_ON:
            version = self._link.version
            _LOG.warning("%s: not verified on controller software %r", self.name, version)

    async def close(self) -> None:
        """Hang up."""
        await self._link.close()

    async def identify(self) -> Identity:
        """Return who answers; this link tells the interface's version only, the rest is the cell file's."""
        await self._link.open()
        version = self._link.version
        firmware = f"RMI {version.major}.{version.minor}"
        return Identity("FANUC", self._options.model, self._options.serial, firmware)

    async def read_condition(self) -> Condition:
        try:
            async with self._answer_deadline("asking its condition"):
                status = await read_status(self._link)
                texts = () if status.has_servo_power else await read_alarm_texts(self._link)
                return condition_of(status, texts)
        except DeviceError as error:
            return Condition(Readiness.UNREACHABLE, error.message, error.remedy)

    async def read_joints(self) -> JointReading:
        async with self._answer_deadline("reading the joints"):
            before, _ = await read_joint_angles(self._link)
            joints, reply = await read_joint_angles(self._link)
        moving = bool(self._doing) or joints != before  # this link tells no motion of others
        return JointReading(joints, moving, time.monotonic(), raw=str(dict(reply)))

    async def flange_pose(self) -> Pose:
        async with self._answer_deadline("reading the pose"):
            user_tip, user, tool = await read_pose(self._link)
            base_user = await read_frame(self._link, "UFrame", user) if user else Pose((0.0, 0.0, 0.0))
            flange_tool = await read_frame(self._link, "UTool", tool) if tool else Pose((0.0, 0.0, 0.0))
        return base_user @ user_tip @ flange_tool.inverse()

    async def active_frames(self) -> ActiveFrames:
        async with self._answer_deadline("reading the active tool"):
            user, tool = await read_active_numbers(self._link)
            flange_tool = await read_frame(self._link, "UTool", tool) if tool else Pose((0.0, 0.0, 0.0))
        return ActiveFrames(tool, flange_tool, user)

    async def controller_mode(self) -> str:
        status = await self._read_status("reading the mode")
        return "TP on" if status.pendant_enabled else "TP off"

    async def speed_override(self) -> float:
        return (await self._read_status("reading the speed override")).override

    async def read_tool_frame(self, number: int) -> Pose:
        return await self._read_frame("UTool", number)

    async def write_tool_frame(self, number: int, flange_tool: Pose) -> Pose:
        return await self._write_frame("UTool", number, flange_tool)

    async def read_user_frame(self, number: int) -> Pose:
        return await self._read_frame("UFrame", number)

    async def write_user_frame(self, number: int, base_user: Pose) -> Pose:
        return await self._write_frame("UFrame", number, base_user)

    async def move_joints(self, target_rad: Joints, *, speed_rad_s: float) -> None:
        target, speed_rad_s = self._check_target(target_rad, speed_rad_s)
        with self._exclusive_use("move"):
            try:
                await self._move_in_steps(target, speed_rad_s)
            except asyncio.CancelledError:
                await run_to_end(self._halt_quietly())
                raise
            except DeviceError as error:
                _LOG.warning("%s: the move failed: %s", self.name, error)
                await run_to_end(self._halt_quietly())
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
        return np.array(target_rad, dtype=float), min(speed_rad_s, self._options.speed_limit_rad_s)

    async def _move_in_steps(self, target: Array, speed_rad_s: float) -> None:
        await self._raise_unless_ready()
        async with self._answer_deadline("starting remote motion", times=2):
            await self._initialise()
            joints, _ = await read_joint_angles(self._link)
        start = np.array(joints)
        for step in step_targets(start, target, speed_rad_s * self._options.step_s):
            self._raise_if_stopped()
            await self._follow_step(step, float(np.abs(step - start).max()) / speed_rad_s)
            start = step
        await asyncio.sleep(self._options.settle_s)
        await self._check_arrival(target)

    async def _initialise(self) -> None:
        """Start RMI_MOVE, where it does not run on this connection already."""
        status = await read_status(self._link)
        if not status.motion_runs:
            await self._link.send_command("FRC_Initialize")

    async def _follow_step(self, target: Array, at_speed_s: float) -> None:
        """Order one step and wait for its reply; as long as the arm moves, however slowly."""
        async with self._answer_deadline("ordering a move"):
            sequence_id = (await read_status(self._link)).next_sequence_id
        angles = {f"J{axis + 1}": math.degrees(value) for axis, value in enumerate(target)}
        order = asyncio.create_task(
            self._link.send_instruction(
                "FRC_JointMotionJRep",
                sequence_id,
                JointAngle=angles,
                SpeedType="mSec",
                Speed=max(1, math.ceil(at_speed_s * 1000.0)),
                TermType="FINE",
                TermValue=0,
            )
        )
        try:
            await self._wait_for_step(order, target)
        finally:
            order.cancel()
            with contextlib.suppress(asyncio.CancelledError, DeviceError):
                await order

    async def _wait_for_step(self, order: "asyncio.Task[object]", target: Array) -> None:
        loop = asyncio.get_running_loop()
        before: tuple[float, ...] = ()
        moved_at_s = loop.time()
        while not (await asyncio.wait({order}, timeout=_POLL_S))[0]:
            async with self._answer_deadline("following the move"):
                joints, _ = await read_joint_angles(self._link)
            self._raise_if_stopped()
            if joints != before:
                before, moved_at_s = joints, loop.time()
            elif loop.time() - moved_at_s > self._options.stuck_s:
                await self._raise_unless_ready()
                raise self._short_of_target_error(joints, target)
        try:
            await order
        except RefusedError as refused:
            await self._raise_unless_ready()  # what stops the robot says more than its refusal
            self._raise_if_stopped()
            raise refused from None

    async def _check_arrival(self, target: Array) -> None:
        async with self._answer_deadline("reading the joints"):
            joints, _ = await read_joint_angles(self._link)
        if float(np.abs(np.array(joints) - target).max()) > self._options.tolerance_rad:
            await self._raise_unless_ready()
            raise self._short_of_target_error(joints, target)

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

    def _short_of_target_error(self, joints: Joints, target: Array) -> MotionStoppedError:
        errors = np.abs(np.array(joints) - target)
        axis = int(errors.argmax())
        return MotionStoppedError(
            self.name,
            f"the arm stands, but joint {axis + 1} is {math.degrees(errors[axis]):.2f} deg from its target.",
            remedy="Look whether something blocks the arm or its speed is at zero, then repeat the step.",
        )

    # ending a move

    async def _halt_quietly(self) -> None:
        try:
            await self._abort_motion()
        except DeviceError as error:
            _LOG.warning("%s: the move failed: %s", self.name, error)

    async def _halt_for_stop(self) -> None:
        try:
            await self._abort_motion()
        except DeviceError as error:
            error.remedy = f"{_LOOK} {error.remedy}".strip()
            raise
        finally:
            if self._stop_ordered:
                with contextlib.suppress(TimeoutError):
                    async with asyncio.timeout(self._options.deadline_s):
                        await self._idle.wait()
            self._stop_ordered = False

    async def _abort_motion(self) -> None:
        """End remote motion and wait for standstill; what was ordered before is given up by the controller."""
        async with self._answer_deadline("stopping", times=2):
            await self._link.send_command("FRC_Abort")
            before: tuple[float, ...] = ()
            while (joints := (await read_joint_angles(self._link))[0]) != before:
                before = joints
                await asyncio.sleep(_POLL_S)

    # inside

    async def _read_status(self, doing: str) -> RmiStatus:
        async with self._answer_deadline(doing):
            return await read_status(self._link)

    async def _read_frame(self, kind: str, number: int) -> Pose:
        async with self._answer_deadline("reading a frame"):
            return await read_frame(self._link, kind, number)

    async def _write_frame(self, kind: str, number: int, pose: Pose) -> Pose:
        with self._exclusive_use("frame"):
            async with self._answer_deadline("writing a frame"):
                await write_frame(self._link, kind, number, pose)
                found = await read_frame(self._link, kind, number)
        near = np.allclose(found.position_m, pose.position_m, rtol=0, atol=_SAME_M)
        alike = np.allclose(found.rotation_matrix(), pose.rotation_matrix(), rtol=0, atol=_SAME_RAD)
        if not (near and alike):
            raise RefusedError(
                self.name,
                f"frame {number} was not written as sent.",
                remedy="Check that the frame is not locked on the controller, then write again.",
            )
        return found

    @contextmanager
    def _exclusive_use(self, doing: str) -> Iterator[None]:
        if self._doing:
            raise BusyError(self.name, f"a {self._doing} is under way, a {doing} was asked for.")
        self._doing, self._stop_ordered = doing, False
        self._idle.clear()
        try:
            yield
        finally:
            self._doing = ""
            self._idle.set()

    def _answer_deadline(self, doing: str, *, times: int = 1) -> AbstractAsyncContextManager[None]:
        return answer_deadline(self.name, times * self._options.deadline_s, doing)
