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
from cellcal.service.review.compute_client import ComputeClient
from cellcal.service.review.review_models import Review
from cellcal.service.web.dependencies import Who, app_context
from cellcal.service.web.response_models import response_options
from cellcal.service.web.waiting_clients import answer_while_awaited
from cellcal.service.web.worker import open_journal, store_of

RunId = Annotated[str, Path(max_length=128)]
Step = Annotated[str, StringConstraints(min_length=1, max_length=200)]


@asynccontextmanager
async def _ended_with_the_service(app: FastAPI) -> AsyncIterator[None]:
    yield
    compute_client: ComputeClient | None = getattr(app.state, "solver", None)
    if compute_client is not None:
        await compute_client.stop_worker()


router = APIRouter(lifespan=_ended_with_the_service)


class WhatIfRequest(BaseModel):
    """The readings to use; all others are left out."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    used: Annotated[list[Step], Field(max_length=2000)]


def compute_client_of(connection: HTTPConnection) -> ComputeClient:
    """Return the process that computes for this service; the first question starts it."""
    state = connection.app.state
    if not hasattr(state, "solver"):
        state.solver = ComputeClient(app_context(connection).settings.cell_file)
    found: ComputeClient = state.solver
    return found


@router.get("/runs/{run_id}/review", **response_options(Review, "the run as it was signed"))
async def get_review(run_id: RunId, request: Request, who: Who) -> dict[str, Any]:
    """Return a run's residuals, its errors at poses that were not fitted, and the map of its work."""
    del who
    return await _ask_worker(request, run_id)


@router.post("/runs/{run_id}/what-if", **response_options(Review, "a what-if"))
async def what_if(run_id: RunId, choice: WhatIfRequest, request: Request, who: Who) -> dict[str, Any]:
    """Return the same as if only these readings were used. Nothing is kept; the signed result stays as it is."""
    del who
    return await _ask_worker(request, run_id, used=choice.used)


async def _ask_worker(request: Request, run_id: str, **arguments: Any) -> dict[str, Any]:
    full_run_id = await asyncio.to_thread(_full_run_id, app_context(request).config, run_id)
    found: dict[str, Any] = await answer_while_awaited(
        request, compute_client_of(request).ask_worker("review", run_id=full_run_id, **arguments)
    )
    return found


def _full_run_id(config: CellConfig, run_id: str) -> str:
    """Return the run's id; a run that is not there is refused before anything is computed."""
    with open_journal(config) as journal:
        store = store_of(journal)
        return store.find_run(store.resolve_run_id(run_id)).run_id
