"""The mastering record: taken while the robot is healthy, so that lost turns can be found again.

With a draw-wire: lengths over the whole reach. Without one: a kit of places, chosen for the smallest error that it
would leave.
"""

import re
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Annotated, Literal

import numpy as np
from pydantic import Field, TypeAdapter
from pydantic_core import to_jsonable_python

from cellcal.calibration.arm.kinematics import load_model
from cellcal.calibration.mastering.counts import MasteringRecord, WireCapture
from cellcal.calibration.mastering.pose_design import predict_turns
from cellcal.calibration.message import make_message
from cellcal.calibration.points.fixture import worst_expanded_u
from cellcal.calibration.wires.model import WirePoses
from cellcal.calibration.wires.reference import WirePredictor, WireReference, fit_wire_reference
from cellcal.drivers.interfaces import Instruction, Readiness
from cellcal.procedures.canonical_json import sha256_of
from cellcal.procedures.forecast import Forecast, Knowledge
from cellcal.procedures.motion.detours import known_way
from cellcal.procedures.motion.plans import MotionBounds, plan_kit, wire_prior
from cellcal.procedures.motors import Motors, MotorState
from cellcal.procedures.procedure_definition import Phase, ProcedureDefinition, StoredResult
from cellcal.procedures.questions import ask_acceptance, ask_confirmation
from cellcal.procedures.recovery.mastering_forecasts import forecast_places, forecast_record
from cellcal.procedures.recovery.place_record import place_phases, record_places
from cellcal.procedures.recovery.record_seal import plan_instruction, seal_record
from cellcal.procedures.recovery.record_verdict import RecordResult, RecoveryProspect, verdict_on_record
from cellcal.procedures.recovery.recovery_kit import (
    KitSpec,
    kit_phases,
    predict_kit,
    recorded_kit,
)
from cellcal.procedures.refit import (
    MEASURED_AGAIN,
    FitPoint,
    FittedValue,
    Refit,
    RefitResult,
    Use,
    misses_of_lengths,
    used_values,
    values_of,
)
from cellcal.procedures.run import RefusalError, Run
from cellcal.procedures.run_history import Finding
from cellcal.procedures.setting_texts import (
    EVIDENCE,
    RETAKES,
    ROOM,
    SAMPLES,
    SEED,
    TOLERANCE_COUNTS,
    describe_setting,
)
from cellcal.procedures.steps.capture import StillCapture, capture_still
from cellcal.procedures.steps.kit_bench import read_kit_bench
from cellcal.procedures.steps.mastering import check_same_epoch, read_motors
from cellcal.procedures.steps.motion import go_along

_PLACES = ("wire's exit x", "wire's exit y", "wire's exit z", "hook x", "hook y", "hook z")
_STATE: TypeAdapter[MotorState] = TypeAdapter(MotorState)
_CAPTURE: TypeAdapter[StillCapture] = TypeAdapter(StillCapture)
HOOK_WIRE = Instruction("wire_is_hooked", "Hook the draw-wire to the flange; nothing may touch the wire.")


@dataclass(frozen=True, slots=True)
class MasteringRecordSpec:
    """How many poses to capture, how carefully, and what motion must keep to."""

    poses: Annotated[
        int,
        Field(ge=8, le=200),
        describe_setting(
            "Poses to record",
            "At how many poses the arm is measured; more make a later recovery surer.",
            "effort",
            unit="1",
            basic=True,
        ),
    ] = 30
    samples: Annotated[int, Field(ge=1, le=1000), SAMPLES] = 5
    tolerance_counts: Annotated[int, Field(ge=0), TOLERANCE_COUNTS] = 50
    retakes: Annotated[int, Field(ge=0, le=20), RETAKES] = 2
    seed: Annotated[int, Field(ge=0), SEED] = 1
    evidence: Annotated[Literal["wire", "places"], EVIDENCE] = "wire"
    kit: Annotated[
        KitSpec | None,
        describe_setting(
            "Places to come back to",
            "Points, a seat or targets recorded beside the lengths, so that a recovery needs no draw-wire.",
            "tool",
        ),
    ] = None
    room: Annotated[MotionBounds, ROOM] = field(default_factory=MotionBounds)


