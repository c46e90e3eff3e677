"""The UR driver against a controller on loopback: what the contract does not ask, and how it is let down."""

import asyncio
import os
import signal
from collections.abc import AsyncIterator, Awaitable, Callable, Sequence
from contextlib import asynccontextmanager
from typing import Any

import numpy as np
import pytest

from cellcal.calibration.arm.kinematics import RobotModel
from cellcal.drivers.errors import (
    DeviceError,
    DeviceTimeoutError,
    MotionStoppedError,
    RefusedError,
    UnreachableError,
    WrongDeviceError,
)
from cellcal.drivers.interfaces import Readiness
from cellcal.drivers.universal_robots.config import UniversalRobotConfig
from cellcal.drivers.universal_robots.robot import UniversalRobot
from cellcal.drivers.universal_robots.state import StateClient
from cellcal.fake_devices.universal_robots.device import FakeUniversalRobot as FakeRobot
from tests.machine_speed import stretched_s
from tests.wire.driver_cases import until_ready
from tests.wire.fake_ur import fake_ur

pytestmark = pytest.mark.timeout(stretched_s(180.0))

HOME = (-1.57, -1.57, -1.57, -1.57, 1.57, 0.0)
AWAY = (0.43, -1.2, -1.9, -1.3, 1.3, 0.4)
NEAR = (-1.52, -1.57, -1.57, -1.57, 1.57, 0.0)
SERIAL = "20225500042"
FAST = 3.0
DEADLINE_S = min(stretched_s(2.0), 5.0)  # ur_rtde gives up by itself after 5 s, in other words
PROMISE_S = stretched_s(
    4.0
)  # twice what the driver promises on an idle machine; tests/soak measures the promise


def config_of(fake: FakeRobot, **changes: Any) -> UniversalRobotConfig:
    fields: dict[str, Any] = {
        "driver": "universal_robots",
        "name": "ur",
        "address": fake.server.address,
        "model": "ur10e",
        "serial": SERIAL,
        "deadline_s": DEADLINE_S,
        "watchdog_hz": 1.0,  # a test machine may be too busy for 5
        "acceleration_rad_s2": 8.0,
        "stop_deceleration_rad_s2": 8.0,
        "settle_s": 0.05,
        **changes,
    }
    return UniversalRobotConfig(**fields)


@pytest.fixture
async def fake_robot() -> AsyncIterator[FakeRobot]:
    async with fake_ur() as fake:
        yield fake


@pytest.fixture
async def robot(fake_robot: FakeRobot) -> AsyncIterator[UniversalRobot]:
    async with config_of(fake_robot).open() as robot:
        yield robot


@asynccontextmanager
async def long_move(robot: UniversalRobot, fake: FakeRobot) -> AsyncIterator[asyncio.Task[None]]:
    """A long move that is under way; it is over when the block is."""
    move = asyncio.create_task(robot.move_joints(AWAY, speed_rad_s=FAST))
    try:
        await wait_until(lambda: fake.true_state()["moving"])
        yield move
    finally:
        move.cancel()
        await asyncio.wait({move})


async def wait_until(holds: Callable[[], bool]) -> None:
    async with asyncio.timeout(stretched_s(30.0)):
        while not holds():
            await asyncio.sleep(0.005)


async def failure_of(work: Awaitable[Any]) -> DeviceError:
    """Return the error in which ``work`` has to end, soon."""
    async with asyncio.timeout(PROMISE_S):
        with pytest.raises(DeviceError) as caught:
            await work
    assert str(caught.value).startswith("ur: ")
    assert caught.value.remedy
    return caught.value


def child_of(robot: UniversalRobot) -> int:
    assert robot._session is not None
    return robot._session._child.pid


async def works_again(robot: UniversalRobot, fake: FakeRobot) -> None:
    await wait_until(lambda: not fake.true_state()["moving"])
    target = (
        fake.true_state()["controller_joints_rad"][0] + 0.05,
        *fake.true_state()["controller_joints_rad"][1:],
    )
    await _move_unless_starved(robot, fake, target)
    assert fake.true_state()["controller_joints_rad"] == pytest.approx(target, abs=1e-3)


