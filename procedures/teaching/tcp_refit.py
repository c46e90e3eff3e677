"""The tip of a tool once more, from other touches of the pin: what if, of a finished run."""

from collections.abc import Mapping, Sequence
from functools import partial
from typing import Any

import numpy as np
from pydantic import TypeAdapter

from cellcal.calibration.geometry import Array, Pose
from cellcal.calibration.points.tool_point import ToolPoint, locate_tool_point
from cellcal.procedures.refit import (
    FitPoint,
    FittedValue,
    PointMiss,
    Refit,
    RefitResult,
    Use,
    used_values,
    values_of,
)
from cellcal.procedures.run_history import Finding
from cellcal.procedures.steps.teach import TaughtPose
from cellcal.procedures.teaching.tcp_touches import STRAY, STRAY_SIGMAS, TouchDecision

LEAST_TOUCHES = 3
_TAUGHT: TypeAdapter[TaughtPose] = TypeAdapter(TaughtPose)
_JUDGED: TypeAdapter[TouchDecision] = TypeAdapter(TouchDecision)


def refit_touches(spec: Any, findings: Sequence[Finding]) -> Refit:
    """Return the touches of a run, those taught again included; its axes come from other poses and stay."""
    found = values_of(findings)
    taught = {step: value for step, value in found.items() if step.startswith("touch")}
    aside = _set_aside(tuple(taught), found)
    touches = tuple(_TAUGHT.validate_python(value).base_flange for value in taught.values())
    points = tuple(FitPoint(step, step not in aside, aside.get(step, "")) for step in taught)
    return Refit("touch", points, LEAST_TOUCHES, "tip", partial(_fit_again, touches, spec.arm_sigma_m))


def _set_aside(steps: tuple[str, ...], found: Mapping[str, Any]) -> dict[str, str]:
    """Return which touches were taught again, and why: every judgement follows its touch."""
    standing: list[str] = []
    aside: dict[str, str] = {}
    anew = -1
    for count, step in enumerate(steps, 1):
        if anew >= 0:
            standing[anew] = step
        else:
            standing.append(step)
        judged = _JUDGED.validate_python(found[f"judge the touches {count}"])
        anew = judged.touch if judged.do == "anew" else -1
        if anew >= 0:
            aside[standing[anew]] = judged.why
    return aside


def _fit_again(touches: tuple[Pose, ...], arm_sigma_m: float, use: Use) -> RefitResult:
    tip = locate_tool_point(used_values(touches, use), arm_sigma_m=arm_sigma_m)
    sizes = _misses_m(touches, tip)
    expected_m = max(np.sqrt(3.0) * tip.rms_m, 1e-9)
    used = np.flatnonzero(use)
    stray = used[tip.stray_touch] if tip.stray_probability < STRAY else -1
    misses = tuple(
        PointMiss(
            float(size),
            float(size / expected_m),
            bool(k == stray or (not use[k] and size > STRAY_SIGMAS * expected_m)),
        )
        for k, size in enumerate(sizes)
    )
    values = (FittedValue(axis, "m", v) for axis, v in zip("xyz", tip.tip_in_flange_m, strict=True))
    return RefitResult(misses, tip.tip_u_in_space_m, tuple(values))


def _misses_m(touches: tuple[Pose, ...], tip: ToolPoint) -> Array:
    """Return how far from the pin each touch puts the tip (N,) [m]."""
    at = [pose.rotation_matrix() @ np.array(tip.tip_in_flange_m) + pose.position_m for pose in touches]
    sizes: Array = np.linalg.norm(np.array(at) - np.array(tip.pin_in_base_m), axis=1)
    return sizes
