"""What robots were found to be, version by version, and how their figures went over the years. Reading only."""

import asyncio
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from fastapi import APIRouter, Query, Request
from pydantic import BaseModel, ConfigDict

from cellcal.service.configuration.cell_file import CellConfig
from cellcal.service.engineering.parameters.parameter_set import ParameterSet, ParameterValue
from cellcal.service.engineering.parameters.parameter_sets import (
    FOLDER,
    ParameterChange,
    ParameterSets,
    compare_sets,
)
from cellcal.service.legacy_texts import remember_recorded_texts
from cellcal.service.web.dependencies import Who, app_context
from cellcal.service.web.worker import open_journal, store_of

if TYPE_CHECKING:
    from cellcal.service.record.run_store import RunView

router = APIRouter()

Named = Annotated[str, Query(min_length=1, max_length=64)]
Version = Annotated[int, Query(ge=1)]
Side = Literal["before", "after"]


class ParametersModel(BaseModel):
    """Base of the responses: numbers are SI."""

    model_config = ConfigDict(frozen=True, from_attributes=True)


class SetHead(ParametersModel):
    """One version of a robot's parameters, without its values."""

    robot_serial: str
    version: int
    model: str
    made_at: str
    made_by: str
    source: str
    note: str
    rolls_back_to: int
    sha256: str


class SetParameter(ParametersModel):
    """One deviation from the nominal model."""

    name: str
    unit: Literal["rad", "m", "rad/m", "1"]
    value: float
    standard_uncertainty: float | None
    determined: bool  # False: assumed, and no result of the measurement


class WholeSet(SetHead):
    """One version with its values."""

    parameters: list[SetParameter]


class ParameterDifference(ParametersModel):
    """One parameter in two versions; None where a version does not have it."""

    name: str
    unit: str
    before: float | None
    after: float | None
    difference: float
    deviations: float | None  # the difference in combined standard uncertainties
    undetermined: list[Side]  # where the value is assumed, and no result


class SetDifference(ParametersModel):
    """The changes from one version to another."""

    before: SetHead
    after: SetHead
    changes: list[ParameterDifference]


class TrendPoint(ParametersModel):
    """A figure of one run."""

    run_id: str
    started_utc: str
    value: float
    expanded_uncertainty: float
    limit: float | None
    decision: str | None


class FigureTrend(ParametersModel):
    """One figure through successive runs of a procedure on one robot, oldest first."""

    name: str
    unit: str
    points: list[TrendPoint]


@router.get("/parameters")
async def parameter_sets(request: Request, who: Who) -> list[SetHead]:
    """Return every version of every robot's parameters, a robot's versions oldest first."""
    del who
    return await asyncio.to_thread(_list_heads, _open_sets(app_context(request).config))


@router.get("/parameters/diff")
async def get_difference(
    request: Request,
    who: Who,
    robot_serial: Named,
    before: Version | None = None,
    after: Version | None = None,
) -> SetDifference:
    """Return what changed between two versions; without numbers, what the newest changed."""
    del who
    return await asyncio.to_thread(
        _compare_versions, _open_sets(app_context(request).config), robot_serial, before, after
    )


@router.get("/parameters/{robot_serial}")
async def parameter_set(
    robot_serial: str, request: Request, who: Who, version: Version | None = None
) -> WholeSet:
    """Return one version with its values; the newest where none is named."""
    del who
    found = await asyncio.to_thread(_open_sets(app_context(request).config).load_set, robot_serial, version)
    values = [SetParameter.model_validate(value) for value in found.values]
    return WholeSet(**_to_head(found).model_dump(), parameters=values)


@router.get("/trend")
async def get_trend(request: Request, who: Who, robot_serial: Named, procedure: Named) -> list[FigureTrend]:
    """Return how the figures of a procedure went through the finished runs on one robot."""
    del who
    return await asyncio.to_thread(_load_trend, app_context(request).config, robot_serial, procedure)


def _open_sets(config: CellConfig) -> ParameterSets:
    return ParameterSets(Path(config.path).parent / FOLDER)


def _list_heads(sets: ParameterSets) -> list[SetHead]:
    return [_to_head(version) for serial in sets.robot_serials() for version in sets.load_history(serial)]


def _compare_versions(
    sets: ParameterSets, serial: str, before: int | None, after: int | None
) -> SetDifference:
    new = sets.load_set(serial, after)
    old = sets.load_set(serial, new.version - 1 if before is None else before)
    return SetDifference(
        before=_to_head(old), after=_to_head(new), changes=[_to_difference(c) for c in compare_sets(old, new)]
    )


def _to_head(found: ParameterSet) -> SetHead:
    remember_recorded_texts([found.source, found.note])  # a file holds them in English alone
    return SetHead.model_validate(found)


def _to_difference(change: ParameterChange) -> ParameterDifference:
    sides: tuple[tuple[Side, ParameterValue | None], ...] = (
        ("before", change.before),
        ("after", change.after),
    )
    return ParameterDifference(
        name=change.name,
        unit=change.unit,
        before=change.before.value if change.before else None,
        after=change.after.value if change.after else None,
        undetermined=[side for side, value in sides if value and not value.determined],
        difference=change.value_difference,
        deviations=change.difference_in_sigmas,
    )


def _load_trend(config: CellConfig, serial: str, procedure: str) -> list[FigureTrend]:
    with open_journal(config) as journal:
        runs = [run for run in store_of(journal).list_runs() if _is_judged(run, serial, procedure)]
    found: dict[tuple[str, str], list[TrendPoint]] = {}
    for run in runs:
        for figure in run.judgement["characteristics"]:
            point = TrendPoint.model_validate(
                {**figure, "run_id": run.run_id, "started_utc": run.started_utc}, from_attributes=False
            )
            found.setdefault((figure["name"], figure["unit"]), []).append(point)
    return [FigureTrend(name=name, unit=unit, points=points) for (name, unit), points in found.items()]


def _is_judged(run: "RunView", serial: str, procedure: str) -> bool:
    robot = run.cell["devices"][0]["identity"]["serial"] if run.cell["devices"] else ""
    return run.procedure == procedure and robot == serial and isinstance(run.judgement, dict)
