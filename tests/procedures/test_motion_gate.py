"""The motion gate: which moves it permits, which it refuses, and that no code bypasses it."""

import ast
import asyncio
import math
import re
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest

from cellcal.calibration.errors import CellError
from cellcal.calibration.motion.cell_shapes import PlaneObstacle, SphereObstacle
from cellcal.calibration.motion.position_uncertainty import PositionUncertainty
from cellcal.drivers.errors import MotionStoppedError, RefusedError, UnreachableError
from cellcal.drivers.interfaces import Condition, JointReading, Readiness
from cellcal.drivers.registry import PROGRAM_WRITERS
from cellcal.procedures.cell import MotionLevel
from cellcal.procedures.mastering_record import MasteringRecordSpec, mastering_record
from cellcal.procedures.motion.approach import OVERSHOOT_RAD
from cellcal.procedures.motion.manual_moves import NotThereError
from cellcal.procedures.motion.motion_gate import JogMove, MotionCare, jog_axis, move_along, refuse_off_target
from cellcal.procedures.motion.plans import MotionBounds
from cellcal.procedures.motion.robot_readiness import MotionRefusedError
from cellcal.procedures.motors import PositionLostAgainError
from cellcal.procedures.run import DeclinedError, Run
from cellcal.procedures.steps.motion import IndexTurn, follow_way, pass_index
from cellcal.procedures.surroundings import Surroundings
from cellcal.service.record.robot_lock import LeaseLostError, acquire_lease
from cellcal.service.runs.pendant_programs import PendantPrograms
from tests.procedures.ideal_devices import IdealArm
from tests.procedures.memory_ledgers import MemoryLedger
from tests.procedures.pendant_technician import PendantTechnician
from tests.procedures.procedure_scenes import ProcedureScene, healthy_scene, recovery_scene

HERE = (0.2, 0.1, -0.3, 0.4, 0.5, -0.6)
THERE = (0.5, 0.2, -0.2, 0.4, 0.6, -0.5)
FLOOR = Surroundings(planes=(PlaneObstacle("floor", (0.0, 0.0, -0.9), (0.0, 0.0, 1.0)),))
ROOT = Path(__file__).parents[2]
MOTION_COMMANDS = ("move_joints", "jog_axis", "move_linear")


def standing_scene(arm: IdealArm | None = None) -> ProcedureScene:
    made = healthy_scene()
    if arm is not None:
        made.arm = arm
        made.cell = replace(made.cell, robot=arm, jogs=arm, mastering=arm)
    made.arm.write_program(np.array(HERE))
    made.cell = replace(made.cell, surroundings=FLOOR)
    return made


def motion_commands(tree: ast.AST) -> set[str]:
    """Names of the commands to move that a file calls, wherever the robot comes from."""
    return {
        node.func.attr
        for node in ast.walk(tree)
        if isinstance(node, ast.Call)
        and isinstance(node.func, ast.Attribute)
        and node.func.attr in MOTION_COMMANDS
        and not (isinstance(node.func.value, ast.Name) and node.func.value.id == "motion_gate")
    }


def test_no_code_commands_motion_past_the_gate() -> None:
    files = [file for folder in ("procedures", "service") for file in (ROOT / folder).rglob("*.py")]
    assert len(files) > 50
    callers = {
        file.relative_to(ROOT).as_posix(): found
        for file in files
        if any(command in (text := file.read_text(encoding="utf-8")) for command in MOTION_COMMANDS)
        and (found := motion_commands(ast.parse(text)))
    }
    assert callers == {
        "procedures/motion/motion_gate.py": {"move_joints", "jog_axis"},
        "procedures/shown_motors.py": {
            "move_joints"
        },  # the gate's own jog, for robots that jog by a joint move
    }


