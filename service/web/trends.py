"""Two runs side by side: what was set, what was found, and whether the difference is more than the uncertainty."""

import asyncio
import math
from collections.abc import Mapping
from typing import TYPE_CHECKING, Annotated, Any

from fastapi import APIRouter, Path, Request
from pydantic import BaseModel, ConfigDict

from cellcal.service.configuration.cell_file import CellConfig
from cellcal.service.web.dependencies import Who, app_context
from cellcal.service.web.response_models import FreeValue
from cellcal.service.web.worker import open_journal, store_of

if TYPE_CHECKING:
    from cellcal.service.record.run_store import RunView

router = APIRouter()
RunId = Annotated[str, Path(max_length=128)]
COVERAGE = 2.0


class _TrendModel(BaseModel):
    model_config = ConfigDict(frozen=True)


class RunHead(_TrendModel):
    """The identity of a run."""

    run_id: str
    procedure: str
    started_utc: str
    state: str
    word: str
    robot_serial: str


class SettingChange(_TrendModel):
    """One setting that is not the same in both."""

    name: str
    before: FreeValue
    after: FreeValue


class FigureChange(_TrendModel):
    """One figure in both runs; None where a run does not have it.

    ``expanded_uncertainty`` is that of the difference (k = 2), as if the runs had nothing in common; None where
    either of the figures has none.
    """

    name: str
    unit: str
    before: float | None
    after: float | None
    difference: float | None
    expanded_uncertainty: float | None
    changed: bool | None  # more than that; None where unknown


class RunsCompared(_TrendModel):
    """One run against another."""

    before: RunHead
    after: RunHead
    settings: list[SettingChange]
    figures: list[FigureChange]


@router.get("/runs/{run_id}/against/{other_id}")
async def compare_with(run_id: RunId, other_id: RunId, request: Request, who: Who) -> RunsCompared:
    """Return what differs between two runs; the one that was begun first is ``before``."""
    del who
    return await asyncio.to_thread(compare_runs, app_context(request).config, run_id, other_id)


def compare_runs(config: CellConfig, run_id: str, other_id: str) -> RunsCompared:
    """Compare two runs of a cell.

    Raises
    ------
    StoreError
        There is no such run.
    """
    with open_journal(config) as journal:
        store = store_of(journal)
        views = [store.find_run(store.resolve_run_id(name)) for name in (run_id, other_id)]
        order = [
            event.run_id for event in journal.list_events()
        ]  # and not by time: a clock may have been set
    before, after = sorted(views, key=lambda view: order.index(view.run_id))
    return RunsCompared(
        before=_run_head(before),
        after=_run_head(after),
        settings=_changed_settings(before.spec, after.spec),
        figures=_figure_changes(before, after),
    )


def _run_head(view: "RunView") -> RunHead:
    devices = view.cell["devices"]
    return RunHead(
        run_id=view.run_id,
        procedure=view.procedure,
        started_utc=view.started_utc,
        state=view.state,
        word=str((view.judgement or {}).get("word", "")),
        robot_serial=devices[0]["identity"]["serial"] if devices else "",
    )


def _changed_settings(before: Any, after: Any, name: str = "") -> list[SettingChange]:
    """Return the leaves that differ, named by their path."""
    if isinstance(before, Mapping) and isinstance(after, Mapping):
        keys = [*before, *(key for key in after if key not in before)]
        inner = [
            _changed_settings(before.get(k), after.get(k), f"{name}.{k}" if name else str(k)) for k in keys
        ]
        return [setting for each in inner for setting in each]
    return [] if before == after else [SettingChange(name=name, before=before, after=after)]


def _figure_changes(before: "RunView", after: "RunView") -> list[FigureChange]:
    old, new = _by_name(before), _by_name(after)
    return [
        _figure_change(key, old.get(key), new.get(key))
        for key in [*new, *(key for key in old if key not in new)]
    ]


def _by_name(view: "RunView") -> dict[tuple[str, str], Mapping[str, Any]]:
    characteristics = (view.judgement or {}).get("characteristics", [])
    return {(figure["name"], figure["unit"]): figure for figure in characteristics}


def _figure_change(
    key: tuple[str, str], old: Mapping[str, Any] | None, new: Mapping[str, Any] | None
) -> FigureChange:
    name, unit = key
    if old is None or new is None:
        values = [None if figure is None else float(figure["value"]) for figure in (old, new)]
        return FigureChange(
            name=name, unit=unit, before=values[0], after=values[1],
            difference=None, expanded_uncertainty=None, changed=None,
        )  # fmt: skip
    difference = float(new["value"]) - float(old["value"])
    spreads = [_standard_uncertainty(old), _standard_uncertainty(new)]
    doubt = None if None in spreads else COVERAGE * math.hypot(*(s for s in spreads if s is not None))
    return FigureChange(
        name=name, unit=unit, before=old["value"], after=new["value"], difference=difference,
        expanded_uncertainty=doubt, changed=None if doubt is None else abs(difference) > doubt,
    )  # fmt: skip


def _standard_uncertainty(figure: Mapping[str, Any]) -> float | None:
    """Return a figure's standard uncertainty; None of one that is an uncertainty itself, or has none."""
    u, k = float(figure["standard_uncertainty"]), float(figure["coverage"])
    return None if u == 0.0 or math.isclose(float(figure["value"]), k * u, rel_tol=1e-9) else u
