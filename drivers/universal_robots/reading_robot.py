"""What every Universal Robots controller can be asked, and its stop. A CB3 gets nothing more than that."""

import asyncio
import contextlib
import logging
import math
from dataclasses import dataclass

import numpy as np

from cellcal.calibration.geometry import Pose, homogeneous_matrix
from cellcal.calibration.mastering.position_record import ShownValue
from cellcal.calibration.message import make_message
from cellcal.calibration.orientation import rotation_from
from cellcal.drivers.errors import (
    LOOK_FIRST,
    DeviceError,
    DeviceTimeoutError,
    RefusedError,
    UnreachableError,
    WireProtocolError,
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
from cellcal.drivers.universal_robots.factory_calibration import FactoryKinematics, read_factory_kinematics
from cellcal.drivers.universal_robots.health import arm_condition_of
from cellcal.drivers.universal_robots.motion import MotionTolerances, has_stood, is_moving
from cellcal.drivers.universal_robots.robot_connection import RobotConnection
from cellcal.drivers.universal_robots.rtde import RuntimeState
from cellcal.drivers.universal_robots.state import Six, StateSample
from cellcal.drivers.wire.cancellation import run_to_end
from cellcal.drivers.wire.deadline import answer_deadline
from cellcal.drivers.wire.possible_values import check_mass, check_override

_log = logging.getLogger(__name__)

STILL_S = 0.1
_MOST_M, _MOST_RAD = 20.0, 20.0  # of a place with its tool; of a rotation vector, which is below a turn
_WATCHDOG_S = 1.5  # longer than any watchdog_hz of the cell file
READ_ONLY_CAPABILITIES = RobotCapabilities(
    axes=6,
    moves_joints=False,
    hand_guiding=True,
    tells_active_frames=True,
    tells_speed_override=True,
    shows_position_data=True,
)


@dataclass(frozen=True, slots=True)
class UrMotionOptions:
    """The cell file's options of motion."""

    deadline_s: float
    speed_limit_rad_s: float
    acceleration_rad_s2: float
    stop_deceleration_rad_s2: float
    tolerances: MotionTolerances


class ReadingUniversalRobot:
    """Robot and KnowsActiveFrames over RTDE, without moves."""

    def __init__(self, contact: RobotConnection, address: str, options: UrMotionOptions) -> None:
        self._contact, self._address, self._options = contact, address, options

    @property
    def name(self) -> str:
        return self._contact.device

    @property
    def capabilities(self) -> RobotCapabilities:
        return READ_ONLY_CAPABILITIES

    async def connect(self) -> None:
        """Connect for reading. Nothing is sent to the arm before the first move."""
        async with answer_deadline(self.name, self._options.deadline_s, "connecting"):
            await self._contact.ensure_stream()

    async def close(self) -> None:
        """Hang up."""
        await self._contact.close()

    async def identify(self) -> Identity:
        async with answer_deadline(self.name, self._options.deadline_s, "asking who it is"):
            return await self._contact.read_identity()

    async def identity_doubts(self) -> str:
        async with answer_deadline(self.name, self._options.deadline_s, "asking who it is"):
            return await self._contact.read_doubts()

    async def read_condition(self) -> Condition:
        try:
            async with answer_deadline(self.name, self._options.deadline_s, "asking its condition"):
                return await self._read_condition()
        except DeviceError as error:
            return Condition(Readiness.UNREACHABLE, error.message, error.remedy)

    async def read_joints(self) -> JointReading:
        sample = await self._read_sample("reading the joints")
        return JointReading(
            joints_rad=sample.joints_rad,
            moving=is_moving(sample, self._options.tolerances),
            taken_at_s=sample.received_at_s,
            device_time_s=sample.timestamp_s,
            raw=sample.raw.hex(),
        )

    async def flange_pose(self) -> Pose:
        sample = await self._read_sample("reading the pose")
        if not all(map(math.isfinite, (*sample.tcp_pose, *sample.tcp_offset))):
            raise RefusedError(self.name, "the controller tells a pose or tool that is not a number.",
                               remedy="Set the TCP anew on the pendant, and look at the pose there.")  # fmt: skip
        return self._to_pose(sample.tcp_pose) @ self._to_pose(sample.tcp_offset).inverse()

    async def active_frames(self) -> ActiveFrames:
        sample = await self._read_sample("reading the active tool")
        if not (
            all(map(math.isfinite, (*sample.tcp_offset, sample.payload_kg))) and sample.payload_kg >= 0.0
        ):
            raise RefusedError(self.name, "the controller tells a tool or payload that is not a number.",
                               remedy="Set TCP and payload anew on the pendant.")  # fmt: skip
        payload_kg = check_mass(self.name, sample.payload_kg)
        return ActiveFrames(None, self._to_pose(sample.tcp_offset), 0, payload_kg)  # poses are in the base

    async def speed_override(self) -> float:
        sample = await self._read_sample("reading the speed slider")
        if not math.isfinite(sample.speed_fraction):
            raise RefusedError(self.name, "the controller tells a speed slider that is not a number.",
                               remedy="Move the speed slider on the pendant.")  # fmt: skip
        return check_override(self.name, sample.speed_fraction)

    async def factory_kinematics(self) -> FactoryKinematics:
        """Return the arm's kinematics as measured by the maker and used by the controller."""
        return await read_factory_kinematics(self.name, self._address, deadline_s=self._options.deadline_s)

    async def position_data(self) -> tuple[ShownValue, ...]:
        """Return what changes with an exchanged joint: the checksum of each, and the name of the factory's table."""
        found = await self.factory_kinematics()
        joints = [
            ShownValue("checksum", f"{value:08x}", axis, is_constant=True)
            for axis, value in enumerate(found.checksums)
        ]
        return (*joints, ShownValue("calibration", found.name, is_constant=True))

    async def move_joints(self, target_rad: Joints, *, speed_rad_s: float) -> None:
        del target_rad, speed_rad_s
        raise RefusedError(
            self.name,
            "a CB3 controller is only read: it has no switch by which a person hands control to the network.",
            remedy="Move the arm at the pendant or by hand, and set the motion of the robot in the cell file to "
            "observe or program.",
        )

    async def stop(self) -> None:
        try:
            await run_to_end(self._halt_arm())
        except DeviceError as error:
            raise with_look_first(error) from None

    async def _read_condition(self) -> Condition:
        return arm_condition_of(await self._contact.read_sample())

    async def _halt_arm(self) -> None:
        """End whatever program plays; confirm standstill."""
        async with answer_deadline(self.name, self._options.deadline_s, "confirming standstill"):
            await self._end_program()
            await self._has_stopped()

    async def _end_program(self) -> None:
        """End whatever program plays: nothing may move on, or be resumed, behind our back."""
        try:
            if (await self._contact.read_sample()).runtime_state == RuntimeState.STOPPED:
                return
        except DeviceError as error:
            _log.info("%s: stopped without knowing its state: %s", self.name, error)
        try:
            await self._contact.stop_program()
        except RefusedError:
            if not await self._has_ended():
                raise

    async def _has_ended(self) -> bool:
        """Whether the program ends all the same: ours does when it is not fed any more."""
        state = await self._contact.ensure_stream()
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(_WATCHDOG_S):
                while (await state.read_fresh()).runtime_state != RuntimeState.STOPPED:
                    pass
                return True
        return False

    async def _has_stopped(self) -> None:
        state = await self._contact.ensure_stream()
        while True:
            await state.read_fresh()
            if has_stood(state.samples, self._options.tolerances, STILL_S):
                return

    async def _read_sample(self, doing: str) -> StateSample:
        async with answer_deadline(self.name, self._options.deadline_s, doing):
            return await self._contact.read_sample()

    def _to_pose(self, values: Six) -> Pose:
        """Return a pose; raise RefusedError where no arm of this maker reaches, or no rotation is."""
        numbers = np.array(values)
        if max(np.abs(numbers[:3]) / _MOST_M) > 1.0 or max(np.abs(numbers[3:]) / _MOST_RAD) > 1.0:
            raise RefusedError(self.name, "the controller tells a pose or tool that its arm cannot have.",
                               remedy="Set the TCP anew on the pendant, and look at the pose there.")  # fmt: skip
        rotation = rotation_from("ur_rotation_vector", numbers[3:])
        return Pose.from_matrix(homogeneous_matrix(rotation, numbers[:3]))


def with_look_first(error: DeviceError) -> DeviceError:
    """Where we lost sight of the arm, the first thing to do is to look at it."""
    blind = isinstance(error, UnreachableError | DeviceTimeoutError | WireProtocolError)
    if blind and not error.remedy.startswith(LOOK_FIRST):
        error.remedy = make_message("{look} {error_remedy}", look=LOOK_FIRST, error_remedy=error.remedy)
    return error