async def test_a_free_way_is_gone_corner_by_corner() -> None:
    made = standing_scene()
    await move_along(made.cell, [THERE, HERE], 0.1)
    assert made.arm.moves == ["move", "move"]
    assert np.allclose(made.arm.true_joints, HERE, atol=1e-5)
    assert made.technician.instructions == []  # the shapes of the cell are known: a plan's approval is enough


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf, 1e300])
async def test_what_is_no_number_moves_nothing(bad: float) -> None:
    made = standing_scene()
    for way, speed in (([(*THERE[:5], bad)], 0.1), ([THERE], bad), ([THERE], -0.1), ([THERE], 0.0)):
        if speed == 1e300:
            continue  # too fast is slowed down to the caps
        with pytest.raises(CellError):
            await move_along(made.cell, way, speed)
    with pytest.raises(CellError):
        await jog_axis(made.cell, JogMove(0, math.nan, 0.03, HERE))
    assert made.arm.moves == []


async def test_limits_obstacles_and_the_wire_stop_a_move_before_it_begins() -> None:
    made = standing_scene()
    beyond = (*THERE[:3], 9.0, *THERE[4:])
    tip = made.arm.model.base_flange(np.array([THERE]))[0, :3, 3]
    x, y, z = (float(v) for v in tip)
    blocked = replace(made.cell, surroundings=replace(FLOOR, balls=(SphereObstacle("post", (x, y, z), 0.1),)))
    with pytest.raises(MotionRefusedError, match="joint limits"):
        await move_along(made.cell, [beyond], 0.1)
    with pytest.raises(MotionRefusedError, match=r"clearance of .* and post"):
        await move_along(blocked, [THERE], 0.1)
    far = replace(made.cell, gauge_setup=replace(made.cell.gauge_setup, anchor_in_base_m=(5.0, 0.0, 0.0)))  # type: ignore[type-var]
    with pytest.raises(MotionRefusedError, match="wire too long"):
        await move_along(far, [THERE], 0.1, care=MotionCare.WIRED)
    assert made.arm.moves == []


@dataclass
class FaultyArm(IdealArm):
    """An arm whose state can be made bad."""

    readiness: Readiness = Readiness.READY
    age_s: float = 0.0
    drifts: bool = False

    async def read_condition(self) -> Condition:
        await asyncio.sleep(0)
        return Condition(self.readiness, "it is so", "mend it")

    async def read_joints(self) -> JointReading:
        reading = await super().read_joints()
        return replace(reading, taken_at_s=reading.taken_at_s - self.age_s, moving=self.drifts)


@pytest.mark.parametrize(
    ("mood", "error"),
    [
        ({"readiness": Readiness.UNREACHABLE}, UnreachableError),
        ({"readiness": Readiness.STOPPED}, MotionStoppedError),
        ({"readiness": Readiness.NOT_READY}, RefusedError),
        ({"readiness": Readiness.POSITION_LOST}, RefusedError),
        ({"age_s": 1.5}, MotionRefusedError),
        ({"drifts": True}, MotionRefusedError),
    ],
)
async def test_a_robot_that_is_not_ready_fresh_and_still_is_not_moved(
    mood: dict[str, object], error: type[CellError]
) -> None:
    made = standing_scene(FaultyArm(**mood))  # type: ignore[arg-type]
    with pytest.raises(error):
        await move_along(made.cell, [THERE], 0.1)
    assert made.arm.moves == []


async def test_a_lost_robot_jogs_one_axis_and_takes_no_target() -> None:
    made = standing_scene()
    made.arm.data = replace(made.arm.data, mastered=False)
    await jog_axis(made.cell, JogMove(2, 0.05, 0.03, HERE))
    with pytest.raises(RefusedError):
        await move_along(made.cell, [THERE], 0.1)
    assert made.arm.moves == ["jog 2"]


async def test_encoders_that_changed_since_the_first_move_end_the_motion() -> None:
    made = standing_scene()
    await move_along(made.cell, [THERE], 0.1)
    made.arm.epoch += 1
    with pytest.raises(PositionLostAgainError):
        await move_along(made.cell, [HERE], 0.1)
    assert made.arm.moves == ["move"]


