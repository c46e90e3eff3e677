"""A browser at a service over a fake cell that has a past."""

from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path

from cellcal.service.web.app import create_app
from cellcal.service.web.context import ServiceSettings
from tests.service.desks import a_cell
from tests.service.reviewed import Past, with_a_past
from tests.service.test_pages import Looking, looking_at


@asynccontextmanager
async def looking_back(folder: Path) -> AsyncIterator[tuple[Looking, Past]]:
    """Serve a cell whose journal holds runs, and look at it in Chromium."""
    async with a_cell(folder) as (path, _):
        past = await with_a_past(path)
        async with looking_at(create_app(ServiceSettings(path, open_access=True))) as looks:
            yield looks, past
