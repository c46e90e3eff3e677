"""Questions and answers over UDP: one at a time, repeated where that is harmless, matched by their number."""

import asyncio
import itertools
from collections.abc import AsyncIterator

from cellcal.calibration.message import make_message
from cellcal.drivers.errors import RefusedError, UnreachableError, WireProtocolError
from cellcal.drivers.wire.deadline import AnswerDeadline, timeout_error
from cellcal.drivers.wire.link_errors import no_connection_error, unreadable_answer_error
from cellcal.drivers.wire.tables import code_table
from cellcal.drivers.wire.trace import FrameTrace
from cellcal.drivers.yaskawa.hses_frames import (
    FILE_DIVISION,
    LAST_BLOCK,
    MOST_DATA,
    HsesAnswer,
    HsesRequest,
    read_answer,
)

_ATTEMPTS = 4
_MOST_BLOCKS = 4096  # of a file: 2 MB
_CABLE = "Check that the controller is switched on, the network cable plugged in and the Ethernet function enabled."
_UNKNOWN = "Read the message on the pendant."


class HsesLink(asyncio.DatagramProtocol):
    """One UDP socket to one port of a controller."""

    def __init__(self, device: str, address: str, port: int, division: int, *, deadline_s: float) -> None:
        self.device = device
        self._address, self._port, self._division, self._deadline_s = address, port, division, deadline_s
        self._transport: asyncio.DatagramTransport | None = None
        self._frames: asyncio.Queue[bytes | OSError] = asyncio.Queue(maxsize=64)
        self._numbers = itertools.cycle(range(1, 256))
        self._lock = asyncio.Lock()
        self.trace = FrameTrace(device)

    async def open(self) -> None:
        """Make the socket; nothing is sent yet.

        Raises
        ------
        UnreachableError
            The address names no host.
        """
        loop = asyncio.get_running_loop()
        try:
            self._transport, _ = await loop.create_datagram_endpoint(
                lambda: self, remote_addr=(self._address, self._port)
            )
        except OSError as error:
            raise no_connection_error(self.device, self._address, error, _CABLE) from error

    def close(self) -> None:
        """Close the socket."""
        if self._transport is not None:
            self._transport.close()
            self._transport = None

    def datagram_received(self, data: bytes, addr: object) -> None:
        """Keep an answer until it is read; a flood beyond the room is dropped, as by the network itself."""
        if not self._frames.full():
            self._frames.put_nowait(data)

    def error_received(self, exc: Exception) -> None:
        """Keep an error of the network, such as a port that nothing listens at."""
        if isinstance(exc, OSError) and not self._frames.full():
            self._frames.put_nowait(exc)

    async def ask(self, request: HsesRequest) -> bytes:
        """Return the data of the answer.

        Raises
        ------
        RefusedError
            The controller refuses; its two status words are in ``vendor_code``.
        DeviceTimeoutError, UnreachableError, WireProtocolError
            No answer, no controller, or an answer that is none.
        """
        async with self._lock:
            return self._data_of(await self._exchange(request), request)

    async def read_file(self, name: str) -> bytes:
        """Return a file of the controller, block by block. Errors as for ``ask``."""
        request = HsesRequest(0, 0, 0, 0x16, name.encode("ascii"), FILE_DIVISION)
        async with self._lock:
            return b"".join([block async for block in self._read_blocks(request)])

    async def list_files(self, pattern: str) -> bytes:
        """Return the names of files, a line each. Errors as for ``ask``."""
        request = HsesRequest(0, 0, 0, 0x32, pattern.encode("ascii"), FILE_DIVISION)
        async with self._lock:
            return b"".join([block async for block in self._read_blocks(request)])

    async def delete_file(self, name: str) -> None:
        """Delete a file of the controller. Errors as for ``ask``."""
        await self.ask(HsesRequest(0, 0, 0, 0x09, name.encode("ascii"), FILE_DIVISION, repeatable=False))

    async def write_file(self, name: str, content: bytes) -> None:
        """Write a file of the controller; each block is acknowledged. Errors as for ``ask``."""
        request = HsesRequest(0, 0, 0, 0x15, name.encode("ascii"), FILE_DIVISION, repeatable=False)
        parts = [content[k : k + MOST_DATA] for k in range(0, len(content), MOST_DATA)] or [b""]
        async with self._lock:
            self._forget_late_answers()
            number = next(self._numbers)
            answer = await self._exchange_frame(request.to_frame(number), request, number, None)
            self._data_of(answer, request)
            for k, part in enumerate(parts, start=1):
                block = k | (LAST_BLOCK if k == len(parts) else 0)
                carrier = HsesRequest(0, 0, 0, 0x15, part, FILE_DIVISION, repeatable=False)
                frame = carrier.to_frame(number, block=block, acknowledges=True)
                self._data_of(await self._exchange_frame(frame, carrier, number, None), carrier)

    async def _read_blocks(self, request: HsesRequest) -> AsyncIterator[bytes]:
        self._forget_late_answers()
        number = next(self._numbers)
        frame = request.to_frame(number)
        expected_block = 1
        for _ in range(_MOST_BLOCKS):
            answer = await self._exchange_frame(frame, request, number, expected_block)
            yield self._data_of(answer, request)
            confirmation = HsesRequest(0, 0, 0, request.service, b"", FILE_DIVISION)
            frame = confirmation.to_frame(number, block=answer.block, acknowledges=True)
            if answer.ends_file:
                self._send(frame)
                return
            expected_block += 1
        raise WireProtocolError(self.device, "a file does not end.", remedy=_UNKNOWN)

    async def _exchange(self, request: HsesRequest) -> HsesAnswer:
        self._forget_late_answers()
        number = next(self._numbers)
        return await self._exchange_frame(request.to_frame(number), request, number, None)

    async def _exchange_frame(
        self, frame: bytes, request: HsesRequest, number: int, block: int | None
    ) -> HsesAnswer:
        """Send until an answer comes; an order that must not happen twice is sent once."""
        attempts = _ATTEMPTS if request.repeatable else 1
        for _ in range(attempts):
            self._send(frame)
            try:
                async with AnswerDeadline(self._deadline_s / attempts):
                    return await self._next_answer(request, number, block)
            except TimeoutError:
                continue
        raise timeout_error(self.device, self._deadline_s, "waiting for an answer")

    async def _next_answer(self, request: HsesRequest, number: int, block: int | None) -> HsesAnswer:
        while True:
            frame = await self._frames.get()
            if isinstance(frame, OSError):
                raise UnreachableError(
                    self.device,
                    make_message(
                        "the controller is not there: {strerror}.", strerror=frame.strerror or frame
                    ),
                    remedy=_CABLE,
                )
            self.trace.add_frame("<", frame.hex())
            answer = self._read_frame(frame)
            if answer.answers(request, number) and self._is_block(answer, block):
                return answer  # others are late answers to earlier questions, or doubled blocks

    def _is_block(self, answer: HsesAnswer, block: int | None) -> bool:
        """Return whether this is the expected block; what fits one answer may bear no number, as other answers."""
        if block is None or answer.status != 0 or answer.block & ~LAST_BLOCK == block:
            return True
        return block == 1 and answer.block == LAST_BLOCK

    def _read_frame(self, frame: bytes) -> HsesAnswer:
        try:
            return read_answer(frame, self._division)
        except ValueError as error:
            raise unreadable_answer_error(
                self.device,
                str(error),
                "Check that the address is that of a Yaskawa controller.",
                frame.hex(),
            ) from error

    def _data_of(self, answer: HsesAnswer, request: HsesRequest) -> bytes:
        if answer.status == 0:
            return answer.data
        code = answer.added_status if answer.status == 0x1F else answer.status
        entry = code_table("cellcal.drivers.yaskawa", "refusals.tsv").get(code)
        text = (
            entry.text
            if entry
            else make_message(
                "status {status:02X} with {added_status:04X}",
                status=answer.status,
                added_status=answer.added_status,
            )
        )
        raise RefusedError(
            self.device,
            make_message(
                "the controller refuses command {command:03X}: {text}.", command=request.command, text=text
            ),
            remedy=entry.remedy if entry else _UNKNOWN,
            vendor_code=code,
        )

    def _send(self, frame: bytes) -> None:
        if self._transport is None:
            raise UnreachableError(self.device, "the connection is closed.", remedy=_CABLE)
        self.trace.add_frame(">", frame.hex())
        self._transport.sendto(frame)

    def _forget_late_answers(self) -> None:
        while not self._frames.empty():
            self._frames.get_nowait()