async def mastering_record(run: Run, spec: MasteringRecordSpec) -> RecordResult:
    """Measure lengths over the whole reach of a healthy robot, or places; store them with counts and turns."""
    if spec.evidence == "places":
        return await _record_by_places(run, spec)
    await run.ensure("the wire is hooked", ask_confirmation, HOOK_WIRE)
    state = await run.step("read the motors", read_motors)
    _refuse_unhealthy(state)
    await run.ensure("the robot kept its position", check_same_epoch, state.epoch)

    plan = await run.solve("plan the poses", plan_kit, state, spec.room, spec.poses, spec.seed)
    await run.step(
        "accept the plan", ask_acceptance, plan_instruction(plan), sha256_of(to_jsonable_python(plan))
    )

    taken: list[StillCapture] = []
    for k, (way, speed_rad_s) in enumerate(zip(plan.ways_rad, plan.speeds_rad_s, strict=True), 1):
        await run.move(f"go to pose {k}", go_along, way, speed_rad_s)
        taken.append(
            await run.step(f"capture {k}", capture_still, f"pose {k}", spec.samples, spec.tolerance_counts)
        )

    captures, here = [still.wire for still in taken], plan.poses_rad[-1]
    sources, set_aside = [f"capture {k + 1}" for k in range(len(taken))], []
    wire = await run.solve("fit the wire 1", fit_wire, state, tuple(captures))
    for retake in range(1, spec.retakes + 1):
        if wire.is_consistent():
            break
        worst = wire.worst_capture
        back = known_way(state.joints_rad, plan.ways_rad, here, plan.poses_rad[worst])
        await run.move(f"go again to pose {retake}", go_along, back, plan.speed_rad_s)
        here = plan.poses_rad[worst]
        label = f"pose {worst + 1}, again"
        still = await run.step(
            f"capture again {retake}", capture_still, label, spec.samples, spec.tolerance_counts
        )
        captures[worst] = still.wire
        set_aside.append(sources[worst])
        sources[worst] = f"capture again {retake}"
        wire = await run.solve(f"fit the wire {retake + 1}", fit_wire, state, tuple(captures))
    _refuse_inconsistent(wire)

    record = seal_record(
        replace(sealed_record(state, tuple(captures), wire), kit=await recorded_kit(run, spec.kit))
    )
    prospect = await run.solve("predict a recovery", predict_recovery, record)
    kit = await run.solve("predict a recovery by places", predict_kit, record) if record.kit else None
    return RecordResult(record, prospect, kit, tuple(set_aside))


async def _record_by_places(run: Run, spec: MasteringRecordSpec) -> RecordResult:
    """Record places alone, in a cell without a draw-wire."""
    bench = await run.step("look at the instruments", read_kit_bench)
    motors = bench.motors
    _refuse_unhealthy(motors)
    await run.ensure("the robot kept its position", check_same_epoch, motors.epoch)
    blank = _unsealed_record(motors, bench.model)
    found = await record_places(run, bench, blank, (spec.kit, spec.room, spec.seed))
    prospect = RecoveryProspect(found.prospect.success_probability, found.prospect.sigma_turns, found.visits)
    return RecordResult(seal_record(found.record), prospect, found.prospect, offers=found.offers)


def fit_wire(state: MotorState, captures: tuple[WireCapture, ...]) -> WireReference:
    """Fit anchor, hook, zero and geometry to the lengths of a healthy robot."""
    counts = np.array([c.counts for c in captures])
    joints = state.drive.to_joints(counts, np.array(state.mastering.counts_at_zero))
    lengths = np.array([c.length_m for c in captures])
    sigmas = np.array([c.sigma_m for c in captures])
    return fit_wire_reference(load_model(state.model), joints, lengths, sigmas, wire_prior(state))


def wire_residuals(
    state: MotorState, wire: WireReference, captures: tuple[WireCapture, ...]
) -> tuple[float, ...]:
    """Return what captures miss a fit by, in it or not, measured minus computed [m]."""
    joints = state.drive.to_joints(
        np.array([c.counts for c in captures]), np.array(state.mastering.counts_at_zero)
    )
    predictor = WirePredictor(load_model(state.model), wire, wire_prior(state))
    computed = predictor.wire_terms(
        WirePoses.from_record_side(joints, np.array([c.sigma_m for c in captures]))
    ).lengths
    return tuple(float(c.length_m - length) for c, length in zip(captures, computed, strict=True))


def predict_recovery(record: MasteringRecord) -> RecoveryProspect:
    """Say how surely lost turns would be found by measuring all poses of the record again."""
    probability, sigmas = predict_turns(load_model(record.model), record, record.capture_joints_rad())
    return RecoveryProspect(probability, tuple(float(s) for s in sigmas), len(record.captures))


def sealed_record(
    state: MotorState, captures: tuple[WireCapture, ...], wire: WireReference
) -> MasteringRecord:
    """Put a record together and seal it with the hash of everything in it."""
    record = replace(
        _unsealed_record(state, state.model), captures=captures, wire=wire, prior=wire_prior(state)
    )
    return seal_record(record)


