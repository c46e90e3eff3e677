"""What if a point were left out: every fit of points, against a computation of its own, and against the journal."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import pytest
from scipy.optimize import least_squares

from cellcal.calibration.errors import CellError
from cellcal.calibration.geometry import Pose, homogeneous_matrix
from cellcal.calibration.points.alignment import WirePoints
from cellcal.procedures.accuracy_limits import FrameLimits
from cellcal.procedures.base_to_base import BaseToBaseSpec
from cellcal.procedures.catalogue import CATALOGUE
from cellcal.procedures.refit import LEFT_OUT, Refit, RefitResult, TooFewPointsError, Use
from cellcal.procedures.run import Run
from cellcal.procedures.run_history import Finding
from cellcal.procedures.simulation_cell import SimulationCell
from cellcal.procedures.survey.survey import SurveyRules
from tests.procedures.ideal_devices import ZERO
from tests.procedures.memory_ledgers import MemoryLedger
from tests.procedures.procedure_scenes import (
    BASE_FIXTURE,
    FIXTURE_POINTS,
    FLANGE_TOOL,
    FRAME,
    OFFSET_POINTS,
    OTHER_BASE_FIXTURE,
    TIP,
    ProcedureScene,
    alignment_of,
    alignment_scene,
    healthy_scene,
    hook_scene,
    moved_workpiece_scene,
    record_of,
    recording_scene,
    tool_touch_scene,
    user_frame_scene,
)
from tests.unit.helpers.tag_paths import FIXTURE_BASE, OFFSETS_DEG, robot_tags, two_paths

SOME = SurveyRules(min_captures=7, max_captures=8, candidates=24, samples=1)
SLIP = (0.0004, -0.0003, 0.0005)  # of one point in its run [m]: too little for the run to say no


@dataclass(frozen=True)
class FinishedRun:
    """A finished run, and its fit."""

    findings: tuple[Finding, ...]
    refit: Refit

    def finding_of(self, step: str) -> object:
        return next(finding.value for finding in self.findings if finding.step == step)

    def index_of(self, step: str) -> int:
        return next(k for k, point in enumerate(self.refit.points) if point.step == step)

    def refit_without(self, *steps: str) -> RefitResult:
        left_out = {self.index_of(step) for step in steps}
        return self.refit.fit_again(
            tuple(used and k not in left_out for k, used in enumerate(self.recorded_use))
        )

    def swapped_use(self, step: str) -> Use:
        return tuple(used != (k == self.index_of(step)) for k, used in enumerate(self.recorded_use))

    @property
    def recorded_use(self) -> Use:
        return self.refit.recorded_use


async def run_to_end(made: ProcedureScene, name: str) -> FinishedRun:
    """Run a procedure to its end; return its points."""
    ledger, entry = MemoryLedger(), CATALOGUE[name]
    await entry.procedure(Run(made.cell, ledger), made.spec)
    findings = ledger.past().findings
    assert entry.refit is not None
    refit = entry.refit(made.spec, findings)
    assert refit is not None
    return FinishedRun(findings, refit)


def slip_at_touch(made: ProcedureScene, key: str, slip: Sequence[float] = SLIP) -> ProcedureScene:
    """Let the hand slip at one touch."""
    place = made.technician.does[key]

    def touch_beside() -> None:
        place()
        taught = made.arm.taught
        assert taught is not None
        made.arm.taught = Pose.from_matrix(
            homogeneous_matrix(taught.rotation_matrix(), np.array(taught.position_m) + slip)
        )

    made.technician.does[key] = touch_beside
    return made


def place_of(found: RefitResult, first: int = 0) -> np.ndarray:
    return np.array([value.value for value in found.values[first : first + 3]])


def outlier_indices(found: RefitResult) -> list[int]:
    return [k for k, miss in enumerate(found.misses) if miss.outlier]


def pointer_tips(done: FinishedRun, steps: Sequence[str]) -> np.ndarray:
    """Return where a pointer's tip was at these steps, (n, 3) [m]."""
    poses = [Pose(**found["base_flange"]) for found in map(done.finding_of, steps) if isinstance(found, dict)]
    return np.array([pose.rotation_matrix() @ np.array(TIP) + np.array(pose.position_m) for pose in poses])


