"""Undo of a mastering that was written: the controller gets back, byte for byte, what it held before that write.

Nothing is measured: whether the old data were right is another question, and the certificate says so.
"""

from dataclasses import dataclass
from typing import Annotated

import numpy as np
from pydantic_core import to_jsonable_python

from cellcal.calibration.arm.kinematics import load_model
from cellcal.calibration.mastering.pose_design import candidate_joints
from cellcal.calibration.message import make_message
from cellcal.calibration.motion.motion_check import MotionLimits
from cellcal.drivers.interfaces import Counts, Instruction, MasteringData
from cellcal.procedures.canonical_json import sha256_of
from cellcal.procedures.cell import Cell, MasteringBackup
from cellcal.procedures.forecast import Forecast, Knowledge
from cellcal.procedures.instruction_page import with_page
from cellcal.procedures.motors import Motors
from cellcal.procedures.procedure_definition import Phase, ProcedureDefinition, StoredResult
from cellcal.procedures.questions import ask_acceptance
from cellcal.procedures.recovery.recovery_verdict import AFTER_MASTERING
from cellcal.procedures.run import RefusalError, Run
from cellcal.procedures.setting_texts import describe_setting
from cellcal.procedures.steps.mastering import nominal_model, read_motors_alone
from cellcal.procedures.steps.pages import axis_levers, joint_displacement, review_page, with_changes
from cellcal.procedures.steps.write import ReadBackError, restore_mastering
from cellcal.procedures.verdict import ProcedureVerdict, ValueChange, state_fact

_POSTURES = 200
_PERSON_S = 30.0


@dataclass(frozen=True, slots=True)
class MasteringUndo:
    """Which run's write is undone; nothing: the newest that wrote a mastering."""

    of_run: Annotated[
        str,
        describe_setting(
            "Run to undo",
            "The run whose writing is taken back, by its number in the history; "
            "empty: the last one that wrote.",
            "what",
            basic=True,
        ),
    ] = ""


@dataclass(frozen=True, slots=True)
class UndoResult:
    """The mastering that the controller had, the one it has again, and the hash of the stored form of both."""

    of_run: str
    joint_names: tuple[str, ...]
    undone: MasteringData
    restored: MasteringData
    backup_sha256: str
    restored_sha256: str
    displaced_m: float  # the most that the tip is displaced, over postures, where it goes to the same joints


async def mastering_undo(run: Run, spec: MasteringUndo) -> UndoResult:
    """Read what is there, show what changes, write the backup, read it back and compare the bytes."""
    backup = await run.step("read the backup", stored_backup, spec.of_run)
    motors = await run.step("read the motors alone", read_motors_alone)
    _refuse_unfit(backup, motors)
    model = await run.step("name the model", _model_name)
    displaced_m = await run.solve("compare old and new", displacement_m, model, motors, backup)
    names = load_model(model).joint_names
    shown = _review_instruction(names, model, motors, backup, displaced_m)
    await run.step("accept the undo", ask_acceptance, shown, backup.sha256)
    restored = await run.write("write the mastering", restore_mastering, backup.data)
    found = mastering_sha256(restored)
    if found != backup.sha256:
        raise ReadBackError(
            make_message(
                "the mastering reads {restored} after {data} was put back",
                restored=restored,
                data=backup.data,
            ),
            remedy="Do not move the robot in AUTO. Compare the counts with the run's backup.",
        )
    return UndoResult(backup.of_run, names, motors.mastering, restored, backup.sha256, found, displaced_m)


def mastering_sha256(data: MasteringData) -> str:
    """Return the hash of the canonical stored form of mastering data: equal hashes are equal bytes."""
    return sha256_of(to_jsonable_python(data))


async def stored_backup(cell: Cell, of_run: str) -> MasteringBackup:
    """Return what this very robot held before a run wrote its mastering."""
    serial = (await cell.robot.identify()).serial
    own = [backup for backup in cell.backups if backup.robot_serial == serial]
    # Pages show the number of a run without the procedure's name before it.
    fits = [backup for backup in own if of_run in ("", backup.of_run, backup.of_run.rpartition("-")[2])]
    if not fits:
        raise RefusalError(
            make_message(
                "no run {of_run} of this robot that wrote a mastering is in the journal", of_run=of_run
            )
            if of_run
            else "no run of this robot that wrote a mastering is in the journal",
            code="procedure.no_backup",
            remedy=make_message(
                "Runs that can be undone: {own}.", own=", ".join(one.of_run for one in own) or "none"
            ),
        )
    if mastering_sha256(fits[-1].data) != fits[-1].sha256:
        raise RefusalError("the backup is not what was stored", code="procedure.no_backup")
    return fits[-1]


def displacement_m(model_name: str, motors: Motors, backup: MasteringBackup) -> float:
    """Return how far the flange is displaced at most [m], over postures, where it is sent to the same joints."""
    model = load_model(model_name)
    postures = candidate_joints(model, MotionLimits(), _POSTURES)
    turned = _turned_rad(motors, backup.data.counts_at_zero)
    return float(joint_displacement(model, [tuple(q) for q in postures], turned, (0.0, 0.0, 0.0))["most_m"])


