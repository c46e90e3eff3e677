"""Reviews of finished runs: residuals, check poses, the map of the work; and what if other readings were used.

Computing happens in the solver's process. A what-if changes nothing: it reads the journal and is forgotten.
"""

import asyncio
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from typing import Annotated, Any

from fastapi import APIRouter, FastAPI, Path, Request
from pydantic import BaseModel, ConfigDict, Field, StringConstraints
from starlette.requests import HTTPConnection

from cellcal.service.configuration.cell_file import CellConfig
from cellcal.service.review.compute_client import Solver
from cellcal.service.review.review_models import Review
from cellcal.service.web.door import Who, house_of
from cellcal.service.web.response_models import answering
from cellcal.service.web.worker import open_journal, store_of

RunId = Annotated[str, Path(max_length=128)]
Step = Annotated[str, StringConstraints(min_length=1, max_length=200)]


@asynccontextmanager
async def _ended_with_the_service(app: FastAPI) -> AsyncIterator[None]:
    yield
    solver: Solver | None = getattr(app.state, "solver", None)
    if solver is not None:
        await solver.leave()


router = APIRouter(lifespan=_ended_with_the_service)


class WhatIf(BaseModel):
    """Which readings are to be used; all others are left out."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    used: Annotated[list[Step], Field(max_length=2000)]


def solver_of(connection: HTTPConnection) -> Solver:
    """Return the process that computes for this service; the first question starts it."""
    state = connection.app.state
    if not hasattr(state, "solver"):
        state.solver = Solver(house_of(connection).settings.cell_file)
    found: Solver = state.solver
    return found


@router.get("/runs/{run_id}/review", **answering(Review, "the run as it was signed"))
async def review(run_id: RunId, request: Request, who: Who) -> dict[str, Any]:
    """Return a run's residuals, its errors at poses that were not fitted, and the map of its work."""
    del who
    return await _asked(request, run_id)


@router.post("/runs/{run_id}/what-if", **answering(Review, "a what-if"))
async def what_if(run_id: RunId, wanted: WhatIf, request: Request, who: Who) -> dict[str, Any]:
    """Return the same as if only these readings were used. Nothing is kept; the signed result stays as it is."""
    del who
    return await _asked(request, run_id, used=wanted.used)


async def _asked(request: Request, run_id: str, **given: Any) -> dict[str, Any]:
    known = await asyncio.to_thread(_known, house_of(request).config, run_id)
    found: dict[str, Any] = await solver_of(request).ask("review", run_id=known, **given)
    return found


def _known(config: CellConfig, run_id: str) -> str:
    """Return the run's id; a run that is not there is refused before anything is computed."""
    with open_journal(config) as journal:
        store = store_of(journal)
        return store.run(store.newest(run_id)).run_id
