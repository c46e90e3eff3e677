"""A KUKA arm through the variables of its controller; moves through CELLCAL.SRC on the controller."""

import logging
import time
from dataclasses import dataclass
from functools import partial

from cellcal.calibration.documents.plain_numbers import parse_whole
from cellcal.calibration.geometry import Array, Pose
from cellcal.calibration.mastering.position_record import ShownValue
from cellcal.drivers.interfaces import (
    ActiveFrames,
    Condition,
    Identity,
    JointReading,
    Joints,
    PositionCure,
    RobotCapabilities,
    ShownExternalAxis,
)
from cellcal.drivers.kuka.variables.motion_server import MotionServer, speed_percent
from cellcal.drivers.kuka.variables.state import (
    condition_of,
    read_fraction,
    read_mode,
    read_position_data,
    read_robot_root,
    read_state,
    read_value,
    refuse_external_tool,
    tells_mastering,
)
from cellcal.drivers.kuka.variables.values import (
    AXES,
    read_axes,
    read_external_axes,
    read_members,
    read_pose,
    write_pose,
)
from cellcal.drivers.kuka.variables.variable_link import VariableLink, unquoted_text
from cellcal.drivers.wire.frame_readback import require_frame_as_sent
from cellcal.drivers.wire.joint_stream import JointStream
from cellcal.drivers.wire.possible_values import check_joints
from cellcal.drivers.wire.serial_number import check_serial_number
from cellcal.drivers.wire.stepwise_motion import IsFinished, StepwiseOptions
from cellcal.drivers.wire.streamed_motion import StreamedStepwiseMotion

_LOG = logging.getLogger(__name__)
VERIFIED_ON: tuple[str, ...] = ()  # controller software this driver has run on; none yet, see README.md

CAPABILITIES = RobotCapabilities(
    axes=AXES,
    axis_names=("A1", "A2", "A3", "A4", "A5", "A6"),
    moves_slowly=False,  # speeds are whole per cents of the fastest axis
    writes_tool_frame=True,
    writes_user_frame=True,
    tells_lost_position=True,
    tells_active_frames=True,
    tells_mode=True,
    tells_speed_override=True,
    position_cure=PositionCure.MASTERING_GAUGE,
    shows_position_data=True,
)


@dataclass(frozen=True, slots=True)
class KukaOptions:
    """The cell file's options of the robot and its motion."""

    serial: str
    fastest_axis_rad_s: float
    motion: StepwiseOptions


