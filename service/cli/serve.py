"""``cellcal serve``: the service and its pages for one cell."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter

if TYPE_CHECKING:
    from cellcal.service.cli.serve_checks import ListenAddress


def serve(
    cell: Path,
    /,
    *,
    host: str = "127.0.0.1",
    port: int = 8470,
    tls_cert: Path | None = None,
    tls_key: Path | None = None,
    allow_host: Annotated[tuple[str, ...], Parameter(negative=())] = (),
) -> int:
    """Serve a cell to browsers: the wizard, its live values, its history.

    On this computer, open the address that is printed; it works once, and the next one is printed then. Before
    people are set up (`cellcal people add`) it makes its browser the local technician; afterwards it asks for a PIN.

    Parameters
    ----------
    cell
        The cell file (TOML).
    host
        The address to listen on. Anything but loopback is refused without a TLS certificate and key, an
        administrator, and --allow-host.
    port
        The port to listen on.
    tls_cert
        The service's certificate with its chain (PEM).
    tls_key
        The certificate's private key (PEM, without a password).
    allow_host
        A name that browsers use for this service; may be given more than once.
    """
    from cellcal.service.cli.serve_checks import ListenAddress, refuse_unguarded
    from cellcal.service.configuration.cell_file import read_cell_file
    from cellcal.service.record.service_lock import hold_data_folder

    listening = ListenAddress(host, tls_cert, tls_key, tuple(name.lower() for name in allow_host))
    refuse_unguarded(cell, listening)
    address = f"{listening.url_scheme}://{listening.host_name}:{port}"
    # Before the port, which the other service mostly has as well: a service that is there is the better news.
    with hold_data_folder(
        read_cell_file(cell).cell.data_dir, f"cellcal serve of {cell.absolute()} at {address}"
    ):
        _serve_pages(cell, listening, port, address)
    return 0


def _serve_pages(cell: Path, listening: "ListenAddress", port: int, address: str) -> None:
    import uvicorn

    from cellcal.service.cli.printing import STDERR_CONSOLE
    from cellcal.service.gc_freeze import freeze_startup_objects
    from cellcal.service.web.app import create_app  # the heavy part last
    from cellcal.service.web.context import ServiceSettings
    from cellcal.service.web.server import WebServer, bind_address, run_server

    def print_address(token: str) -> None:
        STDERR_CONSOLE.print(
            f"Open once: {address}/api/sign-in/console?token={token}", markup=False, soft_wrap=True
        )

    service_settings = ServiceSettings(
        cell, tls=listening.tls_cert is not None, allowed_hosts=listening.hosts,
        on_console_token=print_address if listening.on_loopback else None,
    )  # fmt: skip
    listening_socket = bind_address(listening.host, port)
    app = create_app(service_settings)
    STDERR_CONSOLE.print(
        f"cellcal serves {cell} on {address} (Ctrl+C ends it).", markup=False, soft_wrap=True
    )
    if listening.on_loopback:
        print_address(app.state.context.authenticator.console_token())
    freeze_startup_objects()
    config = uvicorn.Config(
        app, host=listening.host, port=port, log_level="warning", log_config=None, ws="websockets-sansio",
        timeout_graceful_shutdown=5,
        ws_per_message_deflate=False,  # fifty screens ten times a second: packing costs more than the bytes
        ssl_certfile=listening.tls_cert, ssl_keyfile=listening.tls_key, server_header=False, proxy_headers=False,
    )  # fmt: skip
    run_server(WebServer(config), listening_socket)
