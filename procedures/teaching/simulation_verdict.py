"""What a calibrated simulation may claim: how well it meets tags of the real cell, before and after."""

import math

from cellcal.calibration.message import make_message
from cellcal.calibration.points.tag_placement import PlacedTags, SpatialUncertainty
from cellcal.calibration.points.tag_points import TagPairs
from cellcal.calibration.points.tag_robot import SimulatedRobot
from cellcal.procedures.accuracy_limits import CheckLimits, FrameLimits, ToolLimits
from cellcal.procedures.teaching.point_remarks import point_remarks
from cellcal.procedures.verdict import (
    PASS,
    UNDECIDED,
    Characteristic,
    ProcedureVerdict,
    ValueChange,
    judge_value,
    state_evidence,
    state_figure,
)


def robot_verdict(
    found: SimulatedRobot, check: CheckLimits, tool: ToolLimits, limits_from: str
) -> ProcedureVerdict:
    """Return the verdict on a simulated robot's zero positions and tool."""
    freedom = max(3.0 * found.tags - 9.0 - len(found.values), 1.0)
    error_m = found.after.rmse_m
    return ProcedureVerdict(
        (
            judge_value(
                "RMS at tags that were not fitted",
                error_m,
                "m",
                u=error_m / math.sqrt(2.0 * freedom),
                limit=check.check_rms_m,
            ),
            _uncertainty_figure("place of the tool", found.tool, "m", tool.tip_m),
            state_evidence(
                "tags that were not fitted are met better than before",
                found.is_better,
                "PASS if the RMS after is below that before, else UNDECIDED: the tags do not show these errors",
                found=error_m,
                limit=found.before.rmse_m,
                unit="m",
            ),
            state_figure("RMS of the fit itself, no accuracy", found.fit_rms_m, "m"),
        ),
        limits_from=limits_from,
        not_verified=(
            *(
                make_message(
                    "{one_name}: hidden behind {partner}; {cure}",
                    one_name=one.name,
                    partner=one.partner,
                    cure=one.cure,
                )
                for one in found.unknowable
            ),
            "The tool's axes: places of one target do not tell them.",
            "Postures far from the tags.",
        ),
        remarks=(
            *found.remarks,
            *(
                (
                    make_message(
                        "tags that do not belong and were left out: {rejected}",
                        rejected=", ".join(found.rejected),
                    ),
                )
                if found.rejected
                else ()
            ),
            *(
                (make_message("tags of one path only: {unpaired}", unpaired=", ".join(found.unpaired)),)
                if found.unpaired
                else ()
            ),
        ),
        changes=(
            ValueChange("RMS at tags that were not fitted", found.before.rmse_m, error_m, "m"),
            *(ValueChange(value.name, 0.0, value.value, value.unit) for value in found.values),
        ),
    )


def placed_verdict(
    found: PlacedTags, limits: FrameLimits, limits_from: str, sigma_m: float | None
) -> ProcedureVerdict:
    """Return the verdict on a base or a workpiece placed by its tags."""
    worst = max(range(len(found.tags)), key=lambda row: found.after_m[row])
    before, after = _rms_of(found.before_m) if found.before_m else None, _rms_of(found.after_m)
    spare = "" if sigma_m is None else "How good a tag is was taken as stated (sigma_m)."
    turned = (
        ()
        if found.turned_rad is None
        else (state_figure("RMS of what the attitudes miss", found.turned_rad, "rad"),)
    )
    return ProcedureVerdict(
        (
            _uncertainty_figure("origin of the frame", found.origin_uncertainty, "m", limits.origin_m),
            _uncertainty_figure("turn of the frame", found.angle_uncertainty, "rad", limits.angle_rad),
            state_figure(
                make_message("largest distance of a tag, {tags}, no accuracy", tags=found.tags[worst]),
                found.after_m[worst],
                "m",
            ),
            *turned,
        ),
        limits_from=limits_from,
        not_verified=(
            "No tag was kept back to check the place with.",
            *((spare,) if spare else ()),
            "How well the frame that the measured tags are given in is known.",
        ),
        remarks=(make_message("tags of one path only: {unpaired}", unpaired=", ".join(found.unpaired)),)
        if found.unpaired
        else (),
        changes=(ValueChange("RMS distance of the tags", before, after, "m"),),
    )


def tag_remarks(found: PlacedTags, pairs: TagPairs) -> tuple[str, ...]:
    """Return what the distances of the tags do not show by themselves."""
    if found.method == "six_points":  # touched anywhere on the same faces
        return ()
    return point_remarks(found.tags, pairs.one.to_positions(), pairs.other.to_positions())


def _uncertainty_figure(name: str, how: SpatialUncertainty, unit: str, limit: float) -> Characteristic:
    """Judge an expanded uncertainty in space."""
    rule = make_message(
        "PASS if U (k = {coverage:.2f}, 95 %, in space) <= L, else UNDECIDED: measure more",
        coverage=how.coverage,
    )
    word = PASS if how.expanded_uncertainty <= limit else UNDECIDED
    return Characteristic(name, how.expanded_uncertainty, unit, how.standard, how.coverage, limit, word, rule)


def _rms_of(distances: tuple[float, ...]) -> float:
    return math.sqrt(sum(d * d for d in distances) / len(distances))
