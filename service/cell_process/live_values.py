"""What the devices show ten times a second. A run's own readings always come first, and are shown as well.

Robots, wires and dial gauges tell values by themselves. A tracker, a probe, an instrument whose readings are typed
or come in files tell none: of these the state is asked once a second, and the last reading of a run is kept.
"""

import asyncio
import time
from collections.abc import Awaitable, Callable
from dataclasses import dataclass
from typing import Any

from cellcal.drivers.errors import DeviceError, RefusedError
from cellcal.drivers.interfaces import (
    Condition,
    ContactEdge,
    ContactReading,
    PointReading,
    PoseReading,
    Readiness,
    Reading,
)
from cellcal.drivers.supervision import guarded, words_of
from cellcal.procedures.cell import Cell
from cellcal.service.cell_process.recording import SETTLE_SIGMAS, Settle, Standing
from cellcal.service.runs.instruments import SharedInstrument, shared, sharing

CONDITION_EVERY_S = 1.0
STOP_EVERY_S = 0.15  # at every second look: a stopped robot is shown within half a second, in a run, too
LOOK_S = 0.1  # who has not answered by then is heard at a later look


@dataclass(slots=True)
class Shown:
    """The last that was heard of one device."""

    role: str
    name: str
    live: bool = True  # it tells values by itself; of another one, only the state is asked
    typed: bool = False  # its readings are typed by a person, when a run asks for them
    condition: Condition | None = None
    value: Any = None
    value_at_s: float | None = None
    heard_at_s: float | None = None
    asked_at_s: float = float("-inf")  # for its condition
    error: str = ""
    settle: Settle | None = None
    due: str = ""  # until when its calibration holds (ISO date)

    def take(self, value: Any, now_s: float) -> None:
        """Take a value."""
        self.value, self.value_at_s, self.heard_at_s, self.error = value, now_s, now_s, ""
        if self.settle is not None:
            self.settle.take(now_s, value["length_m"])

    def take_condition(self, condition: Condition, now_s: float) -> None:
        """Take a state; where nothing else is asked, it is what the age belongs to."""
        self.condition, self.asked_at_s = condition, now_s
        if not self.live and condition.readiness is not Readiness.UNREACHABLE:
            self.heard_at_s = now_s

    def as_json(self, now_s: float, *, asked: bool = False) -> dict[str, Any]:
        """Return it for a screen: the value with its age, and what is wrong. ``asked``: by a run, just now."""
        condition = self.condition
        return {
            "role": self.role,
            "name": self.name,
            "live": self.live,
            "typed": self.typed,
            "asked": asked,
            "state": "unknown" if condition is None else condition.readiness.value,
            "message": self.error or ("" if condition is None else condition.message),
            "remedy": "" if condition is None else condition.remedy,
            "age_s": _age_s(self.heard_at_s, now_s),
            "value": self.value,
            "value_age_s": _age_s(self.value_at_s, now_s),
            "due": self.due,
            "settle": None if self.settle is None else self.settle.as_json(now_s),
        }


