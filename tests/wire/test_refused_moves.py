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
from cellcal.procedures.motion.motion_gate import JogMove, MotionRefusedError, jog_axis, move_along
from cellcal.procedures.motors import PositionLostAgainError
from cellcal.procedures.surroundings import NOTHING_KNOWN
from cellcal.service.configuration.cell_file import CellConfig, read_cell_file
from cellcal.service.demo.fake_cell_client import FakeCellClient
from cellcal.service.runs.open_cell import open_cell
from tests.wire.cases import ROBOTS, RobotCase, until, until_ready

FANUC = ROBOTS["modbus_robot"]
ASIDE_RAD = 0.05
STALE = {
    "frozen": {"fanuc": "frozen", "ur": "frozen"},
    "silent": {"fanuc": "silent", "ur": "link_stall"},
}
Event = Callable[[], Awaitable[None]]
asked_or_planned = pytest.mark.parametrize("asked", [True, False], ids=["asked", "planned"])


async def nothing() -> None:
    """Happen."""


@dataclass
class Scene:
    """A robot at home in a cell whose obstacles nobody has told, so that each move is asked for."""

    case: RobotCase
    door: FakeCellClient
    cell: Cell
    meanwhile: Event = nothing  # while a person is asked
    stood_rad: Joints = ()

    @property
    def robot(self) -> Any:
        return self.cell.robot

    async def truth(self) -> dict[str, Any]:
        return dict((await self.door.read_truth())["robots"][self.case.name])

    async def happen(self, event: Event) -> None:
        await event()
        self.stood_rad = tuple((await self.truth())["joints_rad"])

    async def refuses(self, event: Event, move: Event, error: type[Exception], *, asked: bool) -> None:
        """Let it happen between the approval of a move and the move: nothing may move."""
        if asked:
            self.meanwhile = lambda: self.happen(event)
        else:
            self.cell.motion.approved = True
            await self.happen(event)
        with pytest.raises(error) as refused:
            await move()
        assert refused.value.remedy
        self.meanwhile, self.cell.motion.approved = nothing, True
        await self.stands()

    async def stands(self) -> None:
        truth = await self.truth()
        assert self.stood_rad
        assert truth["joints_rad"] == pytest.approx(self.stood_rad, abs=1e-9)
        assert not truth["moving"]

    async def move(self) -> None:
        home = self.case.home_rad
        await move_along(self.cell, [(home[0] + ASIDE_RAD, *home[1:])], 0.3)

    async def jog(self) -> None:
        await jog_axis(self.cell, JogMove(0, ASIDE_RAD, 0.3))

    async def heals_and_moves(self, move: Event) -> None:
        """Take the fault away: what was refused must not come late, and moves when it is asked for again."""
        await self.door.send_command("clear")
        await until_ready(self.robot, Readiness.READY)
        await self.stands()
        await move()
        turned = (await self.truth())["joints_rad"][0] - self.stood_rad[0]
        assert turned == pytest.approx(ASIDE_RAD, abs=5e-3)


@asynccontextmanager
async def at_home(config: CellConfig, door: FakeCellClient, case: RobotCase) -> AsyncIterator[Scene]:
    async def approving() -> None:
        await scene.meanwhile()

    operator = ScriptedOperator({"approve_move": "yes"}, hooks={"approve_move": approving})
    async with open_cell(config, operator, case.name) as cell:
        scene = Scene(case, door, replace(cell, surroundings=NOTHING_KNOWN))
        await move_along(scene.cell, [case.home_rad], 0.3)
        yield scene


@pytest.fixture
async def scene(
    robot: Any, robot_case: RobotCase, cell: CellConfig, door: FakeCellClient
) -> AsyncIterator[Scene]:
    await robot.close()
    async with at_home(cell, door, robot_case) as made:
        yield made


@pytest.mark.parametrize("fault", sorted(STALE))
@asked_or_planned
async def test_a_stale_state_moves_nothing(scene: Scene, fault: str, asked: bool) -> None:
    async def goes_stale() -> None:
        await scene.door.inject_fault(STALE[fault][scene.case.name], device=scene.case.name)

    await scene.refuses(goes_stale, scene.move, DeviceError, asked=asked)
    await scene.heals_and_moves(scene.move)


