"""What the devices show ten times a second. A run's own readings always come first, and are shown as well.

Robots, wires and dial gauges tell values by themselves. A tracker, a probe, an instrument whose readings are typed
or come in files tell none: of these the state is asked once a second, and the last reading of a run is kept.
"""

import asyncio
import time
from collections.abc import Awaitable, Callable
from dataclasses import dataclass
from typing import Any

from cellcal.calibration.message import make_message
from cellcal.drivers.errors import DeviceError, RefusedError
from cellcal.drivers.interfaces import (
    Condition,
    ContactEdge,
    ContactReading,
    LengthReading,
    PointReading,
    PoseReading,
    Readiness,
)
from cellcal.drivers.supervision import log_failures, message_and_remedy_of
from cellcal.drivers.wire.cancellation import cancel_until_done
from cellcal.procedures.cell import Cell
from cellcal.service.cell_process.recording_check import SETTLE_SIGMAS, ObservedMotion, SettleDetector
from cellcal.service.runs.instruments import SharedInstrument, share_instruments, shared_instruments
from cellcal.service.session_documents import DeviceDocument, LiveValues, StopDocument

CONDITION_EVERY_S = 1.0
STOP_EVERY_S = 0.15  # at every second look: a stopped robot is shown within half a second, in a run, too
_CANCEL_AGAIN_S = 1.0
LOOK_S = 0.1  # who has not answered by then is heard at a later look


@dataclass(slots=True)
class DeviceStatus:
    """The last that was heard of one device."""

    role: str
    name: str
    live: bool = True  # it tells values by itself; of another one, only the state is asked
    typed: bool = False  # its readings are typed by a person, when a run asks for them
    condition: Condition | None = None
    value: Any = None
    value_at_s: float | None = None
    last_received_at_s: float | None = None
    asked_at_s: float = float("-inf")  # for its condition
    error: str = ""
    settle: SettleDetector | None = None
    due: str = ""  # until when its calibration holds (ISO date)

    def update_value(self, value: Any, now_s: float) -> None:
        """Take a value."""
        self.value, self.value_at_s, self.last_received_at_s, self.error = value, now_s, now_s, ""
        if self.settle is not None:
            self.settle.add_reading(now_s, value["length_m"])

    def take_condition(self, condition: Condition, now_s: float) -> None:
        """Take a state; where nothing else is asked, it is what the age belongs to."""
        self.condition, self.asked_at_s = condition, now_s
        if not self.live and condition.readiness is not Readiness.UNREACHABLE:
            self.last_received_at_s = now_s

    def as_json(self, now_s: float, *, is_queried: bool = False) -> DeviceDocument:
        """Return it for a screen: the value with its age, and what is wrong. ``is_queried``: by a run, just now."""
        condition = self.condition
        return {
            "role": self.role,
            "name": self.name,
            "live": self.live,
            "typed": self.typed,
            "asked": is_queried,
            "state": "unknown" if condition is None else condition.readiness.value,
            "message": self.error or ("" if condition is None else condition.message),
            "remedy": "" if condition is None else condition.remedy,
            "stop": None if condition is None else _stop_of(condition),
            "age_s": _age_s(self.last_received_at_s, now_s),
            "value": self.value,
            "value_age_s": _age_s(self.value_at_s, now_s),
            "due": self.due,
            "settle": None if self.settle is None else self.settle.as_json(now_s),
        }


def _stop_of(condition: Condition) -> StopDocument | None:
    stop = condition if condition.readiness is Readiness.STOPPED else condition.stop
    return None if stop is None else {"message": stop.message, "remedy": stop.remedy}


