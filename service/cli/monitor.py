"""``cellcal monitor``: every cell of a site in one table."""

import sys
import time
from pathlib import Path
from shutil import get_terminal_size
from typing import TYPE_CHECKING, Annotated, Any

from cyclopts import Parameter

if TYPE_CHECKING:
    import threading

    from rich.table import Table

    from cellcal.service.site.fleet import CellView
    from cellcal.service.site.listener import FleetListener

_STYLES = {"online": "green", "silent": "yellow", "offline": "red", "never": "dim"}
_COLUMNS = (
    "cell",
    "link",
    "age",
    "alarms",
    "run",
    "drift RMS / mm",
    "last certificate",
    "next due",
    "events",
)
_FLAWS_SHOWN = 5
_SPARKS = "▁▂▃▄▅▆▇█"
_SKEW_S = 5.0


def monitor(  # a command's options are its arguments
    site: Path,
    /,
    *,
    store: Path | None = None,
    as_json: Annotated[bool, Parameter(name="--json", negative=())] = False,
    wait_s: float = 3.0,
    certificate: str = "",
    port: int | None = None,
) -> int:
    """Show the cells of a site: which are there, alarms, runs, drift, last certificate, what is due.

    A table that follows on a terminal; one picture of now where the output goes into a file or a pipe; with --port a
    page for browsers of this computer.

    Parameters
    ----------
    site
        The site's folder, or its monitor/ alone.
    store
        Where received events are kept; beside the monitor's files when not said.
    as_json
        Print one JSON object and end.
    wait_s
        How long to listen before one picture is given.
    certificate
        CELL/RUN: fetch that certificate from its cell, check it against the cell's key, and print it.
    port
        Serve a page on 127.0.0.1 at this port until interrupted. It shows, and commands nothing.
    """
    from cellcal.service.cli.site import interrupt_event, part_of
    from cellcal.service.site.link_files import MONITOR_FILE
    from cellcal.service.site.listener import FleetListener

    folder = part_of(site, "monitor", MONITOR_FILE)
    if port is not None:
        with FleetListener(folder, store or folder / "received.sqlite") as listener:
            return _serve_fleet(listener, folder, port)
    with (
        interrupt_event() as leave,
        FleetListener(folder, store or folder / "received.sqlite") as listener,
    ):
        if certificate:
            return _print_certificate(listener, certificate)
        if as_json or not sys.stdout.isatty():
            leave.wait(wait_s)
            return _print_picture(listener, as_json=as_json)
        _follow_fleet(listener, leave)
    return 0


def _serve_fleet(listener: "FleetListener", folder: Path, port: int) -> int:
    import uvicorn

    from cellcal.service.cli.printing import STDERR_CONSOLE
    from cellcal.service.gc_freeze import freeze_startup_objects
    from cellcal.service.web.fleet import create_fleet_app
    from cellcal.service.web.server import WebServer, bind_address, run_server

    address = f"http://127.0.0.1:{port}"

    def print_address(token: str) -> None:
        STDERR_CONSOLE.print(
            f"Open once: {address}/api/sign-in/console?token={token}", markup=False, soft_wrap=True
        )

    listening = bind_address("127.0.0.1", port)
    app = create_fleet_app(listener, folder, on_console_token=print_address)
    STDERR_CONSOLE.print(f"The cells of {listener.fleet.site} on {address} (Ctrl+C ends it).", markup=False)
    print_address(app.state.context.authenticator.console_token())
    freeze_startup_objects()
    config = uvicorn.Config(
        app, host="127.0.0.1", port=port, log_level="warning", log_config=None, ws="websockets-sansio",
        timeout_graceful_shutdown=3, server_header=False, proxy_headers=False,
    )  # fmt: skip
    run_server(WebServer(config), listening)
    return 0


def _follow_fleet(listener: "FleetListener", leave: "threading.Event") -> None:
    from rich.console import Console
    from rich.live import Live

    with Live(
        _render_screen(listener), console=Console(emoji=False), refresh_per_second=2, screen=False
    ) as live:
        while not leave.wait(1.0):
            live.update(_render_screen(listener))


def _print_picture(listener: "FleetListener", *, as_json: bool) -> int:
    from rich.console import Console

    from cellcal.service.cli.printing import print_json

    views = listener.fleet.cell_views(time.monotonic())
    if as_json:
        flaws = list(listener.fleet.flaws)
        document = {"site": listener.fleet.site, "router": listener.is_linked}
        print_json(document | {"cells": [view.as_json() for view in views], "not_believed": flaws})
        return 0
    out = Console(width=None if sys.stdout.isatty() else 160, emoji=False)
    out.print(_cell_table(views))
    for sentence in _flaw_lines(listener):
        out.print(sentence, style="bold red", markup=False)
    return 0