class KukaRobot(StreamedStepwiseMotion):
    """Robot with frames, mode and override. Mastering is pendant work on this controller."""

    def __init__(self, link: VariableLink, options: KukaOptions, stream: JointStream | None = None) -> None:
        super().__init__(link.device, options.motion, stream, own_link="$AXIS_ACT", takes_stream=False)
        self._link, self._options = link, options
        self._server = MotionServer(link)

    @property
    def capabilities(self) -> RobotCapabilities:
        return CAPABILITIES

    async def connect(self) -> None:
        """Connect, find out which server answers, and compare the serial number. Nothing is ordered."""
        found = await self.identify()
        check_serial_number(self.name, found.serial, self._options.serial)
        self._link.serial = found.serial
        if not found.firmware.startswith(VERIFIED_ON):
            _LOG.warning("%s: not verified on controller software %r", self.name, found.firmware)
        await self._open_stream()

    async def close(self) -> None:
        """Hang up."""
        self._close_stream()
        await self._link.close()

    async def identify(self) -> Identity:
        async with self._answer_deadline("asking who it is"):
            server = await self._link.identify_server()
            model = unquoted_text(await self._link.read_variable("$MODEL_NAME[]")).lstrip("#")
            serial = await self._link.read_serial()
        return Identity("KUKA", model, serial, f"{server.name} {server.version}".strip())

    async def identity_doubts(self) -> str:
        """Say where this software does not tell whether its axes are mastered: a loss is not seen then."""
        async with self._answer_deadline("asking its condition"):
            if await tells_mastering(self._link):
                return ""
        return (
            "This controller does not tell whether its axes are mastered: a lost position is NOT seen. Run a drift "
            "check after service, and read the messages at the pendant."
        )

    async def _request_condition(self) -> Condition:
        return condition_of(await read_state(self._link))

    async def read_joints(self) -> JointReading:
        async with self._answer_deadline("reading the joints"):
            if compared := await self._read_compared():
                return compared
            before = await self._read_angles()
            await self._let_cycles_pass()
            text = await self._link.read_variable("$AXIS_ACT")
            joints = await self._read_angles()
        moving = bool(self._doing) or joints != before  # the server tells no motion of others
        return JointReading(joints, moving, time.monotonic(), raw=text)

    async def flange_pose(self) -> Pose:
        async with self._answer_deadline("reading the pose"):
            await refuse_external_tool(self._link)
            world_base = await read_robot_root(self._link)
            world_frame = await read_value(self._link, "$BASE", read_pose)
            frame_tip = await read_value(self._link, "$POS_ACT", read_pose)
            flange_tool = await read_value(self._link, "$TOOL", read_pose)
        return world_base.inverse() @ world_frame @ frame_tip @ flange_tool.inverse()

    async def active_frames(self) -> ActiveFrames:
        async with self._answer_deadline("reading the active tool"):
            tool = await read_value(self._link, "$ACT_TOOL", parse_whole)
            base = await read_value(self._link, "$ACT_BASE", parse_whole)
            flange_tool = await read_value(self._link, "$TOOL", read_pose)
            mass = (await read_value(self._link, "$LOAD", read_members)).get("M")
            places = await read_value(self._link, "$AXIS_ACT", read_external_axes)
        return ActiveFrames(
            tool,
            flange_tool,
            base,
            mass if mass is not None and mass >= 0 else None,
            tuple(ShownExternalAxis(name, shown) for name, shown in places),
        )

    async def controller_mode(self) -> str:
        async with self._answer_deadline("reading the mode"):
            return (await read_mode(self._link)).lstrip("#")

    async def speed_override(self) -> float:
        async with self._answer_deadline("reading the speed override"):
            return await read_fraction(self._link, "$OV_PRO")

    async def position_data(self) -> tuple[ShownValue, ...]:
        async with self._answer_deadline("reading the position"):
            return await read_position_data(self._link)

    async def read_tool_frame(self, number: int) -> Pose:
        return await self._read_frame("TOOL_DATA", number)

    async def write_tool_frame(self, number: int, flange_tool: Pose) -> Pose:
        return await self._write_frame("TOOL_DATA", number, flange_tool)

    async def read_user_frame(self, number: int) -> Pose:
        async with self._answer_deadline("reading a frame"):
            world_base = await read_robot_root(self._link)
        return world_base.inverse() @ await self._read_frame("BASE_DATA", number)

    async def write_user_frame(self, number: int, base_user: Pose) -> Pose:
        async with self._answer_deadline("reading a frame"):
            world_base = await read_robot_root(self._link)
        return world_base.inverse() @ await self._write_frame("BASE_DATA", number, world_base @ base_user)

    # a move

    async def _read_angles(self) -> Joints:
        return check_joints(self.name, await read_value(self._link, "$AXIS_ACT", read_axes))

    async def _begin_motion(self, speed_rad_s: float) -> None:
        speed_percent(self.name, speed_rad_s, self._options.fastest_axis_rad_s)
        await self._server.require_running()

    async def _order_step(self, target_rad: Array, duration_s: float, speed_rad_s: float) -> IsFinished:
        percent = speed_percent(self.name, speed_rad_s, self._options.fastest_axis_rad_s)
        request = await self._server.order_move(tuple(target_rad.tolist()), percent)
        return partial(self._server.has_finished, request)

    async def _explain_standstill(self) -> None:
        await self._server.require_alive()

    async def _halt_arm(self) -> None:
        await self._server.stop()

    async def _release_arm(self) -> None:
        """Do nothing: the next motion releases the stop."""

    # inside

    async def _read_frame(self, table: str, number: int) -> Pose:
        async with self._answer_deadline("reading a frame"):
            return await read_value(self._link, f"{table}[{int(number)}]", read_pose)

    async def _write_frame(self, table: str, number: int, pose: Pose) -> Pose:
        with self._exclusive_use("frame"):
            async with self._answer_deadline("writing a frame"):
                await self._link.write_variable(f"{table}[{int(number)}]", write_pose(pose))
                found = await read_value(self._link, f"{table}[{int(number)}]", read_pose)
        require_frame_as_sent(self.name, number, found, pose)
        return found
