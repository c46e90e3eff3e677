"""A Universal Robots arm that moves: its own state stream, a fenced session for motion, a stop on two paths."""

import asyncio
import contextlib
import logging
import math
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace

from cellcal.calibration.message import make_message
from cellcal.drivers.errors import (
    LOOK_FIRST,
    BusyError,
    DeviceError,
    DeviceTimeoutError,
    MotionStoppedError,
    RefusedError,
    UnreachableError,
)
from cellcal.drivers.interfaces import Condition, Joints, Readiness, RobotCapabilities
from cellcal.drivers.universal_robots.health import (
    LOCAL,
    REMOTE_UNKNOWN,
    condition_error,
    condition_of,
    mode_condition_of,
    safety_stop_of,
)
from cellcal.drivers.universal_robots.motion import (
    expected_s,
    farthest_joint,
    has_arrived,
    has_stood,
    path_deviation_rad,
)
from cellcal.drivers.universal_robots.reading_robot import (
    READ_ONLY_CAPABILITIES,
    STILL_S,
    ReadingUniversalRobot,
    UrMotionOptions,
    with_look_first,
)
from cellcal.drivers.universal_robots.robot_connection import RobotConnection
from cellcal.drivers.universal_robots.rtde import RuntimeState
from cellcal.drivers.universal_robots.session import MotionSession, SessionOptions
from cellcal.drivers.universal_robots.state import Six, StateClient, StateSample
from cellcal.drivers.wire.cancellation import run_to_end
from cellcal.drivers.wire.deadline import answer_deadline, timeout_error
from cellcal.drivers.wire.move_timeout import MoveTimeout

_log = logging.getLogger(__name__)

_REMOTE_KNOWN_S = 1.0
_OLD_PROGRAM_S = 0.6  # ours, left by a session that was killed, ends by its watchdog
_STOP_RECEIVED_S = 0.5
_STUCK_S = 1.0
_PATH_RAD = 0.05
_SLOWER = 1.5

CAPABILITIES = replace(READ_ONLY_CAPABILITIES, moves_joints=True, tells_mode=True)


