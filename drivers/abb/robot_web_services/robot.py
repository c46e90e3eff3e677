"""An ABB arm over Robot Web Services 1 or 2; moves through the RAPID module CellcalServer on the controller."""

import logging
import time
from collections.abc import AsyncIterator, Mapping
from contextlib import asynccontextmanager
from dataclasses import dataclass
from functools import partial
from typing import Any

from cellcal.calibration.geometry import Array, Pose
from cellcal.calibration.mastering.position_record import ShownValue
from cellcal.calibration.message import make_message
from cellcal.drivers.abb.robot_web_services.event_history import read_position_history
from cellcal.drivers.abb.robot_web_services.mastership import EditMastership
from cellcal.drivers.abb.robot_web_services.motion_server import MotionServer
from cellcal.drivers.abb.robot_web_services.rapid_values import AXES, read_tool
from cellcal.drivers.abb.robot_web_services.state import (
    condition_of,
    converted,
    number_of,
    read_external_axes,
    read_flange_pose,
    read_joints,
    read_position_data,
    read_state,
    read_unit_names,
    text_of,
)
from cellcal.drivers.abb.robot_web_services.web_link import WebLink
from cellcal.drivers.errors import DeviceError, RefusedError, WireProtocolError
from cellcal.drivers.interfaces import (
    ActiveFrames,
    Condition,
    Identity,
    JointReading,
    Joints,
    PositionCure,
    PositionHistory,
    RobotCapabilities,
)
from cellcal.drivers.wire.cancellation import run_to_end
from cellcal.drivers.wire.joint_stream import JointStream
from cellcal.drivers.wire.possible_values import check_mass, check_override, check_pose
from cellcal.drivers.wire.serial_number import check_serial_number, describe_second_robot
from cellcal.drivers.wire.stepwise_motion import IsFinished, StepwiseOptions
from cellcal.drivers.wire.streamed_motion import StreamedStepwiseMotion

_LOG = logging.getLogger(__name__)
VERIFIED_ON: tuple[str, ...] = ()  # controller software this driver has run on; none yet, see README.md
_BASE = "wobj0"
_SECOND_ROBOT = "/rw/motionsystem/mechunits/ROB_2"

CAPABILITIES = RobotCapabilities(
    axes=AXES,
    tells_lost_position=True,
    tells_active_frames=True,
    tells_mode=True,
    tells_speed_override=True,
    position_cure=PositionCure.REVOLUTION_COUNTERS,
    shows_position_data=True,
    keeps_position_history=True,
)


@dataclass(frozen=True, slots=True)
class AbbOptions:
    """The cell file's options of the robot and its motion."""

    serial: str
    motion: StepwiseOptions


