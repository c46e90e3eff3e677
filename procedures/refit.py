"""What if: the fit of a finished run once more, with other points. By the procedure's own solve, kept nowhere.

What the run found, its verdict, its certificate and its journal stay as they are.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from cellcal.calibration.geometry import Pose, log_rotation
from cellcal.calibration.message import make_message
from cellcal.procedures.run import ProcedureError
from cellcal.procedures.run_history import Finding

Along = Literal["wire", "space", "touch", "place"]
Use = tuple[bool, ...]  # of every point, in their order
STANDS_OUT = 4.5  # deviations
MEASURED_AGAIN = "contradicted by the others; measured again"
LEFT_OUT = "contradicted by the others; the fit left it out"


class RefitError(ProcedureError):
    """These points do not tell what the run was about."""

    code = "review"


class TooFewPointsError(RefitError):
    """Fewer points than the fit takes."""

    code = "review.too_few"

    def __init__(self, count: int, least: int) -> None:
        super().__init__(
            make_message("{count} points are too few for this fit.", count=count),
            remedy=make_message("Keep {least} or more.", least=least),
        )


@dataclass(frozen=True, slots=True)
class FitPoint:
    """One point of a fit by the step that measured it, whether the run used it, and why not."""

    step: str
    used: bool = True
    reason: str = ""


@dataclass(frozen=True, slots=True)
class PointMiss:
    """The distance of a point from the fit; along a wire with its sign, measured minus computed."""

    size_m: float
    deviations: float  # of what it may be
    outlier: bool


@dataclass(frozen=True, slots=True)
class FittedValue:
    """One figure of what was fitted."""

    name: str
    unit: str
    value: float


@dataclass(frozen=True, slots=True)
class RefitResult:
    """A fit of some points: what every point misses it by, those left out too, and what it says."""

    misses: tuple[PointMiss, ...]
    u_m: float  # of what the run is about, ``u_of`` in `Refit`
    values: tuple[FittedValue, ...]


@dataclass(frozen=True, slots=True)
class Refit:
    """The points of a run's fit, and the fit itself.

    ``solve`` raises a CellError where the points told to it do not determine the result.
    """

    along: Along
    points: tuple[FitPoint, ...]
    least: int
    u_of: Literal["tip", "origin", "hook"]
    solve: Callable[[Use], RefitResult]

    @property
    def recorded_use(self) -> Use:
        """Which points the run used."""
        return tuple(point.used for point in self.points)

    def fit_again(self, use: Use) -> RefitResult:
        """Fit exactly the points told.

        Raises
        ------
        TooFewPointsError
            Fewer than ``least``.
        CellError
            They do not determine the result; the message says why.
        """
        if sum(use) < self.least:
            raise TooFewPointsError(sum(use), self.least)
        return self.solve(use)


def values_of(findings: Sequence[Finding]) -> Mapping[str, Any]:
    """Return the findings of a run by their steps."""
    return {finding.step: finding.value for finding in findings}


def pose_values(pose: Pose, recorded: Pose, owner: str = "") -> tuple[FittedValue, ...]:
    """Return where a frame is, and by how much it is turned from the recorded one; ``owner`` is named before."""
    turned = float(np.linalg.norm(log_rotation(recorded.rotation_matrix().T @ pose.rotation_matrix())))
    before = f"{owner}: " if owner else ""
    places = (FittedValue(f"{before}{axis}", "m", v) for axis, v in zip("xyz", pose.position_m, strict=True))
    what = (
        make_message("{owner}: turned from the recorded result", owner=owner)
        if owner
        else "turned from the recorded result"
    )
    return (*places, FittedValue(what, "rad", turned))


def misses_in_space(gaps_m: Sequence[Sequence[float]], sigma_m: float, limit: float) -> tuple[PointMiss, ...]:
    """Return distances from gaps (n, k) [m] whose coordinates have one deviation; ``limit`` is of the deviations."""
    sizes = [math.hypot(*gap) for gap in gaps_m]
    return tuple(PointMiss(size, size / sigma_m, size > limit * sigma_m) for size in sizes)


def misses_of_lengths(residuals_m: Sequence[float], use: Use, worst: int) -> tuple[PointMiss, ...]:
    """Return misses along a wire (n,) [m] over the RMS of those used; ``worst`` stands out by the fit, -1: none."""
    used = np.array(used_values(residuals_m, use))
    rms_m = max(float(np.sqrt(np.mean(used**2))), 1e-9)
    return tuple(
        PointMiss(
            float(size),
            abs(float(size)) / rms_m,
            k == worst or (not use[k] and abs(size) > STANDS_OUT * rms_m),
        )
        for k, size in enumerate(residuals_m)
    )


def used_values(values: Sequence[Any], use: Use) -> tuple[Any, ...]:
    """Return those that are used."""
    return tuple(value for value, used in zip(values, use, strict=True) if used)
