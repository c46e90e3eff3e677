"""Joint moves in short steps, for a controller that drives what was ordered to its end when its client is gone.

The steps lie on the straight line between the joint angles, so the path is that of one move; what the arm may
travel alone is one step.
"""

import asyncio
import contextlib
import logging
import math
from abc import ABC, abstractmethod
from collections.abc import Awaitable, Callable, Iterator
from contextlib import AbstractAsyncContextManager, contextmanager
from dataclasses import dataclass

import numpy as np

from cellcal.calibration.geometry import Array
from cellcal.calibration.message import join_messages, make_message
from cellcal.drivers.errors import LOOK_FIRST, DeviceError, MotionStoppedError, RefusedError
from cellcal.drivers.interfaces import Condition, Joints, Readiness
from cellcal.drivers.wire.busy import refuse_second_action
from cellcal.drivers.wire.cancellation import run_to_end
from cellcal.drivers.wire.deadline import answer_deadline

_LOG = logging.getLogger(__name__)
_POLL_S = 0.01
_APART_S = 0.03  # controllers renew their joints each 4 to 24 ms: nearer readings are of one cycle
IsFinished = Callable[[], Awaitable[bool]]


@dataclass(frozen=True, slots=True)
class StepwiseOptions:
    """The cell file's options of motion."""

    axes: int
    deadline_s: float
    speed_limit_rad_s: float
    step_s: float  # so long a step takes at most
    settle_s: float
    stuck_s: float  # without any motion: given up
    tolerance_rad: float


