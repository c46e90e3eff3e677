"""What routes of jobs share: the name of a job in an address, and the jobs of a service, which end with it."""

from collections.abc import AsyncIterator, Callable
from contextlib import AbstractAsyncContextManager, asynccontextmanager
from typing import Annotated, Any, TypeVar

from fastapi import FastAPI, Path
from starlette.requests import HTTPConnection

from cellcal.service.configuration.cell_file import CellConfig
from cellcal.service.engineering.page_jobs import PageJobs
from cellcal.service.web.dependencies import app_context

JobId = Annotated[str, Path(max_length=32, pattern=r"^[0-9a-z]+$")]
_Jobs = TypeVar("_Jobs", bound=PageJobs[Any])


def jobs_of_service(connection: HTTPConnection, key: str, make: Callable[[CellConfig], _Jobs]) -> _Jobs:
    """Return the jobs under a key of the application's state; they are made when a page first asks for them."""
    state = connection.app.state
    if not hasattr(state, key):
        setattr(state, key, make(app_context(connection).config))
    found: _Jobs = getattr(state, key)
    return found


def jobs_lifespan(key: str) -> Callable[[FastAPI], AbstractAsyncContextManager[None]]:
    """Return the lifespan of a router that ends the jobs under a key when the service ends."""

    @asynccontextmanager
    async def end_jobs_at_exit(app: FastAPI) -> AsyncIterator[None]:
        yield
        jobs: PageJobs[Any] | None = getattr(app.state, key, None)
        if jobs is not None:
            await jobs.close_all()

    return end_jobs_at_exit
