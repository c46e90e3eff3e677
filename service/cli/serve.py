"""``cellcal serve``: the service and its pages for one cell."""

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter


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
    import uvicorn

    from cellcal.service.cli.printing import STDERR_CONSOLE
    from cellcal.service.cli.serve_checks import ListenAddress, refuse_unguarded

    listening = ListenAddress(host, tls_cert, tls_key, tuple(name.lower() for name in allow_host))
    refuse_unguarded(cell, listening)
    from cellcal.service.gc_freeze import freeze_startup_objects
    from cellcal.service.web.app import create_app  # the heavy part last
    from cellcal.service.web.context import ServiceSettings
    from cellcal.service.web.server import WebServer, bind_address, run_server

    address = f"{listening.url_scheme}://{listening.host_name}:{port}"

    def print_address(token: str) -> None:
        STDERR_CONSOLE.print(
            f"Open once: {address}/api/sign-in/console?token={token}", markup=False, soft_wrap=True
        )

    service_settings = ServiceSettings(
        cell, tls=tls_cert is not None, allowed_hosts=listening.hosts,
        on_console_token=print_address if listening.on_loopback else None,
    )  # fmt: skip
    listening_socket = bind_address(host, port)
    app = create_app(service_settings)
    STDERR_CONSOLE.print(
        f"cellcal serves {cell} on {address} (Ctrl+C ends it).", markup=False, soft_wrap=True
    )
    if listening.on_loopback:
        print_address(app.state.context.authenticator.console_token())
    freeze_startup_objects()
    config = uvicorn.Config(
        app, host=host, port=port, log_level="warning", log_config=None, ws="websockets-sansio",
        timeout_graceful_shutdown=5,
        ws_per_message_deflate=False,  # fifty screens ten times a second: packing costs more than the bytes
        ssl_certfile=tls_cert, ssl_keyfile=tls_key, server_header=False, proxy_headers=False,
    )  # fmt: skip
    run_server(WebServer(config), listening_socket)
    return 0
