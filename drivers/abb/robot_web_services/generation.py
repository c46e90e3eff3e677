"""Which generation of Robot Web Services answers at an address; found out without saying user or password.

A controller of the first asks for digest authentication over HTTP, one of the second for basic authentication over
TLS. Plain HTTP is asked first: an answer over it that is no digest challenge is not taken, so that the
password of a basic authentication never goes out without TLS.
"""

import asyncio
import logging
import ssl
from dataclasses import dataclass
from pathlib import Path

import httpx

from cellcal.calibration.message import make_message
from cellcal.drivers.abb.robot_web_services.dialects import Dialect, FirstDialect, SecondDialect
from cellcal.drivers.errors import RefusedError, UnreachableError
from cellcal.drivers.wire.http_answers import STEP_SHARE, BoundedTransport
from cellcal.drivers.wire.link_errors import bracket_host, find_reason

_LOG = logging.getLogger(__name__)
_HTTP, _HTTPS = 80, 443
_ATTEMPTS = 2
_MOST_OCTETS = 100_000  # of a refusal
NO_SESSION = (
    "the controller has no session left.",
    "End other clients of Robot Web Services, or wait ten minutes.",
)
CABLE = "Check that the controller is on, the cable is in its WAN or service port, and the address is right."


@dataclass(frozen=True, slots=True)
class ServiceAddress:
    """The address of a controller; ``certificate`` is a file in PEM form, None where its own is taken unseen."""

    device: str
    host: str
    port: int | None  # None: the port that is usual for the generation
    certificate: Path | None = None

    def url(self, scheme: str) -> str:
        """Return the address with its scheme and port."""
        port = self.port or (_HTTPS if scheme == "https" else _HTTP)
        return f"{scheme}://{bracket_host(self.host)}:{port}"


@dataclass(frozen=True, slots=True)
class FoundService:
    """The service that answered, and how to go on with it."""

    dialect: Dialect
    base_url: str
    tls: ssl.SSLContext | bool


@dataclass(frozen=True, slots=True)
class _Answer:
    """The authentication that a server asks for; "" and the reason where it is not Robot Web Services."""

    challenge: str = ""
    reason: str = ""
    has_no_session: bool = False


async def find_service(address: ServiceAddress, limit_s: float) -> FoundService:
    """Ask without a password which generation answers; each of the two questions takes at most half of the limit.

    Raises
    ------
    UnreachableError
        Nothing answers as Robot Web Services.
    RefusedError
        The controller shows another certificate than the one of the cell file, or the file is none.
    """
    tls = _make_tls_context(address)
    first = await _ask_challenge(address.url("http"), ssl.create_default_context(), limit_s)
    if first.challenge == "digest":
        return FoundService(FirstDialect(), address.url("http"), tls=True)
    if first.has_no_session:
        raise _no_session_error(address.device)
    second = await _ask_challenge(address.url("https"), tls, limit_s, address.device)
    if second.has_no_session:
        raise _no_session_error(address.device)
    if second.challenge == "basic":
        if address.certificate is None:
            _LOG.warning("%s: its certificate is not compared; name it in the cell file", address.device)
        return FoundService(SecondDialect(), address.url("https"), tls)
    raise UnreachableError(
        address.device,
        make_message(
            "no Robot Web Services at {first_url}: {first}; at {second_url}: {second}.",
            first_url=address.url("http"),
            first=first.reason,
            second_url=address.url("https"),
            second=second.reason,
        ),
        remedy=CABLE,
    )


async def _ask_challenge(url: str, tls: ssl.SSLContext, limit_s: float, device: str = "") -> _Answer:
    """Return the first word of the challenge in lower case, or why there is none."""
    accept = SecondDialect.accept if url.startswith("https") else FirstDialect.accept
    limit_s /= _ATTEMPTS
    transport = BoundedTransport(_MOST_OCTETS, verify=tls)
    try:
        async with (
            asyncio.timeout(limit_s),
            httpx.AsyncClient(transport=transport, timeout=limit_s * STEP_SHARE) as client,
        ):
            response = await client.get(f"{url}/rw/system", headers={"Accept": accept})
    except httpx.ConnectError as error:
        if device and "CERTIFICATE_VERIFY_FAILED" in str(error):
            raise RefusedError(
                device,
                "the controller does not show the certificate of the cell file.",
                remedy="Check the address; after a change of the certificate save the new one and name it.",
            ) from error
        return _Answer(reason=find_reason(error))
    except (TimeoutError, httpx.TimeoutException):
        return _Answer(reason=make_message("no answer within {limit_s:.1f} s", limit_s=limit_s))
    except httpx.RemoteProtocolError as error:
        return _Answer(reason=make_message("what answers is no web server ({error})", error=error))
    except (httpx.HTTPError, httpx.InvalidURL) as error:
        return _Answer(reason=find_reason(error))
    challenge = str(response.headers.get("www-authenticate", "")).partition(" ")[0].lower()
    refused = response.status_code == httpx.codes.UNAUTHORIZED
    reason = make_message("a web server answers that is none (status {status})", status=response.status_code)
    full = response.status_code == httpx.codes.SERVICE_UNAVAILABLE
    return _Answer(challenge if refused else "", reason, has_no_session=full)


def _no_session_error(device: str) -> RefusedError:
    return RefusedError(device, NO_SESSION[0], remedy=NO_SESSION[1], vendor_code=503)


def _make_tls_context(address: ServiceAddress) -> ssl.SSLContext:
    """Return a context that takes one certificate, whatever name it bears: controllers sign their own."""
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
    context.check_hostname = False
    if address.certificate is None:
        context.verify_mode = ssl.CERT_NONE
        return context
    try:
        context.load_verify_locations(cafile=address.certificate)
    except (OSError, ssl.SSLError) as error:
        raise RefusedError(
            address.device,
            make_message("{certificate} is no certificate.", certificate=str(address.certificate)),
            remedy="Save the controller's certificate in PEM form and name the file in the cell file.",
        ) from error
    return context
