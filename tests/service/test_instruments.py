"""What is shown of each instrument of a cell: never a value that it does not have, never an age of something else."""

import asyncio
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any, cast

import pytest

from cellcal.drivers.interfaces import (
    Condition,
    GaugeCapabilities,
    LengthReading,
    Operator,
    PointReading,
    Readiness,
    TrackerCapabilities,
)
from cellcal.procedures.cell import Cell, DeviceCertificate
from cellcal.procedures.steps.measure_point import measure_point
from cellcal.service.cell_process.live_values import LivePoller
from cellcal.service.configuration.cell_file import read_cell_file
from cellcal.service.demo.fake_cell_client import FakeCellClient
from cellcal.service.runs.open_cell import open_cell
from tests.machine_speed import stretched_s
from tests.procedures.fake_technician import FakeTechnician
from tests.procedures.procedure_scenes import healthy_scene
from tests.service.instrument_cell import full_cell

DEADLINE_S = stretched_s(60.0)


@asynccontextmanager
async def poll_instruments(
    folder: Path, **how: Any
) -> AsyncIterator[tuple[LivePoller, FakeCellClient, list[str]]]:
    questions: list[str] = []
    with full_cell(folder, **how) as (path, fake_client):
        technician: Operator = FakeTechnician(fake_client, "targets")
        async with open_cell(read_cell_file(path), technician) as cell:
            glance = LivePoller(cell, reads=questions.append)
            try:
                yield glance, fake_client, questions
            finally:
                await glance.cancel_polls()


def device_of(glance: LivePoller, role: str) -> dict[str, Any]:
    devices: list[dict[str, Any]] = glance.as_json()["devices"]
    return next(device for device in devices if device["role"] == role)


async def look_until(glance: LivePoller, true: Callable[[], Any]) -> None:
    async with asyncio.timeout(DEADLINE_S):
        while not true():
            await glance.poll_once()
            await asyncio.sleep(0.01)


async def test_every_instrument_of_a_cell_says_what_it_can(tmp_path: Path) -> None:
    async with poll_instruments(tmp_path, tracker_due="2999-12-31") as (glance, fake_client, questions):
        roles = ("robot", "gauge", "tracker", "probe", "dial")
        await look_until(glance, lambda: all(device_of(glance, role)["state"] == "ready" for role in roles))
        assert [device_of(glance, role)["live"] for role in roles] == [True, True, False, False, True]
        for role in roles:
            assert device_of(glance, role)["age_s"] is not None, role
        assert device_of(glance, "gauge")["value"]["length_m"] > 0.0
        assert "plunger is free" in device_of(glance, "dial")["message"]
        assert device_of(glance, "dial")["value"] is None
        await fake_client.inject_fault("push_in", device="dial", m=0.004)
        await look_until(glance, lambda: device_of(glance, "dial")["value"])
        assert device_of(glance, "dial")["value"]["length_m"] == pytest.approx(0.004, abs=5e-5)
        for role in (
            "tracker",
            "probe",
        ):  # not read yet: there is nothing to show, and that is no fault
            assert (device_of(glance, role)["value"], device_of(glance, role)["value_age_s"]) == (None, None)
        assert device_of(glance, "tracker")["due"] == "2999-12-31"
        assert questions == []  # looking is not reading

        read = await measure_point(glance.cell, "pose 1")
        assert questions == ["tracker"]
        value = device_of(glance, "tracker")["value"]
        assert value == {"position_m": list(read.readings[-1].position_m), "station": read.station}
        assert device_of(glance, "gauge")["value"].keys() == {"length_m", "sigma_m"}
        contact = await cast(Any, glance.cell.probe).read_contact()
        assert device_of(glance, "probe")["value"] == {"closed": contact.closed}


async def test_a_silent_tracker_is_reported_and_delays_no_other_device(tmp_path: Path) -> None:
    async with poll_instruments(tmp_path, wired=False) as (glance, fake_client, _):
        await look_until(glance, lambda: device_of(glance, "tracker")["state"] == "ready")
        shown = next(each for each in glance.others if each.role == "tracker")
        last_received_at_s = shown.last_received_at_s
        assert last_received_at_s is not None
        await fake_client.inject_fault("silent", device="at")
        viewer = 0

        def is_unreachable() -> bool:
            nonlocal viewer
            viewer += (
                device_of(glance, "tracker")["state"] == "ready"
                and device_of(glance, "tracker")["age_s"] > 2.0
            )
            return bool(device_of(glance, "tracker")["state"] == "unreachable")

        await look_until(glance, is_unreachable)
        assert viewer > 2  # of the robot, while the tracker kept silent
        assert device_of(glance, "tracker")["message"]
        assert device_of(glance, "tracker")["age_s"] > 2.0  # its silence is not heard from it
        assert glance.robot.last_received_at_s is not None