async def test_a_lease_taken_over_by_another_process_stops_between_two_corners(tmp_path: Path) -> None:
    made = standing_scene()
    with acquire_lease(tmp_path, "arm", "anna") as lease:
        made.cell = replace(made.cell, permit=lease)
        move = made.arm.move_joints

        async def take_over_lease(target: tuple[float, ...], *, speed_rad_s: float) -> None:
            await move(target, speed_rad_s=speed_rad_s)
            lease.path.unlink()  # the file was deleted, and another run takes the lock
            with acquire_lease(tmp_path, "arm", "ben") as other:
                assert other.token >= 1

        made.arm.move_joints = take_over_lease  # type: ignore[assignment,method-assign]
        with pytest.raises(LeaseLostError):
            await move_along(made.cell, [THERE, HERE], 0.1)
    assert made.arm.moves == ["move"]


def test_every_holder_of_a_lease_has_a_higher_token(tmp_path: Path) -> None:
    tokens = []
    for holder in ("anna", "ben", "anna"):
        with acquire_lease(tmp_path, "arm", holder) as lease:
            lease.check_held()
            tokens.append(lease.token)
    assert tokens == [1, 2, 3]


async def test_without_known_obstacles_each_move_is_asked_for_until_a_plan_is_approved() -> None:
    made = standing_scene()
    made.cell = replace(made.cell, surroundings=Surroundings())
    await move_along(made.cell, [THERE], 0.1)
    assert made.technician.instructions == ["approve_move"]
    made.cell.motion.approved = True
    await move_along(made.cell, [HERE], 0.1)
    assert made.technician.instructions == ["approve_move"]
    made.cell.motion.approved = False
    made.technician.refuses.add("approve_move")
    with pytest.raises(DeclinedError):
        await move_along(made.cell, [THERE], 0.1)
    assert made.arm.moves == ["move", "move"]


async def test_what_was_agreed_to_a_shift_ago_is_asked_again_and_holds_for_another() -> None:
    made = standing_scene()
    now_s = asyncio.get_running_loop().time()
    await move_along(made.cell, [THERE], 0.1)
    made.cell.motion.note_approval(now_s - 7.9 * 3600)
    await move_along(made.cell, [HERE], 0.1)
    assert made.technician.instructions == []
    made.cell.motion.note_approval(now_s - 8.1 * 3600)
    await move_along(made.cell, [THERE], 0.1)
    await move_along(made.cell, [HERE], 0.1)
    assert made.technician.instructions == ["may_still_move"]
    made.cell.motion.note_approval(now_s - 8.1 * 3600)
    made.technician.refuses.add("may_still_move")
    with pytest.raises(DeclinedError):
        await move_along(made.cell, [THERE], 0.1)
    assert made.arm.moves == ["move"] * 4


async def watched_at(override: float) -> ProcedureScene:
    """Return a robot that tells its override and has moved once with it."""
    made = standing_scene()
    made.cell = replace(made.cell, override=made.arm)
    made.arm.override = override
    await move_along(made.cell, [THERE], 0.1)
    return made


async def test_more_speed_than_was_watched_is_asked_for_and_less_never_is() -> None:
    made = await watched_at(0.3)
    made.arm.override = 0.1
    await move_along(made.cell, [HERE], 0.1)
    made.arm.override = 0.3
    await jog_axis(made.cell, JogMove(0, 0.1, 0.02))
    assert made.technician.instructions == []
    made.arm.override = 1.0
    await move_along(made.cell, [THERE], 0.1)
    await move_along(made.cell, [HERE], 0.1)
    assert made.technician.instructions == ["may_move_faster"]
    assert "stands at 100 %, and was 30 % at most" in made.technician.read["may_move_faster"]


