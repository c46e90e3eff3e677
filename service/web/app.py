"""The web application of the service: pages, orders and live values, all of one cell process."""

import asyncio
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from functools import partial

from fastapi import FastAPI
from fastapi.exceptions import RequestValidationError

from cellcal.calibration.errors import CellError
from cellcal.drivers.supervision import SUPERVISOR, log_failures
from cellcal.service.configuration.cell_file import read_cell_file
from cellcal.service.export.event_sinks import EventSinks
from cellcal.service.people.authentication import Authenticator
from cellcal.service.people.authorization import OrderAuthorizer
from cellcal.service.people.session_control import SessionControl
from cellcal.service.session_documents import EventContent, OnCellEvent
from cellcal.service.web import (
    commands,
    exports,
    history,
    measurements,
    metrics,
    models,
    points,
    programs,
    sign_in,
)
from cellcal.service.web import procedures as procedure_routes
from cellcal.service.web import session_control as control
from cellcal.service.web import websocket as screen
from cellcal.service.web.cell_client import CellProcessClient
from cellcal.service.web.context import AppContext, ServiceSettings
from cellcal.service.web.error_responses import REFUSALS, refuse_request, respond_to_error
from cellcal.service.web.message_description import describe_messages
from cellcal.service.web.middleware import RequestFilter
from cellcal.service.web.pages import add_pages, page_paths
from cellcal.service.web.response_models import MessageJsonResponse
from cellcal.service.web.task_troubles import troubles_of
from cellcal.service.web.websocket_hub import OpenScreens


def create_app(settings: ServiceSettings) -> FastAPI:
    """Build the service for one cell file.

    Raises
    ------
    CellError
        The cell file is wrong; every fault is named.
    """
    config = read_cell_file(settings.cell_file)
    screens = OpenScreens()
    event_sinks = EventSinks(settings.cell_file, config)

    def on_event(kind: str, content: EventContent) -> None:
        with log_failures("screens"):
            screens.broadcast(kind, content)
            if kind != "live":
                _show_troubles(context)
        event_sinks.on_event(kind, content)

    authenticator = Authenticator(
        config.cell.data_dir, settings.open_access, on_console_token=settings.on_console_token
    )
    context = AppContext(
        settings,
        config,
        _make_client(settings, on_event),
        screens,
        authenticator,
        OrderAuthorizer(),
        SessionControl(has_open_page=screens.has_page_of),
    )

    @asynccontextmanager
    async def run_lifespan(_: FastAPI) -> AsyncIterator[None]:
        async with _run_background(context, event_sinks):
            yield

    app = FastAPI(
        title="cellcal",
        lifespan=run_lifespan,
        docs_url=None,
        redoc_url=None,
        responses=REFUSALS,
        default_response_class=MessageJsonResponse,
    )
    app.state.context, app.state.meter = context, event_sinks.meter
    describe_messages(app)
    app.add_exception_handler(CellError, respond_to_error)
    app.add_exception_handler(RequestValidationError, refuse_request)
    rooms = (
        screen,
        commands,
        control,
        procedure_routes,
        history,
        exports,
        sign_in,
        models,
        points,
        programs,
        measurements,
    )
    for router in (room.router for room in rooms):
        app.include_router(router, prefix="/api")
    if settings.extension is not None:
        app.include_router(settings.extension.router, prefix="/api")
    app.include_router(metrics.router)
    add_pages(app)
    app.add_middleware(
        RequestFilter, pages=page_paths() | {metrics.PATH}, hosts=settings.allowed_hosts, tls=settings.tls
    )
    return app


@asynccontextmanager
async def _run_background(context: AppContext, event_sinks: EventSinks) -> AsyncIterator[None]:
    """Keep the tasks that run as long as the service, and show which of them fail."""
    unlisten = SUPERVISOR.add_listener(partial(_show_troubles, context))
    background_tasks = [context.link.start_process(), *event_sinks.start_tasks()]
    yield
    unlisten()
    for task in background_tasks:
        task.cancel()
    await asyncio.gather(*background_tasks, return_exceptions=True)


def _show_troubles(context: AppContext) -> None:
    context.screens.broadcast("troubles", troubles_of(context.link.session))


def _make_client(settings: ServiceSettings, on_event: OnCellEvent) -> CellProcessClient:
    if settings.extension is None:
        return CellProcessClient(settings.cell_file, on_event)
    return settings.extension.make_link(settings.cell_file, on_event)
