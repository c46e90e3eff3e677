"""From the alarm on the controller's page, over the wire, to what the watch offers: each that the driver knows."""

from collections.abc import AsyncIterator
from pathlib import Path
from typing import Any

import pytest

from cellcal.drivers.interfaces import AlarmKind
from cellcal.service.configuration.cell_file import CellConfig
from cellcal.service.demo.fake_cell_client import FakeCellClient
from cellcal.service.record.healthy_counts import LastHealthyCounts, remember_healthy
from cellcal.service.watching.loss_response import PreparedAnswer, prepare_answer
from cellcal.service.watching.watch import PositionLoss, RobotWatch
from tests.wire.driver_cases import open_retrying
from tests.wire.robot_cases import ROBOTS

NOTHING = None
DRIFT, RECOVERY = "drift_check", "mastering_recovery"


@pytest.fixture
async def restoring_client(fake_client: FakeCellClient) -> AsyncIterator[FakeCellClient]:
    """The control port; the controller is switched off and on after the test, which ends every alarm raised here."""
    yield fake_client
    await fake_client.inject_fault("power_off", device="fanuc")
    await fake_client.inject_fault("power_on", device="fanuc")


async def loss_after_alarm(
    fanuc: Any, config: CellConfig, folder: Path
) -> tuple[PositionLoss | None, PreparedAnswer | None, list[str]]:
    """Return what a watch that knew the robot healthy sees, what is prepared for it, and what it warns of."""
    warned: list[str] = []

    async def on_loss(_: PositionLoss) -> None: ...

    watch = RobotWatch(fanuc, LastHealthyCounts(folder), on_loss, period_s=0.01, warn=warned.append)
    loss = await watch.look_once()
    return loss, None if loss is None else prepare_answer(config, loss), warned


@pytest.mark.parametrize(
    ("alarm", "offered"),
    [
        (("SRVO-001", AlarmKind.OTHER), NOTHING),
        (("SRVO-038", AlarmKind.TURNS), ("lost", "M1", RECOVERY)),
        (("SRVO-050", AlarmKind.COLLISION), ("held", "M4", DRIFT)),
        (("SRVO-062", AlarmKind.TURNS), ("lost", "M1", RECOVERY)),
        (("SRVO-065", AlarmKind.BATTERY_LOW), NOTHING),
        *(
            ((f"SRVO-0{number}", AlarmKind.ENCODER), ("held", "M2", DRIFT))
            for number in (64, 68, 69, 70, 71, 72, 73, 74)
        ),
        (("SRVO-075", AlarmKind.TURNS), ("lost", "M1", RECOVERY)),
        (("MOTN-017", AlarmKind.UNKNOWN), NOTHING),
    ],
)
async def test_an_alarm_of_the_controller_is_answered_by_its_procedure(
    fanuc: Any,
    restoring_client: FakeCellClient,
    cell: CellConfig,
    tmp_path: Path,
    alarm: tuple[str, AlarmKind],
    offered: Any,
) -> None:
    code, kind = alarm
    await remember_healthy("fanuc", fanuc, LastHealthyCounts(tmp_path))
    await restoring_client.inject_fault("alarm", device="fanuc", code=code, axis="J3")
    assert [(one.code, one.kind) for one in (await fanuc.read_condition()).alarms] == [alarm]
    loss, answer, warned = await loss_after_alarm(fanuc, cell, tmp_path)
    assert bool(warned) == (kind is AlarmKind.BATTERY_LOW)
    if offered is None:
        assert loss is None
        return
    assert loss is not None
    assert answer is not None
    assert (loss.suspicion.loss_kind, loss.suspicion.mode, answer.procedure) == offered
    assert loss.suspicion.axes == (3,)
    assert not answer.starts_unattended
    judged = [reason for reason in answer.reasons if "judgement" in reason]
    assert bool(judged) == (loss.suspicion.mode != "M1")


