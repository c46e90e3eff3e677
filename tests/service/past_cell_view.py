"""A browser at a service over a fake cell that has a past."""

from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path

from cellcal.service.web.app import create_app
from cellcal.service.web.context import ServiceSettings
from tests.service.cell_process_session import a_cell
from tests.service.cell_with_history import PastRuns, cell_with_past_runs
from tests.service.test_pages import PageViewer, view_service


@asynccontextmanager
async def view_past_cell(folder: Path) -> AsyncIterator[tuple[PageViewer, PastRuns]]:
    """Serve a cell whose journal holds runs, and look at it in Chromium."""
    async with a_cell(folder) as (path, _):
        past = await cell_with_past_runs(path)
        async with view_service(create_app(ServiceSettings(path, open_access=True))) as viewer:
            yield viewer, past
