"""The service's door: pages, orders and live values, all through one desk."""

import asyncio
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from fastapi import FastAPI
from fastapi.exceptions import RequestValidationError

from cellcal.calibration.errors import CellError
from cellcal.drivers.supervision import SUPERVISOR, guarded
from cellcal.service.configuration.cell_file import CellConfig, read_cell_file
from cellcal.service.demo.door import Door
from cellcal.service.export.outlets import Outlets
from cellcal.service.people.authentication import Entrance
from cellcal.service.people.authorization import Permits
from cellcal.service.people.session_control import Control
from cellcal.service.web import commands, exports, history, metrics, models, points, programs, sign_in
from cellcal.service.web import procedures as outlook
from cellcal.service.web import session_control as control
from cellcal.service.web import websocket as screen
from cellcal.service.web.cell_client import DeskLink
from cellcal.service.web.error_responses import REFUSALS, not_understood, told
from cellcal.service.web.middleware import Guard
from cellcal.service.web.pages import add_pages, page_paths
from cellcal.service.web.troubles import troubles_of
from cellcal.service.web.websocket_hub import Screens

Heard = Callable[[str, dict[str, Any]], None]


@dataclass(frozen=True, slots=True)
class Settings:
    """How the service is run.

    ``open_access`` lets everybody in as the local technician: for demos on loopback, where no robot is. ``demo_door``
    is the control door of such a demo's fake cell: with it the pages have buttons that make things go wrong. Names
    other than this computer's own loopback ones are answered only where they stand in ``allowed_hosts``.
    """

    cell_file: Path
    demo: bool = False
    open_access: bool = False
    demo_door: Door | None = None
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
    control: Control


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
    if settings.demo_door is not None:
        from cellcal.service.demo import web_routes as demo  # noqa: PLC0415  a real cell's service has no such routes

        app.include_router(demo.router, prefix="/api")
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
    if settings.demo_door is None:
        return DeskLink(settings.cell_file, heard)
    from cellcal.service.demo.web_routes import DemoLink, DemoWorld  # noqa: PLC0415  a real cell's service has no such line

    return DemoLink(settings.cell_file, heard, DemoWorld(settings.demo_door))