def fit_frame(inner: np.ndarray, outer: np.ndarray) -> np.ndarray:
    """Return the frame that carries points onto others, by singular values (4, 4)."""
    middle = inner.mean(axis=0), outer.mean(axis=0)
    u, _, vt = np.linalg.svd((inner - middle[0]).T @ (outer - middle[1]))
    rotation = vt.T @ np.diag([1.0, 1.0, np.linalg.det(vt.T @ u.T)]) @ u.T
    return homogeneous_matrix(rotation, middle[1] - rotation @ middle[0])


@pytest.mark.parametrize(
    ("more", "slipped"),
    [
        ({}, "touch in another attitude 2"),
        ({"method": "four_point"}, "touch in another attitude 4"),
        ({"method": "three_plus_orientation"}, "touch in another attitude 4"),
    ],
)
async def test_a_tip_without_a_touch_is_that_of_the_others(more: dict[str, object], slipped: str) -> None:
    made = tool_touch_scene(min_touches=6, max_touches=6, rms_limit_m=0.002, touch_sigma_m=0.0004, **more)
    run = await run_to_end(slip_at_touch(made, "touch_5"), "six_point_tcp")
    less = run.refit_without(slipped)
    steps = [point.step for point in run.refit.points if point.used and point.step != slipped]
    poses = [Pose(**run.finding_of(step)["base_flange"]) for step in steps]  # type: ignore[index]
    rows = np.vstack([np.hstack([pose.rotation_matrix(), -np.eye(3)]) for pose in poses])
    tip = np.linalg.lstsq(rows, -np.concatenate([pose.position_m for pose in poses]), rcond=None)[0][:3]
    assert place_of(less) == pytest.approx(tip, abs=1e-9)
    assert tip == pytest.approx(TIP, abs=1e-9)
    whole = run.refit.fit_again(run.recorded_use)
    assert np.linalg.norm(place_of(whole) - TIP) > 5e-5
    recorded = run.finding_of("locate the tip")
    assert isinstance(recorded, dict)
    assert place_of(whole) == pytest.approx(recorded["tip"]["tip_in_flange_m"], abs=1e-12)
    assert whole.u_m == pytest.approx(recorded["tip"]["tip_u_in_space_m"])


async def test_a_touch_taught_again_can_be_put_back() -> None:
    made = tool_touch_scene(min_touches=5, rms_limit_m=0.002)
    place, count = made.technician.does["touch_4"], iter(range(10))

    def slip_once() -> None:
        place()
        if next(count) == 0:
            assert made.arm.taught is not None
            x, y, z = made.arm.taught.position_m
            made.arm.taught = replace(made.arm.taught, position_m=(x + 0.004, y, z))

    made.technician.does |= {"touch_4": slip_once, "touch_anew_4": place}
    run = await run_to_end(made, "six_point_tcp")
    (aside,) = (point for point in run.refit.points if not point.used)
    assert "contradict" in aside.reason
    assert run.index_of(aside.step) in outlier_indices(run.refit.fit_again(run.recorded_use))
    both = run.refit.fit_again(run.swapped_use(aside.step))
    assert np.linalg.norm(place_of(both) - TIP) > 2e-4
    assert both.u_m > 10.0 * run.refit.fit_again(run.recorded_use).u_m


