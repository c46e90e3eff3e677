"""The drift check, a few minutes on a schedule: whether a robot still is as it was when known to be healthy.

The first run takes the reference readings. Every later run measures at the same poses and tells warmth from a
knocked tool, a lost zero and a moved device, says how sure that is, and what to run next.
"""

import math
from dataclasses import dataclass, field
from typing import Annotated

import numpy as np
from pydantic import Field
from pydantic_core import to_jsonable_python

from cellcal.calibration.drift.causes import (
    DEVICE,
    NOTHING,
    OTHER,
    TOOL,
    WARMTH,
    Cause,
    DriftFinding,
    causes,
    explain,
    telling_pose,
)
from cellcal.calibration.drift.reference import DriftReference
from cellcal.drivers.interfaces import Instruction, Joints
from cellcal.procedures.arm.arm_bench import (
    READY,
    ArmCapture,
    Bench,
    Method,
    agree,
    bench_before,
    noise_m,
    read_bench,
    same_robot,
    station_of,
    values_of,
)
from cellcal.procedures.arm.arm_series import Visits
from cellcal.procedures.arm.drift_plan import (
    ASSUMED_DISTANCE_M,
    REPEAT_M,
    DriftPlan,
    DriftRules,
    noise_before_m,
    plan_check,
    plan_reference,
)
from cellcal.procedures.canonical import sha256_of
from cellcal.procedures.cell import Cell
from cellcal.procedures.entry import Entry, Keepsake, Phase
from cellcal.procedures.forecast import ANSWER_S, SAMPLE_S, Forecast, Knowledge, PlannedPose, Prediction
from cellcal.procedures.motion.plan_words import Tour, plan_words
from cellcal.procedures.questions import accept, ask
from cellcal.procedures.run import RefusalError, Run
from cellcal.procedures.steps.pages import ARM_CHECKS, WIRE_CHECKS, Moves, plan_page
from cellcal.procedures.verdict import Characteristic, Verdict, enough, held, judged, stated

NEXT = {
    NOTHING: "nothing: go on working",
    WARMTH: "let the robot reach its working temperature, or cool down, and run drift_check again",
    TOOL: "look at the tool and its mount; then six_point_tcp or end_effector_points, and a new reference",
    DEVICE: "see that the measuring device stands and hangs as it did; then take a new reference (renew)",
    OTHER: "look for a collision or for more than one change; then robot_calibration",
    "joint": "look at that axis; mastering_recovery if its encoder lost its turns, else robot_calibration",
}


@dataclass(frozen=True, slots=True)
class DriftCheck:
    """With what to measure, and how much the readings may have changed."""

    method: Method = "wire"
    limit_m: Annotated[float, Field(gt=0, le=0.1)] = 0.0003  # of a reading
    renew: bool = False  # take a new reference; only of a robot that is known to be healthy
    rules: DriftRules = field(default_factory=DriftRules)


@dataclass(frozen=True, slots=True)
class Seen:
    """What was measured so far, at which poses of the reference."""

    reference: DriftReference
    poses: tuple[int, ...]
    captures: tuple[ArmCapture, ...]

    def sigma_m(self) -> float:
        """Return the standard deviation [m] of one coordinate of a change: both readings, and the arm coming back."""
        now_m = max(map(noise_m, self.captures))
        return math.hypot(self.reference.sigma_m(REPEAT_M), now_m, REPEAT_M)

    def causes_at(self, bench: Bench, poses: tuple[int, ...]) -> tuple[Cause, ...]:
        """Return how each cause would move the readings at poses of the reference."""
        rows, joints = list(poses), np.array(self.reference.joints_rad)
        places = self.reference.values_m()[rows] if bench.method == "tracker" else None
        return causes(bench.task(), joints[rows], places)


@dataclass(frozen=True, slots=True)
class Look:
    """What the poses measured so far say, and which further one would decide; -1 for none."""

    finding: DriftFinding
    decided: bool
    next_pose: int


@dataclass(frozen=True, slots=True)
class DriftResult:
    """A new reference, or what changed since the old one."""

    reference: DriftReference
    taken_now: bool
    look: Look | None
    measured: tuple[int, ...]  # poses of the reference, from 0
    sigma_m: float
    recommended: str

    @property
    def saving(self) -> str:
        """What stopping as soon as it was decided saved, in words."""
        taken, every = len(self.measured), len(self.reference.poses_rad)
        if taken >= every:
            return f"no saving: all {every} poses of the reference were needed"
        share = 1.0 - taken / every
        return f"{taken} poses; a fixed plan goes to all {every} of the reference: {share * 100:.0f} % saved"


