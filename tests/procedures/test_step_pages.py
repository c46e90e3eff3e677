"""Pages of steps: never an input of a step, and meters that say beforehand what the procedure says afterwards."""

import math

import numpy as np
import pytest
from pydantic_core import to_jsonable_python

from cellcal.calibration.arm.kinematics import load_model
from cellcal.calibration.geometry import Pose, exp_rotation, quaternion_from_rotation
from cellcal.drivers.interfaces import Answer, Instruction
from cellcal.procedures.catalogue import definition_named
from cellcal.procedures.cell import Cell
from cellcal.procedures.instruction_page import StepKind, page_of, with_page
from cellcal.procedures.motion.plan_words import PER_POSE_S, PlanTour, plan_words
from cellcal.procedures.motion.speed_limit import TimedMotion
from cellcal.procedures.questions import ask_confirmation
from cellcal.procedures.run import DeclinedError, Run
from cellcal.procedures.six_point_tcp import SixPointTcp
from cellcal.procedures.steps.meters import frame_meter, known_points_meter, move_meter, read_meter, tip_meter
from cellcal.procedures.steps.pages import (
    PlannedMoves,
    axis_levers,
    frame_displacement,
    joint_displacement,
    plan_page,
    point_states,
    straight_ways,
)
from cellcal.procedures.teaching.tcp_touches import AGAIN_RAD, WORST_GAIN, judge_touches
from cellcal.service.cell_process.recording_check import SettleDetector
from tests.procedures.ideal_devices import IdealArm, ScriptedTechnician
from tests.procedures.memory_ledgers import MemoryLedger
from tests.procedures.procedure_scenes import recovery_scene, scene_for

RULES = SixPointTcp(tool_number=1).touch_rules
WORDS = Instruction("go", "Go?")


def pose_turned_by(axis: np.ndarray, degrees: float) -> Pose:
    unit = np.array(axis) / np.linalg.norm(axis)
    w, x, y, z = quaternion_from_rotation(exp_rotation(unit * math.radians(degrees)))
    return Pose((0.8, 0.1, 0.6), (float(w), float(x), float(y), float(z)))


def meter_of(touches: list[Pose]) -> dict[str, object]:
    return tip_meter(
        touches,
        sigma_m=RULES.sigma_m,
        turns_rad=(RULES.min_turn_rad, AGAIN_RAD),
        worst_gain=WORST_GAIN,
        limit_m=RULES.tip_u_m,
        arm_sigma_m=RULES.arm_sigma_m,
    )


def test_a_page_is_json_and_grows_without_losing_what_it_had() -> None:
    shown = with_page(with_page(WORDS, "teach", points=["a"]), "capture", at=Pose((1.0, 2.0, 3.0)))
    assert (shown.page.kind, shown.plain_instruction) == ("capture", WORDS)
    assert shown.page.data == to_jsonable_python(dict(shown.page.data))
    assert set(shown.page.data) == {"points", "at"}
    assert page_of(WORDS).kind == "ask"


def test_a_plan_says_how_long_on_its_page_what_it_says_in_words() -> None:
    tour = PlanTour(stops=9, paced=TimedMotion(travel_rad=6.0, moving_s=300.0, fastest_rad_s=0.02))
    instruction = Instruction("accept_plan", plan_words("the robot", tour, ()))
    moves = PlannedMoves(straight_ways([(0.1, 0.2), (0.3, 0.4)]), 0.02, ("joint_limits",), ())
    plan_data = plan_page(instruction, tour, moves).page.data["plan"]
    assert plan_data["duration_s"] == 300.0 + 9 * PER_POSE_S
    assert f"about {plan_data['duration_s'] / 60.0:.0f} min" in instruction.text
    assert [pose["joints_rad"] for pose in plan_data["poses"]] == [[0.1, 0.2], [0.3, 0.4]]


async def test_a_page_is_no_input_of_a_step_and_an_older_run_goes_on_with_it() -> None:
    cell, plain, drawn = Cell("test", IdealArm(), ScriptedTechnician()), MemoryLedger(), MemoryLedger()
    await Run(cell, plain).step("ask", ask_confirmation, WORDS)
    await Run(cell, drawn).step("ask", ask_confirmation, with_page(WORDS, "approve", plan={"poses": []}))
    assert drawn.facts == plain.facts
    resumed = Run(cell, MemoryLedger(), plain.past())
    assert (await resumed.step("ask", ask_confirmation, with_page(WORDS, "teach"))).value == "yes"


async def test_a_recovery_first_asks_for_newer_counts_and_tells_what_a_mark_by_eye_is_worth() -> None:
    made, instructions = await recovery_scene(), list[Instruction]()
    made.technician.refuses = {"saved_counts"}
    answered, moves = made.cell.operator.confirm, list(made.arm.moves)

    async def note_instruction(instruction: Instruction) -> Answer:
        instructions.append(instruction)
        return await answered(instruction)

    made.cell.operator.confirm = note_instruction  # type: ignore[method-assign]
    with pytest.raises(DeclinedError, match="newer counts"):
        await definition_named("mastering_recovery").procedure(Run(made.cell, MemoryLedger()), made.spec)
    assert [each.key for each in instructions] == ["saved_counts"]
    levers = page_of(instructions[0]).data["axes"]
    assert [lever["name"] for lever in levers] == [f"J{k}" for k in range(1, 7)]
    assert max(lever["tenth_degree_m"] for lever in levers) > 1e-3
    assert made.arm.moves == moves