def _print_certificate(listener: "FleetListener", named: str) -> int:
    from cellcal.service.cli.printing import STDERR_CONSOLE
    from cellcal.service.exit_codes import ExitCode
    from cellcal.service.record.signing import CheckFinding

    cell, _, run_id = named.partition("/")
    raw, checked = listener.fetch_certificate(cell, run_id)
    STDERR_CONSOLE.print(f"{checked.sentence} Key: {checked.public_key or 'none'}.", markup=False)
    if checked.finding is not CheckFinding.INTACT:
        return ExitCode.SIGNATURE
    sys.stdout.write(raw.decode())
    return ExitCode.PASS


def _render_screen(listener: "FleetListener") -> Any:
    from rich.console import Group
    from rich.text import Text

    views = sorted(
        listener.fleet.cell_views(time.monotonic()), key=_urgency_key
    )  # what needs a look comes first
    flaws = [Text(words, style="bold red") for words in _flaw_lines(listener)]
    room = max(get_terminal_size().lines - len(flaws) - 6, 3)
    router = Text("" if listener.is_linked else "The site's router does not answer.", style="bold red")
    more = Text("" if len(views) <= room else f"and {len(views) - room} more, calmer than these")
    return Group(router, _cell_table(views[:room]), more, *flaws)


def _urgency_key(view: "CellView") -> tuple[bool, int]:
    return not view.alarms, ("silent", "offline", "online", "never").index(view.link)


def _flaw_lines(listener: "FleetListener") -> list[str]:
    newest = list(listener.fleet.flaws)[-_FLAWS_SHOWN:]
    return [f"{flaw['wall']} {flaw['cell']}: not believed: {flaw['what']}" for flaw in newest]


def _cell_table(views: list["CellView"]) -> "Table":
    from rich import box
    from rich.table import Table
    from rich.text import Text

    table = Table(*_COLUMNS, box=box.SIMPLE_HEAD, pad_edge=False)
    for view in views:
        cells = [Text(text) for text in _cell_row(view)]
        cells[1].stylize(_STYLES[view.link])
        cells[3].stylize("bold red")
        table.add_row(*cells)
    return table


def _cell_row(view: "CellView") -> tuple[str, ...]:
    name = view.cell if view.name == view.cell else f"{view.cell} ({view.name})"
    link = view.link if abs(view.clock_off_s) < _SKEW_S else f"{view.link}, clock {view.clock_off_s:+.0f} s"
    return (
        name,
        link,
        "" if view.age_s is None else f"{view.age_s:.1f} s",
        "; ".join(f"{alarm['source']}: {alarm['text']}" for alarm in view.alarms),
        _describe_run(view),
        _describe_trend(view),
        _describe_certificate(view),
        "; ".join(f"{item['due']} {item['what']}" for item in view.due[:1]),
        _describe_events(view),
    )


def _describe_run(view: "CellView") -> str:
    if view.run is None:
        return "" if view.attended or view.link == "never" else "service not running"
    run = view.run
    place = f" {run['index']}/{run['expected']}" if run["expected"] else ""
    asks = ", waits for a person" if view.asks is not None else ""
    return f"{run['procedure']}: {run['verdict'] or run['state']}, {run['step']}{place}{asks}"


def _describe_trend(view: "CellView") -> str:
    sizes_mm = [point["change_rms_m"] * 1e3 for point in view.drift]
    if not sizes_mm:
        return ""
    most = max(*sizes_mm, 1e-12)
    sparks = "".join(_SPARKS[min(int(size / most * 8), 7)] for size in sizes_mm[-10:])
    return f"{sparks} {sizes_mm[-1]:.3f}"


def _describe_certificate(view: "CellView") -> str:
    newest = view.certificate
    return (
        "" if newest is None else f"{newest['word'].upper()} {newest['procedure']} {newest['ended_utc'][:10]}"
    )


def _describe_events(view: "CellView") -> str:
    reach = view.events
    missing = f", {reach.missing_count} to come" if reach.missing_count else ""
    lost = f", {reach.lost} lost" if reach.lost else ""
    return f"{reach.upto}{missing}{lost}"