async def drift_check(run: Run, spec: DriftCheck) -> DriftResult:
    """Compare the robot with its reference; where there is none, take it."""
    await run.ensure("the device is ready", ask, READY[spec.method])
    bench = await run.step("read the robot", read_bench, spec.method)
    await run.ensure("the robot kept its position", same_robot, bench.epoch)
    reference = await run.step("look up the reference", stored_reference, bench.serial, spec.method)
    if reference is None or spec.renew:
        return await _take_reference(run, spec, bench)
    _refuse_other(reference, bench)
    return await _compare(run, spec, bench, reference)


async def stored_reference(cell: Cell, serial: str, method: Method) -> DriftReference | None:
    """Return the newest reference of this robot with this device; None where none was taken."""
    found = [one for one in cell.drift_references if (one.robot_serial, one.method) == (serial, method)]
    return found[-1] if found else None


async def _take_reference(run: Run, spec: DriftCheck, bench: Bench) -> DriftResult:
    """Measure at poses that tell the causes apart, twice: a reference must repeat."""
    plan = await run.solve("plan the poses", plan_reference, bench, spec.rules)
    await run.step(
        "accept the plan",
        accept,
        _shown(plan, "take the reference", spec.method, rounds=2),
        sha256_of(to_jsonable_python(plan)),
    )
    visits = Visits(run, bench, plan.pace, spec.rules.samples, bench.joints_rad)
    await visits.rest(plan.way_to_rest_rad)
    for way in plan.ways_rad:
        await visits.visit(way)
    again = tuple([await visits.check("again", k, way) for k, way in enumerate(plan.ways_rad, 1)])
    _refuse_scatter(visits.captures(), again, bench)
    reference = reference_of(bench, plan.ways_rad, visits.captures(), again)
    advice = "run drift_check on a schedule: it compares with this reference"
    every = tuple(range(len(plan.ways_rad)))
    return DriftResult(reference, True, None, every, reference.sigma_m(REPEAT_M), advice)


async def _compare(run: Run, spec: DriftCheck, bench: Bench, reference: DriftReference) -> DriftResult:
    """Measure at a few poses of the reference, and at more as long as they would decide."""
    plan = await run.solve("plan the poses", plan_check, bench, reference, spec.rules)
    await run.step(
        "accept the plan", accept, _shown(plan, "compare", spec.method), sha256_of(to_jsonable_python(plan))
    )
    visits = Visits(run, bench, plan.pace, spec.rules.samples, bench.joints_rad)
    await visits.rest(plan.way_to_rest_rad)
    first = min(spec.rules.first, len(reference.poses_rad))
    measured = list(range(first))
    for way in plan.ways_rad[:first]:
        await visits.visit(way)
    while True:
        number = len(measured) - first + 1
        seen = Seen(reference, tuple(measured), visits.captures())
        look = await run.solve(f"look for changes {number}", look_for_changes, bench, seen, spec.rules)
        if look.next_pose < 0:
            break
        measured.append(look.next_pose)
        await visits.visit(plan.ways_rad[look.next_pose])
    advice = recommendation(look.finding, spec.rules.probability)
    return DriftResult(reference, False, look, tuple(measured), seen.sigma_m(), advice)


def look_for_changes(bench: Bench, seen: Seen, rules: DriftRules) -> Look:
    """Explain the changes so far; where that is not sure, say which pose of the reference would decide."""
    reference, sigma_m = seen.reference, seen.sigma_m()
    changes = values_of(seen.captures) - reference.values_m()[list(seen.poses)]
    taken = seen.causes_at(bench, seen.poses)
    finding = explain(taken, changes, sigma_m)
    left = tuple(k for k in range(len(reference.poses_rad)) if k not in seen.poses)
    decided = finding.decided(rules.probability)
    if decided or not left:
        return Look(finding, decided, -1)
    both = seen.causes_at(bench, (*seen.poses, *left))
    first, second = [suspect.name for suspect in finding.suspects if suspect.name != OTHER][:2]
    return Look(finding, False, left[telling_pose(taken, both, changes, sigma_m, (first, second))])


