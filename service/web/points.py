"""What a run measured, point by point: each reading, why some were not used, and the errors that are left."""

import asyncio
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Annotated, Any

from fastapi import APIRouter, Path, Request

from cellcal.service.configuration.cell_file import CellConfig
from cellcal.service.legacy_texts import remember_recorded_texts
from cellcal.service.web.dependencies import Who, app_context

router = APIRouter()
RunId = Annotated[str, Path(max_length=128)]

ERRORS, SPREAD = "errors", "spread"


@dataclass(frozen=True, slots=True)
class PointSeen:
    """One dot."""

    name: str
    value_m: float  # not below zero
    used: bool
    reason: str  # why it was not used


@dataclass(frozen=True, slots=True)
class PointSeriesSeen:
    """One plot. ``kind``: ``errors`` that the result leaves, or the ``spread`` of each reading's samples."""

    kind: str
    what: str
    points: tuple[PointSeen, ...]


@dataclass(frozen=True, slots=True)
class ReadingSeen:
    """One reading as it was taken, in the journal's order."""

    step: str
    at_utc: str
    used: bool
    reason: str
    length_m: float | None  # mean of its samples, where it is a length
    samples: int


@dataclass(frozen=True, slots=True)
class RunPoints:
    """All points of one run."""

    readings: tuple[ReadingSeen, ...]
    series: tuple[PointSeriesSeen, ...]


@router.get("/runs/{run_id}/points")
async def get_points(run_id: RunId, request: Request, who: Who) -> RunPoints:
    """Return what a run measured, those readings too that were not used, and the errors that its result leaves."""
    del who
    return await asyncio.to_thread(points_of, app_context(request).config, run_id)


def points_of(config: CellConfig, run_id: str) -> RunPoints:
    """Return the points of one run; ``last`` is the newest.

    Raises
    ------
    CellError
        There is no such run.
    """
    from cellcal.service.certificates.points import list_readings  # noqa: PLC0415  # heavy: not at the start of the service
    from cellcal.service.record.journal_files import open_journal  # noqa: PLC0415  # heavy, as above
    from cellcal.service.record.run_store import RunStore  # noqa: PLC0415  # heavy, as above

    with open_journal(config) as journal:
        view, events = RunStore(journal).with_events(run_id)
    taken = list_readings(events, view.judgement)
    if not view.has_templates:
        remember_recorded_texts([reading["reason"] for reading in taken])
    spreads = tuple(_spread_point(reading) for reading in taken if len(_sample_values(reading)) > 1)
    found = (*_error_series(view.result), *((PointSeriesSeen(SPREAD, "", spreads),) if spreads else ()))
    return RunPoints(tuple(_reading_of(each) for each in taken), found)


def _error_series(result: Any) -> Iterator[PointSeriesSeen]:
    from cellcal.service.certificates.pictures import errors_in  # noqa: PLC0415  # heavy, as above

    for errors in errors_in(result):
        names = [*errors.names, *(str(i + 1) for i in range(len(errors.names), len(errors.values_m)))]
        dots = (
            PointSeen(name, value, used=True, reason="")
            for name, value in zip(names, errors.values_m, strict=True)
        )
        yield PointSeriesSeen(ERRORS, errors.what, tuple(dots))


def _reading_of(reading: Mapping[str, Any]) -> ReadingSeen:
    samples = _sample_values(reading)
    mean = sum(samples) / len(samples) if samples else None
    return ReadingSeen(
        reading["step"], reading["at_utc"], reading["used"], reading["reason"], mean, len(samples)
    )


def _spread_point(reading: Mapping[str, Any]) -> PointSeen:
    """Return by how much the farthest sample differs from the mean of its reading."""
    samples = _sample_values(reading)
    mean = sum(samples) / len(samples)
    farthest = max(abs(sample - mean) for sample in samples)
    return PointSeen(reading["step"], farthest, reading["used"], reading["reason"])


def _sample_values(reading: Mapping[str, Any]) -> list[float]:
    value = reading.get("value")
    samples = value.get("readings_m", []) if isinstance(value, dict) else []
    return [float(sample) for sample in samples]
