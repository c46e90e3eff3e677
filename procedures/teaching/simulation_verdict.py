"""What a calibrated simulation may claim: how well it meets tags of the real cell, before and after."""

import math

from cellcal.calibration.points.tag_placement import Known, PlacedTags
from cellcal.calibration.points.tag_robot import SimulatedRobot
from cellcal.procedures.limits import CheckLimits, FrameLimits, ToolLimits
from cellcal.procedures.verdict import (
    PASS,
    UNDECIDED,
    Change,
    Characteristic,
    Verdict,
    enough,
    judged,
    stated,
)


def robot_verdict(found: SimulatedRobot, check: CheckLimits, tool: ToolLimits, limits_from: str) -> Verdict:
    """Return the verdict on a simulated robot's zero positions and tool."""
    freedom = max(3.0 * found.tags - 9.0 - len(found.values), 1.0)
    error_m = found.after.rmse_m
    return Verdict(
        (
            judged(
                "RMS at tags that were not fitted",
                error_m,
                "m",
                u=error_m / math.sqrt(2.0 * freedom),
                limit=check.check_rms_m,
            ),
            _known("place of the tool", found.tool, "m", tool.tip_m),
            enough(
                "tags that were not fitted are met better than before",
                found.better,
                "PASS if the RMS after is below that before, else UNDECIDED: the tags do not show these errors",
                found=error_m,
                limit=found.before.rmse_m,
                unit="m",
            ),
            stated("RMS of the fit itself, no accuracy", found.fit_rms_m, "m"),
        ),
        limits_from=limits_from,
        not_verified=(
            *(f"{one.name}: hidden behind {one.partner}; {one.cure}" for one in found.unknowable),
            "The tool's axes: places of one target do not tell them.",
            "Postures far from the tags.",
        ),
        remarks=(
            *found.remarks,
            *(
                (f"tags that do not belong and were left out: {', '.join(found.rejected)}",)
                if found.rejected
                else ()
            ),
            *((f"tags of one path only: {', '.join(found.unpaired)}",) if found.unpaired else ()),
        ),
        changes=(
            Change("RMS at tags that were not fitted", found.before.rmse_m, error_m, "m"),
            *(Change(value.name, 0.0, value.value, value.unit) for value in found.values),
        ),
    )


def placed_verdict(
    found: PlacedTags, limits: FrameLimits, limits_from: str, sigma_m: float | None
) -> Verdict:
    """Return the verdict on a base or a workpiece placed by its tags."""
    worst = max(range(len(found.tags)), key=lambda row: found.after_m[row])
    before, after = _rms(found.before_m) if found.before_m else None, _rms(found.after_m)
    spare = "" if sigma_m is None else "How good a tag is was taken as stated (sigma_m)."
    turned = (
        ()
        if found.turned_rad is None
        else (stated("RMS of what the attitudes miss", found.turned_rad, "rad"),)
    )
    return Verdict(
        (
            _known("origin of the frame", found.origin, "m", limits.origin_m),
            _known("turn of the frame", found.angle, "rad", limits.angle_rad),
            stated(f"largest distance of a tag, {found.tags[worst]}, no accuracy", found.after_m[worst], "m"),
            *turned,
        ),
        limits_from=limits_from,
        not_verified=(
            "No tag was kept back to check the place with.",
            *((spare,) if spare else ()),
            "How well the frame that the measured tags are given in is known.",
        ),
        remarks=(f"tags of one path only: {', '.join(found.unpaired)}",) if found.unpaired else (),
        changes=(Change("RMS distance of the tags", before, after, "m"),),
    )


def _known(name: str, how: Known, unit: str, limit: float) -> Characteristic:
    """Judge an expanded uncertainty in space."""
    rule = f"PASS if U (k = {how.coverage:.2f}, 95 %, in space) <= L, else UNDECIDED: measure more"
    word = PASS if how.expanded <= limit else UNDECIDED
    return Characteristic(name, how.expanded, unit, how.standard, how.coverage, limit, word, rule)


def _rms(distances: tuple[float, ...]) -> float:
    return math.sqrt(sum(d * d for d in distances) / len(distances))