async def test_a_loss_after_a_failing_encoder_is_reported_too_and_asks_for_the_exchanged_one(
    fanuc: Any, restoring_client: FakeCellClient, cell: CellConfig, tmp_path: Path
) -> None:
    losses: list[PositionLoss] = []

    async def on_loss(loss: PositionLoss) -> None:
        losses.append(loss)

    memory = LastHealthyCounts(tmp_path)
    await remember_healthy("fanuc", fanuc, memory)
    watch = RobotWatch(fanuc, memory, on_loss, period_s=0.01)
    await restoring_client.inject_fault("alarm", device="fanuc", code="SRVO-074", axis="J5")
    await watch.look_once()
    await restoring_client.inject_fault("power_off", device="fanuc")
    await restoring_client.inject_fault("power_on", device="fanuc")
    await restoring_client.inject_fault("alarm", device="fanuc", code="SRVO-038", axis="J5")
    await watch.look_once()
    failing, lost = (prepare_answer(cell, loss) for loss in losses)
    assert (failing.procedure, failing.settings) == (DRIFT, {})
    assert (lost.procedure, lost.settings) == (RECOVERY, {"exchanged_axes": (5,)})
    assert not lost.starts_unattended


async def test_beside_an_alarm_that_the_driver_does_not_know_nothing_starts_alone(
    fanuc: Any, restoring_client: FakeCellClient, cell: CellConfig, tmp_path: Path
) -> None:
    await remember_healthy("fanuc", fanuc, LastHealthyCounts(tmp_path))
    await restoring_client.inject_fault("alarm", device="fanuc", code="SRVO-062", axis="J3")
    _, known_loss, _ = await loss_after_alarm(fanuc, cell, tmp_path)
    await restoring_client.inject_fault("alarm", device="fanuc", code="MOTN-017", axis="J1")
    _, strange, _ = await loss_after_alarm(fanuc, cell, tmp_path)
    assert known_loss is not None
    assert strange is not None
    assert set(strange.reasons) - set(known_loss.reasons) == {"the alarm MOTN-017 is unknown here"}


LOSSES = {
    "motoman": ("battery_loss", {"axes": ["U"]}, [2]),
    "kuka": ("mastering_lost", {"axes": ["A4"]}, [3]),
    "abb": ("counters_lost", {"axes": ["2", "5"]}, [1, 4]),
    "rmi": ("alarm", {"text": "SRVO-062 BZAL alarm (Group:1 Axis:3)"}, [2]),
}


@pytest.mark.parametrize("name", sorted(LOSSES))
async def test_a_loss_is_seen_on_every_controller_and_nothing_starts_where_a_person_must_mend_it(
    name: str, cell: CellConfig, fake_client: FakeCellClient, tmp_path: Path
) -> None:
    fault, parameters, axes = LOSSES[name]
    case = next(case for case in ROBOTS.values() if case.name == name)
    async with open_retrying(cell.robot_named(name)) as robot:
        await case.heal(fake_client, robot)
        found: list[PositionLoss] = []

        async def on_loss(loss: PositionLoss) -> None:
            found.append(loss)

        watch = RobotWatch(robot, LastHealthyCounts(tmp_path), on_loss, period_s=0.01)
        assert await watch.look_once() is None
        await fake_client.inject_fault(fault, device=name, **parameters)
        loss = await watch.look_once()
        assert loss is not None
        assert await watch.look_once() is None  # told once
        assert [alarm.axis for alarm in loss.alarms if alarm.axis is not None] == axes
        answer = prepare_answer(cell, loss)
        assert answer.procedure == (None if name == "rmi" else "position_cure")
        assert answer.reasons
        assert "its mastering is set at the pendant only" in answer.reasons
        assert not await watch.is_resolved()
        await case.heal(fake_client, robot)
        await watch.look_once()
        assert await watch.is_resolved()
    assert len(found) == 1
