"""A user frame once more, from other points of those touched: what if, of a finished run."""

from collections.abc import Mapping, Sequence
from functools import partial
from typing import Any

from pydantic import TypeAdapter

from cellcal.calibration.geometry import Pose
from cellcal.calibration.message import make_message
from cellcal.calibration.points.frame_design import FIRST_FIXED
from cellcal.calibration.points.frames import TaughtFrame
from cellcal.procedures.refit import (
    MEASURED_AGAIN,
    STANDS_OUT,
    FitPoint,
    Refit,
    RefitError,
    RefitResult,
    TooFewPointsError,
    Use,
    misses_in_space,
    pose_values,
    used_values,
    values_of,
)
from cellcal.procedures.run_history import Finding
from cellcal.procedures.steps.meters import tip_in_base
from cellcal.procedures.steps.teach import TaughtPose
from cellcal.procedures.teaching.frame_touches import (
    ABOVE_STEP,
    ANEW_STEP,
    ORIGIN_STEP,
    Y_SIDE_STEP,
    FrameRules,
    FrameTouch,
    construct_frame,
    role_of,
)

LEAST = 3
_TAUGHT: TypeAdapter[TaughtPose] = TypeAdapter(TaughtPose)
_FRAME: TypeAdapter[TaughtFrame] = TypeAdapter(TaughtFrame)


def refit_frame(spec: Any, findings: Sequence[Finding]) -> Refit:
    """Return the touches of a run, those touched anew included."""
    found = values_of(findings)
    touched, aside = _touches_of(found)
    above = _TAUGHT.validate_python(found[ABOVE_STEP]).base_flange if spec.check_above else None
    recorded = _FRAME.validate_python(found["construct the frame"]).base_frame
    points = tuple(
        FitPoint(one.step, one.step not in aside, MEASURED_AGAIN if one.step in aside else "")
        for one in touched
    )
    return Refit(
        "place", points, LEAST, "origin", partial(_solve_frame, spec.frame_rules, touched, above, recorded)
    )


def _touches_of(found: Mapping[str, Any]) -> tuple[tuple[FrameTouch, ...], set[str]]:
    """Return all touches in their order, and which were set aside: a touch anew stands for the one before it."""
    touched: list[FrameTouch] = []
    aside: set[str] = set()
    for step, value in found.items():
        role = role_of(step)
        if step.startswith(f"{ANEW_STEP} "):
            role = touched[-1].role
            aside.add(touched[-1].step)
        if role is not None:
            touched.append(FrameTouch(step, role, _TAUGHT.validate_python(value).base_flange))
    return tuple(touched), aside


def _solve_frame(
    rules: FrameRules, touched: Sequence[FrameTouch], above: Pose | None, recorded: Pose, use: Use
) -> RefitResult:
    used = used_values(touched, use)
    for step, role in ((ORIGIN_STEP, "origin"), (Y_SIDE_STEP, "in_plane")):
        if not any(one.role == role for one in used):
            raise RefitError(
                make_message("the frame cannot do without {step!r}.", step=step),
                remedy="Leave another point out, or touch this one anew in a new run.",
            )
    if not any(one.role == "on_x" for one in used):
        raise TooFewPointsError(len(used), LEAST)
    taught = construct_frame(rules, used, above)
    back = taught.base_frame.inverse()
    gaps = [
        tip_in_base(back @ one.base_flange, rules.tip_in_flange_m)[FIRST_FIXED[one.role] :] for one in touched
    ]
    misses = misses_in_space(gaps, rules.goal.sigma_m, STANDS_OUT)
    return RefitResult(misses, 2.0 * max(taught.origin_sigma_m), pose_values(taught.base_frame, recorded))
