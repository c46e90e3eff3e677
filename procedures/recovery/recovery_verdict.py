"""What a mastering recovery may claim, joint by joint, and what it leaves to people."""

from cellcal.calibration.mastering.flank_check import FlankCheck
from cellcal.calibration.message import make_message
from cellcal.procedures.accuracy_limits import (
    MASTERING,
    AccuracyClass,
    MasteringLimits,
    limits_in_force,
    limits_text,
)
from cellcal.procedures.recovery.gate_words import state_gate_check
from cellcal.procedures.recovery.recovery_result import JointRecovery, RecoveryResult
from cellcal.procedures.recovery.recovery_spec import MasteringRecoverySpec
from cellcal.procedures.verdict import (
    Characteristic,
    ProcedureVerdict,
    SetAside,
    ValueChange,
    known_within,
    state_evidence,
    state_fact,
    state_figure,
)

# what motion_safety 3.6 leaves to a person after a mastering was written
AFTER_MASTERING = (
    "The axis marks were compared with all axes at zero: stopped ten degrees before, the rest at creep speed.",
    "One taught production point was touched again at creep speed, and is where it was.",
    "Safety functions that depend on the robot's position (for example FANUC DCS, KUKA SafeOperation mastering "
    "test, ABB SafeMove) were re-verified by the responsible person.",
)
NO_EXCHANGE = "Whole turns are exact provided that no motor, encoder, belt or gear was exchanged."


def verdict_on_recovery(
    accuracy_class: AccuracyClass, own: MasteringLimits | None, result: RecoveryResult
) -> ProcedureVerdict:
    """Say joint by joint what was restored, and repeat the gate that let it pass."""
    limits = limits_in_force(MASTERING, accuracy_class, own)
    joints = [_joint_figure(joint, limits.axis_rad) for joint in result.joints]
    checks = map(state_gate_check, result.gate)
    moved = ", ".join(
        f"{joint.name} {joint.turns_restored:+d}"
        for joint in result.joints
        if joint.exact and joint.turns_restored
    )
    real = ", ".join(joint.name for joint in result.joints if not joint.exact)
    remarks = [make_message("Turn counters corrected: {moved}.", moved=moved or "none")]
    remarks.append(
        make_message("New zero of {names}.", names=real)
        if real
        else "Zero offsets unchanged; this is no calibration."
    )
    return ProcedureVerdict(
        (*joints, *checks, *_flank_figures(result.flanks)),
        limits_from=limits_text(accuracy_class, own) if real else "whole turns: exact or refused",
        not_verified=(
            "No production point was touched; the witness marks were not compared.",
            "The accuracy of the robot beyond its old mastering was not measured.",
        ),
        remarks=(*remarks, NO_EXCHANGE),
        changes=_joint_changes(result),
        set_aside=tuple(
            SetAside(step, "did not fit the others; measured again") for step in result.set_aside
        ),
        to_sign=AFTER_MASTERING,
    )


def saving_texts(spec: MasteringRecoverySpec, result: RecoveryResult) -> tuple[str, ...]:
    """Say what choosing the poses saved against evenly drawn ones that know the least known motor as well."""
    if spec.evidence == "places" or (result.record is not None and result.record.wire is None):
        return ("no saving: every place of the kit was visited, to fit or to check",)
    taken, checked, drawn = result.captures, result.check_captures, result.drawn
    if drawn is None:
        return ()
    took = drawn.travel_rad / result.jog_speed_rad_s / 60.0
    if drawn.drawn_captures is None:
        return (
            make_message(
                "{taken} captures and {checked} checks; evenly drawn poses do not tell the motors as "
                "surely at all",
                taken=taken,
                checked=checked,
            ),
        )
    needs, longer = drawn.drawn_captures, drawn.drawn_travel_rad / result.jog_speed_rad_s / 60.0
    if longer <= took:
        return (
            make_message(
                "no saving: evenly drawn poses need {needs} captures and {longer:.1f} minutes of moving "
                "for as much",
                needs=needs,
                longer=longer,
            ),
        )
    return (
        make_message(
            "{taken} captures, {took:.1f} minutes of moving, and {checked} checks; a fixed plan of "
            "evenly drawn poses needs {needs} captures and {longer:.1f} minutes of moving to be as "
            "sure: {took_percent:.0f} % of the moving saved",
            taken=taken,
            took=took,
            checked=checked,
            needs=needs,
            longer=longer,
            took_percent=(1.0 - took / longer) * 100,
        ),
    )


def _joint_figure(joint: JointRecovery, limit_rad: float) -> Characteristic:
    if joint.exact:
        rule = "exact, or nothing is written: the conditions below decide"
        return state_fact(
            make_message("{joint_name}: turns restored", joint_name=joint.name),
            True,
            rule,
            found=float(joint.turns_restored),
            unit="turn",
        )
    return known_within(
        make_message("{joint_name}: new zero", joint_name=joint.name),
        "rad",
        u=joint.offset_u_rad / 2.0,
        limit=limit_rad,
    )


def _flank_figures(found: FlankCheck | None) -> tuple[Characteristic, ...]:
    """Return what going to check poses again tells; UNDECIDED where hook, gears or warmth are in doubt."""
    if found is None:
        return ()
    figures = []
    if found.moved_m is not None:
        rule = "PASS if within what a capture scatters, 99.9 %; else the hook slips, or the hall or the arm warmed"
        figures.append(
            state_evidence(
                "a check pose gone to again from the same side", found.nothing_moved, rule,
                found=found.moved_m, limit=found.moved_limit_m, unit="m",
            )
        )  # fmt: skip
    if found.lost_motion_m is not None:
        rule = "PASS if no more than gears in order have, 99.9 %; else a gear, the hook or the tool is loose"
        figures.append(
            state_evidence(
                "a check pose gone to again from the other side", found.nothing_loose, rule,
                found=found.lost_motion_m, limit=found.lost_motion_limit_m, unit="m",
            )
        )  # fmt: skip
    if found.backlash_rad is not None:
        name = make_message("play of {joints}, taken as alike", joints=", ".join(found.joints))
        rule = "no more than what this wire sees of them together"
        figures.append(state_figure(name, found.backlash_rad, "rad", u=found.backlash_u_rad / 2.0, rule=rule))
    return tuple(figures)


def _joint_changes(result: RecoveryResult) -> tuple[ValueChange, ...]:
    zeros = zip(result.joints, result.counts_at_zero_before, result.counts_at_zero, strict=True)
    offsets = [
        ValueChange(
            make_message("{joint_name}: error of its zero", joint_name=joint.name),
            joint.offset_rad,
            None if joint.offset_u_rad else 0.0,
            "rad",
        )
        for joint in result.joints
    ]
    counts = [
        ValueChange(make_message("{name}: counts at zero", name=joint.name), float(old), float(new), "count")
        for joint, old, new in zeros
    ]
    return (*offsets, *counts)
