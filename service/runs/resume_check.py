"""Whether a run may go on: the cell, its settings and the procedure are those that it began with."""

from dataclasses import replace
from typing import Any

from pydantic import TypeAdapter, ValidationError
from pydantic_core import to_jsonable_python

from cellcal.calibration.message import join_messages, make_message
from cellcal.drivers.interfaces import ActiveFrames
from cellcal.procedures.canonical_json import is_alike
from cellcal.procedures.cell import Fingerprint
from cellcal.procedures.motion.active_frames import changes_text, cure_text, frame_changes
from cellcal.procedures.procedure_definition import ProcedureDefinition
from cellcal.procedures.run import ReplayMismatchError
from cellcal.service.record.run_store import RunView


def spec_of(view: RunView, entry: ProcedureDefinition) -> Any:
    """Return what the run was asked for; ReplayMismatchError where this version does not understand it."""
    try:
        return TypeAdapter(entry.spec_type).validate_python(view.spec)
    except ValidationError as error:
        raise ReplayMismatchError(
            make_message(
                "the specification of run {run_id} is not one of this version: {error}",
                run_id=view.run_id,
                error=error,
            ),
            remedy="Start a new run.",
        ) from error


def refuse_difference(view: RunView, entry: ProcedureDefinition, now: Fingerprint) -> None:
    """Raise ReplayMismatchError that names every difference, and what cures it."""
    differences = []
    if view.version != entry.version:
        differences.append(
            make_message("procedure version {version}, here {own}", version=view.version, own=entry.version)
        )
    was, present = dict(view.cell), to_jsonable_python(now)
    if entry.epoch_may_change:
        was, present = was | {"encoder_epoch": None}, present | {"encoder_epoch": None}
    changed = [key for key in present if key != "active_frames" and not is_alike(was.get(key), present[key])]
    differences += [_describe_difference(key, was.get(key), present[key]) for key in changed]
    switched = _changed_frames(entry, was.get("active_frames"), now.active_frames)
    remedy = "Restore what was changed, or start a new run; the stored points stay readable."
    if "encoder_epoch" in changed:
        remedy = "Run the mastering recovery, then start a new run; the stored points stay readable."
    if switched:
        remedy = remedy if differences else cure_text(switched)
        differences.append(changes_text(switched))
    if differences:
        raise ReplayMismatchError(
            make_message(
                "run {run_id} cannot be continued: {differences}",
                run_id=view.run_id,
                differences=join_messages("; ", differences),
            ),
            remedy=remedy,
        )


def _changed_frames(
    entry: ProcedureDefinition, was: Any, now: ActiveFrames | None
) -> tuple[tuple[str, str], ...]:
    """Return what is active on the controller and was not when the run began; its own write does not count."""
    if was is None or now is None:
        return ()  # a run from before the robot could be asked
    before = TypeAdapter(ActiveFrames).validate_python(was)
    if "writes_tool_frame" in (*entry.needs, *entry.wants):
        before = replace(before, flange_tool=None)
    return frame_changes(before, now)


def _describe_difference(key: str, was: object, present: object) -> str:
    if key == "config_sha256":
        return "the cell file has been edited since"
    if key == "encoder_epoch":
        return make_message(
            "the robot lost its position during this run (encoder epoch {epoch}, now {found})",
            epoch=was,
            found=present,
        )
    return f"{key} was {was}, is {present}"