async def test_a_declined_speed_override_blocks_motion_until_it_is_turned_back() -> None:
    made = await watched_at(0.1)
    made.arm.override = 0.5
    made.technician.refuses.add("may_move_faster")
    for _ in range(2):
        with pytest.raises(DeclinedError):
            await move_along(made.cell, [HERE], 0.1)
    assert made.arm.moves == ["move"]
    made.arm.override = 0.1
    await move_along(made.cell, [HERE], 0.1)
    assert made.arm.moves == ["move"] * 2


async def test_speed_turned_up_while_it_is_asked_about_is_asked_about_again() -> None:
    made = await watched_at(0.1)
    made.arm.override = 0.5
    made.technician.does["may_move_faster"] = lambda: setattr(made.arm, "override", 1.0)
    await move_along(made.cell, [HERE], 0.1)
    assert made.technician.instructions == ["may_move_faster"] * 2


async def test_no_part_of_the_arm_is_faster_than_its_cap() -> None:
    made = standing_scene()
    speeds = []
    move = made.arm.move_joints

    async def move_timed(target: tuple[float, ...], *, speed_rad_s: float) -> None:
        speeds.append(speed_rad_s)
        await move(target, speed_rad_s=speed_rad_s)

    made.arm.move_joints = move_timed  # type: ignore[assignment,method-assign]
    turned = (HERE[0] + 0.4, *HERE[1:])
    await move_along(made.cell, [turned], 0.5)
    made.cell = replace(made.cell, surroundings=Surroundings())
    await move_along(made.cell, [HERE], 0.5)
    flange = made.arm.model.base_flange(np.array([HERE]))[0, :2, 3]
    assert speeds[0] * float(np.linalg.norm(flange)) < 0.25
    assert speeds[0] > 0.15
    assert speeds[1] == pytest.approx(speeds[0] / 2, rel=0.01)


def hand_jog_scene(level: MotionLevel = MotionLevel.OBSERVE, beside_rad: float = 0.0) -> ProcedureScene:
    made = standing_scene()
    made.technician = PendantTechnician(arm=made.arm, beside_rad=beside_rad)
    made.cell = replace(made.cell, operator=made.technician, level=level)
    return made


async def test_at_l0_a_person_moves_and_the_software_looks() -> None:
    made = hand_jog_scene(beside_rad=0.004)
    found = await follow_way(made.cell, (THERE,), 0.1)
    assert made.technician.instructions == ["move_by_hand"]
    assert made.arm.moves == []
    assert np.allclose(found, np.array(THERE) + 0.004, atol=1e-4)  # where it really stands


async def test_at_l0_a_wrong_place_is_asked_for_again_and_then_refused() -> None:
    made = hand_jog_scene(beside_rad=0.03)
    with pytest.raises(NotThereError, match=r"is \+1.72 deg off"):
        await follow_way(made.cell, (THERE,), 0.1)
    assert made.technician.instructions == ["move_by_hand"] * 6
    assert made.arm.moves == []


async def test_at_l0_no_technician_is_sent_where_the_way_is_not_free() -> None:
    made = hand_jog_scene()
    with pytest.raises(MotionRefusedError):
        await follow_way(made.cell, ((*THERE[:3], 9.0, *THERE[4:]),), 0.1)
    assert made.technician.instructions == []


@pytest.mark.parametrize("level", [MotionLevel.OBSERVE, MotionLevel.PROGRAM])
async def test_a_record_is_taken_without_a_single_command(level: MotionLevel, tmp_path: Path) -> None:
    made = hand_jog_scene(level)
    shelf = PendantPrograms(tmp_path / "programs", "arm", "F-1", PROGRAM_WRITERS["universal_robots"])
    made.cell = replace(made.cell, programs=shelf)
    spec = MasteringRecordSpec(poses=16, samples=2, room=MotionBounds(surroundings=FLOOR))
    result = await mastering_record(Run(made.cell, MemoryLedger()), spec)
    assert made.arm.moves == []
    assert result.record.wire.is_consistent()
    captures = len(result.record.captures)
    assert made.technician.instructions.count("move_by_hand") == captures >= 14
    programs = list((tmp_path / "programs").glob("*.script"))
    assert len(programs) == (captures if level is MotionLevel.PROGRAM else 0)


