"""The fleet in a browser: every cell of a site on one page. It shows; there is no way to command anything here.

Only this computer can come in, with the address that the console showed. A page is told what changed, twice a second
at most: a row that stays as it is, is not sent and not drawn again.
"""

import asyncio
import contextlib
import time
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Protocol, cast

import orjson
from fastapi import APIRouter, FastAPI, Request, Response, WebSocket, WebSocketDisconnect
from fastapi.exceptions import RequestValidationError
from fastapi.responses import FileResponse, PlainTextResponse, RedirectResponse
from starlette.requests import HTTPConnection

from cellcal.calibration.errors import CellError
from cellcal.calibration.message import make_message
from cellcal.calibration.message_table import with_messages
from cellcal.drivers.supervision import start_task
from cellcal.service.people.authentication import Authenticator
from cellcal.service.people.errors import NotSignedInError
from cellcal.service.record.signing import CheckedDocument, CheckFinding
from cellcal.service.site.fleet import CellRow, Fleet
from cellcal.service.site.keys import SiteError
from cellcal.service.web.dependencies import Who, person_of
from cellcal.service.web.error_responses import REFUSALS, refuse_request, respond_to_error
from cellcal.service.web.fleet_models import FleetSeen
from cellcal.service.web.message_description import describe_messages
from cellcal.service.web.middleware import RequestFilter
from cellcal.service.web.pages import DIST, BuiltFiles
from cellcal.service.web.response_models import MessageJsonResponse, SignedDocument, response_options
from cellcal.service.web.sign_in import open_console
from cellcal.service.web.websocket_hub import let_go

PERIOD_S = 0.5
SLOW_S = 2.0
PAGE = "fleet.html"
_FLAWS = 20
_NOT_BUILT = "The pages of this copy of cellcal are not built: run `make pages`, then start again.\n"


class FleetBus(Protocol):
    """The connection that receives the cells' messages; ``site/listener.py`` is one."""

    @property
    def fleet(self) -> Fleet: ...
    @property
    def is_linked(self) -> bool: ...
    def fetch_certificate(self, cell: str, run_id: str) -> tuple[bytes, CheckedDocument]: ...


@dataclass(frozen=True, slots=True)
class _PlainSettings:
    tls: bool = False


@dataclass
class FleetContext:
    """Parts shared by the routes. ``rows`` is every cell as sent, ``ages`` of those that are not heard just now."""

    bus: FleetBus
    authenticator: Authenticator
    settings: _PlainSettings = field(default_factory=_PlainSettings)
    rows: dict[str, bytes] = field(default_factory=dict)
    ages: dict[str, int] = field(default_factory=dict)

    def update_rows(self) -> None:
        """Take the picture of now."""
        cell_views = self.bus.fleet.cell_views(time.monotonic())
        self.ages = {
            view.cell: int(view.age_s)
            for view in cell_views
            if view.link != "online" and view.age_s is not None
        }
        views = [view.as_json() for view in cell_views]
        for view in views:
            del view["age_s"]  # it changes all the time; the row does not
            view["clock_off_s"] = round(view["clock_off_s"])
            self.rows[view["cell"]] = self._row_to_json(view)

    def _row_to_json(self, view: CellRow) -> bytes:
        """Return a cell's row; one that cannot be shown is never left as it was before."""
        try:
            return orjson.dumps(with_messages(view))
        except TypeError as error:
            self.bus.fleet.name_flaw(
                view["cell"], make_message("what it says cannot be shown: {error}", error=str(error))
            )
            plain = dict.fromkeys(view) | {"cell": view["cell"], "name": view["cell"], "link": "silent"}
            lists = {"alarms": [], "drift": [], "due": [], "attended": False, "clock_off_s": 0}
            return orjson.dumps(plain | lists | {"events": {"have": 0, "known": 0, "lost": 0}})

    def changes_message(self, sent: dict[str, bytes]) -> str:
        """Return what a page does not know yet, and note that it does."""
        changed = [row for cell, row in self.rows.items() if sent.get(cell) != row]
        sent.update(self.rows)
        fleet = self.bus.fleet
        head = {
            "site": fleet.site,
            "router": self.bus.is_linked,
            "cells": len(self.rows),
            "ages": self.ages,
            "not_believed": list(fleet.flaws)[-_FLAWS:],
        }
        return (orjson.dumps(with_messages(head))[:-1] + b',"rows":[' + b",".join(changed) + b"]}").decode()


router = APIRouter(prefix="/api")


