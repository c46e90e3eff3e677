"""A Universal Robots arm: reads its own state stream, moves through a fenced session, stops on two paths."""

import asyncio
import contextlib
import logging
import math
from collections.abc import Coroutine, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import numpy as np

from cellcal.calibration.geometry import Pose, homogeneous
from cellcal.calibration.orientation import rotation_from
from cellcal.drivers.errors import (
    BusyError,
    DeviceError,
    DeviceTimeoutError,
    MotionStoppedError,
    RefusedError,
    UnreachableError,
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
from cellcal.drivers.universal_robots.contact import Contact
from cellcal.drivers.universal_robots.factory_calibration import FactoryKinematics, read_factory_kinematics
from cellcal.drivers.universal_robots.health import LOCAL, condition_of, error_of, stop_of
from cellcal.drivers.universal_robots.motion import (
    Tolerances,
    arrived,
    expected_s,
    farthest,
    moves,
    off_path_rad,
    stands,
)
from cellcal.drivers.universal_robots.rtde import RuntimeState
from cellcal.drivers.universal_robots.session import MotionSession, SessionOptions
from cellcal.drivers.universal_robots.state import Sample, Six, StateClient
from cellcal.drivers.wire.deadline import deadline, too_long
from cellcal.drivers.wire.patience import Patience

_log = logging.getLogger(__name__)

_REMOTE_KNOWN_S = 1.0
_OLD_PROGRAM_S = 0.6  # ours, left by a session that was killed, ends by its watchdog
_STOP_HEARD_S = 0.5
_STILL_S = 0.1
_STUCK_S = 1.0
_PATH_RAD = 0.05
_SLOWER = 1.5
_LOOK = "Look at the robot first: it should have stopped. Use the emergency stop if it has not."


@dataclass(frozen=True, slots=True)
class MotionOptions:
    """What the cell file says about motion."""

    deadline_s: float
    speed_limit_rad_s: float
    acceleration_rad_s2: float
    stop_deceleration_rad_s2: float
    tolerances: Tolerances


CAPABILITIES = RobotCapabilities(
    axes=6, hand_guiding=True, tells_active_frames=True, tells_mode=True, tells_speed_override=True
)


class UniversalRobot:
    """Robot and KnowsActiveFrames over RTDE. The rest a UR cannot do without a person or its own program."""

    def __init__(self, contact: Contact, session: SessionOptions, options: MotionOptions) -> None:
        self._contact, self._session_options, self._options = contact, session, options
        self._session: MotionSession | None = None
        self._moving = False
        self._stop_asked = False

    @property
    def name(self) -> str:
        return self._contact.device

    @property
    def capabilities(self) -> RobotCapabilities:
        return CAPABILITIES

    async def connect(self) -> None:
        """Connect for reading. Nothing is sent to the arm before the first move."""
        async with deadline(self.name, self._options.deadline_s, "connecting"):
            await self._contact.state()

    async def close(self) -> None:
        """Give the robot back and hang up."""
        await self._end_session()
        self._contact.close()

    async def identify(self) -> Identity:
        async with deadline(self.name, self._options.deadline_s, "asking who it is"):
            return await self._contact.identity()

    async def condition(self) -> Condition:
        try:
            async with deadline(self.name, self._options.deadline_s, "asking its condition"):
                return await self._condition(remote_known_s=_REMOTE_KNOWN_S)
        except DeviceError as error:
            return Condition(Readiness.UNREACHABLE, error.message, error.remedy)

    async def joints(self) -> JointReading:
        sample = await self._read("reading the joints")
        return JointReading(
            joints_rad=sample.joints_rad,
            moving=moves(sample, self._options.tolerances),
            taken_at_s=sample.received_at_s,
            device_time_s=sample.timestamp_s,
            raw=sample.raw.hex(),
        )

    async def flange_pose(self) -> Pose:
        sample = await self._read("reading the pose")
        return _pose(sample.tcp_pose) @ _pose(sample.tcp_offset).inverse()

    async def active_frames(self) -> ActiveFrames:
        sample = await self._read("reading the active tool")
        if not all(map(math.isfinite, (*sample.tcp_offset, sample.payload_kg))):
            raise RefusedError(self.name, "the controller tells a tool or payload that is not a number.",
                               remedy="Set TCP and payload anew on the pendant.")  # fmt: skip
        return ActiveFrames(None, _pose(sample.tcp_offset), 0, sample.payload_kg)  # poses are in the base

    async def controller_mode(self) -> str:
        async with deadline(self.name, self._options.deadline_s, "asking its mode"):
            remote = await self._contact.in_remote_control()
        return "remote control" if remote else "local control"

    async def speed_override(self) -> float:
        sample = await self._read("reading the speed slider")
        if not math.isfinite(sample.speed_fraction):
            raise RefusedError(self.name, "the controller tells a speed slider that is not a number.",
                               remedy="Move the speed slider on the pendant.")  # fmt: skip
        return sample.speed_fraction

    async def factory_kinematics(self) -> FactoryKinematics:
        """Return the arm's kinematics as measured by the maker and used by the controller."""
        return await read_factory_kinematics(
            self.name, self._session_options.address, deadline_s=self._options.deadline_s
        )

    async def move_joints(self, target_rad: Joints, *, speed_rad_s: float) -> None:
        target, speed_rad_s = self._checked(target_rad, speed_rad_s)
        with self._alone():
            state = await self._ready_state()
            session = await self._open_session(state)
            session.begin()
            try:
                await self._travel(state, session, target, speed_rad_s)
            except asyncio.CancelledError as cancelled:
                await _finish(self._halt_for(cancelled, session))
                raise
            except DeviceError as error:
                _log.warning("%s: the move failed: %s", self.name, error)
                await self._abandon(session, error.message)
                raise _look_first(error) from None
            finally:
                session.rest()

    async def stop(self) -> None:
        self._stop_asked = True
        try:
            await _finish(self._halt(self._session))
        except DeviceError as error:
            raise _look_first(error) from None
        finally:
            self._stop_asked = self._moving  # a move under way has still to see it

    # before a move

    def _checked(self, target_rad: Joints, speed_rad_s: float) -> tuple[Six, float]:
        if len(target_rad) != 6 or not all(map(math.isfinite, target_rad)):
            raise RefusedError(self.name, "a target needs six finite joint angles.")
        if max(map(abs, target_rad)) > 2 * math.pi:
            raise RefusedError(self.name, "a joint angle is beyond one turn of this arm's joints.",
                               remedy="Check the unit: targets are radians.")  # fmt: skip
        if not (math.isfinite(speed_rad_s) and speed_rad_s > 0):
            raise RefusedError(self.name, "a speed must be finite and above zero.")
        a, b, c, d, e, f = (float(angle) for angle in target_rad)
        return (a, b, c, d, e, f), min(speed_rad_s, self._options.speed_limit_rad_s)

    @contextmanager
    def _alone(self) -> Iterator[None]:
        if self._moving:
            raise BusyError(self.name, "a move is under way, another one was asked for.")
        self._moving, self._stop_asked = True, False
        try:
            yield
        finally:
            self._moving = self._stop_asked = False

    async def _ready_state(self) -> StateClient:
        """Return the state stream of an arm that may be moved now; raise what forbids it."""
        async with deadline(self.name, self._options.deadline_s, "asking its condition"):
            state = await self._contact.state()
            await self._drop_dead_session(await state.fresh())
            if self._session is None:
                await self._old_program_ends(state)
            condition = await self._condition(remote_known_s=0.0)
        if condition.readiness is not Readiness.READY:
            raise error_of(self.name, condition)
        return state

    async def _drop_dead_session(self, sample: Sample) -> None:
        if self._session is None:
            return
        if sample.runtime_state != RuntimeState.PLAYING:
            self._session.kill("its program on the controller has ended")
        if not self._session.usable:
            await self._end_session()

    async def _old_program_ends(self, state: StateClient) -> None:
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(_OLD_PROGRAM_S):
                while (await state.fresh()).runtime_state != RuntimeState.STOPPED:
                    pass

    async def _open_session(self, state: StateClient) -> MotionSession:
        if self._session is None:
            self._session = await self._new_session()
            async with deadline(self.name, self._options.deadline_s, "starting the program"):
                while (await state.fresh()).runtime_state != RuntimeState.PLAYING:
                    self._session.check()
        return self._session

    async def _new_session(self) -> MotionSession:
        contact = self._contact
        try:
            return await MotionSession.open(self.name, self._session_options, lambda: contact.stands)
        except (DeviceTimeoutError, UnreachableError):
            with contextlib.suppress(DeviceError):  # our program may have started all the same
                await contact.dashboard.stop()
            raise

    async def _condition(self, *, remote_known_s: float) -> Condition:
        sample = await self._contact.sample()
        ours = self._session is not None and self._session.usable
        condition = condition_of(sample, program_is_ours=ours)
        if condition.readiness is not Readiness.READY:
            return condition
        return condition if await self._contact.in_remote_control(known_s=remote_known_s) else LOCAL

    # during a move

    async def _travel(
        self, state: StateClient, session: MotionSession, target: Six, speed_rad_s: float
    ) -> None:
        acceleration = self._options.acceleration_rad_s2
        start = await state.fresh()
        travel_s = _SLOWER * expected_s(start.joints_rad, target, speed_rad_s, acceleration)
        margin_s = self._options.tolerances.settle_s + self._options.deadline_s
        self._look_for_stops(start, session)
        await session.move_joints(target, speed_rad_s, acceleration)
        patience = Patience(travel_s, margin_s, asyncio.get_running_loop().time())
        await self._follow(state, session, start.joints_rad, target, patience)

    async def _follow(
        self, state: StateClient, session: MotionSession, start: Six, target: Six, patience: Patience
    ) -> None:
        tolerances, loop = self._options.tolerances, asyncio.get_running_loop()
        moved_at_s = loop.time()
        while True:
            sample = await state.fresh()
            self._look_for_stops(sample, session)
            if off_path_rad(sample, start, target) > _PATH_RAD:
                raise self._stranger()
            if arrived(state.samples, target, tolerances) and not await session.move_running():
                return
            if not stands(state.samples, tolerances, _STILL_S):
                moved_at_s = loop.time()
            elif loop.time() - moved_at_s > _STUCK_S:
                raise self._short(sample, target)
            if patience.ended(loop.time(), sample.speed_fraction):
                raise too_long(self.name, patience.passed_s(), "moving")

    def _look_for_stops(self, sample: Sample, session: MotionSession) -> None:
        stop = stop_of(self.name, sample)
        if stop is not None:
            raise stop
        session.check()
        if self._stop_asked:
            raise MotionStoppedError(
                self.name,
                "the move was stopped because a stop was asked for.",
                remedy="Repeat the step when the arm may move on.",
            )
        if sample.runtime_state != RuntimeState.PLAYING:
            raise MotionStoppedError(
                self.name,
                "the program that moves the arm was stopped or paused: at the pendant, by another client, or "
                "because this computer fell silent.",
                remedy="Look at the pendant; if nobody stopped it, check the network, then repeat the step.",
            )

    def _stranger(self) -> MotionStoppedError:
        return MotionStoppedError(
            self.name,
            "the arm left the path of its move: another client commands it, or somebody pushes it.",
            remedy="Find out who else moves the robot and disconnect that client, then repeat the step.",
        )

    def _short(self, sample: Sample, target: Six) -> MotionStoppedError:
        joint, error_rad = farthest(sample, target)
        return MotionStoppedError(
            self.name,
            f"the arm stands, but joint {joint + 1} is {math.degrees(error_rad):.2f} deg from its target.",
            remedy="Look whether something blocks the arm or its speed is at zero, then repeat the step.",
        )

    # ending a move

    async def _halt(self, session: MotionSession | None) -> None:
        """Stop the arm through the session, or else through the dashboard; confirm standstill."""
        async with deadline(self.name, self._options.deadline_s, "confirming standstill"):
            if session is None or not await self._session_stops(session):
                await self._dashboard_stops(session)
            await self._stands_still()

    async def _session_stops(self, session: MotionSession) -> bool:
        if not session.usable:
            return False
        with contextlib.suppress(DeviceError):
            await session.stop(self._options.stop_deceleration_rad_s2, deadline_s=_STOP_HEARD_S)
            return True
        return False

    async def _dashboard_stops(self, session: MotionSession | None) -> None:
        """End whatever program plays: nothing may move on, or be resumed, behind our back."""
        if session is not None:
            session.kill("the arm had to be stopped without it")
        with contextlib.suppress(DeviceError):
            if (await self._contact.sample()).runtime_state == RuntimeState.STOPPED:
                return
        await self._contact.dashboard.stop()

    async def _stands_still(self) -> None:
        state = await self._contact.state()
        while True:
            await state.fresh()
            if stands(state.samples, self._options.tolerances, _STILL_S):
                return

    async def _halt_for(self, cancelled: asyncio.CancelledError, session: MotionSession) -> None:
        try:
            await self._halt(session)
        except DeviceError as error:
            cancelled.add_note(f"{error} {_LOOK}")
            _log.error("%s: cancelled, but standstill is not confirmed: %s %s", self.name, error, _LOOK)

    async def _abandon(self, session: MotionSession, reason: str) -> None:
        """After a failure: end the child and the program, so that a later ``play`` cannot resume the move."""
        session.kill(reason)
        with contextlib.suppress(DeviceError):
            await self._contact.dashboard.stop()
        if self._contact.stands:
            with contextlib.suppress(DeviceError):
                async with deadline(self.name, self._options.deadline_s / 2, "confirming standstill"):
                    await self._stands_still()

    async def _end_session(self) -> None:
        session, self._session = self._session, None
        if session is None:
            return
        if not self._contact.stands:
            session.kill("the link to the controller was lost")
        await session.close()

    async def _read(self, doing: str) -> Sample:
        async with deadline(self.name, self._options.deadline_s, doing):
            return await self._contact.sample()


def _pose(values: Six) -> Pose:
    numbers = np.array(values)
    return Pose.from_matrix(homogeneous(rotation_from("ur_rotation_vector", numbers[3:]), numbers[:3]))


def _look_first(error: DeviceError) -> DeviceError:
    """Where we lost sight of the arm, the first thing to do is to look at it."""
    blind = isinstance(error, UnreachableError | DeviceTimeoutError)
    if blind and not error.remedy.startswith(_LOOK):
        error.remedy = f"{_LOOK} {error.remedy}"
    return error


async def _finish(work: Coroutine[Any, Any, None]) -> None:
    """Run ``work``, which ends by its own deadline, to its end even when we are cancelled; then re-raise."""
    task = asyncio.ensure_future(work)
    cancelled: asyncio.CancelledError | None = None
    while not task.done():
        try:
            await asyncio.wait({task})
        except asyncio.CancelledError as error:
            cancelled = error
    if cancelled is not None:
        raise cancelled from task.exception()
    task.result()
