"""A FANUC arm over the Remote Motion Interface (option R912): joints, frames, moves, stop, alarms."""

import asyncio
import logging
import math
import time
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from dataclasses import dataclass
from functools import partial

from cellcal.calibration.geometry import Array, Pose
from cellcal.calibration.message import make_message
from cellcal.drivers.fanuc.rmi.rmi_link import Packet, RmiLink
from cellcal.drivers.fanuc.rmi.rmi_state import (
    AXES,
    RmiStatus,
    condition_of,
    read_alarm_texts,
    read_frame,
    read_joint_angles,
    read_position,
    read_second_group,
    read_status,
    write_frame,
)
from cellcal.drivers.interfaces import (
    ActiveFrames,
    Condition,
    Identity,
    JointReading,
    Joints,
    RobotCapabilities,
)
from cellcal.drivers.wire.frame_readback import require_frame_as_sent
from cellcal.drivers.wire.possible_values import check_override
from cellcal.drivers.wire.stepwise_motion import IsFinished, StepwiseMotion, StepwiseOptions

_LOG = logging.getLogger(__name__)
VERIFIED_ON: tuple[str, ...] = ()  # controller software this driver has run on; none yet, see README.md
_POLL_S = 0.05

CAPABILITIES = RobotCapabilities(
    axes=AXES,
    writes_tool_frame=True,
    writes_user_frame=True,
    tells_lost_position=True,
    tells_active_frames=True,
    tells_mode=True,
    tells_speed_override=True,
)


@dataclass(frozen=True, slots=True)
class RmiOptions:
    """The cell file's options of the robot and its motion."""

    serial: str
    model: str
    motion: StepwiseOptions
    has_second_group: bool


