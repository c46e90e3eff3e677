"""The main job, end to end: a healthy cell, a loss, the service that notices, the recovery, the truth."""

import asyncio
import time
from collections.abc import AsyncIterator, Callable, Mapping
from contextlib import asynccontextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from cellcal.calibration.errors import CellError
from cellcal.calibration.mastering.counts import DriveTrain
from cellcal.procedures.cell import Cell
from cellcal.procedures.progress import StepProgress, ignore_progress
from cellcal.procedures.recovery.recovery_result import RecoveryResult
from cellcal.service.configuration.cell_file import CellConfig, read_cell_file
from cellcal.service.demo.demo_arm import DemoArm
from cellcal.service.demo.fake_cell import (
    OTHER_ARM,
    QUICKLY,
    free_address,
    running_fakes,
    write_cell_file,
)
from cellcal.service.demo.fake_cell_client import FakeCellClient
from cellcal.service.demo.report import DemoReport, JointReport, TcpError
from cellcal.service.demo.simulated_technician import SimulatedTechnician
from cellcal.service.demo.timing import RobotTime, StepClock
from cellcal.service.record.healthy_counts import LastHealthyCounts
from cellcal.service.record.journal import Journal
from cellcal.service.record.journal_files import open_journal
from cellcal.service.record.run_outcome import RunOutcome, RunVerdict
from cellcal.service.runs.cell_check import check_cell
from cellcal.service.runs.open_cell import open_cell, with_robot_history
from cellcal.service.runs.run_procedure import RunConditions, run_procedure
from cellcal.service.runs.settings import build_spec
from cellcal.service.watching.mastering_comparison import MasteringComparison, journalled_mastering
from cellcal.service.watching.watch import PositionLoss, RobotWatch

ROBOT = "fanuc"
NOTICE_WITHIN_S = 60.0
_BUSY_TRIES = 3


@dataclass(frozen=True, slots=True)
class DemoScenario:
    """The story to tell, its pace, and who listens."""

    loss: str = "turns"
    seed: int = 1
    time_factor: float = 600.0
    say: Callable[[str], None] = lambda _: None
    on_event: Callable[[StepProgress], None] = ignore_progress
    arm: DemoArm | None = None  # in place of the demo's own

    @property
    def robot(self) -> str:
        """The cell file's name of the robot of the story."""
        return ROBOT if self.arm is None else OTHER_ARM


@dataclass(frozen=True, slots=True)
class _DemoOutcome:
    """The events, and the world's truth before and after."""

    loss: PositionLoss
    outcome: RunOutcome
    truth_before: dict[str, Any]
    truth_after: dict[str, Any]
    error_before: TcpError
    error_after: TcpError
    drive: DriveTrain
    seconds: float
    robot_time: RobotTime


async def run_recovery_demo(folder: Path, scenario: DemoScenario) -> DemoReport:
    """Tell the story on a fresh fake cell whose files live in ``folder``."""
    fault = fault_of(scenario.loss)
    started_s = time.monotonic()
    with free_address() as address:
        path = write_cell_file(
            folder, address, seed=scenario.seed, time_factor=scenario.time_factor, arm=scenario.arm
        )
    config = read_cell_file(path)
    async with running_fakes(path) as fake_cell:
        await _reach_everything(config, scenario)
        with open_journal(config) as journal:
            async with open_cell(config, _make_technician(fake_cell, scenario), scenario.robot) as cell:
                async with _run_fast(fake_cell, scenario.time_factor):
                    await _take_record(config, cell, journal, scenario)
                await _back_to_work(fake_cell, scenario)
                loss = await _lose_and_notice(config, cell, fake_cell, fault, scenario)
                truth_before, error_before = (
                    await _truth_of(fake_cell, scenario),
                    await _tcp_error(fake_cell, scenario),
                )
                outcome, robot_time = await _recover_timed(config, cell, journal, fake_cell, scenario)
                truth_after, error_after = (
                    await _truth_of(fake_cell, scenario),
                    await _tcp_error(fake_cell, scenario),
                )
                assert cell.mastering is not None
                drive = await cell.mastering.drive_train()
    seconds = time.monotonic() - started_s
    truths = (truth_before, truth_after, error_before, error_after)
    demo_outcome = _DemoOutcome(loss, outcome, *truths, drive, seconds, robot_time)
    return _build_report(scenario, demo_outcome)


_FAULTS: dict[str, tuple[str, Mapping[str, object], str]] = {
    "turns": ("battery_loss", {"axes": "all"}, "the encoder battery is pulled, and the arm sags a little"),
    "all": ("reference_loss", {}, "every encoder loses its reference"),
    "crash": ("crash", {}, "the arm hits something, bends, and loses its encoder battery"),
    "memory": ("memory_loss", {}, "the controller forgets its mastering data"),
    "backup": ("old_backup", {}, "a backup from before the last mastering is loaded: J3 is wrong, no alarm"),
    "swap": ("swapped_arm", {}, "another arm of the same type is put under the same cabinet"),
}


