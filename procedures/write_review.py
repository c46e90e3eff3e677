"""What a person sees before something is written: the verdict with its rules. FAIL is not written by itself."""

import math
from collections.abc import Iterable
from dataclasses import replace
from typing import Annotated

import numpy as np
from pydantic import Field

from cellcal.calibration.geometry import Pose, log_rotation
from cellcal.calibration.message import join_messages, make_message
from cellcal.calibration.points.frames import frame_offset as offset_between
from cellcal.drivers.interfaces import Instruction
from cellcal.procedures.run import RefusalError
from cellcal.procedures.steps.pages import LEVER_M, frame_displacement, review_page, with_changes
from cellcal.procedures.verdict import FAIL, PASS, Characteristic, ProcedureVerdict, ValueChange

WriteAnyway = Annotated[
    str, Field(max_length=200)
]  # an engineer's reason; empty: what is not proved is refused

_IN_WORDS = {"pass": "PASS", "fail": "FAIL", "undecided": "UNDECIDED, measure more"}
_SHOWN = {"m": (1e3, "mm", 3), "rad": (math.degrees(1.0), "deg", 4)}


def with_verdict(
    shown: Instruction,
    verdict: ProcedureVerdict,
    question: str,
    write_anyway: str = "",
    *,
    writes: bool = False,
) -> Instruction:
    """Return what a person is asked: what was found, what it is worth and by which rule, and the question.

    ``writes`` tells that a yes changes a controller: its page wants a longer press.
    """
    decided = [figure for figure in verdict.characteristics if figure.decision is not None]
    rules = join_messages("; ", dict.fromkeys(figure.rule for figure in decided if figure.rule))
    figures = join_messages("; ", map(_figure_text, decided))
    doubt = (
        make_message(" The settings say to keep it all the same: {write_anyway}.", write_anyway=write_anyway)
        if _needs_order(verdict, write_anyway)
        else ""
    )
    text = make_message(
        "{shown_text} Verdict: {in_words} ({limits_from}). {entry_text}. Rule: {rules}.",
        shown_text=shown.text,
        in_words=_IN_WORDS[verdict.overall_decision],
        limits_from=verdict.limits_from,
        entry_text=figures,
        rules=rules,
    )
    instruction = replace(
        shown, text=make_message("{text}{doubt} {question}", text=text, doubt=doubt, question=question)
    )
    return review_page(instruction, verdict, writes=writes, write_anyway=write_anyway)


def ask_to_write(
    found: Instruction,
    verdict: ProcedureVerdict,
    before: Pose,
    after: Pose,
    write_anyway: str = "",
    *,
    lever_m: float = LEVER_M,
) -> Instruction:
    """Return the question whether a frame is written to the controller, with what it was and what it will be.

    ``lever_m``: how far from its origin the point is whose displacement is told.
    """
    instruction = with_verdict(found, verdict, "Write it to the controller?", write_anyway, writes=True)
    moved = frame_displacement(before, after, lever_m=lever_m)
    return with_changes(instruction, frame_changes(before, after), **moved)


def ask_to_write_user_frame(
    frame_number: int,
    before: Pose,
    base_user: Pose,
    turn_u_rad: float,
    verdict: ProcedureVerdict,
    write_anyway: str,
) -> Instruction:
    """Return the question whether a user frame is written; ``turn_u_rad`` is the uncertainty of its axes (k=2)."""
    x, y, z = (value * 1e3 for value in base_user.position_m)
    found = Instruction(
        "accept_frame",
        make_message(
            "User frame {frame_number}: origin x {x:.2f}, y {y:.2f}, z {z:.2f} mm from the base; its "
            "axes are known to {turn:.2f} mm per metre (k=2). {text}",
            frame_number=frame_number,
            x=x,
            y=y,
            z=z,
            turn=1e3 * turn_u_rad,
            text=shift_text(before, base_user),
        ),
    )
    return ask_to_write(found, verdict, before, base_user, write_anyway)


