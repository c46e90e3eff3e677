"""From a run's id to its review: read from the journal once, asked many times."""

from collections import OrderedDict
from collections.abc import Sequence
from typing import Any

import numpy as np

from cellcal.service.configuration.cell_file import CellConfig
from cellcal.service.legacy_texts import remember_recorded_texts
from cellcal.service.record.journal_files import open_journal
from cellcal.service.record.run_store import RunStore, RunView
from cellcal.service.review.arm_review import ArmSeries, chosen_rows, review_arm, series_of, spread_of
from cellcal.service.review.fit_review import FitSeries, fit_of_run, review_fit
from cellcal.service.review.review_models import CheckPoint, Review, Validation

CALIBRATION, ACCURACY = "robot_calibration", "accuracy_check"
_MOST_CACHED = 4


class Reviewer:
    """Remembers the series of the runs that were looked at last."""

    def __init__(self, config: CellConfig) -> None:
        self._config = config
        self._cache: OrderedDict[str, tuple[bytes, Any]] = OrderedDict()

    def review_run(self, run_id: str, used: Sequence[str] | None = None) -> Review:
        """Return the review of a run; ``used`` are the readings of a what-if.

        Raises
        ------
        CellError
            There is no such run; it has no result; the readings do not determine one.
        """
        series = self.load_series(run_id)
        if isinstance(series, ArmSeries):
            return review_arm(series, chosen_rows(series.steps, used))
        if isinstance(series, FitSeries):
            return review_fit(series, chosen_rows(series.steps, used))
        found: Review = series
        return found

    def load_series(self, run_id: str) -> Any:
        """Return what was measured in a run."""
        with open_journal(self._config) as journal:
            head = journal.head_hash()
            if self._cache.get(run_id, (b"", None))[0] == head:
                return self._cache[run_id][1]
            store = RunStore(journal)
            view = store.find_run(store.resolve_run_id(run_id))
        found = _read_series(view)
        self._cache[run_id] = head, found
        while len(self._cache) > _MOST_CACHED:
            self._cache.popitem(last=False)
        return found


def _read_series(view: RunView) -> Any:
    if not view.has_templates:
        remember_recorded_texts([view.result, view.judgement, [found.value for found in view.past.findings]])
    if view.procedure == CALIBRATION and isinstance(view.result, dict):
        return series_of(view)
    fit = fit_of_run(view)
    if fit is not None:
        return fit
    validation = _accuracy_validation(view.result) if view.procedure == ACCURACY else None
    return Review(view.run_id, "space", signed=True, least=0, validation=validation)


def _accuracy_validation(result: Any) -> Validation | None:
    """Return an accuracy check by both models: its poses took part in the fit of neither."""
    if not isinstance(result, dict) or not result.get("identified"):
        return None
    tests = [result[model]["poses"] for model in ("nominal", "identified")]
    before, after = (np.array([float(pose["ap_m"]) for pose in poses]) for poses in tests)
    points = tuple(
        CheckPoint(f"pose {k}", float(b), float(a))
        for k, (b, a) in enumerate(zip(before, after, strict=True), 1)
    )
    return Validation(spread_of(before, len(before)), spread_of(after, len(after)), points)