async def _move_unless_starved(robot: UniversalRobot, fake: FakeRobot, target: Sequence[float]) -> None:
    """Move; repeat it where a busy machine did not feed the watchdog for a second, as the error says."""
    while True:
        stops = fake.true_state()["watchdog_stops"]
        try:
            return await robot.move_joints(tuple(target), speed_rad_s=FAST)
        except MotionStoppedError:
            if fake.true_state()["watchdog_stops"] == stops:
                raise  # it was stopped for another reason
            await until_ready(robot, Readiness.READY)


# reading


async def test_reading_sends_no_program_to_the_controller(
    robot: UniversalRobot, fake_robot: FakeRobot
) -> None:
    await robot.identify()
    await robot.read_condition()
    await robot.read_joints()
    await robot.flange_pose()
    truth = fake_robot.true_state()
    assert truth["program"] is None
    assert truth["connections"]["30003"] == 0


async def test_the_active_tool_is_taken_off_the_flange_pose(
    robot: UniversalRobot, fake_robot: FakeRobot
) -> None:
    bare = await robot.flange_pose()
    fake_robot.server.controller.set_tcp((0.1, -0.05, 0.2, 0.3, -0.8, 1.1))
    await robot.read_joints()  # a state from before the change may still be on its way
    tooled = await robot.flange_pose()
    assert tooled.position_m == pytest.approx(bare.position_m, abs=1e-12)
    assert tooled.quaternion == pytest.approx(bare.quaternion, abs=1e-12)


async def test_the_factory_kinematics_give_the_pose_that_the_controller_reports(
    robot: UniversalRobot,
) -> None:
    found = await robot.factory_kinematics()
    model = RobotModel.from_dh(found.to_table(), name="as the maker measured it")
    reading, pose = await robot.read_joints(), await robot.flange_pose()
    base_flange = model.base_flange(np.array([reading.joints_rad]))[0]
    assert pose.to_matrix() == pytest.approx(base_flange, abs=1e-9)


async def test_another_model_at_the_address_is_refused(fake_robot: FakeRobot) -> None:
    with pytest.raises(WrongDeviceError, match=r"ur10e.*ur5e"):
        async with config_of(fake_robot, model="ur5e").open():
            pytest.fail("a stranger was let in")


async def test_a_robot_exchanged_at_its_address_is_noticed(
    robot: UniversalRobot, fake_robot: FakeRobot
) -> None:
    object.__setattr__(fake_robot.server.controller.identity, "serial", "20990000001")
    await fake_robot.inject_fault("link_loss_rtde", {})
    assert isinstance(await failure_of(_read_on(robot)), UnreachableError)
    failure = await failure_of(robot.read_joints())
    assert isinstance(failure, WrongDeviceError)
    assert "20990000001" in str(failure)


async def _read_on(robot: UniversalRobot) -> None:
    while True:
        await robot.read_joints()


# what forbids a move


@pytest.mark.parametrize(
    ("fault", "says"),
    [("local_mode", "Local"), ("program_pause", "another client"), ("slider", "speed slider")],
)
async def test_a_robot_that_is_not_ours_to_move_says_so_and_is_left_alone(
    robot: UniversalRobot, fake_robot: FakeRobot, fault: str, says: str
) -> None:
    if fault == "slider":
        fake_robot.server.controller.speed_fraction = 0.0
    elif fault == "program_pause":
        await fake_robot.inject_fault("other_client_moves", {"axis": "J1", "rad": 0.5})
        await fake_robot.inject_fault("program_pause", {})
    else:
        await fake_robot.inject_fault(fault, {})
    condition = await until_ready(robot, Readiness.NOT_READY)  # the slider comes with the next state
    before = fake_robot.true_state()
    assert says in condition.message
    failure = await failure_of(robot.move_joints(NEAR, speed_rad_s=FAST))
    assert isinstance(failure, RefusedError)
    assert says in str(failure)
    assert fake_robot.true_state()["program"] == before["program"]
    assert fake_robot.true_state()["controller_joints_rad"] == pytest.approx(before["controller_joints_rad"])