@pytest.mark.parametrize(
    ("name", "kinds"),
    [
        ("six_point_tcp", ["ask", *["teach"] * 7, "review"]),
        ("three_point_frame", ["ask", *["teach"] * 3, "review"]),
        ("frame_offset", ["ask", *["teach"] * 4, "review"]),
        ("base_to_base", ["ask", "review"]),
    ],
)
async def test_a_procedure_shows_kinds_of_pages_with_their_data(name: str, kinds: list[StepKind]) -> None:
    made = await scene_for(name)
    instructions: list[Instruction] = []
    answered = made.cell.operator.confirm

    async def note_instruction(instruction: Instruction) -> Answer:
        instructions.append(instruction)
        return await answered(instruction)

    made.cell.operator.confirm = note_instruction  # type: ignore[method-assign]
    await definition_named(name).procedure(Run(made.cell, MemoryLedger()), made.spec)
    pages = [page_of(instruction) for instruction in instructions]
    assert list(dict.fromkeys(page.kind for page in pages)) == list(dict.fromkeys(kinds))
    review = pages[-1].data["review"]
    assert review["characteristics"]
    for page in pages:
        assert to_jsonable_python(dict(page.data)) == page.data
        if page.kind == "teach":
            assert [point["state"] for point in page.data["points"]].count("now") <= 1


def test_the_meter_of_a_tip_refuses_exactly_what_the_procedure_would_have_taught_again() -> None:
    rng = np.random.default_rng(5)
    outcomes = set()
    for _ in range(120):
        touches = [
            pose_turned_by(rng.normal(size=3), float(rng.choice([4.0, 15.0, 30.0, 60.0])))
            for _ in range(int(rng.integers(1, 5)))
        ]
        here = pose_turned_by(rng.normal(size=3), float(rng.choice([4.0, 15.0, 30.0, 60.0])))
        reading = read_meter(to_jsonable_python(meter_of(touches)), here)
        judged = judge_touches(RULES, (*touches, here), ())
        of_attitude = judged.do == "anew" and "contradict" not in judged.why
        assert bool(reading.refusal) == of_attitude
        outcomes.add(reading.refusal)
    assert outcomes == {"", "tcp.spread_low", "tcp.one_axis"}


@pytest.mark.parametrize(
    ("degrees", "refusal"), [(5.0, "tcp.spread_low"), (25.0, ""), (45.0, ""), (90.0, "")]
)
def test_five_degrees_are_no_attitude_of_their_own(degrees: float, refusal: str) -> None:
    first = pose_turned_by(np.array([0.0, 0.0, 1.0]), 0.0)
    reading = read_meter(
        to_jsonable_python(meter_of([first])), pose_turned_by(np.array([1.0, 0.0, 0.0]), degrees)
    )
    assert reading.refusal == refusal
    assert reading.figures[0].value == pytest.approx(math.radians(degrees), abs=1e-9)


def test_rolls_of_the_wrist_alone_never_pass() -> None:
    up = np.array([0.0, 0.0, 1.0])
    rolls = [pose_turned_by(up, angle) for angle in (0.0, 60.0)]
    for angle in (-60.0, 120.0, 180.0):
        assert (
            read_meter(to_jsonable_python(meter_of(rolls)), pose_turned_by(up, angle)).refusal
            == "tcp.one_axis"
        )


def test_a_move_that_turns_or_is_short_is_distinguished() -> None:
    start = Pose((0.5, 0.0, 0.5))
    meter = to_jsonable_python(move_meter(start, 0.3))
    assert read_meter(meter, Pose((0.6, 0.0, 0.5))).refusal == "tool.move_short"
    assert read_meter(meter, Pose((0.9, 0.0, 0.5))).refusal == ""
    w, x, y, z = (float(v) for v in quaternion_from_rotation(exp_rotation(np.array([0.01, 0.0, 0.0]))))
    assert read_meter(meter, Pose((0.9, 0.0, 0.5), (w, x, y, z))).refusal == "tool.turned"


