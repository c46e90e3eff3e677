"""Modbus TCP, fenced: only the answer to this very request can become a value.

What pymodbus leaves to its caller, and what is done about it here:

* exception answers come back as values; each becomes a typed error from ``modbus_exceptions.tsv``
* an answer with another function code, register count or transaction id 0 is handed over as if it were ours;
  all three are compared
* after a time-out the link stays up, and the late answer may meet the next request; a link that failed, or
  whose request was cancelled, is dropped, and the next call makes a new one
* a lost connection is noticed only at the end of the time-out; here it ends the request at once
* after a standstill of this process its time-out wins over an answer that came in time; here the answer counts
"""

import asyncio
from collections.abc import Awaitable, Callable, Coroutine, Sequence
from contextlib import suppress
from functools import partial
from typing import Any

from pymodbus.client import AsyncModbusTcpClient
from pymodbus.exceptions import ModbusException
from pymodbus.pdu import ModbusPDU

from cellcal.calibration.message import make_message
from cellcal.drivers.errors import (
    DeviceError,
    DeviceTimeoutError,
    RefusedError,
    UnreachableError,
    WireProtocolError,
)
from cellcal.drivers.wire.backoff import Backoff
from cellcal.drivers.wire.cancellation import cancel_until_done
from cellcal.drivers.wire.deadline import AnswerDeadline
from cellcal.drivers.wire.link_errors import no_connection_error
from cellcal.drivers.wire.tables import CodeEntry, code_table
from cellcal.drivers.wire.trace import FrameTrace

Words = tuple[int, ...]
ServerCheck = Callable[["ModbusLink"], Awaitable[None]]
_Ask = Callable[[AsyncModbusTcpClient], Awaitable[ModbusPDU]]

_READ, _WRITE_COIL, _WRITE = 3, 5, 16
_BUSY_PAUSES_S = (0.02, 0.05, 0.1)
_NEVER = 10.0  # deadlines: the library's own time-out ends a wait whose answer has come, see Limit
_CANCEL_AGAIN_S = 0.5
_NO_MODBUS = "Check that address and port are those of the device's Modbus server, and the network cable."
_NEVER_ANSWERED = (
    "Check power and network cable, and that address and port of the cell file are its Modbus server's."
)
_CABLE = "Check its power and the network cable; the next call connects again by itself."
_UNKNOWN = "Report this to the maker of the profile; the reading was not used."


class _BusyAnswer(Exception):  # noqa: N818 - never leaves this module
    def __init__(self, entry: CodeEntry) -> None:
        self.entry = entry