def reference_of(
    bench: Bench,
    ways_rad: tuple[tuple[Joints, ...], ...],
    first: tuple[ArmCapture, ...],
    again: tuple[ArmCapture, ...],
) -> DriftReference:
    """Return two rounds of captures as a reference."""
    values_of((*first, *again))  # one station
    return DriftReference(
        robot_serial=bench.serial,
        model=bench.model,
        method=bench.method,
        counts_at_zero=bench.counts_at_zero,
        station=station_of(first),
        rest_rad=ways_rad[0][0],
        poses_rad=tuple(way[-1] for way in ways_rad),
        joints_rad=tuple(capture.joints_rad for capture in first),
        first_m=_rows(first),
        again_m=_rows(again),
        noise_m=max(map(noise_m, (*first, *again))),
    )


def _rows(captures: tuple[ArmCapture, ...]) -> tuple[tuple[float, ...], ...]:
    return tuple(tuple(float(v) for v in row) for row in values_of(captures))


def recommendation(finding: DriftFinding, probability: float) -> str:
    """Return what to do next."""
    if not finding.seen:
        return NEXT[NOTHING]
    if not finding.decided(probability):
        names = " and ".join(suspect.name for suspect in finding.suspects[:2])
        return f"not decided between {names}, and no pose of the reference would tell: look at both; {NEXT[OTHER]}"
    name = finding.likeliest.name
    return NEXT.get(name, NEXT["joint"])


def _refuse_other(reference: DriftReference, bench: Bench) -> None:
    same = (reference.robot_serial, reference.model, reference.method) == (
        bench.serial,
        bench.model,
        bench.method,
    )
    if not same or reference.counts_at_zero != bench.counts_at_zero:
        what = "another mastering" if same else "another robot or device"
        raise RefusalError(
            f"the reference is of {what}: readings cannot be compared with it",
            code="procedure.reference_outdated",
            remedy="See that the robot is healthy, for example by accuracy_check; then take a new reference (renew).",
        )


def _refuse_scatter(first: tuple[ArmCapture, ...], again: tuple[ArmCapture, ...], bench: Bench) -> None:
    apart = [
        k + 1 for k, (a, b) in enumerate(zip(first, again, strict=True)) if not agree(a, b, bench.sigma_m)
    ]
    if apart:
        raise RefusalError(
            f"the two rounds differ at pose {', '.join(map(str, apart))}: this is no reference",
            code="procedure.not_repeatable",
            remedy="Let the robot warm up, see that device and wire are firm and free; then start a new run.",
        )


def _shown(plan: DriftPlan, what: str, method: Method, rounds: int = 1) -> Instruction:
    told = f"the robot, to up to {len(plan.ways_rad)} poses, to {what}"
    tour = Tour(rounds * len(plan.ways_rad), plan.paced().times(rounds))
    asked = Instruction("accept_plan", plan_words(told, tour, plan.not_checked))
    checks = WIRE_CHECKS if method == "wire" else ARM_CHECKS
    each = ("go to pose", "capture", "go to again", "capture again") if rounds > 1 else ()
    moves = Moves(
        plan.ways_rad,
        tour.paced.fastest_rad_s,
        checks,
        plan.not_checked,
        planned=dict.fromkeys(each, len(plan.ways_rad)),
    )
    return plan_page(asked, tour, moves)


def _outline(spec: DriftCheck) -> tuple[Phase, ...]:
    poses, again = (spec.rules.poses, spec.rules.poses) if spec.renew else (spec.rules.first, 0)
    return (
        *(
            Phase("read the robot"),
            Phase("look up the reference"),
            Phase("plan the poses"),
            Phase("accept the plan"),
        ),
        *(Phase("go to rest"), Phase("go to pose", poses, adaptive=True)),
        *(Phase("capture", poses, adaptive=True), Phase("go to again", again, adaptive=True)),
        Phase("capture again", again, adaptive=True),
        Phase("look for changes", 0 if spec.renew else 1, adaptive=True),
    )


def _keeps(spec: DriftCheck, result: DriftResult) -> Keepsake | None:
    del spec
    if not result.taken_now:
        return None
    return Keepsake(
        "drift_reference", f"{result.reference.robot_serial} {result.reference.method}", result.reference
    )


