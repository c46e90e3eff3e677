"""What results are judged by: three classes of limits, each figure editable by an engineer in the spec.

The figures are typical practice, not a standard's. Where a specification of the part exists, it goes into the
spec in their place.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Literal, TypeVar

from pydantic import Field

from cellcal.calibration.message import make_message
from cellcal.procedures.setting_texts import describe_setting

AccuracyClass = Literal["A", "B", "C"]  # precise, general, coarse
SELECTABLE_SHARE = 3.0  # a class is in reach where the predicted U is at most its limit / 3

Length = Annotated[float, Field(gt=0, le=1, allow_inf_nan=False)]
Angle = Annotated[float, Field(gt=0, le=1, allow_inf_nan=False)]
_L = TypeVar("_L")


@dataclass(frozen=True, slots=True)
class ToolLimits:
    """Of a tool frame: expanded uncertainty of the tip, largest residual, expanded uncertainty of the axes."""

    tip_m: Annotated[
        Length,
        describe_setting("Place of the tip", "Largest uncertainty of the tip (k = 2).", "limits", unit="m"),
    ]
    residual_m: Annotated[
        Length,
        describe_setting(
            "Worst touch", "Largest distance of one touch from the common point.", "limits", unit="m"
        ),
    ]
    orientation_rad: Annotated[
        Angle,
        describe_setting(
            "Direction of the axes",
            "Largest uncertainty of the directions of the tool's axes (k = 2).",
            "limits",
            unit="rad",
        ),
    ]


@dataclass(frozen=True, slots=True)
class FrameLimits:
    """Of a user frame, a fixture or a base: expanded uncertainty of origin and angle."""

    origin_m: Annotated[
        Length,
        describe_setting(
            "Place of the origin", "Largest uncertainty of the origin (k = 2).", "limits", unit="m"
        ),
    ]
    angle_rad: Annotated[
        Angle,
        describe_setting(
            "Direction of the axes",
            "Largest uncertainty of the directions of the axes (k = 2).",
            "limits",
            unit="rad",
        ),
    ]


@dataclass(frozen=True, slots=True)
class PoseLimits:
    """Of an accuracy check: positional accuracy AP and repeatability RP at the worst pose."""

    ap_m: Annotated[
        Length,
        describe_setting(
            "Accuracy at the worst pose",
            "Largest positional accuracy AP following ISO 9283.",
            "limits",
            unit="m",
        ),
    ]
    rp_m: Annotated[
        Length,
        describe_setting(
            "Repeatability at the worst pose",
            "Largest repeatability RP following ISO 9283.",
            "limits",
            unit="m",
        ),
    ]


@dataclass(frozen=True, slots=True)
class MasteringLimits:
    """Of the zero of one axis whose reference was lost; whole turns are exact or refused."""

    axis_rad: Annotated[
        Angle,
        describe_setting(
            "Zero of an axis",
            "Largest uncertainty of the zero of an axis whose reference was lost (k = 2).",
            "limits",
            unit="rad",
        ),
    ]


@dataclass(frozen=True, slots=True)
class CheckLimits:
    """Of a calibrated robot: RMS at poses that were not fitted."""

    check_rms_m: Annotated[
        Length,
        describe_setting(
            "Error at check poses",
            "Largest RMS error at poses that were not used for the fit.",
            "limits",
            unit="m",
        ),
    ]


TOOL: Mapping[AccuracyClass, ToolLimits] = {
    "A": ToolLimits(0.00015, 0.0003, math.radians(0.05)),
    "B": ToolLimits(0.0004, 0.0008, math.radians(0.2)),
    "C": ToolLimits(0.001, 0.002, math.radians(0.5)),
}
FRAME: Mapping[AccuracyClass, FrameLimits] = {
    "A": FrameLimits(0.0001, math.radians(0.01)),
    "B": FrameLimits(0.0003, math.radians(0.05)),
    "C": FrameLimits(0.001, math.radians(0.2)),
}
POSE: Mapping[AccuracyClass, PoseLimits] = {
    "A": PoseLimits(0.0003, 0.0001),
    "B": PoseLimits(0.001, 0.0003),
    "C": PoseLimits(0.003, 0.001),
}
MASTERING: Mapping[AccuracyClass, MasteringLimits] = {
    "A": MasteringLimits(math.radians(0.005)),
    "B": MasteringLimits(math.radians(0.02)),
    "C": MasteringLimits(math.radians(0.05)),
}
CHECK: Mapping[AccuracyClass, CheckLimits] = {
    "A": CheckLimits(0.00015),
    "B": CheckLimits(0.0004),
    "C": CheckLimits(0.001),
}


def limits_in_force(table: Mapping[AccuracyClass, _L], accuracy_class: AccuracyClass, own: _L | None) -> _L:
    """Return the engineer's own limits where there are any, else those of the class."""
    return table[accuracy_class] if own is None else own


def limits_text(accuracy_class: AccuracyClass, own: object) -> str:
    """Return in words where the limits come from."""
    return (
        make_message("limits of class {accuracy_class}", accuracy_class=accuracy_class)
        if own is None
        else "limits set by an engineer in the settings"
    )


def is_in_reach(predicted_expanded: float, limit: float) -> bool:
    """Return whether a limit may be chosen: the predicted U is at most a third of it."""
    return predicted_expanded <= limit / SELECTABLE_SHARE
