"""One reader of HTTP answers for every driver: bounded in octets while it reads, never unpacked.

The client of the library reads whole answers, also those of a redirect and of a login, and unpacks them; a few
kilobytes of a damaged or foreign server can so fill the memory. This transport stands below all of that. The time is
bounded by ``answer_deadline`` around the request: the library's own limit begins anew with each octet.
"""

import ssl
from collections.abc import AsyncIterator

import httpx

_AS_IT_IS = "identity"
STEP_SHARE = 0.9  # of the deadline, for each step: a TLS handshake that is cancelled leaves its socket open


class OversizedAnswerError(httpx.HTTPError):
    """An answer is longer than any of this device, or packed although that was not asked for."""


class BoundedTransport(httpx.AsyncBaseTransport):
    """The library's transport, whose answers end at ``most_octets``.

    Raises
    ------
    OversizedAnswerError
        On reading an answer that is longer, or that is packed.
    """

    def __init__(
        self, most_octets: int, *, verify: ssl.SSLContext | bool, limits: httpx.Limits | None = None
    ) -> None:
        self._most_octets = most_octets
        self._stream: _BoundedStream | None = None
        self._inner = httpx.AsyncHTTPTransport(
            verify=verify, trust_env=False, limits=limits or httpx.Limits()
        )

    async def handle_async_request(self, request: httpx.Request) -> httpx.Response:
        request.headers["Accept-Encoding"] = _AS_IT_IS
        self._stream = None
        response = await self._inner.handle_async_request(request)
        if response.headers.get("content-encoding", _AS_IT_IS).strip().lower() != _AS_IT_IS:
            await response.aclose()
            raise OversizedAnswerError("it is packed, which was not asked for")
        assert isinstance(response.stream, httpx.AsyncByteStream)
        response.stream = self._stream = _BoundedStream(response.stream, self._most_octets)
        return response

    @property
    def is_half(self) -> bool:
        """Whether the last answer began, and has not come to its end."""
        return self._stream is not None and not self._stream.is_whole

    async def aclose(self) -> None:
        await self._inner.aclose()


class _BoundedStream(httpx.AsyncByteStream):
    def __init__(self, inner: httpx.AsyncByteStream, most_octets: int) -> None:
        self._inner, self._most_octets, self.is_whole = inner, most_octets, False

    async def __aiter__(self) -> AsyncIterator[bytes]:
        size = 0
        async for part in self._inner:
            size += len(part)
            if size > self._most_octets:
                raise OversizedAnswerError("it is too long")
            yield part
        self.is_whole = True

    async def aclose(self) -> None:
        await self._inner.aclose()