def _turned_rad(motors: Motors, counts_at_zero: Counts) -> tuple[float, ...]:
    """Return by how much each joint stands elsewhere when it is sent to the same angle [rad]."""
    zeros = [np.array(zero) for zero in (counts_at_zero, motors.mastering.counts_at_zero)]
    return tuple(float(v) for v in motors.drive.to_joints(*zeros))


def _refuse_unfit(backup: MasteringBackup, motors: Motors) -> None:
    if motors.epoch != backup.epoch:
        raise RefusalError(
            make_message(
                "the encoders lost their position since that write (epoch {epoch_of_write}, now {epoch_now}): its "
                "backup belongs to other counts",
                epoch_of_write=backup.epoch,
                epoch_now=motors.epoch,
            ),
            code="procedure.wrong_backup",
            remedy="Recover the mastering instead.",
        )
    if motors.mastering == backup.data:
        raise RefusalError(
            make_message("the controller holds what it held before {of_run} already", of_run=backup.of_run),
            code="procedure.nothing_to_undo",
            remedy="Nothing is left to do.",
        )


async def _model_name(cell: Cell) -> str:
    return nominal_model(cell).name


def _review_instruction(
    names: tuple[str, ...], model: str, motors: Motors, backup: MasteringBackup, displaced_m: float
) -> Instruction:
    flag = _MASTERED if backup.data.mastered else _NOT_MASTERED
    instruction = Instruction(
        "accept_mastering",
        make_message(
            "The controller gets back the mastering that it held before the run named here wrote "
            "another. Taught positions move with it. {flag} Write the old mastering back?",
            flag=flag,
        ),
    )
    changes = _mastering_changes(names, motors.mastering, backup.data)
    whole = state_fact("the backup is whole", True, "its stored form has the hash that the journal tells")
    verdict = ProcedureVerdict(
        (whole,),
        limits_from=make_message("run {of_run}", of_run=backup.of_run),
        not_verified=_NOT_VERIFIED,
        changes=changes,
    )
    page = with_changes(
        review_page(instruction, verdict, writes=True), changes, most_m=displaced_m, at="postures"
    )
    return with_page(page, "review", axes=axis_levers(load_model(model), motors.joints_rad))


def _mastering_changes(
    names: tuple[str, ...], old: MasteringData, new: MasteringData
) -> tuple[ValueChange, ...]:
    rows = zip(names, old.counts_at_zero, new.counts_at_zero, strict=True)
    counts = [
        ValueChange(make_message("{name}: counts at zero", name=name), float(a), float(b), "count")
        for name, a, b in rows
    ]
    return (*counts, ValueChange("mastered", float(old.mastered), float(new.mastered), "1"))


_MASTERED = "The robot will be mastered."
_NOT_MASTERED = "The robot will NOT be mastered, as before that run."
_UNMASTERED = ("The robot is marked as not mastered and stays out of production until it is mastered again.",)
_NOT_VERIFIED = (
    "Nothing was measured: whether the old mastering was right is not known.",
    "No production point was touched; the witness marks were not compared.",
)


def _make_verdict(spec: MasteringUndo, result: UndoResult) -> ProcedureVerdict:
    del spec
    rule = "the stored form read back, byte for byte that of the backup (SHA-256)"
    same = result.restored_sha256 == result.backup_sha256
    return ProcedureVerdict(
        (state_fact("the mastering is that from before the write", same, rule),),
        limits_from="equal or refused",
        not_verified=_NOT_VERIFIED,
        changes=_mastering_changes(result.joint_names, result.undone, result.restored),
        to_sign=AFTER_MASTERING if result.restored.mastered else _UNMASTERED,
    )


def _outline_phases(spec: MasteringUndo) -> tuple[Phase, ...]:
    del spec
    return (
        Phase("read the backup"),
        Phase("read the motors alone"),
        Phase("name the model"),
        Phase("compare old and new"),
        Phase("accept the undo"),
        Phase("write the mastering"),
    )


def _results_to_store(spec: MasteringUndo, result: UndoResult) -> StoredResult | None:
    del spec, result
    return None


def _forecast_run(spec: MasteringUndo, knowledge: Knowledge) -> Forecast:
    del spec, knowledge
    return Forecast(duration_s=_PERSON_S, assumed=("the robot stands still; nothing moves",))


DEFINITION = ProcedureDefinition(
    name="mastering_undo",
    title="Undo of a written mastering",
    version=1,
    procedure=mastering_undo,
    spec_type=MasteringUndo,
    needs=("writes_mastering", "model"),
    wants=("backup",),
    needs_position=False,
    outline=_outline_phases,
    results_to_store=_results_to_store,
    verdict=_make_verdict,
    forecast=_forecast_run,
)
