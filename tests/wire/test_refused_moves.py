"""No move with a state that has gone stale, or with encoders that lost their place: what the arm really did says so.

Each time the move was allowed and then something happened: while a person was asked for this move, or after a plan
was approved. The fakes show a state that stands still but obey commands as before: a command that got through
would move the arm.
"""

from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import asynccontextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import pytest

from cellcal.drivers.errors import DeviceError, UnreachableError
from cellcal.drivers.interfaces import Joints, Readiness
from cellcal.drivers.operator.scripted import ScriptedOperator
from cellcal.procedures.cell import Cell
from cellcal.procedures.motion.motion_gate import JogMove, jog_axis, move_along
from cellcal.procedures.motion.robot_readiness import MotionRefusedError
from cellcal.procedures.motors import PositionLostAgainError
from cellcal.procedures.surroundings import NOTHING_KNOWN
from cellcal.service.configuration.cell_file import CellConfig, read_cell_file
from cellcal.service.demo.fake_cell_client import FakeCellClient
from cellcal.service.runs.open_cell import open_cell
from tests.wire.driver_cases import until_ready, wait_until
from tests.wire.robot_cases import ROBOTS, RobotCase

FANUC = ROBOTS["modbus_robot"]
ASIDE_RAD = 0.05
STALE = {
    "frozen": {"fanuc": "frozen", "ur": "frozen"},  # others are asked anew for each answer: nothing can stand still
    "silent": {
        "fanuc": "silent", "ur": "link_stall", "abb": "silent", "kuka": "silent", "motoman": "silent", "rmi": "silent",
    },
}  # fmt: skip
Event = Callable[[], Awaitable[None]]
confirmed_or_planned = pytest.mark.parametrize("is_confirmed", [True, False], ids=["asked", "planned"])


async def do_nothing() -> None:
    """Happen."""


@dataclass
class RobotAtHome:
    """A robot at home in a cell whose obstacles are not described, so that each move is asked for."""

    case: RobotCase
    fake_client: FakeCellClient
    cell: Cell
    meanwhile: Event = do_nothing  # while a person is asked
    stood_rad: Joints = ()

    @property
    def robot(self) -> Any:
        return self.cell.robot

    async def read_truth(self) -> dict[str, Any]:
        return dict((await self.fake_client.read_truth())["robots"][self.case.name])

    async def cause_event(self, event: Event) -> None:
        await event()
        self.stood_rad = tuple((await self.read_truth())["joints_rad"])

    async def check_refusal(
        self, event: Event, move: Event, error: type[Exception], *, is_confirmed: bool
    ) -> None:
        """Let it happen between the approval of a move and the move: nothing may move."""
        if is_confirmed:
            self.meanwhile = lambda: self.cause_event(event)
        else:
            self.cell.motion.approved = True
            await self.cause_event(event)
        with pytest.raises(error) as refused:
            await move()
        assert refused.value.remedy
        self.meanwhile, self.cell.motion.approved = do_nothing, True
        await self.check_standing()

    async def check_standing(self) -> None:
        truth = await self.read_truth()
        assert self.stood_rad
        assert truth["joints_rad"] == pytest.approx(self.stood_rad, abs=1e-9)
        assert not truth["moving"]

    async def move_robot(self) -> None:
        home = self.case.home_rad
        await move_along(self.cell, [(home[0] + ASIDE_RAD, *home[1:])], 0.3)

    async def jog_axis(self) -> None:
        await jog_axis(self.cell, JogMove(0, ASIDE_RAD, 0.3))

    async def heals_and_moves(self, move: Event) -> None:
        """Take the fault away: what was refused must not come late, and moves when it is asked for again."""
        await self.fake_client.send_command("clear")
        await until_ready(self.robot, Readiness.READY)
        await self.check_standing()
        await move()
        turned = (await self.read_truth())["joints_rad"][0] - self.stood_rad[0]
        assert turned == pytest.approx(ASIDE_RAD, abs=5e-3)


@asynccontextmanager
async def at_home(
    config: CellConfig, fake_client: FakeCellClient, case: RobotCase
) -> AsyncIterator[RobotAtHome]:
    async def approve_event() -> None:
        await scene.meanwhile()

    operator = ScriptedOperator({"approve_move": "yes"}, hooks={"approve_move": approve_event})
    async with open_cell(config, operator, case.name) as cell:
        scene = RobotAtHome(case, fake_client, replace(cell, surroundings=NOTHING_KNOWN))
        await move_along(scene.cell, [case.home_rad], 0.3)
        yield scene


@pytest.fixture
async def robot_at_home(
    robot: Any, robot_case: RobotCase, cell: CellConfig, fake_client: FakeCellClient
) -> AsyncIterator[RobotAtHome]:
    if not robot.capabilities.moves_joints:
        pytest.skip("this link moves no arm")
    await robot.close()
    async with at_home(cell, fake_client, robot_case) as made:
        yield made


@pytest.mark.parametrize(
    ("fault", "robot_case"),
    [
        (fault, kind)
        for fault, robots in sorted(STALE.items())
        for kind, case in sorted(ROBOTS.items())
        if case.name in robots
    ],
    indirect=["robot_case"],
)
@confirmed_or_planned
async def test_a_stale_state_moves_nothing(
    robot_at_home: RobotAtHome, fault: str, is_confirmed: bool
) -> None:
    async def goes_stale() -> None:
        await robot_at_home.fake_client.inject_fault(
            STALE[fault][robot_at_home.case.name], device=robot_at_home.case.name
        )

    await robot_at_home.check_refusal(
        goes_stale, robot_at_home.move_robot, DeviceError, is_confirmed=is_confirmed
    )
    await robot_at_home.heals_and_moves(robot_at_home.move_robot)


