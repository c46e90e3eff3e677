"""A tool's touches looked at again: what each misses the pin by, and the tip without, or with, some of them."""

from dataclasses import dataclass

import numpy as np
from pydantic import TypeAdapter

from calibration.geometry import Array, Pose
from calibration.points.tool_point import ToolPoint, locate_tool_point
from procedures.steps.teach import TaughtPose
from procedures.teaching.tcp_touches import STRAY, STRAY_SIGMAS
from service.runs.store import RunView
from service.web.arm_review import Chosen
from service.web.review_shapes import Review, ReviewError, ReviewPoint

_TAUGHT: TypeAdapter[TaughtPose] = TypeAdapter(TaughtPose)
LEAST_TOUCHES = 3


@dataclass(frozen=True, eq=False)
class TouchSeries:
    """All touches of one pin, those set aside too."""

    run_id: str
    steps: tuple[str, ...]
    base_flange: tuple[Pose, ...]
    signed: Chosen
    reasons: dict[str, str]


def touches_of(view: RunView) -> TouchSeries:
    """Read the touches of a finished run.

    Raises
    ------
    ReviewError
        It has no result.
    """
    if not isinstance(view.result, dict) or "tip" not in view.result:
        raise ReviewError(
            f"run {view.run_id} has no result to look at.", remedy="Resume it, or start it anew."
        )
    taught = {
        found.step: _TAUGHT.validate_python(found.value).base_flange
        for found in view.past.findings
        if found.step.startswith("touch") and isinstance(found.value, dict) and "base_flange" in found.value
    }
    reasons = {str(told["step"]): str(told["reason"]) for told in view.result["set_aside"]}
    signed = np.array([step not in reasons for step in taught])
    return TouchSeries(view.run_id, tuple(taught), tuple(taught.values()), signed, reasons)


def review_touches(series: TouchSeries, chosen: Chosen | None) -> Review:
    """Judge a tool's tip; ``chosen`` tells the touches to use, None those that the run used."""
    kept = series.signed if chosen is None else chosen
    if int(kept.sum()) < LEAST_TOUCHES:
        raise ReviewError(
            f"{int(kept.sum())} touches cannot locate a tip.",
            remedy=f"Keep {LEAST_TOUCHES} or more.",
            code="review.too_few",
        )
    tip, signed = _tip(series, kept), _tip(series, series.signed)
    misses = _misses(series, tip)
    expected_m = max(np.sqrt(3.0) * tip.rms_m, 1e-9)
    used = np.flatnonzero(kept)
    stray = used[tip.stray_touch] if tip.stray_probability < STRAY else -1
    points = tuple(
        ReviewPoint(
            step, bool(kept[i]),
            bool(i == stray or (not kept[i] and misses[i] > STRAY_SIGMAS * expected_m)),
            float(misses[i]), float(misses[i] / expected_m), series.reasons.get(step, ""),
        )
        for i, step in enumerate(series.steps)
    )  # fmt: skip
    return Review(
        run_id=series.run_id,
        along="touch",
        signed=bool((kept == series.signed).all()),
        least=LEAST_TOUCHES,
        points=points,
        rms_m=float(np.sqrt(np.mean(misses[kept] ** 2))),
        max_m=float(misses[kept].max()),
        u_m=tip.tip_u_in_space_m,
        signed_rms_m=float(np.sqrt(np.mean(_misses(series, signed)[series.signed] ** 2))),
        signed_u_m=signed.tip_u_in_space_m,
    )


def _tip(series: TouchSeries, kept: Chosen) -> ToolPoint:
    return locate_tool_point([pose for pose, used in zip(series.base_flange, kept, strict=True) if used])


def _misses(series: TouchSeries, tip: ToolPoint) -> Array:
    """Return how far from the pin each touch puts the tip (N,) [m]."""
    at = [pose.rotation() @ np.array(tip.tip_in_flange_m) + pose.position_m for pose in series.base_flange]
    misses: Array = np.linalg.norm(np.array(at) - np.array(tip.pin_in_base_m), axis=1)
    return misses
