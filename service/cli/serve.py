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

    from cellcal.service.cli.printing import EN_ROUTE
    from cellcal.service.cli.serve_checks import Listening, refuse_unguarded

    listening = Listening(host, tls_cert, tls_key, tuple(name.lower() for name in allow_host))
    refuse_unguarded(cell, listening)
    from cellcal.service.settled import settle
    from cellcal.service.web.app import create_app  # the heavy part last
    from cellcal.service.web.context import Settings
    from cellcal.service.web.server import Server, bind_address, run_server

    address = f"{listening.scheme}://{listening.name}:{port}"

    def show(token: str) -> None:
        EN_ROUTE.print(
            f"Open once: {address}/api/sign-in/console?token={token}", markup=False, soft_wrap=True
        )

    known = Settings(
        cell, tls=tls_cert is not None, allowed_hosts=listening.hosts,
        on_console_token=show if listening.on_loopback else None,
    )  # fmt: skip
    listening_socket = bind_address(host, port)
    app = create_app(known)
    EN_ROUTE.print(f"cellcal serves {cell} on {address} (Ctrl+C ends it).", markup=False, soft_wrap=True)
    if listening.on_loopback:
        show(app.state.house.entrance.console_token())
    settle()
    config = uvicorn.Config(
        app, host=host, port=port, log_level="warning", log_config=None, ws="websockets-sansio",
        timeout_graceful_shutdown=5,
        ws_per_message_deflate=False,  # fifty screens ten times a second: packing costs more than the bytes
        ssl_certfile=tls_cert, ssl_keyfile=tls_key, server_header=False, proxy_headers=False,
    )  # fmt: skip
    run_server(Server(config), listening_socket)
    return 0