class Glance:
    """Looks at robot and instruments again and again, and remembers what it saw.

    ``cell`` is what runs are lent: what they read is seen here, too. ``reads`` hears which instrument a run asks.
    """

    def __init__(
        self,
        cell: Cell,
        *,
        reads: Callable[[str], None] = lambda role: None,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self.cell = shared(cell, self._told)
        self._reads, self._clock = reads, clock
        self._robot_asked_at_s = float("-inf")
        self._instruments = sharing(self.cell)
        self._looks: dict[str, asyncio.Task[None]] = {}
        self.robot = Shown("robot", cell.robot.name)
        self.others = [_unseen(role, device, cell) for role, device in self._instruments.items()]

    async def look(self) -> None:
        """Look once. An instrument that takes its time holds up nobody else."""
        await self._ask(self.robot, self._joints())
        if self._clock() - self._robot_asked_at_s >= STOP_EVERY_S:
            self._robot_asked_at_s = self._clock()
            self.robot.condition = await self.cell.robot.condition()
        for shown in self.others:
            if shown.role not in self._looks:
                self._looks[shown.role] = asyncio.create_task(self._look_at(shown))
        if self._looks:
            await asyncio.wait(self._looks.values(), timeout=LOOK_S)
        for role in [role for role, task in self._looks.items() if task.done()]:
            self._finish_look(role, self._looks.pop(role))

    def _finish_look(self, role: str, task: asyncio.Task[None]) -> None:
        """Name what a look at an instrument raised, at that instrument alone: the run and the others go on."""
        shown = next(shown for shown in self.others if shown.role == role)
        with guarded(f"look at {shown.name}"):
            try:
                task.result()
            except Exception as error:
                shown.error, shown.value = words_of(error)[0], None
                raise

    async def leave(self) -> None:
        """End the looks that are under way."""
        tasks = list(self._looks.values())
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)
        self._looks.clear()

    def as_json(self) -> dict[str, Any]:
        """Return the live message: newest values with their ages."""
        now_s = self._clock()
        others = (shown.as_json(now_s, asked=self._instruments[shown.role].asked) for shown in self.others)
        return {"devices": [self.robot.as_json(now_s), *others]}

    def standing(self) -> Standing:
        """Return how robot and wire stand, as they were seen last."""
        now_s, robot = self._clock(), self.robot
        age_s = float("inf") if robot.heard_at_s is None else now_s - robot.heard_at_s
        gauge = next((shown for shown in self.others if shown.role == "gauge"), None)
        settled = None if gauge is None or gauge.settle is None else gauge.settle.settled(now_s)
        if robot.value is None:
            return Standing(None, moving=False, age_s=age_s, settled=settled)
        joints = tuple(robot.value["joints_rad"])
        return Standing(joints, robot.value["moving"], age_s, settled)

    async def _joints(self) -> Any:
        reading = await self.cell.robot.joints()
        return {"joints_rad": list(reading.joints_rad), "moving": reading.moving}

    async def _look_at(self, shown: Shown) -> None:
        device = self._instruments[shown.role]
        if shown.live:
            await self._ask(shown, self._length(device))
        if self._clock() - shown.asked_at_s >= CONDITION_EVERY_S:
            condition = await device.glimpse(lambda seen: seen.condition())
            if condition is not None:
                shown.take_condition(condition, self._clock())

    async def _length(self, device: SharedInstrument) -> Any:
        reading = await device.glimpse(lambda seen: seen.distance())
        return None if reading is None else _value_of(reading)

    async def _ask(self, shown: Shown, question: Awaitable[Any]) -> None:
        try:
            value = await question
        except DeviceError as error:
            shown.error, shown.value = error.message, None
            if isinstance(error, RefusedError):  # it answers, and has nothing to tell: a plunger that is free
                shown.heard_at_s = self._clock()
            return
        if value is not None:
            shown.take(value, self._clock())

    def _told(self, role: str, reading: Any) -> None:
        """Hear what a run asks and reads."""
        if reading is None:
            self._reads(role)
            return
        shown = next(shown for shown in self.others if shown.role == role)
        shown.take(_value_of(reading), self._clock())


def _unseen(role: str, device: Any, cell: Cell) -> Shown:
    live = role in ("gauge", "dial") and device.capabilities.answers_alone
    typed = role in ("gauge", "tracker") and device.capabilities.typed
    settle = Settle(SETTLE_SIGMAS * device.capabilities.sigma_m) if live else None
    held = cell.certificates.get(role)
    return Shown(role, device.name, live, typed, settle=settle, due="" if held is None else held.due)


def _value_of(reading: Any) -> dict[str, Any]:
    """Return a reading as a screen shows it."""
    if isinstance(reading, Reading):
        return {"length_m": reading.value_m, "sigma_m": reading.sigma_m}
    if isinstance(reading, PointReading):
        return {"position_m": list(reading.position_m), "station": reading.station}
    if isinstance(reading, PoseReading):
        return {"position_m": list(reading.station_probe.position_m), "station": reading.station}
    return {
        "closed": isinstance(reading, ContactEdge) or (isinstance(reading, ContactReading) and reading.closed)
    }


def _age_s(at_s: float | None, now_s: float) -> float | None:
    return None if at_s is None else round(now_s - at_s, 3)
