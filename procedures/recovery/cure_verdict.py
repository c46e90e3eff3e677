"""What may be claimed of a position that was brought back at the pendant, and what is left to people."""

import math

from cellcal.calibration.message import make_message
from cellcal.procedures.recovery.cure_result import AxisProof, PositionCureResult
from cellcal.procedures.recovery.gate_words import state_gate_check
from cellcal.procedures.verdict import (
    Characteristic,
    ProcedureVerdict,
    SetAside,
    judge_value,
    state_fact,
    state_figure,
)

NOTHING_BACK = "No axis was brought back in this run: all were proved as they stood."
NEW_ZEROS = "Zeros were set anew: once they pass, take a new position record, for the next loss."
AFTER_CURE = (
    "One taught production point was touched again at creep speed, and is where it was.",
    "Safety functions that depend on the robot's position (for example FANUC DCS, KUKA SafeOperation mastering "
    "test, ABB SafeMove) were re-verified by the responsible person.",
)


def _axis_figures(axis: AxisProof, limit_rad: float) -> tuple[Characteristic, ...]:
    if axis.found == "new":
        name = make_message("axis {name}: error of its zero", name=axis.name)
        judged = judge_value(name, axis.offset_rad, "rad", u=axis.u_rad / 2.0, limit=limit_rad)
        if axis.zero == "new":
            return (judged,)
        fact = state_fact(
            make_message("axis {name}: its zero was kept", name=axis.name),
            False,
            "PASS if it is off by whole motor turns, or by none",
        )
        return (judged, fact)
    turns = state_fact(
        make_message("axis {name}: motor turns that it is off", name=axis.name),
        axis.turns_off == 0,
        "PASS if none; whole turns are exact or refused",
        found=float(axis.turns_off),
        limit=0.0,
        unit="turn",
    )
    if not axis.hidden_rad:
        return (turns,)
    hidden = state_figure(
        make_message("axis {name}: a smaller error than this could not be told", name=axis.name),
        axis.hidden_rad,
        "rad",
        rule="of this axis alone; three deviations of what the lengths tell",
    )
    return (turns, hidden)


def verdict_on_cure(limit_rad: float, result: PositionCureResult) -> ProcedureVerdict:
    """Say axis by axis what the lengths prove, and what a person does next about one that is wrong."""
    figures = [figure for axis in result.axes for figure in _axis_figures(axis, limit_rad)]
    gate = map(state_gate_check, result.gate)
    constants = state_fact(
        "the machine data are those of the record",
        not result.changed_constants,
        "; ".join(result.changed_constants) or "nothing that the controller shows of them differs",
    )
    back = [
        make_message("Axis {name} was brought back at the pendant.", name=axis.name)
        for axis in result.axes
        if axis.brought_back
    ]
    return ProcedureVerdict(
        (*figures, *gate, constants),
        limits_from="limits of the settings",
        not_verified=(
            "No production point was touched; the witness marks were not compared by this software.",
            "The accuracy of the robot beyond that of its position record was not measured.",
            "What the controller keeps inside and does not show, such as encoder values, was not compared.",
        ),
        remarks=(
            *(back or [NOTHING_BACK]),
            *((NEW_ZEROS,) if any(axis.found == "new" for axis in result.axes) else ()),
            *(_next_text(axis, limit_rad) for axis in result.axes if _is_wrong(axis, limit_rad)),
        ),
        set_aside=tuple(
            SetAside(step, "did not fit the others; measured again") for step in result.set_aside
        ),
        to_sign=AFTER_CURE,
    )


def _is_wrong(axis: AxisProof, limit_rad: float) -> bool:
    if axis.found == "new":
        return axis.zero == "kept" or abs(axis.offset_rad) + axis.u_rad > limit_rad
    return axis.turns_off != 0


def _next_text(axis: AxisProof, limit_rad: float) -> str:
    """Say what a person does next about an axis that is wrong."""
    degrees = math.degrees(axis.offset_rad)
    if axis.found == "kept":
        return make_message(
            "Axis {name} stands {turns:+d} motor turns ({degrees:+.3f} deg) from what the controller shows. Run "
            "position_cure again with this axis in axes_again: at its true mark the controller shows it at "
            "{shown:+.3f} deg beside the mark's angle.",
            name=axis.name,
            turns=axis.turns_off,
            degrees=degrees,
            shown=-degrees,
        )
    if abs(axis.offset_rad) - axis.u_rad <= limit_rad and axis.zero == "new":
        return make_message(
            "Whether axis {name} keeps the limit is not decided: {degrees:+.3f} deg, U {u:.3f} deg. Measure at more "
            "poses, or set its zero again.",
            name=axis.name,
            degrees=degrees,
            u=math.degrees(axis.u_rad),
        )
    return make_message(
        "The zero of axis {name} is off by {degrees:+.3f} deg (U {u:.3f} deg), which is no whole motor turn. Run "
        "position_cure again with this axis in axes_again, and set its zero with care.",
        name=axis.name,
        degrees=degrees,
        u=math.degrees(axis.u_rad),
    )