async def test_a_frame_without_a_point_is_fitted_to_the_others() -> None:
    made = user_frame_scene()
    made.spec = replace(made.spec, more_on_x=2, more_in_plane=2)
    attitude = np.diag([1.0, -1.0, -1.0])
    shift = iter([(0.3, 0.0, 0.0), (0.2, 0.0, 0.0), (0.35, -0.2, 0.0), (0.3, 0.25, 0.0)])

    def touch_point() -> None:
        tip = FRAME.rotation_matrix() @ np.array(next(shift)) + np.array(FRAME.position_m)
        made.arm.taught = Pose.from_matrix(homogeneous_matrix(attitude, tip - attitude @ np.array(TIP)))

    made.technician.does |= {"touch_more_on_x": touch_point, "touch_more_on_xy": touch_point}
    slip_at_touch(made, "touch_on_x", (0.0, 0.0, 0.0009))
    run = await run_to_end(made, "three_point_frame")
    less = run.refit_without("touch a point on x")
    assert place_of(less) == pytest.approx(FRAME.position_m, abs=1e-9)
    whole = run.refit.fit_again(run.recorded_use)
    recorded = run.finding_of("construct the frame")
    assert isinstance(recorded, dict)
    assert place_of(whole) == pytest.approx(recorded["base_frame"]["position_m"], abs=1e-12)
    assert whole.values[3].value == pytest.approx(0.0, abs=1e-9)
    assert less.values[3].value > 1e-4
    steps = [point.step for point in run.refit.points]
    touched, free = pointer_tips(run, steps), [0, 1, 2, 1, 1, 2, 2]

    def frame_residuals(x: np.ndarray) -> np.ndarray:
        turn = np.cross(np.eye(3), -x[3:]) + np.eye(3)
        turn = np.linalg.qr(FRAME.rotation_matrix() @ turn)[0]
        turn = turn * np.sign(np.sum(turn * FRAME.rotation_matrix(), axis=0))
        local = (touched - x[:3]) @ turn
        return np.concatenate([row[k:] for row, k in zip(local, free, strict=True)])

    best = least_squares(frame_residuals, [*FRAME.position_m, 0, 0, 0], xtol=1e-15, ftol=1e-15, gtol=1e-15)
    assert place_of(whole) == pytest.approx(best.x[:3], abs=1e-7)
    with pytest.raises(CellError, match="cannot do without"):
        run.refit_without("touch the origin")


async def test_three_points_have_none_to_spare() -> None:
    run = await run_to_end(user_frame_scene(), "three_point_frame")
    for point in run.refit.points:
        with pytest.raises(TooFewPointsError, match="2 points are too few"):
            run.refit_without(point.step)
    assert run.refit.points[0].step == "touch the origin"


async def test_a_moved_frame_without_a_point_is_that_of_the_others() -> None:
    run = await run_to_end(slip_at_touch(moved_workpiece_scene(), "touch_point_3"), "frame_offset")
    points, touched = np.array(OFFSET_POINTS), pointer_tips(run, [point.step for point in run.refit.points])
    for left_out in range(4):
        keep = [k for k in range(4) if k != left_out]
        less = run.refit_without(f"touch point {left_out + 1}")
        assert place_of(less) == pytest.approx(fit_frame(points[keep], touched[keep])[:3, 3], abs=1e-9)
    whole, recorded = run.refit.fit_again(run.recorded_use), run.finding_of("find the offset")
    assert isinstance(recorded, dict)
    assert place_of(whole) == pytest.approx(recorded["base_frame_new"]["position_m"], abs=1e-12)
    assert max(range(4), key=lambda k: run.refit_without("touch point 3").misses[k].size_m) == 2
    with pytest.raises(TooFewPointsError):
        run.refit_without("touch point 1", "touch point 2")


def knock_wire(made: ProcedureScene, *readings: int) -> ProcedureScene:
    """Knock the wire during a capture: the run takes that one again."""
    made.wire.kink_m = dict.fromkeys(readings, 0.02)
    return made


@pytest.mark.parametrize("what", ["fixture_alignment", "end_effector_points"])
async def test_a_survey_without_a_length_is_that_of_the_others(what: str) -> None:
    fixture = what == "fixture_alignment"
    run = await run_to_end(
        knock_wire(alignment_scene(rules=SOME) if fixture else hook_scene(rules=SOME), 3), what
    )
    truth = np.array((BASE_FIXTURE if fixture else FLANGE_TOOL).position_m)
    whole = run.refit.fit_again(run.recorded_use)
    recorded = run.finding_of("place the fixture" if fixture else "locate the tool")
    assert isinstance(recorded, dict)
    journalled = recorded["alignment"]["base_fixture"] if fixture else recorded["flange_tool"]
    assert place_of(whole) == pytest.approx(journalled["position_m"], abs=1e-10)
    assert whole.values[3].value == pytest.approx(0.0, abs=1e-9)
    (aside,) = (point for point in run.refit.points if not point.used)
    assert run.index_of(aside.step) in outlier_indices(whole)
    assert whole.misses[run.index_of(aside.step)].size_m == pytest.approx(0.02, abs=0.004)
    put_back = run.refit.fit_again(run.swapped_use(aside.step))
    assert np.linalg.norm(place_of(put_back) - truth) > 2.0 * np.linalg.norm(place_of(whole) - truth)
    assert run.refit.fit_again(run.recorded_use) == whole
    with pytest.raises(CellError, match="too few"):
        run.refit_without(*(f"capture {k}" for k in (1, 2, 3, 5, 6)))


