"""The service's door: pages, orders and live values, all through one desk."""

import asyncio
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from functools import partial
from typing import Any

from fastapi import FastAPI
from fastapi.exceptions import RequestValidationError

from cellcal.calibration.errors import CellError
from cellcal.drivers.supervision import SUPERVISOR, guarded
from cellcal.service.configuration.cell_file import read_cell_file
from cellcal.service.export.outlets import Outlets
from cellcal.service.people.authentication import Entrance
from cellcal.service.people.authorization import Permits
from cellcal.service.people.session_control import Control
from cellcal.service.web import commands, exports, history, metrics, models, points, programs, sign_in
from cellcal.service.web import procedures as outlook
from cellcal.service.web import session_control as control
from cellcal.service.web import websocket as screen
from cellcal.service.web.cell_client import DeskLink
from cellcal.service.web.context import House, Settings
from cellcal.service.web.error_responses import REFUSALS, not_understood, told
from cellcal.service.web.middleware import Guard
from cellcal.service.web.pages import add_pages, page_paths
from cellcal.service.web.troubles import troubles_of
from cellcal.service.web.websocket_hub import Screens

Heard = Callable[[str, dict[str, Any]], None]


def create_app(settings: Settings) -> FastAPI:
    """Build the service for one cell file.

    Raises
    ------
    CellError
        The cell file is wrong; every fault is named.
    """
    config = read_cell_file(settings.cell_file)
    screens = Screens()
    outlets = Outlets(settings.cell_file, config)

    def heard(kind: str, content: dict[str, Any]) -> None:
        with guarded("screens"):
            screens.show(kind, content)
            if kind != "live":
                _show_troubles(house)
        outlets.heard(kind, content)

    entrance = Entrance(
        config.cell.data_dir, settings.open_access, on_console_token=settings.on_console_token
    )
    house = House(settings, config, _link(settings, heard), screens, entrance, Permits(), Control())

    @asynccontextmanager
    async def lifespan(_: FastAPI) -> AsyncIterator[None]:
        async with _kept(house, outlets):
            yield

    app = FastAPI(title="cellcal", lifespan=lifespan, docs_url=None, redoc_url=None, responses=REFUSALS)
    app.state.house, app.state.meter = house, outlets.meter
    app.add_exception_handler(CellError, told)
    app.add_exception_handler(RequestValidationError, not_understood)
    rooms = (screen, commands, control, outlook, history, exports, sign_in, models, points, programs)
    for router in (room.router for room in rooms):
        app.include_router(router, prefix="/api")
    if settings.extension is not None:
        app.include_router(settings.extension.router, prefix="/api")
    app.include_router(metrics.router)
    add_pages(app)
    app.add_middleware(
        Guard, pages=page_paths() | {metrics.PATH}, hosts=settings.allowed_hosts, tls=settings.tls
    )
    return app


@asynccontextmanager
async def _kept(house: House, outlets: Outlets) -> AsyncIterator[None]:
    """Keep what lives as long as the service, and show what fails of it."""
    unlisten = SUPERVISOR.listen(partial(_show_troubles, house))
    keeping = [house.link.start(), *outlets.keep()]
    yield
    unlisten()
    for task in keeping:
        task.cancel()
    await asyncio.gather(*keeping, return_exceptions=True)


def _show_troubles(house: House) -> None:
    house.screens.show("troubles", troubles_of(house.link.session))


def _link(settings: Settings, heard: Heard) -> DeskLink:
    if settings.extension is None:
        return DeskLink(settings.cell_file, heard)
    return settings.extension.make_link(settings.cell_file, heard)
