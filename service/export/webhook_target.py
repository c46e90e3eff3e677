"""Where a webhook may go, and one delivery to it: no redirect, no proxy, and only to an address that was checked.

A cell file is written by the cell's administrator; a name in it is not: what it resolves to is checked each
time, and the connection goes to the very address that was checked.
"""

import http.client
import ipaddress
import socket
import ssl
import threading
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from urllib.parse import urlsplit

from cellcal.calibration.errors import CellError
from cellcal.service.configuration.report_tables import WebhookTable

TIMEOUT_S = 10.0
WHOLE_S = 30.0  # a receiver that answers a byte at a time
_IpAddress = ipaddress.IPv4Address | ipaddress.IPv6Address
_TRANSLATED = ipaddress.ip_network("2002::/16")  # leads on to an IPv4 address, which may be any


class WebhookError(CellError):
    """An event cannot be delivered."""

    code = "site"


@dataclass(frozen=True, slots=True)
class WebhookTarget:
    """A receiver, as the cell file names it."""

    scheme: str
    host: str
    port: int
    path: str
    private_network: bool
    ca_file: Path | None

    @property
    def is_here(self) -> bool:
        """Whether it is named as a program of this computer."""
        return _is_loopback_name(self.host)


def target_of(table: WebhookTable) -> WebhookTarget:
    """Return where a cell file wants its alarms.

    Raises
    ------
    WebhookError
        The address is none that may be used.
    """
    try:
        parts = urlsplit(table.url)
        port = parts.port or (443 if parts.scheme == "https" else 80)
    except ValueError as error:
        raise _usage_error(f"{table.url!r} is no address: {error}.") from error
    host = parts.hostname or ""
    if parts.username is not None or parts.password is not None:
        raise _usage_error(
            "the webhook's url holds a name or a password; the signature is what proves who sends."
        )
    if any(letter <= " " or letter == "\x7f" for letter in table.url) or parts.fragment or not host:
        raise _usage_error(f"{table.url!r} is no address of a receiver.")
    if parts.scheme != "https" and not (parts.scheme == "http" and _is_loopback_name(host)):
        raise _usage_error("a webhook goes to https://…, or to http://… of this computer itself.")
    path = (parts.path or "/") + (f"?{parts.query}" if parts.query else "")
    return WebhookTarget(parts.scheme, host, port, path, table.private_network, table.ca_file)


def deliver_event(target: WebhookTarget, body: bytes, headers: Mapping[str, str]) -> int:
    """Send one event and return the status of the answer.

    Raises
    ------
    WebhookError
        No answer, the address is not allowed, or what answers is no web server.
    """
    connection = _CheckedConnection(target)
    # whatever happens, this one delivery ends: a socket's own timeout begins anew with each byte
    watchdog = threading.Timer(WHOLE_S, connection.cut_connection)
    watchdog.daemon = True
    watchdog.start()
    try:
        connection.request("POST", target.path, body=body, headers=dict(headers))
        return connection.getresponse().status
    except (OSError, http.client.HTTPException, UnicodeError) as error:
        why = getattr(error, "strerror", None) or str(error) or type(error).__name__
        raise WebhookError(
            f"{target.host}:{target.port} does not take the event: {why}.",
            remedy="See that it runs, and that this computer reaches it.",
            code="device.unreachable",
        ) from error
    finally:
        watchdog.cancel()
        connection.close()


def refuse_address(address: _IpAddress, target: WebhookTarget) -> None:
    """Raise WebhookError for an address that the cell file did not mean to reach."""
    mapped = getattr(address, "ipv4_mapped", None)
    address = mapped or address
    never = address.is_multicast or address.is_unspecified or address.is_link_local or address.is_reserved
    if address.is_loopback:
        allowed = target.is_here
    elif never or target.is_here:
        allowed = False
    else:
        translated = address.version == 6 and address in _TRANSLATED
        allowed = target.private_network or (address.is_global and not translated)
    if not allowed:
        raise WebhookError(
            f"{target.host} is {address}: no event is sent there.",
            remedy="A receiver in the plant's own network needs `private_network = true` in [webhook]. Addresses of "
            "this computer are named as such; link-local ones are never used.",
            code="usage",
        )


class _CheckedConnection(http.client.HTTPConnection):
    """A connection to an address that was checked, with TLS for the name that was meant."""

    def __init__(self, target: WebhookTarget) -> None:
        super().__init__(target.host, target.port, timeout=TIMEOUT_S)
        self._target = target

    def connect(self) -> None:
        address = _resolve_address(self._target)
        context = _ssl_context(self._target)
        plain = socket.create_connection((str(address), self._target.port), TIMEOUT_S)
        self.sock = plain
        if context is not None:
            self.sock = context.wrap_socket(plain, server_hostname=self._target.host)

    def cut_connection(self) -> None:
        """End it, from another thread."""
        if self.sock is not None:
            try:
                self.sock.shutdown(socket.SHUT_RDWR)
            except OSError:
                return


def _resolve_address(target: WebhookTarget) -> _IpAddress:
    found = socket.getaddrinfo(target.host, target.port, type=socket.SOCK_STREAM)
    addresses = [ipaddress.ip_address(str(one[4][0]).partition("%")[0]) for one in found]
    for address in addresses:
        refuse_address(address, target)
    return addresses[0]


def _ssl_context(target: WebhookTarget) -> ssl.SSLContext | None:
    if target.scheme == "http":
        return None
    context = ssl.create_default_context(cafile=None if target.ca_file is None else str(target.ca_file))
    context.minimum_version = ssl.TLSVersion.TLSv1_2
    return context


def _is_loopback_name(host: str) -> bool:
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return host == "localhost"


def _usage_error(message: str) -> WebhookError:
    return WebhookError(message, remedy="Correct url in [webhook] of the cell file.", code="usage")