async def test_a_length_left_out_of_a_spot_that_the_wire_has_left_can_be_put_back() -> None:
    rules = SurveyRules(min_captures=6, max_captures=8, candidates=24, samples=1)
    made = alignment_scene(FIXTURE_POINTS, limits=FrameLimits(0.0005, 0.0009), rules=rules)
    made.cell = replace(made.cell, record=await record_of(healthy_scene()))
    made.wire.kink_m = {2: 0.0015}  # little enough for the lengths of its own spot
    run = await run_to_end(made, "fixture_alignment")
    (aside,) = (point for point in run.refit.points if not point.used)
    assert (aside.step, aside.reason) == ("capture 3", LEFT_OUT)
    whole, recorded = run.refit.fit_again(run.recorded_use), run.finding_of("place the fixture")
    assert isinstance(recorded, dict)
    assert place_of(whole) == pytest.approx(recorded["alignment"]["base_fixture"]["position_m"], abs=1e-10)
    assert np.linalg.norm(place_of(whole) - BASE_FIXTURE.position_m) < whole.u_m
    put_back = run.refit.fit_again(run.swapped_use("capture 3"))
    assert whole.misses[run.index_of("capture 3")].outlier
    assert put_back.u_m != whole.u_m


async def test_a_record_without_a_length_is_that_of_the_others() -> None:
    made = knock_wire(recording_scene(), 12, 13)  # two readings a capture: the seventh
    run = await run_to_end(made, "mastering_record")
    whole, recorded = run.refit.fit_again(run.recorded_use), run.finding_of("fit the wire 2")
    assert isinstance(recorded, dict)
    assert place_of(whole) == pytest.approx(recorded["anchor_in_base_m"], abs=1e-12)
    assert place_of(whole, 3) == pytest.approx(recorded["hook_in_flange_m"], abs=1e-12)
    (aside,) = (point for point in run.refit.points if not point.used)
    assert aside.step == "capture 7"
    assert outlier_indices(whole) == [6]
    assert whole.misses[6].size_m == pytest.approx(0.02, abs=0.002)
    put_back = run.refit.fit_again(run.swapped_use("capture 7"))
    hook = np.array(made.wire.hook_in_flange_m)
    assert np.linalg.norm(place_of(put_back, 3) - hook) > np.linalg.norm(place_of(whole, 3) - hook)
    with pytest.raises(TooFewPointsError):
        run.refit_without(*(f"capture {k}" for k in range(8, 21)))


def points_from_wire(base_fixture: Pose, slip: Sequence[float], number: int) -> WirePoints:
    """Return alignment points as a wire of its own found them, all alike; one is off."""
    drawn = np.array(FIXTURE_POINTS)
    found = drawn @ base_fixture.rotation_matrix().T + np.array(base_fixture.position_m)
    found[number] += slip
    rows = np.eye(3 * len(found) + 1) * 2e-5**2
    return WirePoints(
        wire=repr(base_fixture),
        found_m=tuple((float(x), float(y), float(z)) for x, y, z in found),
        of_wire=(1.0,),
        covariance=tuple(tuple(float(v) for v in row) for row in rows),
        believed=(1.0,),
        sigma=(1e-4,),
        sigma_seat_m=2e-5,
        sigma_drawing_m=0.0,
    )