async def test_a_running_program_of_others_is_not_ended(robot: UniversalRobot, fake_robot: FakeRobot) -> None:
    await fake_robot.inject_fault("other_client_moves", {"axis": "J1", "rad": 1.0, "speed": 0.2})
    failure = await failure_of(robot.move_joints(NEAR, speed_rad_s=FAST))
    assert "another client" in str(failure)
    assert fake_robot.true_state()["program"] == "other_client"
    assert fake_robot.true_state()["moving"]


async def test_registers_in_use_by_another_client_are_written_in_our_words(
    robot: UniversalRobot, fake_robot: FakeRobot
) -> None:
    await fake_robot.inject_fault("in_use", {})
    failure = await failure_of(robot.move_joints(NEAR, speed_rad_s=FAST))
    assert isinstance(failure, RefusedError)
    assert "another program already commands this robot" in str(failure)
    assert failure.vendor_text
    fake_robot.clear_faults()
    await works_again(robot, fake_robot)


@pytest.mark.parametrize(
    ("port", "error", "says"),
    [
        (30003, DeviceTimeoutError, "hung"),  # ur-rtde's constructor waits, and holds the interpreter
        (30004, UnreachableError, "no new state"),
        (29999, UnreachableError, "the dashboard"),
    ],
)
async def test_a_port_that_accepts_and_is_silent_costs_a_child_at_most(
    robot: UniversalRobot, fake_robot: FakeRobot, port: int, error: type[DeviceError], says: str
) -> None:
    await fake_robot.inject_fault("silent_accept", {"port": port})
    failure = await failure_of(robot.move_joints(NEAR, speed_rad_s=FAST))
    assert isinstance(failure, error)
    assert says in str(failure)
    fake_robot.clear_faults()
    assert (await robot.read_joints()).joints_rad
    await works_again(robot, fake_robot)


# speed


async def test_no_move_is_faster_than_the_cell_file_allows(fake_robot: FakeRobot) -> None:
    watcher = StateClient("watcher", fake_robot.server.address, rate_hz=500.0, stale_s=stretched_s(10.0))
    async with config_of(fake_robot, speed_limit_rad_s=0.3).open() as robot:
        here = (await robot.read_joints()).joints_rad
        await watcher.connect(deadline_s=stretched_s(10.0))
        await robot.move_joints((here[0] + 0.2, *here[1:]), speed_rad_s=FAST)
    watcher.close()
    fastest = max(abs(speed) for sample in watcher.samples for speed in sample.joint_speeds_rad_s)
    assert 0.25 < fastest < 0.301


async def test_a_stop_asked_for_before_the_arm_moves_keeps_it_from_moving(
    robot: UniversalRobot, fake_robot: FakeRobot
) -> None:
    before = fake_robot.true_state()["controller_joints_rad"]
    move = asyncio.create_task(robot.move_joints(AWAY, speed_rad_s=FAST))
    await asyncio.sleep(0)
    await robot.stop()
    failure = await failure_of(move)
    assert isinstance(failure, MotionStoppedError)
    assert fake_robot.true_state()["controller_joints_rad"] == pytest.approx(before, abs=1e-9)
    await works_again(robot, fake_robot)


async def test_a_program_that_starts_too_late_is_not_left_running(
    robot: UniversalRobot, fake_robot: FakeRobot
) -> None:
    await fake_robot.inject_fault("late_script", {"delay_s": 0.8 * DEADLINE_S})
    failure = await failure_of(robot.move_joints(NEAR, speed_rad_s=FAST))
    assert isinstance(failure, DeviceTimeoutError)
    fake_robot.clear_faults()
    await robot.stop()
    await until_ready(robot, Readiness.READY)
    await works_again(robot, fake_robot)