@router.get("/fleet", **response_options(FleetSeen, "every cell as it stands"))
async def get_fleet(request: Request, who: Who) -> Response:
    """Return every cell as it stands."""
    del who
    return Response(_fleet_context(request).changes_message({}), media_type="application/json")


@router.get(
    "/fleet/{cell}/certificates/{run_id}.json",
    **response_options(SignedDocument, "the signed document, as its cell sent it"),
)
async def get_certificate(cell: str, run_id: str, request: Request, who: Who) -> Response:
    """Return a certificate from its cell, after it was checked against the cell's key."""
    del who
    raw, checked = await asyncio.to_thread(_fleet_context(request).bus.fetch_certificate, cell, run_id)
    if checked.finding is not CheckFinding.INTACT:
        raise SiteError(
            make_message(
                "what {cell} sent is not its certificate. {sentence}", cell=cell, sentence=checked.sentence
            ),
            remedy="Look into that cell before you trust it.",
            code="signature",
        )
    name = "".join(letter for letter in f"{cell}-{run_id}" if letter.isalnum() or letter in "_-")
    headers = {"content-disposition": f'attachment; filename="{name}.json"'}
    return Response(raw, media_type="application/json", headers=headers)


@router.websocket("/fleet/live")
async def send_live(socket: WebSocket) -> None:
    """Tell a page what changed, until it leaves or is too slow."""
    context = _fleet_context(socket)
    person_of(socket)
    await socket.accept()
    sent: dict[str, bytes] = {}
    leaving = asyncio.ensure_future(_wait_until_left(socket))
    try:
        with contextlib.suppress(WebSocketDisconnect, NotSignedInError, TimeoutError):
            while not leaving.done():
                person_of(socket)  # a session that has ended sees nothing more
                async with asyncio.timeout(SLOW_S):
                    await socket.send_text(context.changes_message(sent))
                await asyncio.wait([leaving], timeout=PERIOD_S)
    finally:
        leaving.cancel()
        with contextlib.suppress(asyncio.CancelledError, RuntimeError):
            await leaving
        await let_go(socket)


async def _wait_until_left(socket: WebSocket) -> None:
    with contextlib.suppress(WebSocketDisconnect):
        while True:
            await socket.receive_text()  # a page that babbles is not listened to


def create_fleet_app(
    bus: FleetBus, folder: Path, on_console_token: Callable[[str], None] | None = None
) -> FastAPI:
    """Build the monitor's web application. ``folder`` is for a register of people; the monitor has none."""
    context = FleetContext(bus, Authenticator(folder, on_console_token=on_console_token))

    @asynccontextmanager
    async def run_lifespan(_: FastAPI) -> AsyncIterator[None]:
        looking = start_task("monitor: view of the cells", partial(_update_forever, context))
        yield
        looking.cancel()
        await asyncio.gather(looking, return_exceptions=True)

    app = FastAPI(
        title="cellcal monitor",
        lifespan=run_lifespan,
        docs_url=None,
        redoc_url=None,
        responses=REFUSALS,
        default_response_class=MessageJsonResponse,
    )
    app.state.context = context
    describe_messages(app)
    app.add_exception_handler(CellError, respond_to_error)
    app.add_exception_handler(RequestValidationError, refuse_request)
    app.include_router(router)
    app.add_api_route(
        "/api/sign-in/console", open_console, response_class=RedirectResponse, include_in_schema=False
    )
    pages = _add_page(app)
    app.add_middleware(RequestFilter, pages=pages)
    return app


def _add_page(app: FastAPI) -> frozenset[str]:
    """Serve the fleet's page and what it loads; return their paths. The wizard's page is not among them."""
    page = DIST / PAGE
    if not page.is_file():
        app.add_api_route(
            "/", lambda: PlainTextResponse(_NOT_BUILT, status_code=503), include_in_schema=False
        )
        return frozenset({"/"})
    app.add_api_route("/", lambda: FileResponse(page), include_in_schema=False)
    app.add_api_route("/icon.svg", lambda: FileResponse(DIST / "icon.svg"), include_in_schema=False)
    assets = DIST / "assets"
    app.mount("/assets", BuiltFiles(directory=assets), name="assets")
    return frozenset({"/", "/icon.svg", *(f"/assets/{file.name}" for file in assets.iterdir())})


async def _update_forever(context: FleetContext) -> None:
    while True:
        context.update_rows()
        await asyncio.sleep(PERIOD_S)


def _fleet_context(connection: HTTPConnection) -> FleetContext:
    return cast("FleetContext", connection.app.state.context)