async def test_a_base_without_an_alignment_point_is_that_of_the_others() -> None:
    made = healthy_scene(BaseToBaseSpec("table"))
    slip = (0.00004, -0.00003, 0.00002)
    mine = alignment_of(
        "F-1", BASE_FIXTURE, counts_at_zero=ZERO, points=points_from_wire(BASE_FIXTURE, slip, 2)
    )
    other = alignment_of(
        "F-2", OTHER_BASE_FIXTURE, points=points_from_wire(OTHER_BASE_FIXTURE, (0.0, 0.0, 0.0), 0)
    )
    made.cell = replace(made.cell, alignments=(mine, other))
    run = await run_to_end(made, "base_to_base")
    truth = (BASE_FIXTURE @ OTHER_BASE_FIXTURE.inverse()).position_m
    less, whole = run.refit_without("alignment point 3"), run.refit.fit_again(run.recorded_use)
    assert place_of(less) == pytest.approx(truth, abs=1e-9)
    assert less.misses[2].size_m == pytest.approx(np.linalg.norm(slip), rel=1e-3)
    recorded = run.finding_of("chain the bases")
    assert isinstance(recorded, dict)
    base = recorded["bases"][0]["pose"]["other_base_base"]
    assert place_of(whole) == pytest.approx(base["position_m"], abs=1e-12)
    assert mine.points is not None
    drawn, keep = np.array(FIXTURE_POINTS), [0, 2, 3]
    fitted_frame = fit_frame(drawn[keep], np.array(mine.points.found_m)[keep])
    through = fitted_frame @ np.linalg.inv(OTHER_BASE_FIXTURE.to_matrix())
    assert place_of(run.refit_without("alignment point 2")) == pytest.approx(through[:3, 3], abs=1e-9)
    with pytest.raises(TooFewPointsError):
        run.refit_without("alignment point 1", "alignment point 2")


async def test_bases_that_were_chained_have_no_points() -> None:
    made = healthy_scene(BaseToBaseSpec("table"))
    mine = alignment_of("F-1", BASE_FIXTURE, counts_at_zero=ZERO)
    made.cell = replace(made.cell, alignments=(mine, alignment_of("F-2", OTHER_BASE_FIXTURE)))
    ledger, entry = MemoryLedger(), CATALOGUE["base_to_base"]
    await entry.procedure(Run(made.cell, ledger), made.spec)
    assert entry.refit is not None
    assert entry.refit(made.spec, ledger.past().findings) is None


async def test_a_simulated_base_without_a_tag_is_that_of_the_others() -> None:
    one, other = two_paths(FIXTURE_BASE, 9)
    run = await run_to_end(healthy_scene(SimulationCell("base", one, other)), "simulation_cell")
    whole, recorded = run.refit.fit_again(run.recorded_use), run.finding_of("place the tags")
    assert isinstance(recorded, dict)
    assert place_of(whole) == pytest.approx(recorded["outer_inner"]["position_m"], abs=1e-12)
    for left_out in (0, 4):
        keep = [k for k in range(9) if k != left_out]
        expected = fit_frame(one.to_positions()[keep], other.to_positions()[keep])
        assert place_of(run.refit_without(f"tag P{left_out + 1}")) == pytest.approx(expected[:3, 3], abs=1e-9)
    with pytest.raises(TooFewPointsError):
        run.refit_without(*(f"tag P{k}" for k in range(1, 8)))


async def test_a_simulated_robot_without_a_tag_keeps_its_zeros() -> None:
    tags = robot_tags(24)
    positions = list(tags.device.positions_m)
    x, y, z = positions[5]
    positions[5] = (x + 0.03, y, z)
    spoilt = replace(tags.device, positions_m=tuple(positions))
    run = await run_to_end(
        healthy_scene(SimulationCell("robot", tags.robot, spoilt, model="fanuc_m6ib")), "simulation_cell"
    )
    whole, recorded = run.refit.fit_again(run.recorded_use), run.finding_of("calibrate the robot")
    assert isinstance(recorded, dict)
    journalled = {each["name"]: each["value"] for each in recorded["found"]["values"]}
    assert {value.name: value.value for value in whole.values} == pytest.approx(journalled, abs=1e-9)
    assert outlier_indices(whole) == [5]
    assert whole.misses[5].size_m == pytest.approx(0.03, rel=0.1)
    less = run.refit_without("tag P6")
    zeros = np.degrees([value.value for value in less.values])  # the first and the last axis are not told
    assert zeros[1:5] == pytest.approx(OFFSETS_DEG[1:5], abs=0.05)
    assert less.u_m > 0.0


WHAT_FITS = (
    "mastering_record", "six_point_tcp", "three_point_frame", "frame_offset", "end_effector_points",
    "fixture_alignment", "base_to_base", "simulation_cell",
)  # fmt: skip


def test_every_fit_of_points_can_be_asked_what_if() -> None:
    assert {name for name, entry in CATALOGUE.items() if entry.refit is not None} >= set(WHAT_FITS)