class SteppedClock:
    """A clock that a test turns."""

    now_s = 100.0

    def __call__(self) -> float:
        return self.now_s


class SlowTracker:
    """A tracker whose answers come when the test lets them."""

    name, capabilities = "at", TrackerCapabilities(measures_poses=False, range_m=9.0, sigma_m=1e-5)

    def __init__(self) -> None:
        self.answers = asyncio.Semaphore(0)  # that it may give
        self.doing: list[str] = []

    async def read_condition(self) -> Condition:
        return await self._answer_when_let("condition", Condition(Readiness.READY))

    async def measure_point(self) -> PointReading:
        return await self._answer_when_let("point", PointReading((1.0, 2.0, 3.0), (1e-5,) * 3, 0.0, 1))

    async def _answer_when_let(self, what: str, answer: Any) -> Any:
        assert not self.doing, "a second question during one"
        self.doing.append(what)
        try:
            await self.answers.acquire()
        finally:
            self.doing.remove(what)
        return answer


def slow_cell() -> tuple[Cell, SlowTracker]:
    tracker = SlowTracker()
    made = healthy_scene().cell
    return Cell("c", made.robot, made.operator, tracker=cast(Any, tracker)), tracker


async def _poll_until(true: Callable[[], Any], do: Callable[[], Awaitable[Any]]) -> None:
    async with asyncio.timeout(DEADLINE_S):
        while not true():
            await do()
            await asyncio.sleep(0)


async def test_a_reading_waits_for_a_look_and_no_look_comes_between() -> None:
    cell, tracker = slow_cell()
    clock = SteppedClock()
    glance = LivePoller(cell, clock=clock)
    await glance.poll_once()
    assert tracker.doing == ["condition"]
    reading = asyncio.create_task(cast(Any, glance.cell.tracker).measure_point())
    await asyncio.sleep(0)
    assert tracker.doing == ["condition"]
    assert device_of(glance, "tracker")["asked"]
    tracker.answers.release()
    await _poll_until(lambda: tracker.doing == ["point"], lambda: asyncio.sleep(0))
    clock.now_s += 60.0
    await glance.poll_once()  # during a run's requests there is no polling
    assert tracker.doing == ["point"]
    tracker.answers.release()
    assert (await reading).station == 1
    assert not device_of(glance, "tracker")["asked"]
    await glance.cancel_polls()


async def test_the_age_of_a_reading_is_not_that_of_the_state() -> None:
    cell, tracker = slow_cell()
    for _ in range(2):
        tracker.answers.release()
    clock = SteppedClock()
    glance = LivePoller(cell, clock=clock)
    await cast(Any, glance.cell.tracker).measure_point()
    clock.now_s += 30.0
    await _poll_until(lambda: device_of(glance, "tracker")["state"] == "ready", glance.poll_once)
    device_state = device_of(glance, "tracker")
    assert (device_state["value_age_s"], device_state["age_s"]) == (30.0, 0.0)
    await glance.cancel_polls()


class TypedGauge:
    """A gauge whose readings a person types: each question would reach a person."""

    name = "tape"
    capabilities = GaugeCapabilities(
        range_m=3.0, resolution_m=1e-9, sigma_m=2e-5, answers_alone=False, typed=True
    )
    question_count = 0

    async def read_condition(self) -> Condition:
        return Condition(Readiness.READY)

    async def read_distance(self) -> LengthReading:
        self.question_count += 1
        return LengthReading(1.25, 2e-5, 0.0, 1_250_000_000)


async def test_no_typed_reading_is_requested_for_display_only() -> None:
    made, gauge = healthy_scene().cell, TypedGauge()
    certificates = {"gauge": DeviceCertificate("C-1", "2001-02-03", "2999-12-31")}
    cell = Cell("c", made.robot, made.operator, gauge=cast(Any, gauge), certificates=certificates)
    glance = LivePoller(cell)
    await _poll_until(lambda: device_of(glance, "gauge")["state"] == "ready", glance.poll_once)
    assert gauge.question_count == 0
    assert (device_of(glance, "gauge")["typed"], device_of(glance, "gauge")["live"]) == (True, False)
    assert glance.observe_motion().settled is None  # nothing swings, and nothing waits for it
    assert (await cast(Any, glance.cell.gauge).read_distance()).value_m == 1.25
    assert device_of(glance, "gauge")["value"]["length_m"] == 1.25
    assert device_of(glance, "gauge")["due"] == "2999-12-31"
    await glance.cancel_polls()
