"""One session with an OPC UA server: made when it is needed, given up where it fails, made anew by the next request.

The library asyncua encodes and decodes; its tasks for reconnecting and renewing are not used, so that a session
begins and ends with the requests of this driver.
"""

import asyncio
import logging
import time
from collections.abc import Awaitable, Callable
from contextlib import suppress
from typing import TypeVar

from asyncua import Client, ua
from asyncua.client.ua_session import UaSession
from asyncua.common.utils import NotEnoughData
from asyncua.ua import ua_binary

from cellcal.calibration.message import make_message
from cellcal.drivers.errors import DeviceError, RefusedError, UnreachableError, WireProtocolError
from cellcal.drivers.opc_ua.bounded_protocol import BoundedProtocol, bound_answers
from cellcal.drivers.opc_ua.server_access import ServerAccess, prepare_client
from cellcal.drivers.wire.backoff import Backoff
from cellcal.drivers.wire.deadline import timeout_error
from cellcal.drivers.wire.link_errors import find_reason

T = TypeVar("T")
_CABLE = "Check that the controller is on, its OPC UA server runs, and address and port of the cell file are its own."
_CERTIFICATE = (
    "Check that the OPC UA server runs, and that server_certificate in the cell file is the one that it uses."
)
_ACCESS = (
    "Allow reading on the server: anonymously, or for the user and the certificates that the cell file names."
)
_REPORT = "Try again; if it stays, report this with the name and the version of the server."
_RENEW_SHARE = 0.5  # of the life of a secure channel
_CLOSING_S = 0.5
# The session or its channel is no more; a new one may be all right.
_SESSION_ENDED = frozenset(
    (
        ua.StatusCodes.BadSessionIdInvalid,
        ua.StatusCodes.BadSessionClosed,
        ua.StatusCodes.BadSessionNotActivated,
        ua.StatusCodes.BadSecureChannelIdInvalid,
        ua.StatusCodes.BadSecureChannelClosed,
        ua.StatusCodes.BadSecureChannelTokenUnknown,
        ua.StatusCodes.BadConnectionClosed,
        ua.StatusCodes.BadConnectionRejected,
        ua.StatusCodes.BadServerHalted,
        ua.StatusCodes.BadShutdown,
        ua.StatusCodes.BadCommunicationError,
        ua.StatusCodes.BadTimeout,
    )
)
_NOT_LET_IN = frozenset(
    (
        ua.StatusCodes.BadSecurityPolicyRejected,
        ua.StatusCodes.BadSecurityModeRejected,
        ua.StatusCodes.BadSecurityChecksFailed,
        ua.StatusCodes.BadIdentityTokenRejected,
        ua.StatusCodes.BadIdentityTokenInvalid,
        ua.StatusCodes.BadUserAccessDenied,
    )
)
logging.getLogger("asyncua").setLevel(
    logging.CRITICAL
)  # what it reports as errors is reported here, in sentences


class _RefusedArray:
    """Arrays of the type Null: no element takes an octet, and the library makes as many as a damaged length says."""

    @staticmethod
    def unpack_array(data: object, length: int) -> list[None]:
        """Refuse an array."""
        del data, length
        raise ValueError("an array of empty values")


bound_answers()
ua_binary.Primitives1.Null = _RefusedArray  # found there by the library's reader of arrays