def fault_of(loss: str) -> tuple[str, Mapping[str, object]]:
    """Return the world's fault for a loss: turns, motor:J3, all, crash, memory, backup, swap."""
    if loss in _FAULTS:
        return _FAULTS[loss][:2]
    kind, _, axis = loss.partition(":")
    if kind == "motor" and axis in {f"J{i}" for i in range(1, 7)}:
        return "motor_exchange", {"axis": axis}
    names = ", ".join(_FAULTS)
    raise CellError(
        f"there is no loss {loss!r}", remedy=f"Choose {names} or motor:J1 … motor:J6.", code="usage"
    )


def describe_loss(loss: str) -> str:
    """Return what the world does, in words."""
    if loss in _FAULTS:
        return _FAULTS[loss][2]
    return f"the motor of {loss.removeprefix('motor:')} is exchanged, and the battery was out"


def _make_technician(fake_cell: FakeCellClient, scenario: DemoScenario) -> SimulatedTechnician:
    """Return the pair of hands; after a swap the plate on the arm is not the one that is asked for."""
    says_no = {"compare_plate"} if scenario.loss == "swap" else frozenset[str]()
    return SimulatedTechnician(fake_cell, scenario.say, says_no=frozenset(says_no))


async def _reach_everything(config: CellConfig, scenario: DemoScenario) -> None:
    if scenario.arm is not None:
        scenario.say(f"The arm: {scenario.arm.title}; gears, masses and stiffness are generic, no maker's.")
    scenario.say("The fake cell is up; every device is asked who it is.")
    report = await check_cell(config)
    for _ in range(_BUSY_TRIES):  # a busy machine answers late; a real cell gets no second look
        if report.all_reached:
            break
        report = await check_cell(config)
    for device in report.devices:
        scenario.say(f"{device.name}: {device.message}")
    if not report.all_reached:
        raise CellError(
            "the fake cell does not answer", remedy="Run `cellcal check` on its cell file.", code="fake"
        )
    for line in report.advice:
        scenario.say(line.split(":")[0] + ".")


async def _take_record(config: CellConfig, cell: Cell, journal: Journal, scenario: DemoScenario) -> None:
    scenario.say("The robot is healthy: its mastering record is taken.")
    spec = build_spec(config, scenario.robot, "mastering_record", {})
    outcome = await run_procedure(
        cell, "mastering_record", spec, journal, how=RunConditions(on_event=scenario.on_event, actor="demo")
    )
    if outcome.verdict is not RunVerdict.PASSED:
        raise CellError(f"no mastering record: {outcome.reason}", remedy=outcome.remedy, code=outcome.code)


async def _back_to_work(door: FakeCellClient, plot: DemoScenario) -> None:
    """Bring an arm of the user's choice away from the record's last pose, which may be at the end of its range."""
    if plot.arm is not None:
        plot.say("The robot goes back to its work.")
        await door.inject_fault("hand_moves", device=plot.robot, joints=plot.arm.park_rad.tolist())


@asynccontextmanager
async def _run_fast(fake_cell: FakeCellClient, time_factor: float) -> AsyncIterator[None]:
    """Let the world run fast for what the story is not about: a record takes half an hour of a robot's time."""
    await fake_cell.send_command("pace", time_factor=max(QUICKLY, time_factor))
    yield
    await fake_cell.send_command("pace", time_factor=time_factor)


async def _lose_and_notice(
    config: CellConfig,
    cell: Cell,
    fake_cell: FakeCellClient,
    fault: tuple[str, Mapping[str, object]],
    scenario: DemoScenario,
) -> PositionLoss:
    """Let the watch follow the healthy robot, pull the plug behind its back, and wait until it says so."""
    noticed: asyncio.Future[PositionLoss] = asyncio.get_running_loop().create_future()

    async def on_loss(loss: PositionLoss) -> None:
        if not noticed.done():
            noticed.set_result(loss)

    memory = LastHealthyCounts(config.cell.data_dir)
    robot: Any = cell.robot
    comparison = MasteringComparison(
        journalled_mastering(config, config.robot_named(scenario.robot).serial), look_every_s=0.0
    )
    watch = RobotWatch(robot, memory, on_loss, period_s=config.watch.period_s, comparison=comparison)
    await watch.look_once()  # the healthy state is on disk before anything happens
    async with asyncio.TaskGroup() as tasks:
        following = tasks.create_task(watch.watch_forever())
        scenario.say(f"Behind the service's back: {describe_loss(scenario.loss)}.")
        await fake_cell.inject_fault(fault[0], **fault[1])
        async with asyncio.timeout(NOTICE_WITHIN_S):
            detected_loss = await noticed
        following.cancel()
    scenario.say(f"The service noticed by itself: {detected_loss.detected_by}")
    return detected_loss


