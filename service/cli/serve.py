"""``cellcal serve``: the service and its pages for one cell."""

from pathlib import Path


def serve(cell: Path, /, *, host: str = "127.0.0.1", port: int = 8470) -> int:
    """Serve a cell to browsers: the wizard, its live values, its history.

    Parameters
    ----------
    cell
        The cell file (TOML).
    host
        The address to listen on. Anything but loopback is refused until TLS, people and allowed hosts are set up.
    port
        The port to listen on.
    """
    import ipaddress

    import uvicorn

    from calibration.errors import CellError
    from service.cli.printing import EN_ROUTE
    from service.web.app import Settings, create_app

    try:
        on_loopback = ipaddress.ip_address(host).is_loopback
    except ValueError:
        on_loopback = host == "localhost"
    if not on_loopback:
        raise CellError(
            f"{host} is not this computer alone, and the service has no people and no TLS to guard it with.",
            remedy="Serve on 127.0.0.1.",
            code="usage",
        )
    app = create_app(Settings(cell))
    EN_ROUTE.print(f"cellcal serves {cell} on http://{host}:{port} (Ctrl+C ends it).")
    uvicorn.run(
        app, host=host, port=port, log_level="warning", ws="websockets-sansio", timeout_graceful_shutdown=5
    )
    return 0
