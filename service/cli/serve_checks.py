"""What must be there before the service listens to other computers."""

import ssl
from dataclasses import dataclass
from pathlib import Path

from cellcal.calibration.errors import CellError
from cellcal.calibration.message import make_message
from cellcal.service.configuration.cell_file import read_cell_file
from cellcal.service.people.accounts import AccountStore
from cellcal.service.people.roles import Role
from cellcal.service.web.middleware import is_loopback


@dataclass(frozen=True, slots=True)
class ListenAddress:
    """The address on which the service listens, and the names by which it is known."""

    host: str
    tls_cert: Path | None = None
    tls_key: Path | None = None
    hosts: tuple[str, ...] = ()

    @property
    def on_loopback(self) -> bool:
        """Whether only this computer can reach it."""
        return is_loopback(self.host)

    @property
    def url_scheme(self) -> str:
        """The scheme of the addresses for browsers."""
        return "http" if self.tls_cert is None else "https"

    @property
    def host_name(self) -> str:
        """The name to show in an address."""
        name = self.hosts[0] if self.hosts else self.host
        return f"[{name}]" if ":" in name else name


def refuse_unguarded(cell: Path, listening: ListenAddress) -> None:
    """Refuse to listen to others without TLS, an administrator and names; refuse a certificate that cannot be used.

    Raises
    ------
    CellError
        What is missing, all of it.
    """
    if (listening.tls_cert is None) != (listening.tls_key is None):
        raise _usage_error("--tls-cert and --tls-key belong together.", "Give both.")
    for name in listening.hosts:
        if not name or any(each in "/:*@ " for each in name.removeprefix("[").removesuffix("]")):
            raise _usage_error(
                f"--allow-host {name!r} is no host's name.", "Give it without scheme, port and *."
            )
    if not listening.on_loopback:
        _refuse_missing(cell, listening)
    if listening.tls_cert is not None and listening.tls_key is not None:
        _refuse_bad_certificate(listening.tls_cert, listening.tls_key)


def _refuse_missing(cell: Path, listening: ListenAddress) -> None:
    people = AccountStore(read_cell_file(cell).cell.data_dir).list_people()
    lacks = {
        "a TLS certificate and key (--tls-cert, --tls-key)": listening.tls_cert is None,
        "an administrator (`cellcal people add … --role admin`)": all(
            p.role is not Role.ADMIN for p in people
        ),
        "the names that browsers use (--allow-host)": not listening.hosts,
    }
    missing = [what for what, is_missing in lacks.items() if is_missing]
    if missing:
        raise _usage_error(
            f"{listening.host} is not this computer alone, and what guards the service there is missing: "
            f"{'; '.join(missing)}.",
            "Set it up, or serve on 127.0.0.1.",
        )


def _refuse_bad_certificate(certificate: Path, key: Path) -> None:
    try:
        if key.stat().st_mode & 0o077:
            raise _usage_error(
                make_message("other users of this computer may read {path}.", path=key),
                make_message("Run: chmod 600 {path}", path=key),
            )
        ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER).load_cert_chain(certificate, key, password=lambda: b"")
    except OSError as error:  # also ssl.SSLError
        raise _usage_error(
            f"{certificate} with {key} cannot be used for TLS: {error.strerror or error}.",
            "Give a certificate and its own key, both PEM, the key without a password.",
        ) from error


def _usage_error(message: str, remedy: str) -> CellError:
    return CellError(message, remedy=remedy, code="usage")