class AbbRobot(StreamedStepwiseMotion):
    """Robot with active tool, mode and override. Revolution counters are updated by a person at the pendant."""

    def __init__(self, link: WebLink, options: AbbOptions, stream: JointStream | None = None) -> None:
        super().__init__(
            link.device, options.motion, stream, own_link="Robot Web Services", takes_stream=True
        )
        self._link, self._options = link, options
        self._server = MotionServer(link)
        self._mastership = EditMastership(link)
        self._has_ordered = False  # a step of the present move

    @property
    def capabilities(self) -> RobotCapabilities:
        return CAPABILITIES

    async def connect(self) -> None:
        """Find out the generation, open the session and compare the serial number. Nothing is ordered."""
        await self._link.connect()
        found = await self.identify()
        check_serial_number(self.name, found.serial, self._options.serial)
        if not found.firmware.startswith(VERIFIED_ON):
            _LOG.warning("%s: not verified on controller software %r", self.name, found.firmware)
        await self._open_stream()

    async def close(self) -> None:
        """Give mastership and session back."""
        self._close_stream()
        try:
            await self._mastership.release()
        finally:
            await self._link.close()

    async def identify(self) -> Identity:
        async with self._answer_deadline("asking who it is"):
            identity = await self._link.get_state("/ctrl/identity")
            system = await self._link.get_state("/rw/system")
        return Identity(
            "ABB",
            _word_of(self._link, identity, "ctrl-type"),
            _word_of(self._link, identity, "ctrl-id"),
            f"RobotWare {_word_of(self._link, system, 'rwversion')}".strip(),
        )

    async def identity_doubts(self) -> str:
        """Say that another robot is on the same controller, whose serial number is the same."""
        async with self._answer_deadline("asking who it is"):
            try:
                await self._link.get_state(_SECOND_ROBOT)
            except RefusedError:
                return ""
        return describe_second_robot("ROB_1")

    async def _request_condition(self) -> Condition:
        async with self._link.confirmed_answers():
            return condition_of(await read_state(self._link))

    async def read_joints(self) -> JointReading:
        async with self._answer_deadline("reading the joints"):
            if compared := await self._read_compared():
                return compared
            async with self._link.confirmed_answers():
                before, _ = await read_joints(self._link)
                await self._let_cycles_pass()
                joints, reply = await read_joints(self._link)
        moving = bool(self._doing) or joints != before  # the service tells no motion of others
        return JointReading(joints, moving, time.monotonic(), raw=str(dict(reply)))

    async def flange_pose(self) -> Pose:
        async with self._confirmed_answers("reading the pose"):
            return await read_flange_pose(self._link)

    async def active_frames(self) -> ActiveFrames:
        async with self._confirmed_answers("reading the active tool"):
            tool_name, work_object = await read_unit_names(self._link)
            text = await self._link.read_symbol(tool_name)
            external_axes = await read_external_axes(self._link)
        robot_carries, flange_tool, mass_kg = converted(self._link, partial(read_tool, text))
        if not robot_carries:
            raise RefusedError(
                self.name,
                make_message("the active tool {tool_name} stands beside the robot.", tool_name=tool_name),
                remedy="Select the tool that the robot carries.",
            )
        payload_kg = check_mass(self.name, mass_kg) if mass_kg >= 0 else None
        frame_number = 0 if work_object == _BASE else None
        return ActiveFrames(None, check_pose(self.name, flange_tool), frame_number, payload_kg, external_axes)

    async def controller_mode(self) -> str:
        async with self._confirmed_answers("reading the mode"):
            return text_of(self._link, await self._link.get_state("/rw/panel/opmode"), "opmode")

    async def speed_override(self) -> float:
        async with self._confirmed_answers("reading the speed override"):
            state = await self._link.get_state("/rw/panel/speedratio")
            return check_override(self.name, number_of(self._link, state, "speedratio") / 100.0)

    async def position_data(self) -> tuple[ShownValue, ...]:
        async with self._confirmed_answers("reading the position"):
            return await read_position_data(self._link)

    async def position_history(self, since: tuple[str, ...]) -> PositionHistory:
        async with self._answer_deadline("reading the event log", times=10), self._link.confirmed_answers():
            return await read_position_history(self._link, since)

    @asynccontextmanager
    async def _confirmed_answers(self, doing: str) -> AsyncIterator[None]:
        async with self._answer_deadline(doing), self._link.confirmed_answers():
            yield

    # a move

    async def _read_angles(self) -> Joints:
        async with self._link.confirmed_answers():
            return (await read_joints(self._link))[0]

    async def move_joints(self, target_rad: Joints, *, speed_rad_s: float) -> None:
        try:
            await super().move_joints(target_rad, speed_rad_s=speed_rad_s)
        finally:
            if not self._doing:  # a move that was refused because of another leaves that one its mastership
                await run_to_end(self._mastership.release())

    async def stop(self) -> None:
        try:
            await super().stop()
        finally:
            if not self._doing:
                await run_to_end(self._mastership.release())

    async def _begin_motion(self, speed_rad_s: float) -> None:
        self._has_ordered = False
        await self._mastership.acquire()
        await self._server.require_running()

    async def _order_step(self, target_rad: Array, duration_s: float, speed_rad_s: float) -> IsFinished:
        self._has_ordered = True
        request = await self._server.order_move(tuple(target_rad.tolist()), duration_s)
        return partial(self._server.has_finished, request)

    async def _explain_standstill(self) -> None:
        await self._server.require_alive()

    async def _halt_arm(self) -> None:
        try:
            await self._mastership.acquire()
            await self._server.stop()
        except (RefusedError, WireProtocolError) as error:
            self._mastership.note_loss()
            await self._stop_all_programs(error)

    async def _stop_all_programs(self, error: DeviceError) -> None:
        """Stop every program where the write of a stop was barred: by another client, or with a right that has ended.

        A move of this client that has ordered nothing yet has nothing to stop. What another client has ordered is not
        known: between two of its steps its program waits.
        """
        if self._doing and not self._has_ordered:
            return
        _LOG.warning("%s: a stop was not written (%s): all programs are stopped", self.name, error.message)
        await self._link.post_action("/rw/rapid/execution", "stop", stopmode="stop")

    async def _release_arm(self) -> None:
        """Do nothing: the next motion releases the stop."""


def _word_of(link: WebLink, state: Mapping[str, Any], key: str) -> str:
    """Return a word of the name plate; "" where it is left out."""
    return text_of(link, state, key) if state.get(key) not in (None, "") else ""