async def test_at_l0_lost_motors_are_turned_by_hand() -> None:
    made = await recovery_scene()
    pendant = PendantTechnician(arm=made.arm)
    cell = replace(made.cell, operator=pendant, level=MotionLevel.OBSERVE)
    made.arm.battery_flat = False
    await jog_axis(cell, JogMove(3, 0.1, 0.03))
    assert pendant.instructions == ["jog_by_hand"]
    assert "turn J4 alone by +5.73 deg" in pendant.texts[0]
    assert made.arm.moves == []


def test_a_program_holds_the_moves_the_token_and_what_it_is_not(tmp_path: Path) -> None:
    for make, words in (
        ("universal_robots", ["movej([0.500000, 0.200000", "v=0.020000", "end"]),
        ("fanuc_hmi", ["/PROG  CC", "J1=    28.648 deg", "OVERRIDE=10%", "J P[2] 1% FINE", "/END"]),
    ):
        shelf = PendantPrograms(tmp_path / make, "arm", "F-1", PROGRAM_WRITERS[make])
        path = Path(shelf.write_program((HERE, THERE), 0.02))
        text = path.read_text()
        flat = " ".join(re.sub(r"\d+:|[#!;]", " ", text).split())
        assert all(word in text for word in words), text
        assert path.stem[2:] in text
        assert "performs no safety function" in flat
        assert shelf.write_program((HERE, THERE), 0.02) == str(path)
        assert shelf.write_program((THERE, HERE), 0.02) != str(path)


def test_an_arrival_that_is_no_number_is_off_target() -> None:
    cell = healthy_scene().cell
    with pytest.raises(CellError):
        refuse_off_target(cell, (math.nan,) * 6, THERE, 0.1)
    refuse_off_target(cell, THERE, THERE, OVERSHOOT_RAD)


async def test_distances_grow_with_the_doubt_about_where_the_arm_stands() -> None:
    made = standing_scene()
    model = made.arm.model
    elbow = float(model.base_flange(np.array([THERE]))[0, 0, 3])
    wall = PlaneObstacle("wall", (elbow + 0.3, 0.0, 0.0), (-1.0, 0.0, 0.0))
    made.cell = replace(made.cell, surroundings=replace(FLOOR, planes=(*FLOOR.planes, wall)))
    await move_along(made.cell, [THERE], 0.05)
    made.arm.write_program(np.array(HERE))
    with pytest.raises(MotionRefusedError, match=r"and wall: .* for turns that are not known yet"):
        await move_along(made.cell, [THERE], 0.05, doubt=PositionUncertainty((0.15,) * 6, (0.0,) * 6))


async def test_a_turn_past_an_index_keeps_away_from_what_is_solid() -> None:
    made = await recovery_scene()
    made.arm.battery_flat = False
    likely = tuple(float(q) for q in made.arm.true_joints)
    model = made.arm.model
    flange = model.base_flange(np.array([likely]))[0, :3, 3]
    post = SphereObstacle("post", (float(flange[0]), float(flange[1]) + 0.35, float(flange[2])), 0.1)
    made.cell = replace(made.cell, surroundings=Surroundings(balls=(post,)))
    doubt = PositionUncertainty((0.08,) * 6, (0.08,) * 6)
    before = await made.arm.encoder_counts()
    with pytest.raises(MotionRefusedError, match="post"):
        await pass_index(made.cell, IndexTurn(0, 0.2, before, likely, doubt), 0.03)
    assert made.arm.moves == []
    await pass_index(made.cell, IndexTurn(0, -0.06, before, likely, doubt), 0.03)
    assert made.arm.moves == ["jog 0", "jog 0"]