class FanucRmiRobot(StepwiseMotion):
    """Robot with frames, mode and override. Mastering is not reached over this link."""

    def __init__(self, link: RmiLink, options: RmiOptions) -> None:
        super().__init__(link.device, options.motion)
        self._link, self._options = link, options

    @property
    def capabilities(self) -> RobotCapabilities:
        return CAPABILITIES

    async def connect(self) -> None:
        """Connect for reading; nothing is initialised, so hand guiding and the pendant are not disturbed."""
        await self._link.open()
        firmware = (await self.identify()).firmware
        if not firmware.startswith(VERIFIED_ON):
            _LOG.warning("%s: not verified on controller software %r", self.name, firmware)

    async def close(self) -> None:
        """Hang up."""
        await self._link.close()

    async def identify(self) -> Identity:
        """Return who answers; this link tells the interface's version only, the rest is the cell file's."""
        await self._link.open()
        version = self._link.version
        firmware = f"RMI {version.major}.{version.minor}"
        return Identity("FANUC", self._options.model, self._options.serial, firmware)

    async def identity_doubts(self) -> str:
        """Say that model and serial number, as they are shown, prove nothing."""
        return make_message(
            "This link tells neither model nor serial number; {model} and {serial} are what the cell file says. "
            "Compare the label on the arm.",
            model=self._options.model,
            serial=self._options.serial,
        )

    async def _request_condition(self) -> Condition:
        async with self._link.confirmed_answers():
            status = await read_status(self._link)
            texts = () if status.has_servo_power else await read_alarm_texts(self._link)
        return condition_of(status, texts)

    async def read_joints(self) -> JointReading:
        async with self._confirmed_answers("reading the joints"):
            before, _ = await read_joint_angles(self._link)
            await self._let_cycles_pass()
            joints, reply = await read_joint_angles(self._link)
        moving = bool(self._doing) or joints != before  # this link tells no motion of others
        return JointReading(joints, moving, time.monotonic(), raw=str(dict(reply)))

    async def flange_pose(self) -> Pose:
        async with self._confirmed_answers("reading the pose"):
            position = await read_position(self._link)
            base_user = await self._frame_or_none("UFrame", position.user_number)
            flange_tool = await self._frame_or_none("UTool", position.tool_number)
        return base_user @ position.user_tip @ flange_tool.inverse()

    async def active_frames(self) -> ActiveFrames:
        async with self._confirmed_answers("reading the active tool"):
            position = await read_position(self._link)
            flange_tool = await self._frame_or_none("UTool", position.tool_number)
            group_2 = await read_second_group(self._link) if self._options.has_second_group else ()
        external_axes = position.external_axes + group_2
        return ActiveFrames(
            position.tool_number, flange_tool, position.user_number, external_axes=external_axes
        )

    async def controller_mode(self) -> str:
        status = await self._read_status("reading the mode")
        return "TP on" if status.pendant_enabled else "TP off"

    async def speed_override(self) -> float:
        return check_override(self.name, (await self._read_status("reading the speed override")).override)

    async def read_tool_frame(self, number: int) -> Pose:
        return await self._read_frame("UTool", number)

    async def write_tool_frame(self, number: int, flange_tool: Pose) -> Pose:
        return await self._write_frame("UTool", number, flange_tool)

    async def read_user_frame(self, number: int) -> Pose:
        return await self._read_frame("UFrame", number)

    async def write_user_frame(self, number: int, base_user: Pose) -> Pose:
        return await self._write_frame("UFrame", number, base_user)

    # a move

    async def _read_angles(self) -> Joints:
        async with self._link.confirmed_answers():
            return (await read_joint_angles(self._link))[0]

    async def _begin_motion(self, speed_rad_s: float) -> None:
        """Start RMI_MOVE, where it does not run already."""
        if not (await read_status(self._link)).motion_runs:
            await self._link.send_command("FRC_Initialize")

    async def _order_step(self, target_rad: Array, duration_s: float, speed_rad_s: float) -> IsFinished:
        sequence_id = (await read_status(self._link)).next_sequence_id
        angles = {f"J{axis + 1}": math.degrees(value) for axis, value in enumerate(target_rad)}
        reply = await self._link.send_instruction(
            "FRC_JointMotionJRep",
            sequence_id,
            JointAngle=angles,
            SpeedType="mSec",
            Speed=max(1, math.ceil(duration_s * 1000.0)),
            TermType="FINE",
            TermValue=0,
        )
        return partial(self._is_executed, reply)

    async def _is_executed(self, reply: "asyncio.Future[Packet]") -> bool:
        """Return whether the reply to a step has come; raise what it says."""
        if not (await asyncio.wait({reply}, timeout=_POLL_S))[0]:
            return False
        self._link.accept_reply(reply.result())
        return True

    async def _halt_arm(self) -> None:
        await self._link.send_command("FRC_Abort")

    async def _release_arm(self) -> None:
        """Do nothing: the next motion starts RMI_MOVE again."""

    # inside

    @asynccontextmanager
    async def _confirmed_answers(self, doing: str) -> AsyncIterator[None]:
        async with self._answer_deadline(doing), self._link.confirmed_answers():
            yield

    async def _read_status(self, doing: str) -> RmiStatus:
        async with self._confirmed_answers(doing):
            return await read_status(self._link)

    async def _frame_or_none(self, kind: str, number: int) -> Pose:
        """Return a frame; number 0 is the base, or the flange itself."""
        return await read_frame(self._link, kind, number) if number else Pose((0.0, 0.0, 0.0))

    async def _read_frame(self, kind: str, number: int) -> Pose:
        async with self._confirmed_answers("reading a frame"):
            return await read_frame(self._link, kind, number)

    async def _write_frame(self, kind: str, number: int, pose: Pose) -> Pose:
        with self._exclusive_use("frame"):
            async with self._confirmed_answers("writing a frame"):
                await write_frame(self._link, kind, number, pose)
                found = await read_frame(self._link, kind, number)
        require_frame_as_sent(self.name, number, found, pose)
        return found