def _unsealed_record(state: MotorState | Motors, model: str) -> MasteringRecord:
    """Return a record of the motors alone: counts, gears and where the robot stands."""
    return MasteringRecord(
        robot_serial=state.identity.serial,
        model=model,
        epoch=state.epoch,
        drive=state.drive,
        counts_at_zero=state.mastering.counts_at_zero,
        reference_joints_rad=state.joints_rad,
        reference_counts=state.counts,
        captures=(),
        wire=None,
        prior=None,
        taken_by="mastering_record 1",
        sha256="",
    )


def _refuse_unhealthy(state: MotorState | Motors) -> None:
    if not state.mastering.mastered or state.condition.readiness is not Readiness.READY:
        raise RefusalError(
            make_message(
                "the robot is not ready or not mastered: {condition_message}",
                condition_message=state.condition.message or "mastering data invalid",
            ),
            code="procedure.not_healthy",
            remedy="Clear what is wrong, then start a new run: a record must be taken of a healthy robot.",
        )


def _refuse_inconsistent(wire: WireReference) -> None:
    if not wire.is_consistent():
        raise RefusalError(
            make_message(
                "the lengths contradict each other: residual {residual_rms_mm:.2f} mm RMS, capture "
                "{worst_capture} stands out by {worst_deviation:.1f} deviations",
                residual_rms_mm=wire.residual_rms_m * 1000.0,
                worst_capture=wire.worst_capture + 1,
                worst_deviation=wire.worst_deviation,
            ),
            code="procedure.record_inconsistent",
            remedy="Check the hook, the anchor and the wire's path; compare their places with the cell file; "
            "then start a new run.",
        )


def _outline_phases(spec: MasteringRecordSpec) -> tuple[Phase, ...]:
    if spec.evidence == "places":
        return place_phases(spec.kit)
    return (
        *(Phase("read the motors"), Phase("plan the poses"), Phase("accept the plan")),
        *(Phase("go to pose", spec.poses), Phase("capture", spec.poses)),
        *(Phase("fit the wire", 1, adaptive=True), Phase("go again to pose", 0, adaptive=True)),
        *(Phase("capture again", 0, adaptive=True), *kit_phases(spec.kit), Phase("predict a recovery")),
    )


def _results_to_store(spec: MasteringRecordSpec, result: RecordResult) -> StoredResult:
    del spec
    return StoredResult("mastering_record", result.record.robot_serial, result.record)


def _forecast_run(spec: MasteringRecordSpec, knowledge: Knowledge) -> Forecast:
    if spec.evidence == "places":
        return forecast_places(knowledge, spec.room, spec.kit, spec.seed)
    return forecast_record(knowledge, spec.room, (spec.poses, spec.samples), (spec.kit, spec.seed))


def _make_refit(spec: MasteringRecordSpec, findings: Sequence[Finding]) -> Refit | None:
    if spec.evidence == "places":
        return None
    found = values_of(findings)
    state = _STATE.validate_python(found["read the motors"])
    taken = [step for step in found if re.fullmatch(r"capture (again )?\d+", step)]
    captures = tuple(_CAPTURE.validate_python(found[step]).wire for step in taken)
    standing, aside = [step for step in taken if "again" not in step], set()
    for retake in range(1, len(taken) - len(standing) + 1):
        worst = found[f"fit the wire {retake}"]["worst_capture"]
        aside.add(standing[worst])
        standing[worst] = f"capture again {retake}"
    points = tuple(FitPoint(s, s not in aside, MEASURED_AGAIN if s in aside else "") for s in taken)

    def solve_again(use: Use) -> RefitResult:
        wire = fit_wire(state, used_values(captures, use))
        worst = -1 if wire.is_consistent() else [k for k, used in enumerate(use) if used][wire.worst_capture]
        residuals = wire_residuals(state, wire, captures)
        places = (*wire.anchor_in_base_m, *wire.hook_in_flange_m)
        values = tuple(FittedValue(n, "m", v) for n, v in zip(_PLACES, places, strict=True))
        u_m = worst_expanded_u(np.array(wire.covariance)[3:6, 3:6])
        return RefitResult(misses_of_lengths(residuals, use, worst), u_m, values)

    return Refit("wire", points, len(state.counts) + 2, "hook", solve_again)


DEFINITION = ProcedureDefinition(
    name="mastering_record",
    title="Mastering record",
    version=4,
    procedure=mastering_record,
    spec_type=MasteringRecordSpec,
    needs=("writes_mastering", "model"),
    outline=_outline_phases,
    results_to_store=_results_to_store,
    verdict=lambda _, result: verdict_on_record(result),
    forecast=_forecast_run,
    refit=_make_refit,
)
