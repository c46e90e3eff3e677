"""The demo in a browser: fake cell, service and pages on this computer alone, until Ctrl+C."""

import asyncio
import contextlib
import os
import signal
import socket
import sys
import webbrowser
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from types import FrameType

import uvicorn
from fastapi import FastAPI

from cellcal.calibration.errors import CellError
from cellcal.drivers.supervision import start_task
from cellcal.service.demo.fake_cell import free_address, running_fakes, write_cell_file
from cellcal.service.gc_freeze import freeze_startup_objects
from cellcal.service.record.service_lock import hold_data_folder
from cellcal.service.web.server import WebServer, bind_address

HOST = "127.0.0.1"
PORT = 8471
_LEAVE_S = 2
_ENDS = tuple(getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name))


@dataclass(frozen=True, slots=True)
class DemoOptions:
    """The world to play, its pace, and the port (None: the usual one or, where it is taken, another)."""

    seed: int
    time_factor: float
    port: int | None
    browser: bool
    say: Callable[[str], None]


def show_wizard(folder: Path, options: DemoOptions) -> None:
    """Play a fresh fake cell whose files live in ``folder`` and serve its pages until Ctrl+C.

    Raises
    ------
    CellError
        The port is taken, or the fake cell cannot start.
    """
    with _bind_socket(options.port) as listening:
        asyncio.run(_serve_demo(folder, options, listening))


def has_display() -> bool:
    """Whether a browser has somewhere to open."""
    if sys.platform in ("darwin", "win32"):
        return True
    return any(os.environ.get(name) for name in ("DISPLAY", "WAYLAND_DISPLAY"))


class _DemoServer(WebServer):
    """Ends on Ctrl+C without raising it again: that is how a demo ends, not how it fails."""

    def __init__(self, app: FastAPI) -> None:
        super().__init__(
            uvicorn.Config(
                app, log_level="warning", log_config=None, ws="websockets-sansio", timeout_graceful_shutdown=_LEAVE_S,
                ws_per_message_deflate=False, server_header=False, proxy_headers=False,
            )
        )  # fmt: skip
        self.is_up = asyncio.Event()

    async def startup(self, sockets: list[socket.socket] | None = None) -> None:
        """Start, and say so."""
        await super().startup(sockets)
        self.is_up.set()

    @contextlib.contextmanager
    def capture_signals(self) -> Iterator[None]:
        def request_exit(number: int, _frame: FrameType | None) -> None:
            self.handle_exit(number, None)

        before = [(number, signal.signal(number, request_exit)) for number in _ENDS]
        try:
            yield
        finally:
            for number, handler in before:
                signal.signal(number, handler)


def _bind_socket(port: int | None) -> socket.socket:
    try:
        return bind_address(HOST, PORT if port is None else port)
    except CellError:
        if port is not None:
            raise
        return bind_address(HOST, 0)


async def _serve_demo(folder: Path, options: DemoOptions, listening: socket.socket) -> None:
    with free_address() as address:
        path = write_cell_file(
            folder, address, seed=options.seed, time_factor=options.time_factor, furnished=True
        )
    loading = asyncio.create_task(asyncio.to_thread(_import_modules))  # while the fakes start
    service = f"cellcal demo at {_url_of(listening)}"
    async with running_fakes(path) as fake_cell:
        await loading
        from cellcal.service.demo.demo_startup import DemoStartup  # noqa: PLC0415  loaded by now
        from cellcal.service.demo.web_routes import DemoExtension  # noqa: PLC0415  as above
        from cellcal.service.web.app import create_app  # noqa: PLC0415  as above
        from cellcal.service.web.context import ServiceSettings  # noqa: PLC0415  as above

        app = create_app(
            ServiceSettings(path, demo=True, open_access=True, extension=DemoExtension(fake_cell))
        )
        server = _DemoServer(app)
        freeze_startup_objects()
        opening = start_task(
            "opening of the demo", DemoStartup(app.state.context.link, options.time_factor).record_mastering
        )
        telling = start_task("address of the demo", partial(_announce_address, server, listening, options))
        try:
            with hold_data_folder(app.state.context.config.cell.data_dir, service):
                await server.serve([listening])
        finally:
            for task in (opening, telling):
                task.cancel()
            await asyncio.gather(opening, telling, return_exceptions=True)
    options.say("The demo has ended.")


def _url_of(listening: socket.socket) -> str:
    return f"http://{HOST}:{listening.getsockname()[1]}/"


def _import_modules() -> None:
    import cellcal.service.demo.demo_startup  # noqa: PLC0415  takes as long as the fakes do
    import cellcal.service.web.app  # noqa: PLC0415, F401  as above


async def _announce_address(server: _DemoServer, listening: socket.socket, options: DemoOptions) -> None:
    await server.is_up.wait()
    address = _url_of(listening)
    options.say(f"Demo, no robot: a fake cell at {address}")
    if options.browser and has_display():
        await asyncio.to_thread(webbrowser.open, address)
    else:
        options.say("Open this address in a browser of this computer.")
    options.say("Ctrl+C ends the demo.")