@pytest.mark.parametrize("robot_case", ["modbus_robot"], indirect=True)
@pytest.mark.parametrize(("fault", "error"), [("frozen", UnreachableError), ("silent", DeviceError)])
@confirmed_or_planned
async def test_a_stale_state_jogs_nothing(
    robot_at_home: RobotAtHome, fault: str, error: type[DeviceError], is_confirmed: bool
) -> None:
    async def goes_stale() -> None:
        await robot_at_home.fake_client.inject_fault(STALE[fault]["fanuc"], device="fanuc")

    await robot_at_home.check_refusal(goes_stale, robot_at_home.jog_axis, error, is_confirmed=is_confirmed)
    await robot_at_home.heals_and_moves(robot_at_home.jog_axis)


async def test_an_arm_that_was_moved_while_a_person_was_asked_is_not_moved(
    robot_at_home: RobotAtHome,
) -> None:
    """The way was checked from where it stood before."""

    async def moved_by_hand() -> None:
        joints = [robot_at_home.case.home_rad[0] + 0.1, *robot_at_home.case.home_rad[1:]]
        await robot_at_home.fake_client.inject_fault(
            "hand_moves", device=robot_at_home.case.name, joints=joints
        )

    await robot_at_home.check_refusal(
        moved_by_hand, robot_at_home.move_robot, MotionRefusedError, is_confirmed=True
    )
    await robot_at_home.move_robot()
    there = [robot_at_home.case.home_rad[0] + ASIDE_RAD, *robot_at_home.case.home_rad[1:]]
    assert (await robot_at_home.robot.read_joints()).joints_rad == pytest.approx(there, abs=2e-3)


@pytest.mark.parametrize("robot_case", ["modbus_robot"], indirect=True)
async def test_an_axis_that_was_turned_while_a_person_was_asked_is_not_jogged(
    robot_at_home: RobotAtHome,
) -> None:
    """Only its motors' counts show it: where a lost robot says that it stands means nothing."""

    async def turned_by_hand() -> None:
        joints = [
            *robot_at_home.case.home_rad[:2],
            robot_at_home.case.home_rad[2] + 0.1,
            *robot_at_home.case.home_rad[3:],
        ]
        await robot_at_home.fake_client.inject_fault(
            "hand_moves", device=robot_at_home.case.name, joints=joints
        )

    await robot_at_home.check_refusal(
        turned_by_hand, robot_at_home.jog_axis, MotionRefusedError, is_confirmed=True
    )
    await robot_at_home.jog_axis()
    turned = (await robot_at_home.read_truth())["joints_rad"][0] - robot_at_home.stood_rad[0]
    assert turned == pytest.approx(ASIDE_RAD, abs=5e-3)


@pytest.fixture
async def fresh_robot_at_home(fresh_fakes: tuple[Path, FakeCellClient]) -> AsyncIterator[RobotAtHome]:
    """A robot whose place may be lost for good."""
    path, fake_client = fresh_fakes
    async with at_home(read_cell_file(path), fake_client, FANUC) as made:
        yield made


async def mastered_anew(scene: RobotAtHome) -> None:
    """Lose the encoders' battery, then master the robot from memory, a turn of J2 beside the truth."""
    robot = scene.robot
    at_zero = (await scene.read_truth())["counts_at_zero"]
    await lose_encoders(scene)
    turns = abs((await robot.drive_train()).radians_per_turn().diagonal())
    for axis, turn_rad in enumerate(turns):
        await robot.jog_axis(axis, 1.05 * float(turn_rad), speed_rad_s=0.05)
    await robot.reset_position_alarms()
    await robot.write_mastering(tuple(at_zero))
    assert (await robot.read_condition()).readiness is Readiness.READY


async def lose_encoders(scene: RobotAtHome) -> None:
    """Lose the encoders' battery and put in a new one: the robot does not know where it is, and may be jogged."""
    robot, fake_client = scene.robot, scene.fake_client
    await fake_client.inject_fault("battery_loss", device="fanuc", drift_turns=0.0)
    await until_ready(robot, Readiness.POSITION_LOST)
    await fake_client.inject_fault("new_battery", device="fanuc")
    await robot.reset_position_alarms()
    await fake_client.inject_fault("power_cycle", device="fanuc")

    async def waits_for_its_index() -> bool:
        return {alarm.code for alarm in (await robot.read_condition()).alarms} == {"SRVO-075"}

    await wait_until(waits_for_its_index)


@confirmed_or_planned
async def test_encoders_of_another_epoch_move_nothing(
    fresh_robot_at_home: RobotAtHome, is_confirmed: bool
) -> None:
    """The robot says that it is ready, and believes to be where it is not."""
    await fresh_robot_at_home.check_refusal(
        lambda: mastered_anew(fresh_robot_at_home),
        fresh_robot_at_home.move_robot,
        PositionLostAgainError,
        is_confirmed=is_confirmed,
    )


@confirmed_or_planned
async def test_encoders_of_another_epoch_jog_nothing(
    fresh_robot_at_home: RobotAtHome, is_confirmed: bool
) -> None:
    await fresh_robot_at_home.check_refusal(
        lambda: lose_encoders(fresh_robot_at_home),
        fresh_robot_at_home.jog_axis,
        PositionLostAgainError,
        is_confirmed=is_confirmed,
    )
    fresh_robot_at_home.cell.motion.epoch = None  # a new beginning, as a recovery makes it
    await fresh_robot_at_home.jog_axis()
    turned = (await fresh_robot_at_home.read_truth())["joints_rad"][0] - fresh_robot_at_home.stood_rad[0]
    assert turned == pytest.approx(ASIDE_RAD, abs=5e-3)