# a child that is killed, hangs or crashes


@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGSEGV, signal.SIGSTOP])
async def test_a_dead_or_hung_child_during_a_move_is_an_error_and_the_service_goes_on(
    robot: UniversalRobot, fake_robot: FakeRobot, number: signal.Signals
) -> None:
    async with long_move(robot, fake_robot) as move:
        os.kill(child_of(robot), number)
        failure = await failure_of(move)
        if number != signal.SIGSTOP:
            assert f"signal {number.value}" in str(failure)
        await wait_until(lambda: not fake_robot.true_state()["moving"])
        assert fake_robot.true_state()["controller_joints_rad"][0] < AWAY[0] - 0.05, (
            "the arm went on without us"
        )
        assert fake_robot.true_state()["runtime"] == "STOPPED"
    await works_again(robot, fake_robot)


async def test_a_child_that_dies_between_moves_is_replaced(
    robot: UniversalRobot, fake_robot: FakeRobot
) -> None:
    await works_again(robot, fake_robot)
    first = child_of(robot)
    os.kill(first, signal.SIGSEGV)
    await wait_until(lambda: robot._session is not None and not robot._session.is_usable)
    await wait_until(lambda: fake_robot.true_state()["runtime"] == "STOPPED")  # by the robot's own watchdog
    await works_again(robot, fake_robot)
    assert child_of(robot) != first


async def test_stop_reaches_the_arm_while_the_child_hangs(
    robot: UniversalRobot, fake_robot: FakeRobot
) -> None:
    async with long_move(robot, fake_robot) as move:
        os.kill(child_of(robot), signal.SIGSTOP)
        async with asyncio.timeout(PROMISE_S):
            await robot.stop()
        assert not fake_robot.true_state()["moving"]
        assert fake_robot.true_state()["runtime"] == "STOPPED"
        await failure_of(move)


async def test_a_cancelled_move_with_a_hung_child_stops_the_arm_all_the_same(
    robot: UniversalRobot, fake_robot: FakeRobot
) -> None:
    async with long_move(robot, fake_robot) as move:
        os.kill(child_of(robot), signal.SIGSTOP)
        move.cancel()
        async with asyncio.timeout(PROMISE_S):
            with pytest.raises(asyncio.CancelledError):
                await move
        assert not fake_robot.true_state()["moving"]


async def test_a_cancelled_move_says_so_when_standstill_cannot_be_confirmed(
    robot: UniversalRobot, fake_robot: FakeRobot
) -> None:
    async with long_move(robot, fake_robot) as move:
        await fake_robot.inject_fault("link_loss_all", {})
        move.cancel()
        async with asyncio.timeout(PROMISE_S):
            with pytest.raises(asyncio.CancelledError) as caught:
                await move
        assert any("Look at the robot" in note for note in caught.value.__notes__)
        await wait_until(lambda: not fake_robot.true_state()["moving"])  # the robot's own watchdog


async def test_the_robot_stops_by_itself_when_everything_of_ours_falls_silent(
    robot: UniversalRobot, fake_robot: FakeRobot
) -> None:
    async with long_move(robot, fake_robot):
        os.kill(child_of(robot), signal.SIGSTOP)
        await wait_until(lambda: not fake_robot.true_state()["moving"])
        assert fake_robot.true_state()["controller_joints_rad"][0] < AWAY[0] - 0.05


# the link


@pytest.mark.parametrize("fault", ["link_loss_rtde", "link_loss_all", "link_stall"])
async def test_a_cut_link_during_a_move_tells_where_to_look_and_is_found_again(
    robot: UniversalRobot, fake_robot: FakeRobot, fault: str
) -> None:
    async with long_move(robot, fake_robot) as move:
        await fake_robot.inject_fault(fault, {})
        failure = await failure_of(move)
        assert isinstance(failure, UnreachableError)
        assert failure.remedy.startswith("Look at the robot first")
    fake_robot.clear_faults()
    await wait_until(lambda: fake_robot.true_state()["runtime"] == "STOPPED")
    await until_ready(robot, Readiness.READY)
    await works_again(robot, fake_robot)