async def _run_recovery(
    config: CellConfig, cell: Cell, journal: Journal, scenario: DemoScenario
) -> RunOutcome:
    scenario.say("The recovery begins.")
    spec = build_spec(config, scenario.robot, "mastering_recovery", {})
    how = RunConditions(on_event=scenario.on_event, actor="demo")
    return await run_procedure(
        await with_robot_history(cell, journal), "mastering_recovery", spec, journal, how=how
    )


async def _recover_timed(
    config: CellConfig, cell: Cell, journal: Journal, fake_cell: FakeCellClient, scenario: DemoScenario
) -> tuple[RunOutcome, RobotTime]:
    """Recover, and read the world's clock before and after."""
    clock = StepClock(scenario.time_factor)

    def on_event(event: StepProgress) -> None:
        clock.on_event(event)
        scenario.on_event(event)

    began_s = (await fake_cell.read_truth())["time_s"]
    outcome = await _run_recovery(config, cell, journal, replace(scenario, on_event=on_event))
    return outcome, clock.split_total((await fake_cell.read_truth())["time_s"] - began_s)


async def _truth_of(fake_cell: FakeCellClient, plot: DemoScenario) -> dict[str, Any]:
    truth: dict[str, Any] = (await fake_cell.read_truth())["robots"][plot.robot]
    return truth


async def _tcp_error(fake_cell: FakeCellClient, plot: DemoScenario) -> TcpError:
    answer = await fake_cell.send_command("tcp_error", robot=plot.robot)
    return TcpError(answer["mean"], answer["max"])


def _build_report(scenario: DemoScenario, demo_outcome: "_DemoOutcome") -> DemoReport:
    result: RecoveryResult | None = demo_outcome.outcome.result
    if result is None and demo_outcome.outcome.verdict is RunVerdict.DECLINED:
        return _declined_report(scenario, demo_outcome)
    if result is None:
        outcome = demo_outcome.outcome
        raise CellError(f"the recovery broke off: {outcome.reason}", remedy=outcome.remedy, code=outcome.code)
    passed = (
        demo_outcome.outcome.verdict is RunVerdict.PASSED
    )  # a refusal writes nothing, so nothing was restored
    zero_error_rad = demo_outcome.drive.to_joints(
        np.array(demo_outcome.truth_after["true_counts_at_zero"]),
        np.array(demo_outcome.truth_after["counts_at_zero"]),
    )
    joints = tuple(
        JointReport(joint.name, lost, joint.turns_restored if passed else 0, float(error), joint.offset_u_rad)
        for joint, lost, error in zip(
            result.joints, demo_outcome.truth_before["turns_lost"], zero_error_rad, strict=True
        )
    )
    return DemoReport(
        loss=scenario.loss,
        detected_by=demo_outcome.loss.detected_by,
        captures=result.captures + result.check_captures + result.final_captures,
        joints=joints,
        tcp_error_before_m=demo_outcome.error_before,
        tcp_error_after_m=demo_outcome.error_after,
        verdict="PASS" if passed else "REFUSED",
        reason=result.reason
        if passed
        else f"{demo_outcome.outcome.reason} {demo_outcome.outcome.remedy}".strip(),
        seconds=demo_outcome.seconds,
        robot_time_s=result.robot_seconds,
        clock=demo_outcome.robot_time,
        gate=tuple((check.name, check.passed, check.sentence) for check in result.gate),
    )


def _declined_report(scenario: DemoScenario, demo_outcome: "_DemoOutcome") -> DemoReport:
    """Return the end of a recovery that the technician stopped before anything was written."""
    wrong = demo_outcome.drive.to_joints(
        np.array(demo_outcome.truth_after["true_counts_at_zero"]),
        np.array(demo_outcome.truth_after["counts_at_zero"]),
    )
    lost = demo_outcome.truth_before["turns_lost"]
    return DemoReport(
        loss=scenario.loss,
        detected_by=demo_outcome.loss.detected_by,
        captures=0,
        joints=tuple(
            JointReport(f"J{k}", turns, 0, float(error), 0.0)
            for k, (turns, error) in enumerate(zip(lost, wrong, strict=True), 1)
        ),
        tcp_error_before_m=demo_outcome.error_before,
        tcp_error_after_m=demo_outcome.error_after,
        verdict="REFUSED",
        reason=f"{demo_outcome.outcome.reason} {demo_outcome.outcome.remedy}".strip(),
        seconds=demo_outcome.seconds,
        clock=demo_outcome.robot_time,
    )