@pytest.mark.parametrize(
    ("role", "place", "refusal", "warning"),
    [
        ("on_x", (0.01, 0.0, 0.0), "frame.points_close", ""),
        ("on_x", (0.1, 0.0, 0.0), "", "frame.short_base"),
        ("on_x", (0.4, 0.0, 0.0), "", ""),
        ("in_plane", (0.3, 0.01, 0.0), "frame.collinear", ""),
        ("in_plane", (0.3, 0.06, 0.0), "", "frame.opening_low"),
        ("in_plane", (0.0, 0.3, 0.0), "", ""),
        ("above", (0.1, 0.1, -0.05), "frame.left_handed", ""),
        ("above", (0.1, 0.1, 0.05), "", ""),
    ],
)
def test_points_of_a_frame_are_refused_before_they_are_recorded(
    role: str, place: tuple[float, float, float], refusal: str, warning: str
) -> None:
    recorded = {"origin": [(0.0, 0.0, 0.0)], "on_x": [], "in_plane": []}
    if role != "on_x":
        recorded["on_x"] = [(0.4, 0.0, 0.0)]
    if role == "above":
        recorded["in_plane"] = [(0.0, 0.3, 0.0)]
    meter = frame_meter(role, recorded, tip_in_flange_m=(0.0, 0.0, 0.0), sigma_m=5e-4, limits=(2e-3, 0.01))
    reading = read_meter(to_jsonable_python(meter), Pose(place))
    assert (reading.refusal, reading.warning) == (refusal, warning)


@pytest.mark.parametrize(("beside_m", "warning"), [(0.001, ""), (0.02, "frame.points_disagree")])
def test_another_point_than_is_asked_for_is_warned_of(beside_m: float, warning: str) -> None:
    taught_points = [(0.0, 0.0, 0.0), (0.4, 0.0, 0.0)]
    meter = known_points_meter(1, taught_points, [(1.0, 0.2, 0.3)], (0.0, 0.0, 0.0))
    reading = read_meter(to_jsonable_python(meter), Pose((1.4 + beside_m, 0.2, 0.3)))
    assert (reading.refusal, reading.warning) == ("", warning)
    (gap,) = reading.figures
    assert gap.value == pytest.approx(beside_m)


def test_a_tenth_of_a_degree_is_its_lever() -> None:
    model, posture = load_model("fanuc_m6ib"), (0.0, 0.3, 0.2, 0.1, -1.2, 0.4)
    levers = axis_levers(model, posture)
    x, y, _ = model.base_flange(np.array([posture]))[0, :3, 3]
    assert levers[0]["tenth_degree_m"] == pytest.approx(math.hypot(x, y) * math.radians(0.1), rel=1e-5)
    assert levers[5]["tenth_degree_m"] == pytest.approx(0.0, abs=1e-9)  # the flange's middle is on the axis
    all_of_one = joint_displacement(model, [posture], (math.radians(0.1), *[0.0] * 5), (0.0, 0.0, 0.0))
    assert all_of_one["most_m"] == pytest.approx(levers[0]["tenth_degree_m"], rel=1e-6)


def test_a_frame_displaces_no_point_by_more_than_stated() -> None:
    rng = np.random.default_rng(2)
    for _ in range(50):
        before = pose_turned_by(rng.normal(size=3), float(rng.uniform(0, 170)))
        after = before @ Pose(
            tuple(rng.normal(size=3) * 0.01), pose_turned_by(rng.normal(size=3), 3.0).quaternion
        )
        most = float(frame_displacement(before, after)["most_m"])
        points = rng.normal(size=(200, 3))
        points *= 0.5 / np.linalg.norm(points, axis=1, keepdims=True)
        moved = [
            pose.rotation_matrix() @ points.T + np.array(pose.position_m)[:, None] for pose in (before, after)
        ]
        assert np.linalg.norm(moved[1] - moved[0], axis=0).max() <= most + 1e-12


def test_points_are_counted_from_what_is_asked_for() -> None:
    assert point_states(("a", "b", "c"), 1) == [("a", "recorded"), ("b", "now"), ("c", "to_do")]


@pytest.mark.parametrize(
    ("length_m", "settles"),
    [
        (lambda t: 1.0, True),
        (lambda t: 1.0 + 0.003 * math.sin(2 * math.pi * 2.0 * t), False),
        (lambda t: 1.0 + 0.010 * math.sin(2 * math.pi * 0.4 * t), False),  # a long wire, swinging slowly
        (lambda t: 1.0 + 0.02 * t, False),  # the arm creeps
    ],
)
def test_a_wire_rests_only_after_a_second_of_quiet(length_m: object, settles: bool) -> None:
    settle, rng = SettleDetector(4e-4), np.random.default_rng(1)
    rested = []
    for k in range(60):
        now = 0.1 * k
        settle.add_reading(now, length_m(now) + float(rng.normal()) * 1e-4)  # type: ignore[operator]
        rested.append(settle.is_settled(now))
    assert not any(rested[:10])
    assert rested[-1] is settles
    if not settles:
        assert sum(rested) <= 3
    assert not settle.is_settled(7.0)  # nothing was heard for a second


def test_a_wire_that_was_silent_is_looked_at_anew() -> None:
    settle = SettleDetector(4e-4)
    for k in range(30):
        settle.add_reading(0.1 * k, 1.0)
    assert settle.is_settled(2.9)
    settle.add_reading(5.0, 1.2)
    assert not settle.is_settled(5.0)