class StepwiseMotion(ABC):
    """The motion of a robot whose controller is given one step after the other.

    A subclass says how a step is ordered, how the arm is stopped, and what the controller's angles are.
    """

    def __init__(self, device: str, options: StepwiseOptions) -> None:
        self._device, self._motion = device, options
        self._doing = ""
        self._stop_ordered = False
        self._idle = asyncio.Event()
        self._idle.set()

    @property
    def name(self) -> str:
        """Name in the cell file."""
        return self._device

    async def read_condition(self) -> Condition:
        """As the interface ``Device`` says."""
        try:
            async with self._answer_deadline("asking its condition"):
                return await self._request_condition()
        except DeviceError as error:
            return Condition(Readiness.UNREACHABLE, error.message, error.remedy)

    @abstractmethod
    async def _request_condition(self) -> Condition:
        """Return what the controller says about itself; raise where it does not answer."""

    @abstractmethod
    async def _read_angles(self) -> Joints:
        """Return the joint angles now [rad]."""

    @abstractmethod
    async def _begin_motion(self, speed_rad_s: float) -> None:
        """Make the controller ready for steps at a speed, or raise why it is not."""

    @abstractmethod
    async def _order_step(self, target_rad: Array, duration_s: float, speed_rad_s: float) -> IsFinished:
        """Order one step, once, and return what tells whether it has ended."""

    async def _explain_standstill(self) -> None:  # noqa: B027  a controller without a program has nothing to add
        """Raise why the arm of a controller that is ready stands before its target, where that can be known."""

    @abstractmethod
    async def _halt_arm(self) -> None:
        """Stop the arm and give up what was ordered; return when the controller has taken the order."""

    @abstractmethod
    async def _release_arm(self) -> None:
        """Release what would keep a stopped arm from moving again."""

    async def move_joints(self, target_rad: Joints, *, speed_rad_s: float) -> None:
        """As the interface ``Robot`` says."""
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
        """As the interface ``Robot`` says."""
        self._stop_ordered = not self._idle.is_set()
        await run_to_end(self._halt_for_stop())

    # a move

    def _check_target(self, target_rad: Joints, speed_rad_s: float) -> tuple[Array, float]:
        axes = self._motion.axes
        if len(target_rad) != axes or not all(map(math.isfinite, target_rad)):
            raise RefusedError(
                self.name, make_message("a target needs {axes} finite joint angles.", axes=axes)
            )
        if not (math.isfinite(speed_rad_s) and speed_rad_s > 0):
            raise RefusedError(self.name, "a speed must be finite and above zero.")
        return np.array(target_rad, dtype=float), min(speed_rad_s, self._motion.speed_limit_rad_s)

    async def _move_in_steps(self, target: Array, speed_rad_s: float) -> None:
        await self._raise_unless_ready()
        async with self._answer_deadline("starting remote motion", times=2):
            await self._begin_motion(speed_rad_s)
            start = np.array(await self._read_angles())
        for step in step_targets(start, target, speed_rad_s * self._motion.step_s):
            self._raise_if_stopped()
            duration_s = float(np.abs(step - start).max()) / speed_rad_s
            async with self._answer_deadline("ordering a move"):
                is_finished = await self._order_step(step, duration_s, speed_rad_s)
            await self._follow_step(is_finished, step)
            start = step
        await asyncio.sleep(self._motion.settle_s)
        await self._check_arrival(target)

    async def _follow_step(self, is_finished: IsFinished, target: Array) -> None:
        """Wait until a step has ended; as long as the arm moves, however slowly."""
        loop = asyncio.get_running_loop()
        before: Joints = ()
        moved_at_s = loop.time()
        while True:
            async with self._answer_deadline("following the move"):
                finished = await self._has_ended(is_finished)
                joints = await self._read_angles()
            self._raise_if_stopped()
            if finished:
                return
            now_s = loop.time()
            if joints != before:
                before, moved_at_s = joints, now_s
            elif now_s - moved_at_s > self._motion.stuck_s:
                await self._raise_unless_ready()
                async with self._answer_deadline("following the move", times=2):
                    await self._explain_standstill()
                raise self._short_of_target_error(joints, target)
            await asyncio.sleep(_POLL_S)

    async def _has_ended(self, is_finished: IsFinished) -> bool:
        """Ask whether a step has ended; what stops the robot says more than why its step failed."""
        try:
            return await is_finished()
        except (MotionStoppedError, RefusedError):
            self._raise_if_stopped()
            await self._raise_unless_ready()
            raise

    async def _check_arrival(self, target: Array) -> None:
        async with self._answer_deadline("reading the joints"):
            joints = await self._read_angles()
        if float(np.abs(np.array(joints) - target).max()) > self._motion.tolerance_rad:
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
            make_message(
                "the arm stands, but joint {joint} is {error_deg:.2f} deg from its target.",
                joint=axis + 1,
                error_deg=math.degrees(errors[axis]),
            ),
            remedy="Look whether something blocks the arm or its speed is at zero, then repeat the step.",
        )

    # ending a move

    async def _halt_quietly(self) -> None:
        try:
            await self._halt_and_wait()
        except DeviceError as error:
            _LOG.warning("%s: the move failed: %s", self.name, error)

    async def _halt_for_stop(self) -> None:
        try:
            await self._halt_and_wait()
        except DeviceError as error:
            error.remedy = join_messages(" ", filter(None, (LOOK_FIRST, error.remedy)))
            raise
        finally:
            if self._stop_ordered:
                with contextlib.suppress(TimeoutError):
                    async with asyncio.timeout(self._motion.deadline_s):
                        await self._idle.wait()
            self._stop_ordered = False

    async def _halt_and_wait(self) -> None:
        """Stop the arm and wait until it stands; then release what would keep it from moving again."""
        async with self._answer_deadline("stopping", times=2):
            await self._halt_arm()
            before: Joints = ()
            while (joints := await self._read_angles()) != before:
                before = joints
                await self._let_cycles_pass()
            await self._release_arm()

    # shared by everything that a robot does

    @contextmanager
    def _exclusive_use(self, doing: str) -> Iterator[None]:
        refuse_second_action(self.name, self._doing, doing)
        self._doing, self._stop_ordered = doing, False
        self._idle.clear()
        try:
            yield
        finally:
            self._doing = ""
            self._idle.set()

    async def _let_cycles_pass(self) -> None:
        """Wait until an arm that moves shows other joints than before."""
        await asyncio.sleep(_APART_S)

    def _answer_deadline(self, doing: str, *, times: int = 1) -> AbstractAsyncContextManager[None]:
        return answer_deadline(self.name, times * self._motion.deadline_s, doing)


def step_targets(start_rad: Array, target_rad: Array, step_rad: float) -> list[Array]:
    """Return the ends of the steps, the target last; no axis turns further in one than ``step_rad``."""
    way = np.asarray(target_rad, dtype=float) - start_rad
    steps = max(1, math.ceil(float(np.abs(way).max()) / step_rad - 1e-9))
    return [start_rad + way * (k / steps) for k in range(1, steps)] + [np.asarray(target_rad, dtype=float)]