class LivePoller:
    """Looks at robot and instruments again and again, and remembers what it saw.

    ``cell`` is the one that runs use, so that their readings are shown, too. ``reads`` gets
    which instrument a run asks.
    """

    def __init__(
        self,
        cell: Cell,
        *,
        reads: Callable[[str], None] = lambda role: None,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self.cell = share_instruments(cell, self._on_reading)
        self._reads, self._clock = reads, clock
        self._robot_asked_at_s = float("-inf")
        self._instruments = shared_instruments(self.cell)
        self._looks: dict[str, asyncio.Task[None]] = {}
        self.robot = DeviceStatus("robot", cell.robot.name)
        self.others = [_initial_status(role, device, cell) for role, device in self._instruments.items()]

    async def poll_once(self) -> None:
        """Poll once. A slow instrument does not delay the others."""
        await self._query_device(self.robot, self._read_joints())
        if self._clock() - self._robot_asked_at_s >= STOP_EVERY_S:
            self._robot_asked_at_s = self._clock()
            self.robot.condition = await self.cell.robot.read_condition()
        for shown in self.others:
            if shown.role not in self._looks:
                self._looks[shown.role] = asyncio.create_task(self._poll_instrument(shown))
        if self._looks:
            await asyncio.wait(self._looks.values(), timeout=LOOK_S)
        for role in [role for role, task in self._looks.items() if task.done()]:
            self._finish_poll(role, self._looks.pop(role))

    def _finish_poll(self, role: str, task: asyncio.Task[None]) -> None:
        """Name what a look at an instrument raised, at that instrument alone: the run and the others go on."""
        shown = next(shown for shown in self.others if shown.role == role)
        with log_failures(make_message("look at {device}", device=shown.name)):
            try:
                task.result()
            except Exception as error:
                shown.error, shown.value = message_and_remedy_of(error)[0], None
                raise

    async def cancel_polls(self) -> None:
        """End the looks that are under way."""
        tasks = list(self._looks.values())
        await cancel_until_done(*tasks, every_s=_CANCEL_AGAIN_S)
        await asyncio.gather(*tasks, return_exceptions=True)
        self._looks.clear()

    def as_json(self) -> LiveValues:
        """Return the live message: newest values with their ages."""
        now_s = self._clock()
        others = (
            shown.as_json(now_s, is_queried=self._instruments[shown.role].is_queried) for shown in self.others
        )
        return {"devices": [self.robot.as_json(now_s), *others]}

    def observe_motion(self) -> ObservedMotion:
        """Return how robot and wire stand, as they were seen last."""
        now_s, robot = self._clock(), self.robot
        age_s = float("inf") if robot.last_received_at_s is None else now_s - robot.last_received_at_s
        gauge = next((shown for shown in self.others if shown.role == "gauge"), None)
        settled = None if gauge is None or gauge.settle is None else gauge.settle.is_settled(now_s)
        if robot.value is None:
            return ObservedMotion(None, moving=False, age_s=age_s, settled=settled)
        joints = tuple(robot.value["joints_rad"])
        return ObservedMotion(joints, robot.value["moving"], age_s, settled)

    @property
    def is_at_rest(self) -> bool:
        """Whether the robot answered, and did not move."""
        return self.robot.value is not None and not self.robot.value["moving"]

    async def _read_joints(self) -> Any:
        reading = await self.cell.robot.read_joints()
        return {"joints_rad": list(reading.joints_rad), "moving": reading.moving}

    async def _poll_instrument(self, shown: DeviceStatus) -> None:
        device = self._instruments[shown.role]
        if shown.live:
            await self._query_device(shown, self._read_length(device))
        if self._clock() - shown.asked_at_s >= CONDITION_EVERY_S:
            condition = await device.read_for_screen(lambda instrument: instrument.read_condition())
            if condition is not None:
                shown.take_condition(condition, self._clock())

    async def _read_length(self, device: SharedInstrument) -> Any:
        reading = await device.read_for_screen(lambda instrument: instrument.read_distance())
        return None if reading is None else _value_of(reading)

    async def _query_device(self, shown: DeviceStatus, question: Awaitable[Any]) -> None:
        try:
            value = await question
        except DeviceError as error:
            shown.error, shown.value = error.message, None
            if isinstance(error, RefusedError):  # it answers, and has nothing to tell: a plunger that is free
                shown.last_received_at_s = self._clock()
            return
        if value is not None:
            shown.update_value(value, self._clock())

    def _on_reading(self, role: str, reading: Any) -> None:
        """Receive what a run asks and reads."""
        if reading is None:
            self._reads(role)
            return
        shown = next(shown for shown in self.others if shown.role == role)
        shown.update_value(_value_of(reading), self._clock())


def _initial_status(role: str, device: Any, cell: Cell) -> DeviceStatus:
    live = role in ("gauge", "dial") and device.capabilities.answers_alone
    typed = role in ("gauge", "tracker") and device.capabilities.typed
    settle = SettleDetector(SETTLE_SIGMAS * device.capabilities.sigma_m) if live else None
    certificate = cell.certificates.get(role)
    return DeviceStatus(
        role, device.name, live, typed, settle=settle, due="" if certificate is None else certificate.due
    )


def _value_of(reading: Any) -> dict[str, object]:
    """Return a reading as a screen shows it."""
    if isinstance(reading, LengthReading):
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
