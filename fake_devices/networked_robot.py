"""What robots behind one network server have in common: their tasks, their faults and the pendant's hand.

Imitates
    Nothing by itself: a maker's ``device.py`` adds its controller, its server and its events.
Source
    Ours.
Modelled
    A server that is shut while the fault ``refuse`` is on; events by name; an arm that is driven at the pendant.
Not modelled
    Robots with several links that fail one by one (``universal_robots``, ``modbus_robot``).
"""

import asyncio
import math
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from typing import Any, Protocol

from cellcal.fake_devices.arm import SimulatedArm
from cellcal.fake_devices.device import FaultRefusedError, JsonObject, run_fault_action
from cellcal.fake_devices.keep_running import keep_running
from cellcal.fake_devices.link_faults import LinkFaults

_TICK_REAL_S = 0.05
Event = Callable[[dict[str, Any]], None]  # takes the parameters that it knows out of the table


class RobotServer(Protocol):
    """The sockets of a controller."""

    async def open(self) -> None:
        """Listen, where nothing listens yet."""
        ...

    def close(self) -> None:
        """Stop listening and hang up."""
        ...


class NetworkedRobot:
    """One controller on one loopback address."""

    def __init__(self, name: str, arm: SimulatedArm, server: RobotServer, faults: LinkFaults) -> None:
        self._name, self._arm, self._server, self._faults = name, arm, server, faults
        self._tasks: list[asyncio.Task[None]] = []
        self._events: dict[str, Event] = {"hand_moves": self._move_by_hand}

    @property
    def name(self) -> str:
        """Name in the cell file."""
        return self._name

    def _begin_tasks(self) -> list[asyncio.Task[None]]:
        """Begin what runs beside the server until the robot is stopped."""
        return []

    async def start(self) -> None:
        await self._server.open()
        self._tasks = [*self._begin_tasks(), keep_running(f"ports of {self.name}", self._follow_faults)]

    async def stop(self) -> None:
        for task in self._tasks:
            task.cancel()
            with suppress(asyncio.CancelledError):
                await task
        self._server.close()

    async def _follow_faults(self) -> None:
        while True:
            await self._listen_or_not()
            await asyncio.sleep(_TICK_REAL_S)

    async def _listen_or_not(self) -> None:
        if self._faults.active_parameters("refuse") is not None:
            self._server.close()
        else:
            with suppress(OSError):  # the address is not free yet; the next tick tries again
                await self._server.open()

    def fault_names(self) -> frozenset[str]:
        return self._faults.fault_kinds | frozenset(self._events)

    async def inject_fault(self, name: str, parameters: Mapping[str, Any]) -> JsonObject:
        if name in self._events:
            try:
                run_fault_action(self._events[name], name, parameters)
            except (TypeError, ValueError) as problem:
                raise FaultRefusedError(str(problem)) from problem
        else:
            self._faults.switch_on(name, parameters)
        await self._listen_or_not()
        return {}

    def clear_faults(self) -> None:
        self._faults.clear_all()

    def _true_arm(self) -> JsonObject:
        """Return the truth about the arm; without encoders of its own the controller shows the true joints."""
        arm = self._arm
        return {
            "joints_rad": arm.joints_rad.tolist(),
            "controller_joints_rad": arm.joints_rad.tolist(),
            "moving": arm.is_moving,
            "dh": arm.true_dh.tolist(),
            "nominal_dh": arm.nominal_dh.tolist(),
            "base_flange": arm.base_flange().tolist(),
        }

    def _move_by_hand(self, parameters: dict[str, Any]) -> None:
        """Drive the arm at the pendant to these joints."""
        joints = [float(angle) for angle in parameters.pop("joints")]
        if len(joints) != len(self._arm.joints_rad) or not all(map(math.isfinite, joints)):
            raise ValueError("joints are as many finite numbers as there are axes [rad]")
        self._arm.put_joints(joints)


def parse_axes(names: Any, axes: Sequence[str]) -> list[int]:
    """Return the indices of the named axes; ``all`` is every one."""
    if names == "all":
        return list(range(len(axes)))
    found = [names] if isinstance(names, str) else list(names)
    if not found or any(name not in axes for name in found):
        raise FaultRefusedError(f"{names!r} are no axes; they are {', '.join(axes)}")
    return sorted(axes.index(name) for name in found)
