"""The service's door: pages, orders and live values, all through one desk."""

import asyncio
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from fastapi import FastAPI, Request
from fastapi.exceptions import RequestValidationError
from fastapi.responses import JSONResponse

from calibration.errors import CellError
from service.configuration.cell_file import CellConfig, read_cell_file
from service.people.entrance import Entrance
from service.people.errors import PeopleError
from service.people.permits import Permits
from service.site.feed import SiteFeed
from service.web import commands, history, models, outlook, points, screen, sign_in
from service.web.guard import Guard
from service.web.link import DeskGoneError, DeskLink
from service.web.pages import add_pages, page_paths
from service.web.screens import Screens

Heard = Callable[[str, dict[str, Any]], None]


@dataclass(frozen=True, slots=True)
class Settings:
    """How the service is run.

    ``open_access`` lets everybody in as the local technician: for demos on loopback, where no robot is. Names other
    than this computer's own loopback ones are answered only where they stand in ``allowed_hosts``.
    """

    cell_file: Path
    demo: bool = False
    open_access: bool = False
    tls: bool = False
    allowed_hosts: tuple[str, ...] = ()
    on_console_token: Callable[[str], None] | None = None


@dataclass(frozen=True, slots=True)
class House:
    """What every route is lent: the cell's file, its desk, the open screens, who may come in."""

    settings: Settings
    config: CellConfig
    link: DeskLink
    screens: Screens
    entrance: Entrance
    permits: Permits


def create_app(settings: Settings) -> FastAPI:
    """Build the service for one cell file.

    Raises
    ------
    CellError
        The cell file is wrong; every fault is named.
    """
    config = read_cell_file(settings.cell_file)
    screens = Screens()
    feed = None if config.site is None else SiteFeed(settings.cell_file)

    def heard(kind: str, content: dict[str, Any]) -> None:
        screens.show(kind, content)
        if feed is not None:
            feed.heard(kind, content)

    entrance = Entrance(
        config.cell.data_dir, settings.open_access, on_console_token=settings.on_console_token
    )
    house = House(settings, config, DeskLink(settings.cell_file, heard), screens, entrance, Permits())

    @asynccontextmanager
    async def lifespan(_: FastAPI) -> AsyncIterator[None]:
        keeping = [asyncio.create_task(house.link.keep(), name="desk")]
        if feed is not None:
            keeping.append(asyncio.create_task(feed.keep(), name="site"))
        yield
        for task in keeping:
            task.cancel()
        await asyncio.gather(*keeping, return_exceptions=True)

    app = FastAPI(title="cellcal", lifespan=lifespan, docs_url=None, redoc_url=None)
    app.state.house = house
    app.add_exception_handler(CellError, _told)
    app.add_exception_handler(RequestValidationError, _not_understood)
    rooms = (screen, commands, outlook, history, sign_in, models, points)
    for router in (room.router for room in rooms):
        app.include_router(router, prefix="/api")
    add_pages(app)
    app.add_middleware(Guard, pages=page_paths(), hosts=settings.allowed_hosts, tls=settings.tls)
    return app


def _told(_: Request, error: Exception) -> JSONResponse:
    assert isinstance(error, CellError)
    body = {"code": error.code, "message": error.message, "remedy": error.remedy}
    if isinstance(error, PeopleError):
        return JSONResponse(body, status_code=error.status)
    return JSONResponse(body, status_code=503 if isinstance(error, DeskGoneError) else 422)


def _not_understood(_: Request, error: Exception) -> JSONResponse:
    """Say which field is wrong, without sending back what was sent: it may be huge, or no JSON at all."""
    assert isinstance(error, RequestValidationError)
    faults = "; ".join(f"{'.'.join(map(str, each['loc']))}: {each['msg']}" for each in error.errors()[:5])
    body = {
        "code": "request",
        "message": f"The request is not understood: {faults}",
        "remedy": "See /openapi.json.",
    }
    return JSONResponse(body, status_code=422)