def _verdict(spec: DriftCheck, result: DriftResult) -> Verdict:
    told = (
        "A change that is the same at every pose of the reference, such as a turn about the first axis, may hide.",
    )
    if result.look is None:
        repeats = held("both rounds agree", True, "no pose differs by more than six deviations of the device")
        sigma = stated("deviation of a reference reading", result.sigma_m, "m")
        return Verdict(
            (repeats, sigma),
            limits_from="fixed limits of the procedure",
            not_verified=(
                "Whether the robot has drifted: this run took the reference that later ones compare with.",
            ),
            remarks=(result.saving,),
        )
    finding, share = result.look.finding, spec.rules.probability
    change = judged(
        "largest change of a reading", finding.change_max_m, "m", u=result.sigma_m, limit=spec.limit_m
    )
    figures: list[Characteristic] = [change, stated("RMS of the changes", finding.change_rms_m, "m")]
    if finding.seen:
        likely = finding.likeliest
        rule = f"PASS if at least {share:g}, else UNDECIDED: measure at more poses"
        figures.append(
            enough(f"cause: {likely.name}", result.look.decided, rule, found=likely.probability, limit=share)
        )
        figures.append(stated("left by that cause", likely.unexplained_m, "m"))
    return Verdict(
        tuple(figures),
        limits_from="limits of the settings",
        not_verified=told,
        remarks=(f"Next: {result.recommended}.", _suspects_told(finding), result.saving),
    )


def _suspects_told(finding: DriftFinding) -> str:
    words = [f"{one.name} {one.probability:.1%}" for one in finding.suspects if one.probability >= 0.001]
    return f"How probable: {', '.join(words)}."


def _forecast(spec: DriftCheck, known: Knowledge) -> Forecast:
    bench = bench_before(known, spec.method)
    if bench is None:
        return Forecast(0.0, lacks=(f"a kinematic model, and where the {spec.method} is",))
    of_this = [one for one in known.drift_references if one.method == spec.method]
    reference = None if spec.renew or not of_this else of_this[-1]
    rules = spec.rules
    plan = plan_reference(bench, rules) if reference is None else plan_check(bench, reference, rules)
    poses, rounds = (len(plan.ways_rad), 2) if reference is None else (rules.first, 1)
    paced, each_s = plan.paced(poses), known.limits.settle_s + rules.samples * SAMPLE_S
    moving_s = paced.times(rounds).moving_s
    return Forecast(
        duration_s=math.ceil(moving_s + rounds * poses * each_s + ANSWER_S),
        poses=tuple(PlannedPose(f"pose {k}", way[-1]) for k, way in enumerate(plan.ways_rad, 1)),
        speed_rad_s=paced.fastest_rad_s,
        predictions=_foretold(spec, noise_before_m(known, spec.method, rules.samples), reference),
        assumed=(
            *(
                (f"the target is {ASSUMED_DISTANCE_M:g} m from the tracker",)
                if spec.method == "tracker"
                else ()
            ),
            f"an arm of this class comes back to a pose within {REPEAT_M * 1e3:.2f} mm a coordinate",
            "no reference was taken yet, or a new one is asked for: this run takes it, at all poses twice"
            if reference is None
            else "the newest reference is compared with",
        ),
        not_checked=plan.not_checked,
    )


def _foretold(spec: DriftCheck, reading_m: float, reference: DriftReference | None) -> tuple[Prediction, ...]:
    """Return how well a reading of the reference, or a change since it, will be known: as the run states it."""
    taken_m = math.hypot(reading_m, REPEAT_M) / math.sqrt(2.0)  # of the mean of two rounds
    if reference is None:
        change_m = math.hypot(taken_m, reading_m, REPEAT_M)
        later = f"a check against it would see changes to {2e3 * change_m:.3f} mm (k=2)"
        return (Prediction("a reference reading", 2.0 * taken_m, "m", sentence=later),)
    change_m = math.hypot(reference.sigma_m(REPEAT_M), reading_m, REPEAT_M)
    words = f"a change of {spec.limit_m * 1e3:.2f} mm fails (limit_m)"
    return (Prediction("change of a reading", 2.0 * change_m, "m", sentence=words),)


ENTRY = Entry(
    name="drift_check",
    title="Drift check against the reference of a healthy robot",
    version=3,
    procedure=drift_check,
    spec_type=DriftCheck,
    needs=("moves_joints", "model", "sees_the_flange"),
    outline=_outline,
    keeps=_keeps,
    verdict=_verdict,
    forecast=_forecast,
)