@pytest.mark.parametrize("robot_case", ["modbus_robot"], indirect=True)
@pytest.mark.parametrize(("fault", "error"), [("frozen", UnreachableError), ("silent", DeviceError)])
@asked_or_planned
async def test_a_stale_state_jogs_nothing(
    scene: Scene, fault: str, error: type[DeviceError], asked: bool
) -> None:
    async def goes_stale() -> None:
        await scene.door.inject_fault(STALE[fault]["fanuc"], device="fanuc")

    await scene.refuses(goes_stale, scene.jog, error, asked=asked)
    await scene.heals_and_moves(scene.jog)


async def test_an_arm_that_was_moved_while_a_person_was_asked_is_not_moved(scene: Scene) -> None:
    """The way was checked from where it stood before."""

    async def moved_by_hand() -> None:
        joints = [scene.case.home_rad[0] + 0.1, *scene.case.home_rad[1:]]
        await scene.door.inject_fault("hand_moves", device=scene.case.name, joints=joints)

    await scene.refuses(moved_by_hand, scene.move, MotionRefusedError, asked=True)
    await scene.move()
    there = [scene.case.home_rad[0] + ASIDE_RAD, *scene.case.home_rad[1:]]
    assert (await scene.robot.joints()).joints_rad == pytest.approx(there, abs=2e-3)


@pytest.mark.parametrize("robot_case", ["modbus_robot"], indirect=True)
async def test_an_axis_that_was_turned_while_a_person_was_asked_is_not_jogged(scene: Scene) -> None:
    """Only its motors' counts show it: where a lost robot says that it stands means nothing."""

    async def turned_by_hand() -> None:
        joints = [*scene.case.home_rad[:2], scene.case.home_rad[2] + 0.1, *scene.case.home_rad[3:]]
        await scene.door.inject_fault("hand_moves", device=scene.case.name, joints=joints)

    await scene.refuses(turned_by_hand, scene.jog, MotionRefusedError, asked=True)
    await scene.jog()
    turned = (await scene.truth())["joints_rad"][0] - scene.stood_rad[0]
    assert turned == pytest.approx(ASIDE_RAD, abs=5e-3)


@pytest.fixture
async def alone(fresh_fakes: tuple[Path, FakeCellClient]) -> AsyncIterator[Scene]:
    """A robot whose place may be lost for good."""
    path, door = fresh_fakes
    async with at_home(read_cell_file(path), door, FANUC) as made:
        yield made


async def mastered_anew(scene: Scene) -> None:
    """Lose the encoders' battery; somebody masters the robot from memory, a turn of J2 beside the truth."""
    robot = scene.robot
    at_zero = (await scene.truth())["counts_at_zero"]
    await lost(scene)
    turns = abs((await robot.drive_train()).radians_per_turn().diagonal())
    for axis, turn_rad in enumerate(turns):
        await robot.jog_axis(axis, 1.05 * float(turn_rad), speed_rad_s=0.05)
    await robot.reset_position_alarms()
    await robot.write_mastering(tuple(at_zero))
    assert (await robot.read_condition()).readiness is Readiness.READY


async def lost(scene: Scene) -> None:
    """Lose the encoders' battery and put in a new one: the robot does not know where it is, and may be jogged."""
    robot, door = scene.robot, scene.door
    await door.inject_fault("battery_loss", device="fanuc", drift_turns=0.0)
    await until_ready(robot, Readiness.POSITION_LOST)
    await door.inject_fault("new_battery", device="fanuc")
    await robot.reset_position_alarms()
    await door.inject_fault("power_cycle", device="fanuc")

    async def waits_for_its_index() -> bool:
        return {alarm.code for alarm in (await robot.condition()).alarms} == {"SRVO-075"}

    await until(waits_for_its_index)


@asked_or_planned
async def test_encoders_of_another_epoch_move_nothing(alone: Scene, asked: bool) -> None:
    """The robot says that it is ready, and believes to be where it is not."""
    await alone.refuses(lambda: mastered_anew(alone), alone.move, PositionLostAgainError, asked=asked)


@asked_or_planned
async def test_encoders_of_another_epoch_jog_nothing(alone: Scene, asked: bool) -> None:
    await alone.refuses(lambda: lost(alone), alone.jog, PositionLostAgainError, asked=asked)
    alone.cell.motion.epoch = None  # a new beginning, as a recovery makes it
    await alone.jog()
    turned = (await alone.truth())["joints_rad"][0] - alone.stood_rad[0]
    assert turned == pytest.approx(ASIDE_RAD, abs=5e-3)