class UniversalRobot(ReadingUniversalRobot):
    """Robot, KnowsActiveFrames and KnowsMode. The rest a UR cannot do without a person or its own program."""

    def __init__(self, contact: RobotConnection, session: SessionOptions, options: UrMotionOptions) -> None:
        super().__init__(contact, session.address, options)
        self._session_options = session
        self._session: MotionSession | None = None
        self._moving = False
        self._stop_asked = False

    @property
    def capabilities(self) -> RobotCapabilities:
        return CAPABILITIES

    async def close(self) -> None:
        """Give the robot back and hang up."""
        await self._end_session()
        await super().close()

    async def controller_mode(self) -> str:
        async with answer_deadline(self.name, self._options.deadline_s, "asking its mode"):
            remote = await self._contact.in_remote_control()
            operational = (await self._contact.operational_mode()).lower()
        return f"{'remote' if remote else 'local'} control{', ' if operational else ''}{operational}"

    async def move_joints(self, target_rad: Joints, *, speed_rad_s: float) -> None:
        target, speed_rad_s = self._check_target(target_rad, speed_rad_s)
        with self._exclusive_use():
            state = await self._ready_state()
            session = await self._open_session(state)
            session.begin_move()
            try:
                await self._travel_to(state, session, target, speed_rad_s)
            except asyncio.CancelledError as cancelled:
                await run_to_end(self._halt_after_cancel(cancelled))
                raise
            except DeviceError as error:
                _log.warning("%s: the move failed: %s", self.name, error)
                await self._abandon_session(session, error.message)
                raise with_look_first(error) from None
            finally:
                session.end_move()

    async def stop(self) -> None:
        self._stop_asked = True
        try:
            await run_to_end(self._halt_arm())
        except DeviceError as error:
            raise with_look_first(error) from None
        finally:
            self._stop_asked = self._moving  # a move under way has still to see it

    # before a move

    def _check_target(self, target_rad: Joints, speed_rad_s: float) -> tuple[Six, float]:
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
    def _exclusive_use(self) -> Iterator[None]:
        if self._moving:
            raise BusyError(self.name, "a move is under way, another one was asked for.")
        self._moving, self._stop_asked = True, False
        try:
            yield
        finally:
            self._moving = self._stop_asked = False

    async def _ready_state(self) -> StateClient:
        """Return the state stream of an arm that may be moved now; raise what forbids it."""
        async with answer_deadline(self.name, self._options.deadline_s, "asking its condition"):
            state = await self._contact.ensure_stream()
            await self._drop_dead_session(await state.read_fresh())
            if self._session is None:
                await self._wait_for_old_program(state)
            condition = await self._current_condition(remote_known_s=0.0)
        if condition.readiness is not Readiness.READY:
            raise condition_error(self.name, condition)
        return state

    async def _drop_dead_session(self, sample: StateSample) -> None:
        if self._session is None:
            return
        if sample.runtime_state != RuntimeState.PLAYING:
            self._session.kill("its program on the controller has ended")
        if not self._session.is_usable:
            await self._end_session()

    async def _wait_for_old_program(self, state: StateClient) -> None:
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(_OLD_PROGRAM_S):
                while (await state.read_fresh()).runtime_state != RuntimeState.STOPPED:
                    pass

    async def _open_session(self, state: StateClient) -> MotionSession:
        if self._session is None:
            self._session = await self._new_session()
            async with answer_deadline(self.name, self._options.deadline_s, "starting the program"):
                while (await state.read_fresh()).runtime_state != RuntimeState.PLAYING:
                    self._session.raise_failure()
        return self._session

    async def _new_session(self) -> MotionSession:
        contact = self._contact
        try:
            return await MotionSession.open(self.name, self._session_options, lambda: contact.is_connected)
        except (DeviceTimeoutError, UnreachableError):
            with contextlib.suppress(DeviceError):  # our program may have started all the same
                await contact.stop_program()
            raise

    async def _read_condition(self) -> Condition:
        return await self._current_condition(remote_known_s=_REMOTE_KNOWN_S)

    async def _current_condition(self, *, remote_known_s: float) -> Condition:
        sample = await self._contact.read_sample()
        ours = self._session is not None and self._session.is_usable
        condition = condition_of(sample, program_is_ours=ours)
        if condition.readiness is not Readiness.READY:
            return condition
        if not self._contact.tells_remote_control:
            return REMOTE_UNKNOWN
        if not await self._contact.in_remote_control(known_s=remote_known_s):
            return LOCAL
        mode = await self._contact.operational_mode(known_s=remote_known_s)
        return mode_condition_of(mode) or condition

    # during a move

    async def _travel_to(
        self, state: StateClient, session: MotionSession, target: Six, speed_rad_s: float
    ) -> None:
        acceleration = self._options.acceleration_rad_s2
        start = await state.read_fresh()
        travel_s = _SLOWER * expected_s(start.joints_rad, target, speed_rad_s, acceleration)
        margin_s = self._options.tolerances.settle_s + self._options.deadline_s
        self._raise_on_stop(start, session)
        await session.move_joints(target, speed_rad_s, acceleration)
        patience = MoveTimeout(travel_s, margin_s, asyncio.get_running_loop().time())
        await self._follow_move(state, session, start.joints_rad, target, patience)

    async def _follow_move(
        self, state: StateClient, session: MotionSession, start: Six, target: Six, patience: MoveTimeout
    ) -> None:
        tolerances, loop = self._options.tolerances, asyncio.get_running_loop()
        moved_at_s = loop.time()
        while True:
            sample = await state.read_fresh()
            self._raise_on_stop(sample, session)
            if path_deviation_rad(sample, start, target) > _PATH_RAD:
                raise self._foreign_motion_error()
            if has_arrived(state.samples, target, tolerances) and not await session.move_running():
                return
            if not has_stood(state.samples, tolerances, STILL_S):
                moved_at_s = loop.time()
            elif loop.time() - moved_at_s > _STUCK_S:
                raise self._short_of_target_error(sample, target)
            if patience.has_expired(loop.time(), sample.speed_fraction):
                raise timeout_error(self.name, patience.passed_s(), "moving")

    def _raise_on_stop(self, sample: StateSample, session: MotionSession) -> None:
        stop = safety_stop_of(self.name, sample)
        if stop is not None:
            raise stop
        session.raise_failure()
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
                remedy="Look at the pendant; if it was not stopped there, check the network, then repeat the step.",
            )

    def _foreign_motion_error(self) -> MotionStoppedError:
        return MotionStoppedError(
            self.name,
            "the arm left the path of its move: another client commands it, or a person pushes it.",
            remedy="Find out who else moves the robot and disconnect that client, then repeat the step.",
        )

    def _short_of_target_error(self, sample: StateSample, target: Six) -> MotionStoppedError:
        joint, error_rad = farthest_joint(sample, target)
        return MotionStoppedError(
            self.name,
            make_message(
                "the arm stands, but joint {joint} is {error_deg:.2f} deg from its target.",
                joint=joint + 1,
                error_deg=math.degrees(error_rad),
            ),
            remedy="Look whether something blocks the arm or its speed is at zero, then repeat the step.",
        )

    # ending a move

    async def _end_program(self) -> None:
        """End what moves through the session, or else whatever program plays on the controller's own path."""
        session = self._session
        if session is not None and await self._stop_by_session(session):
            return
        if session is not None:
            session.kill("the arm had to be stopped without it")
        await super()._end_program()

    async def _stop_by_session(self, session: MotionSession) -> bool:
        if not session.is_usable:
            return False
        with contextlib.suppress(DeviceError):
            await session.decelerate_arm(self._options.stop_deceleration_rad_s2, deadline_s=_STOP_RECEIVED_S)
            return True
        return False

    async def _halt_after_cancel(self, cancelled: asyncio.CancelledError) -> None:
        try:
            await self._halt_arm()
        except DeviceError as error:
            cancelled.add_note(f"{error} {LOOK_FIRST}")
            _log.error("%s: cancelled, but standstill is not confirmed: %s %s", self.name, error, LOOK_FIRST)

    async def _abandon_session(self, session: MotionSession, reason: str) -> None:
        """After a failure: end the child and the program, so that a later ``play`` cannot resume the move."""
        session.kill(reason)
        with contextlib.suppress(DeviceError):
            await self._contact.stop_program()
        if self._contact.is_connected:
            with contextlib.suppress(DeviceError):
                async with answer_deadline(self.name, self._options.deadline_s / 2, "confirming standstill"):
                    await self._has_stopped()

    async def _end_session(self) -> None:
        session, self._session = self._session, None
        if session is None:
            return
        if not self._contact.is_connected:
            session.kill("the link to the controller was lost")
        await session.close()
