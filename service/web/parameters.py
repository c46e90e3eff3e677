"""What robots were found to be, version by version, and how their figures went over the years. Reading only."""

import asyncio
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from fastapi import APIRouter, Query, Request
from pydantic import BaseModel, ConfigDict

from cellcal.service.configuration.cell_file import CellConfig
from cellcal.service.engineering.parameters.parameter_sets import (
    FOLDER,
    Change,
    ParameterSet,
    ParameterSets,
    Value,
    diff,
)
from cellcal.service.web.door import Who, house_of
from cellcal.service.web.worker import open_journal, store_of

if TYPE_CHECKING:
    from cellcal.service.record.run_store import RunView

router = APIRouter()

Named = Annotated[str, Query(min_length=1, max_length=64)]
Version = Annotated[int, Query(ge=1)]
Side = Literal["before", "after"]


class Told(BaseModel):
    """What is answered here: numbers are SI."""

    model_config = ConfigDict(frozen=True, from_attributes=True)


class Head(Told):
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


class Parameter(Told):
    """One deviation from the nominal model."""

    name: str
    unit: Literal["rad", "m", "rad/m", "1"]
    value: float
    standard_uncertainty: float | None
    determined: bool  # False: assumed, and no result of the measurement


class Whole(Head):
    """One version with its values."""

    parameters: list[Parameter]


class Changed(Told):
    """One parameter in two versions; None where a version does not have it."""

    name: str
    unit: str
    before: float | None
    after: float | None
    difference: float
    deviations: float | None  # the difference in combined standard uncertainties
    undetermined: list[Side]  # where the value is assumed, and no result


class Difference(Told):
    """What changed from one version to another."""

    before: Head
    after: Head
    changes: list[Changed]


class Point(Told):
    """A figure of one run."""

    run_id: str
    started_utc: str
    value: float
    expanded_uncertainty: float
    limit: float | None
    decision: str | None


class Trend(Told):
    """One figure through successive runs of a procedure on one robot, oldest first."""

    name: str
    unit: str
    points: list[Point]


@router.get("/parameters")
async def parameter_sets(request: Request, who: Who) -> list[Head]:
    """Return every version of every robot's parameters, a robot's versions oldest first."""
    del who
    return await asyncio.to_thread(_all, _sets(house_of(request).config))


@router.get("/parameters/diff")
async def difference(
    request: Request,
    who: Who,
    robot_serial: Named,
    before: Version | None = None,
    after: Version | None = None,
) -> Difference:
    """Return what changed between two versions; without numbers, what the newest changed."""
    del who
    return await asyncio.to_thread(_diff, _sets(house_of(request).config), robot_serial, before, after)


@router.get("/parameters/{robot_serial}")
async def parameter_set(
    robot_serial: str, request: Request, who: Who, version: Version | None = None
) -> Whole:
    """Return one version with its values; the newest where none is named."""
    del who
    found = await asyncio.to_thread(_sets(house_of(request).config).load, robot_serial, version)
    values = [Parameter.model_validate(value) for value in found.values]
    return Whole(**_head(found).model_dump(), parameters=values)


@router.get("/trend")
async def trend(request: Request, who: Who, robot_serial: Named, procedure: Named) -> list[Trend]:
    """Return how the figures of a procedure went through the finished runs on one robot."""
    del who
    return await asyncio.to_thread(_trend, house_of(request).config, robot_serial, procedure)


def _sets(config: CellConfig) -> ParameterSets:
    return ParameterSets(Path(config.path).parent / FOLDER)


def _all(sets: ParameterSets) -> list[Head]:
    return [_head(version) for serial in sets.robots() for version in sets.history(serial)]


def _diff(sets: ParameterSets, serial: str, before: int | None, after: int | None) -> Difference:
    new = sets.load(serial, after)
    old = sets.load(serial, new.version - 1 if before is None else before)
    return Difference(before=_head(old), after=_head(new), changes=[_changed(c) for c in diff(old, new)])


def _head(found: ParameterSet) -> Head:
    return Head.model_validate(found)


def _changed(change: Change) -> Changed:
    sides: tuple[tuple[Side, Value | None], ...] = (("before", change.before), ("after", change.after))
    return Changed(
        name=change.name,
        unit=change.unit,
        before=change.before.value if change.before else None,
        after=change.after.value if change.after else None,
        undetermined=[side for side, value in sides if value and not value.determined],
        difference=change.difference,
        deviations=change.deviations,
    )


def _trend(config: CellConfig, serial: str, procedure: str) -> list[Trend]:
    with open_journal(config) as journal:
        runs = [run for run in store_of(journal).runs() if _is_judged(run, serial, procedure)]
    found: dict[tuple[str, str], list[Point]] = {}
    for run in runs:
        for figure in run.judgement["characteristics"]:
            point = Point.model_validate(
                {**figure, "run_id": run.run_id, "started_utc": run.started_utc}, from_attributes=False
            )
            found.setdefault((figure["name"], figure["unit"]), []).append(point)
    return [Trend(name=name, unit=unit, points=points) for (name, unit), points in found.items()]


def _is_judged(run: "RunView", serial: str, procedure: str) -> bool:
    robot = run.cell["devices"][0]["identity"]["serial"] if run.cell["devices"] else ""
    return run.procedure == procedure and robot == serial and isinstance(run.judgement, dict)