class ServerLink:
    """Asks one server; a request that fails ends the session."""

    def __init__(self, device: str, url: str, access: ServerAccess, *, deadline_s: float) -> None:
        self.device, self._url, self._access, self._deadline_s = device, url, access, deadline_s
        self._client: Client | None = None
        self._newest: Client | None = None  # also one that never got a session
        self._renew_at_s = 0.0
        self._backoff = Backoff()
        self.session_number = 0  # counts sessions: node ids of an earlier one may be other nodes

    async def connect(self) -> None:
        """Make a session, where there is none; renew the channel of one before its life ends."""
        if self._client is not None:
            await self._renew_channel(self._client)
            return
        await self._backoff.wait()
        client = Client(self._url, timeout=self._deadline_s)
        client.name = client.description = "cellcal"
        self._newest = client
        try:
            await prepare_client(self.device, client, self._access)
            await self._enter_session(client)
        except BaseException:
            self._backoff.note_failure()
            client.disconnect_socket()
            raise
        self._backoff.note_success()
        self._client = client
        self.session_number += 1

    async def ask(self, request: Callable[[UaSession], Awaitable[T]], asking: str) -> T:
        """Return the answer to a request; ``asking`` says in a message what for."""
        await self.connect()
        client = self._client
        assert client is not None
        assert isinstance(client.uaclient.protocol, BoundedProtocol)
        client.uaclient.protocol.note_request()
        return await self._ask_server(lambda: request(client.uaclient.session), asking)

    async def close(self) -> None:
        """End the session in good order, if the server still listens."""
        client, self._client = self._client, None
        if client is None:
            return
        with suppress(Exception):  # whatever is left of it ends with the socket
            async with asyncio.timeout(_CLOSING_S):
                await client.close_session()
                await client.close_secure_channel()
        client.disconnect_socket()

    def is_half(self) -> bool:
        """Whether the server has begun an answer, and not ended it."""
        protocol = None if self._newest is None else self._newest.uaclient.protocol
        return isinstance(protocol, BoundedProtocol) and protocol.is_half

    def drop(self) -> None:
        """Give the session up; the next request makes a new one."""
        client, self._client = self._client, None
        if client is not None:
            client.disconnect_socket()

    async def _enter_session(self, client: Client) -> None:
        async def make_session() -> None:
            await client.connect_socket()
            await client.send_hello()
            await client.open_secure_channel()
            await client.create_session()
            await client.activate_session(self._access.user or None, self._access.password or None)

        await self._ask_server(make_session, "a session")
        self._note_channel(client)

    async def _renew_channel(self, client: Client) -> None:
        if time.monotonic() >= self._renew_at_s:
            await self._ask_server(lambda: client.open_secure_channel(renew=True), "a longer session")
            self._note_channel(client)

    def _note_channel(self, client: Client) -> None:
        self._renew_at_s = time.monotonic() + _RENEW_SHARE * client.secure_channel_timeout / 1000.0

    async def _ask_server(self, request: Callable[[], Awaitable[T]], asking: str) -> T:
        """Await a request; turn what the library raises into a DeviceError."""
        try:
            return await request()
        except asyncio.CancelledError as cancelled:
            # The library has a kind of its own where an answer came meanwhile, which no deadline takes as its end
            raise asyncio.CancelledError from cancelled
        except TimeoutError:
            is_half = self.is_half()
            self.drop()
            raise timeout_error(
                self.device, self._deadline_s, "waiting for the OPC UA server", is_half=is_half
            ) from None
        except OSError as error:
            self.drop()
            raise self._lost_error(find_reason(error)) from error
        except ua.UaStatusCodeError as error:
            raise self._status_error(error, asking) from error
        except Exception as error:
            self.drop()
            if isinstance(error, ua.UaError) and not isinstance(error, NotEnoughData):
                # raised by the library where server and client have no way in common
                raise self._not_let_in_error(str(error), 0) from error
            raise WireProtocolError(
                self.device,
                make_message(
                    "the OPC UA server answered to {asking} with what cannot be read ({error_type}: {error}).",
                    asking=asking,
                    error_type=type(error).__name__,
                    error=error,
                ),
                remedy=_REPORT,
            ) from error

    def _status_error(self, error: ua.UaStatusCodeError, asking: str) -> DeviceError:
        status = ua.StatusCode(ua.UInt32(error.code)).name
        if error.code in _SESSION_ENDED:
            self.drop()
            return self._lost_error(status)
        if error.code in _NOT_LET_IN:
            return self._not_let_in_error(status, error.code)
        return RefusedError(
            self.device,
            make_message("the OPC UA server refuses {asking} ({status}).", asking=asking, status=status),
            remedy=_REPORT,
            vendor_code=error.code,
            vendor_text=status,
        )

    def _not_let_in_error(self, status: str, code: int) -> RefusedError:
        return RefusedError(
            self.device,
            make_message("the OPC UA server does not let this program in ({status}).", status=status),
            remedy=_ACCESS,
            vendor_code=code,
            vendor_text=status,
        )

    def _lost_error(self, reason: str) -> UnreachableError:
        return UnreachableError(
            self.device,
            make_message("no connection to the OPC UA server {url}: {reason}.", url=self._url, reason=reason),
            remedy=_CABLE if self._access.files is None else _CERTIFICATE,
        )