class ModbusLink:
    """One Modbus TCP connection at a time, one request at a time, addresses counted from 1."""

    def __init__(
        self, device: str, host: str, port: int, *, deadline_s: float, check_server: ServerCheck | None = None
    ) -> None:
        self.device = device
        self.trace = FrameTrace(device)
        self._is_unreadable = self._has_answered = False
        self._host, self._port, self._deadline_s = host, port, deadline_s
        self.check_server = check_server
        self._client: AsyncModbusTcpClient | None = None
        self._lost: asyncio.Future[None] | None = None
        self._is_checked = False
        self._turn = asyncio.Lock()
        self._backoff = Backoff()

    async def open(self) -> None:
        """Connect and check who answers; raises UnreachableError or what the greeting raises."""
        async with self._turn:
            await self._ensure_connected()

    async def close(self) -> None:
        """Hang up. May be called twice."""
        self._drop_connection()
        await asyncio.sleep(0)  # lets the transport close its socket before the loop may end

    async def read(self, address: int, count: int) -> Words:
        """Read ``count`` holding registers (FC 3). A busy device is asked again a few times."""
        async with self._turn:
            return await self._read_with_retries(lambda: self._read_once(address, count))

    async def write(self, address: int, words: Sequence[int]) -> None:
        """Write holding registers in one telegram (FC 16). Never repeated by itself."""
        async with self._turn:
            await self._ensure_connected()
            try:
                answer = await self._exchange_request(
                    lambda client: client.write_registers(address - 1, list(words)), _WRITE
                )
            except _BusyAnswer as busy:
                raise self._refused_error(busy.entry) from None
            if (answer.address, answer.count) != (address - 1, len(words)):
                what = make_message(
                    "confirmed {count} words at {address}", count=answer.count, address=answer.address + 1
                )
                raise self._foreign_answer_error(what)

    async def write_coil(self, address: int, value: bool) -> None:
        """Write one output bit (FC 5) and leave its neighbours alone. Never repeated by itself."""
        async with self._turn:
            await self._ensure_connected()
            try:
                answer = await self._exchange_request(
                    lambda client: client.write_coil(address - 1, value), _WRITE_COIL
                )
            except _BusyAnswer as busy:
                raise self._refused_error(busy.entry) from None
            if (answer.address, answer.bits[:1]) != (address - 1, [value]):
                what = make_message(
                    "confirmed {bits} at coil {address}", bits=answer.bits[:1], address=answer.address + 1
                )
                raise self._foreign_answer_error(what)

    async def read_during_check(self, address: int, count: int) -> Words:
        """Read while the connection is being made; for greetings only. A busy device is asked again, too."""
        return await self._read_with_retries(lambda: self._ask_registers(address, count))

    async def _read_with_retries(self, read: Callable[[], Awaitable[Words]]) -> Words:
        for pause_s in _BUSY_PAUSES_S:
            with suppress(_BusyAnswer):
                return await read()
            await asyncio.sleep(pause_s)
        try:
            return await read()
        except _BusyAnswer as busy:
            raise self._refused_error(busy.entry) from None

    async def _read_once(self, address: int, count: int) -> Words:
        await self._ensure_connected()
        return await self._ask_registers(address, count)

    async def _ask_registers(self, address: int, count: int) -> Words:
        answer = await self._exchange_request(
            lambda client: client.read_holding_registers(address - 1, count=count), _READ
        )
        words = tuple(answer.registers)
        if len(words) != count:
            raise self._foreign_answer_error(
                make_message("sent {got} registers instead of {expected}", got=len(words), expected=count)
            )
        return words

    async def _ensure_connected(self) -> None:
        if self._client is not None and self._client.connected and self._is_checked:
            return
        self._drop_connection()
        await self._backoff.wait()
        try:
            await self._open_connection()
            if self.check_server is not None:
                await self.check_server(self)
            self._is_checked = True
        except BaseException:
            self._backoff.note_failure()
            self._drop_connection()
            raise
        self._backoff.note_success()

    async def _open_connection(self) -> None:
        self._lost, self._is_unreadable = asyncio.get_running_loop().create_future(), False
        self._client = AsyncModbusTcpClient(
            self._host, port=self._port, timeout=_NEVER * self._deadline_s, retries=0, reconnect_delay=0,
            trace_packet=self._trace_packet, trace_connect=self._connection_changed,
        )  # fmt: skip
        self._client.ctx.data_received = partial(self._take_received, self._client)  # type: ignore[method-assign]
        reasons: list[OSError] = []
        self._client.ctx.call_create = partial(_note_reason, self._client.ctx.call_create, reasons)
        connected = False
        with suppress(TimeoutError):
            async with AnswerDeadline(self._deadline_s):
                connected = await self._client.connect()
        if not connected:
            where = f"{self._host}:{self._port}"
            if reasons:
                raise no_connection_error(self.device, where, reasons[0], self._remedy)
            raise UnreachableError(
                self.device, make_message("no connection to {where}.", where=where), remedy=self._remedy
            )

    @property
    def _remedy(self) -> str:
        """What to do about a loss: what never answered may be another device."""
        return _CABLE if self._has_answered else _NEVER_ANSWERED

    async def _exchange_request(self, ask: _Ask, function: int) -> ModbusPDU:
        """Send one request and return its own answer; on anything else the connection is dropped."""
        client, lost = self._client, self._lost
        if client is None or lost is None:
            raise UnreachableError(self.device, "the connection was closed.", remedy=_CABLE)
        try:
            answer = await self._answer_or_loss(ask, client, lost)
            self._check_answer(client, answer, function)
            self._has_answered = True
        except BaseException as error:
            if not isinstance(error, (RefusedError, _BusyAnswer)):
                self._drop_connection()
            raise
        return answer

    async def _answer_or_loss(
        self, ask: _Ask, client: AsyncModbusTcpClient, lost: asyncio.Future[None]
    ) -> ModbusPDU:
        try:
            async with AnswerDeadline(self._deadline_s):
                return await _first_result(ask(client), lost)
        except TimeoutError:
            raise self._silence_error() from None
        except (ModbusException, OSError) as error:
            if "No response" in str(error):
                raise self._silence_error() from None
            if self._is_unreadable:
                raise self._foreign_answer_error("sent what is no Modbus answer") from None
            raise UnreachableError(
                self.device, make_message("the connection broke: {error}.", error=error), remedy=self._remedy
            ) from error

    def _check_answer(self, client: AsyncModbusTcpClient, answer: ModbusPDU, function: int) -> None:
        if answer.transaction_id != client.ctx.request_transaction_id:
            raise self._foreign_answer_error(
                make_message("answered request {number}, which is not ours", number=answer.transaction_id)
            )
        if answer.function_code == function:
            return
        if answer.function_code != function | 0x80:
            raise self._foreign_answer_error(
                make_message(
                    "answered function {got} instead of {expected}",
                    got=answer.function_code,
                    expected=function,
                )
            )
        entry = code_table("cellcal.drivers.wire", "modbus_exceptions.tsv").get(answer.exception_code)
        if entry is None:
            raise self._foreign_answer_error(
                make_message("sent the unknown exception {code}", code=answer.exception_code)
            )
        if entry.kind == "busy":
            raise _BusyAnswer(entry)
        raise self._refused_error(entry)

    def _refused_error(self, entry: CodeEntry) -> DeviceError:
        message = make_message(
            "Modbus exception {entry_code}: {entry_text}.", entry_code=entry.code, entry_text=entry.text
        )
        if entry.kind == "unreachable":
            return UnreachableError(self.device, message, remedy=entry.remedy)
        return RefusedError(
            self.device, message, remedy=entry.remedy, vendor_code=entry.code, vendor_text=entry.text
        )

    def _foreign_answer_error(self, what: str) -> WireProtocolError:
        self._drop_connection()
        return WireProtocolError(
            self.device,
            make_message("the device {what}.", what=what),
            remedy=_UNKNOWN if self._has_answered else _NO_MODBUS,
            frame=self.trace.last_received(),
        )

    def _silence_error(self) -> DeviceTimeoutError:
        if self.trace.ends_with_received():
            return DeviceTimeoutError(
                self.device,
                make_message(
                    "what came within {deadline_s:g} s is no whole Modbus answer.",
                    deadline_s=self._deadline_s,
                ),
                remedy=_NO_MODBUS,
            )
        return DeviceTimeoutError(
            self.device,
            make_message("no answer within {deadline_s:g} s.", deadline_s=self._deadline_s),
            remedy=self._remedy,
        )

    def _trace_packet(self, sending: bool, packet: bytes) -> bytes:
        self.trace.add_frame(">" if sending else "<", packet.hex())
        return packet

    def _take_received(self, client: AsyncModbusTcpClient, data: bytes) -> None:
        """Hand on what came; what the library cannot read would else be printed by the event loop, with its trace."""
        try:
            type(client.ctx).data_received(client.ctx, data)
        except Exception:  # noqa: BLE001  foreign octets may break any part of its decoder; the request says so
            self._is_unreadable = True
            if isinstance(client.ctx.transport, asyncio.Transport):
                client.ctx.transport.abort()

    def _connection_changed(self, connected: bool) -> None:
        if not connected and self._lost is not None and not self._lost.done():
            self._lost.set_result(None)

    def _drop_connection(self) -> None:
        client, self._client, self._is_checked = self._client, None, False
        if client is None:
            return
        transport = client.ctx.transport
        client.close()
        if isinstance(transport, asyncio.Transport):
            transport.abort()  # close() alone would wait for a peer that may never read again


async def _note_reason(create: Callable[[], Coroutine[Any, Any, Any]], reasons: list[OSError]) -> Any:
    """Make a connection, and keep why it cannot be made: the library only logs it."""
    try:
        return await create()
    except OSError as error:
        reasons.append(error)
        raise


async def _first_result(asking: Awaitable[ModbusPDU], lost: asyncio.Future[None]) -> ModbusPDU:
    """Return the answer, or raise as soon as the connection is lost; leave no request behind."""
    request: asyncio.Future[ModbusPDU] = asyncio.ensure_future(asking)
    try:
        waiting: set[asyncio.Future[Any]] = {request, lost}
        await asyncio.wait(waiting, return_when=asyncio.FIRST_COMPLETED)
        if request.done():
            return request.result()
        raise ConnectionResetError("it was closed during a request")
    finally:
        await cancel_until_done(request, every_s=_CANCEL_AGAIN_S)
        if not request.cancelled():
            request.exception()  # consumed, so that nothing is reported about it later
