"""A fit of points looked at again: what each misses it by, and what it would be without, or with, some of them."""

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from pydantic import TypeAdapter

from cellcal.procedures.catalogue import CATALOGUE
from cellcal.procedures.refit import Refit, RefitResult
from cellcal.service.record.run_store import RunView
from cellcal.service.review.arm_review import Chosen
from cellcal.service.review.review_models import Review, ReviewPoint, ReviewValue


@dataclass(frozen=True)
class FitSeries:
    """The points of one run's fit."""

    run_id: str
    refit: Refit

    @cached_property
    def signed_fit(self) -> RefitResult:
        """The fit of the points that the run used."""
        return self.refit.fit_again(self.refit.recorded_use)

    @property
    def steps(self) -> tuple[str, ...]:
        """The names of the points."""
        return tuple(point.step for point in self.refit.points)


def fit_of_run(view: RunView) -> FitSeries | None:
    """Return the points of a finished run's fit; None where it has no result, or its procedure fits no points."""
    entry = CATALOGUE[view.procedure]
    if entry.refit is None or not isinstance(view.result, dict):
        return None
    codec: TypeAdapter[Any] = TypeAdapter(entry.spec_type)
    refit = entry.refit(codec.validate_python(view.spec), view.past.findings)
    return None if refit is None else FitSeries(view.run_id, refit)


def review_fit(series: FitSeries, chosen: Chosen | None) -> Review:
    """Judge a fit; ``chosen`` tells the points to use, None those that the run used."""
    refit, signed = series.refit, series.signed_fit
    use = refit.recorded_use if chosen is None else tuple(bool(used) for used in chosen)
    found = signed if use == refit.recorded_use else refit.fit_again(use)
    points = tuple(
        ReviewPoint(point.step, used, miss.outlier, miss.size_m, miss.deviations, point.reason)
        for point, used, miss in zip(refit.points, use, found.misses, strict=True)
    )
    sizes = [abs(point.residual_m) for point in points if point.used]
    return Review(
        run_id=series.run_id,
        along=refit.along,
        signed=use == refit.recorded_use,
        least=refit.least,
        points=points,
        rms_m=_root_mean_square(sizes),
        max_m=max(sizes),
        u_m=found.u_m,
        u_of=refit.u_of,
        signed_rms_m=_root_mean_square(
            [m.size_m for m, used in zip(signed.misses, refit.recorded_use, strict=True) if used]
        ),
        signed_u_m=signed.u_m,
        values=tuple(
            ReviewValue(now.name, now.unit, now.value, then.value)
            for now, then in zip(found.values, signed.values, strict=True)
        ),
    )


def _root_mean_square(sizes_m: list[float]) -> float:
    return float(np.sqrt(np.mean(np.square(sizes_m))))