def refuse_failed(verdict: ProcedureVerdict, write_anyway: str | None, evidence: object) -> None:
    """Refuse to go on with what failed, unless an engineer gave a reason to; None: not allowed.

    Raises
    ------
    RefusalError
        ``procedure.failed``, with the figures that failed.
    """
    failed = [figure for figure in verdict.characteristics if figure.decision is FAIL]
    if failed and not write_anyway:
        order = "" if write_anyway is None else " An engineer may order the writing with write_anyway."
        raise RefusalError(
            make_message(
                "the verdict is FAIL: {failed}. Nothing was written",
                failed=join_messages("; ", (_figure_text(figure) for figure in failed)),
            ),
            code="procedure.failed",
            remedy=make_message(
                "Look for the cause; then do the doubtful steps again (`cellcal resume RUN --from STEP`) "
                "or start a new run.{order}",
                order=order,
            ),
            evidence=evidence,
        )


def with_order_remark(verdict: ProcedureVerdict, write_anyway: str) -> ProcedureVerdict:
    """Return the verdict with a remark, where something that is not proved was kept by an engineer's order."""
    if not _needs_order(verdict, write_anyway):
        return verdict
    word = verdict.overall_decision.value.upper()
    remark = make_message(
        "Kept although it is {word}, by order of the settings (write_anyway): {write_anyway}",
        word=word,
        write_anyway=write_anyway,
    )
    return replace(verdict, remarks=(*verdict.remarks, remark))


def frame_changes(before: Pose, after: Pose) -> tuple[ValueChange, ...]:
    """Return a frame's place before and after, and by how much it was turned."""
    pairs = zip("xyz", before.position_m, after.position_m, strict=True)
    turn_rad = float(np.linalg.norm(log_rotation(offset_between(before, after).rotation_matrix())))
    return (
        *(ValueChange(make_message("origin {axis}", axis=axis), old, new, "m") for axis, old, new in pairs),
        ValueChange("turned by", 0.0, turn_rad, "rad"),
    )


def shift_text(before: Pose, after: Pose) -> str:
    """Return in words how far a frame goes from what the controller holds."""
    away_mm = math.dist(before.position_m, after.position_m) * 1e3
    turn_rad = float(np.linalg.norm(log_rotation(offset_between(before, after).rotation_matrix())))
    return make_message(
        "That is {away_mm:.2f} mm and {turn_deg:.3f} deg from what the controller holds.",
        away_mm=away_mm,
        turn_deg=math.degrees(turn_rad),
    )


def raise_first(refusals: Iterable[RefusalError | None], write_anyway: str) -> None:
    """Raise the first refusal there is, unless an engineer's reason stands in the settings."""
    refusal = next((refusal for refusal in refusals if refusal is not None), None)
    if refusal is not None and not write_anyway:
        raise refusal


def _needs_order(verdict: ProcedureVerdict, write_anyway: str) -> bool:
    return bool(write_anyway) and verdict.overall_decision is not PASS


def _figure_text(figure: Characteristic) -> str:
    word = "-" if figure.decision is None else figure.decision.value.upper()
    if figure.limit is None:
        return make_message("{figure_name}: {word}", figure_name=figure.name, word=word)
    found, limit = _quantity_text(figure.value, figure.unit), _quantity_text(figure.limit, figure.unit)
    uncertainty_text = (
        ""
        if figure.expanded_uncertainty in (0.0, figure.value)
        else f", U {_quantity_text(figure.expanded_uncertainty, figure.unit)}"
    )
    return make_message(
        "{figure_name}: {word}, {found}{uncertainty_text}, limit {limit}",
        figure_name=figure.name,
        word=word,
        found=found,
        uncertainty_text=uncertainty_text,
        limit=limit,
    )


def _quantity_text(value: float, unit: str) -> str:
    factor, shown, digits = _SHOWN.get(unit, (1.0, unit, 3))
    return f"{value:g}" if unit == "1" else f"{value * factor:.{digits}f} {shown}"