@pytest.mark.parametrize("fault", ["link_loss_rtde", "link_loss_all", "link_stall"])
async def test_a_cut_link_between_moves_ends_the_child_before_it_reconnects(
    robot: UniversalRobot, fake_robot: FakeRobot, fault: str
) -> None:
    await works_again(robot, fake_robot)
    child = child_of(robot)
    await fake_robot.inject_fault(fault, {})
    assert isinstance(await failure_of(_read_on(robot)), UnreachableError)
    session = robot._session
    assert session is not None
    await wait_until(lambda: not session.is_usable)
    fake_robot.clear_faults()
    await wait_until(lambda: fake_robot.true_state()["runtime"] == "STOPPED")
    await until_ready(robot, Readiness.READY)
    await works_again(robot, fake_robot)
    assert child_of(robot) != child


# people and other clients


@pytest.mark.parametrize(
    ("fault", "says"),
    [
        ("protective_stop", "protective stop"),
        ("emergency_stop", "emergency stop"),
        ("program_stop", "stopped or paused"),
        ("program_pause", "stopped or paused"),
    ],
)
async def test_any_stop_ends_the_move_for_good(
    robot: UniversalRobot, fake_robot: FakeRobot, fault: str, says: str
) -> None:
    async with long_move(robot, fake_robot) as move:
        await fake_robot.inject_fault(fault, {})
        failure = await failure_of(move)
    assert isinstance(failure, MotionStoppedError)
    assert says in str(failure)
    stood_at = fake_robot.true_state()["controller_joints_rad"]
    await fake_robot.inject_fault("unlock_protective_stop", {})
    await fake_robot.inject_fault("release_emergency_stop", {})
    fake_robot.server.controller.resume_program()  # play is pressed
    await until_ready(robot, Readiness.READY)
    assert fake_robot.true_state()["program"] is None
    assert fake_robot.true_state()["controller_joints_rad"] == pytest.approx(stood_at, abs=1e-9)
    await works_again(robot, fake_robot)


async def test_a_client_that_takes_the_arm_over_is_noticed(
    robot: UniversalRobot, fake_robot: FakeRobot
) -> None:
    async with long_move(robot, fake_robot) as move:
        await fake_robot.inject_fault("other_client_moves", {"axis": "J3", "rad": 0.6, "speed": 1.0})
        failure = await failure_of(move)
    assert isinstance(failure, MotionStoppedError)
    assert "another client" in str(failure)


async def test_the_robot_is_given_back_after_a_while_and_taken_again(fake_robot: FakeRobot) -> None:
    async with config_of(fake_robot, release_after_s=0.1).open() as robot:
        await works_again(robot, fake_robot)
        await wait_until(lambda: fake_robot.true_state()["runtime"] == "STOPPED")
        assert (await robot.read_condition()).readiness is Readiness.READY
        await works_again(robot, fake_robot)


async def test_closing_ends_our_program_and_our_process(fake_robot: FakeRobot) -> None:
    async with config_of(fake_robot).open() as robot:
        await works_again(robot, fake_robot)
        child = child_of(robot)
    await wait_until(lambda: fake_robot.true_state()["runtime"] == "STOPPED")
    with pytest.raises(ProcessLookupError):
        os.kill(child, 0)


async def test_an_arm_that_is_blocked_short_of_its_target_is_an_error(
    robot: UniversalRobot, fake_robot: FakeRobot
) -> None:
    async with long_move(robot, fake_robot) as move:
        controller: Any = fake_robot.server.controller
        controller.program.background = None  # the program forgets the move, and plays on
        controller.point.move_to(controller.point.joints_rad)
        failure = await failure_of(move)
    assert isinstance(failure, MotionStoppedError)
    assert "deg from its target" in str(failure)
