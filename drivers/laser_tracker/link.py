"""The connection to an emScon server: one question at a time, answers told from events, nothing late believed.

The wire has no sequence numbers. What keeps a late answer from becoming a value:

* one command is under way at a time; an answer to any other command ends the connection;
* after a time-out or a cancelled question the connection is dropped, and the next call makes a new one;
* a result counts only after the tracker has accepted *our* start of a measurement, and it accepts none while an
  earlier measurement is still running (``BUSY``).
"""

import asyncio
import struct
import time
from collections.abc import Awaitable, Callable
from contextlib import suppress
from functools import partial

from cellcal.calibration.message import make_message
from cellcal.drivers.errors import DeviceError, RefusedError, UnreachableError, WireProtocolError
from cellcal.drivers.laser_tracker.packets import (
    ANSWER,
    HEADER,
    MOST_BYTES,
    RESULTS,
    SIZES,
    WORD,
    PacketKind,
    StationaryResult,
    StatusChange,
    TrackerCommand,
    decode_result,
    encode_command,
)
from cellcal.drivers.supervision import message_and_remedy_of, start_link_task
from cellcal.drivers.wire.backoff import Backoff
from cellcal.drivers.wire.cancellation import cancel_until_done
from cellcal.drivers.wire.deadline import answer_deadline
from cellcal.drivers.wire.tables import CodeEntry, code_table
from cellcal.drivers.wire.trace import FrameTrace

BUSY = 1  # ES_RS_ServerBusy: an earlier command, of ours or of another program, is under way
_POLL_S = 0.1
_CANCEL_AGAIN_S = 0.5
_CABLE = "Check the network cable and that the tracker's controller is on."
_BYTES = (
    "The reading was not used. Check that address and port are those of an emScon server; "
    "if they are, try again, and report it with the trace of the link."
)


def status_meaning(status: int) -> CodeEntry:
    """Return what a status of the tracker means, in its maker's name for it."""
    unknown = CodeEntry(
        status, "fault", make_message("status {status}", status=status), "Look at the tracker's own display."
    )
    return code_table("cellcal.drivers.laser_tracker", "statuses.tsv").get(status, unknown)


class EmsconLink:
    """One TCP connection. Its owner sees to it that no two tasks ask at once."""

    def __init__(self, device: str, address: str, port: int, deadline_s: float) -> None:
        self.device, self._address, self._port, self._deadline_s = device, address, port, deadline_s
        self.trace = FrameTrace(device)
        self.check_server: Callable[[], Awaitable[None]] | None = None
        self.on_change: Callable[[int], None] = lambda _code: None
        self._backoff = Backoff()
        self._writer: asyncio.StreamWriter | None = None
        self._closing_writer: asyncio.StreamWriter | None = None
        self._listener: asyncio.Task[None] | None = None
        self._pending_command: tuple[TrackerCommand, asyncio.Future[tuple[int, bytes]]] | None = None
        self._measuring: asyncio.Future[StationaryResult] | None = None
        self._accepted = False
        self._sizes_asked: tuple[int, ...] = ()
        self._why: DeviceError = self._connection_lost_error("there is no connection.")

    @property
    def is_connected(self) -> bool:
        """Whether there is a connection that nothing has gone wrong with."""
        return self._writer is not None

    async def ensure_connected(self) -> None:
        """Connect and greet, unless that has been done."""
        if self._writer is not None:
            return
        await self._await_closing()
        await self._backoff.wait()
        try:
            await self._open_connection()
            if self.check_server is not None:
                await self.check_server()
        except BaseException:
            self._backoff.note_failure()
            self._drop_connection(self._connection_lost_error("the connection was given up."))
            raise
        self._backoff.note_success()

    async def close(self) -> None:
        """Disconnect. May be called twice."""
        self._drop_connection(self._connection_lost_error("the connection was closed."))
        await self._await_closing()

    async def send_command(
        self,
        number: TrackerCommand,
        parameters: bytes = b"",
        *,
        layout: str = "<",
        deadline_s: float | None = None,
    ) -> tuple[float, ...]:
        """Send a command and return the values of its answer; a busy tracker is asked again until the deadline.

        Raises
        ------
        RefusedError
            The tracker said no.
        WireProtocolError
            The answer has another size than the document gives it.
        """
        seconds = self._deadline_s if deadline_s is None else deadline_s
        bare = HEADER.size + ANSWER.size
        self._sizes_asked = (bare, bare + struct.calcsize(layout))
        give_up_s = time.monotonic() + seconds - _POLL_S
        while True:
            try:
                async with answer_deadline(
                    self.device, seconds, make_message("answering {name}", name=number.name)
                ):
                    status, values = await self._exchange_packets(number, parameters)
            except (TimeoutError, asyncio.CancelledError):
                self._drop_connection(
                    self._connection_lost_error("the connection was dropped with its late answer.")
                )
                raise
            if status != BUSY or time.monotonic() > give_up_s:
                break
            await asyncio.sleep(_POLL_S)
        if status:
            raise self.refused_error(number.name, status)
        if len(values) != struct.calcsize(layout):
            raise self._damaged_packet_error(
                make_message("the answer to {name} has {count} bytes", name=number.name, count=len(values)),
                values,
            )
        return struct.unpack(layout, values)

    async def measure_stationary(self) -> StationaryResult:
        """Start a stationary measurement and return its result; the caller sets the deadline.

        Cancelled, it tells the tracker to stop and drops the connection.
        """
        self._measuring = asyncio.get_running_loop().create_future()
        self._accepted = False
        try:
            await self.send_command(TrackerCommand.START_MEASUREMENT)
            return await self._measuring
        except asyncio.CancelledError:
            if self._writer is not None:
                self._send_bytes(self._writer, encode_command(TrackerCommand.STOP_MEASUREMENT))
            self._drop_connection(
                self._connection_lost_error("the connection was dropped with its late result.")
            )
            raise
        finally:
            waiting, self._measuring = self._measuring, None
            if waiting is not None and waiting.done() and not waiting.cancelled():
                waiting.exception()  # seen, also where the start was refused as well

    def refused_error(self, doing: str, status: int) -> RefusedError:
        """Return the error for a status that is not zero."""
        entry = status_meaning(status)
        return RefusedError(
            self.device,
            make_message("the tracker said no to {doing}: {status}.", doing=doing, status=entry.text),
            remedy=entry.remedy,
            vendor_code=status,
            vendor_text=entry.text,
        )

    # inside

    async def _open_connection(self) -> None:
        try:
            async with answer_deadline(self.device, self._deadline_s, "connecting"):
                reader, writer = await asyncio.open_connection(self._address, self._port)
        except TimeoutError:
            raise
        except OSError as error:
            where = f"{self._address}:{self._port}"
            raise self._connection_lost_error(
                make_message("nothing answers at {where}.", where=where)
            ) from error
        self._writer = writer
        self._listener = start_link_task(
            make_message("answers of {device}", device=self.device),
            partial(self._read_packets, reader, writer),
            self._drop_broken,
        )

    async def _exchange_packets(self, number: TrackerCommand, parameters: bytes) -> tuple[int, bytes]:
        if self._writer is None:
            raise self._why
        answer: asyncio.Future[tuple[int, bytes]] = asyncio.get_running_loop().create_future()
        self._pending_command = (number, answer)
        try:
            self._send_bytes(self._writer, encode_command(number, parameters))
            return await answer
        finally:
            self._pending_command = None

    def _send_bytes(self, writer: asyncio.StreamWriter, data: bytes) -> None:
        self.trace.add_frame(">", data.hex())
        writer.write(data)

    async def _read_packets(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        error: DeviceError = self._connection_lost_error("the tracker closed the connection.")
        try:
            while True:
                size, number = HEADER.unpack(await reader.readexactly(HEADER.size))
                kind = self._packet_kind(size, number)
                self._take_packet(kind, await reader.readexactly(size - HEADER.size))
        except WireProtocolError as found:
            error = found
        except (asyncio.IncompleteReadError, OSError) as found:
            error.__cause__ = found
        except (
            struct.error,
            ValueError,
            LookupError,
            TypeError,
        ) as found:  # of a packet that no document has
            error = self._damaged_packet_error(
                make_message("a packet that cannot be read ({error_type})", error_type=type(found).__name__),
                b"",
            )
            error.__cause__ = found
        finally:
            if self._writer is writer:
                self._drop_connection(error)
            writer.close()

    def _drop_broken(self, error: Exception) -> None:
        """Leave a connection whose answers are not heard any more; the next question makes a new one."""
        self._drop_connection(
            self._connection_lost_error(
                make_message(
                    "the program failed while it listened: {reason}.", reason=message_and_remedy_of(error)[0]
                )
            )
        )

    def _packet_kind(self, size: int, number: int) -> PacketKind:
        header = HEADER.pack(size, number)
        try:
            kind = PacketKind(number)
        except ValueError:
            raise self._damaged_packet_error(
                make_message("a packet of type {number}", number=number), header
            ) from None
        fits = size == SIZES.get(kind, size) and HEADER.size + WORD.size <= size <= MOST_BYTES
        if not fits or (kind is PacketKind.COMMAND and size not in self._sizes_asked):
            raise self._damaged_packet_error(
                make_message("a packet {name} of {size} bytes", name=kind.name, size=size), header
            )
        return kind

    def _take_packet(self, kind: PacketKind, body: bytes) -> None:
        self.trace.add_frame("<", (HEADER.pack(HEADER.size + len(body), kind) + body).hex())
        if kind is PacketKind.COMMAND:
            self._take_answer(body)
        elif kind is PacketKind.ERROR:
            self._take_error(*ANSWER.unpack(body))
        elif kind is PacketKind.STATUS_CHANGE:
            self._take_change(*WORD.unpack(body))
        elif (
            kind in RESULTS and self._accepted and self._measuring is not None and not self._measuring.done()
        ):
            self._measuring.set_result(decode_result(kind, body))

    def _take_answer(self, body: bytes) -> None:
        if len(body) < ANSWER.size:
            raise self._damaged_packet_error("an answer without a status", body)
        number, status = ANSWER.unpack_from(body)
        if (
            self._pending_command is None
            or self._pending_command[0] != number
            or self._pending_command[1].done()
        ):
            raise self._damaged_packet_error(
                make_message("an answer to command {number}, which was not asked", number=number), body
            )
        self._accepted = self._accepted or (number == TrackerCommand.START_MEASUREMENT and status == 0)
        self._pending_command[1].set_result((status, body[ANSWER.size :]))

    def _take_error(self, number: int, status: int) -> None:
        """Give an error to whom it belongs; a broken beam comes unasked and belongs to the measurement."""
        if (
            self._pending_command is not None
            and self._pending_command[0] == number
            and not self._pending_command[1].done()
        ):
            self._pending_command[1].set_result((status, b""))
        elif number in (TrackerCommand.START_MEASUREMENT, TrackerCommand.UNKNOWN):
            self._interrupt_measurement(self.refused_error("measuring", status))
            self.on_change(StatusChange.NOT_READY)

    def _take_change(self, code: int) -> None:
        if code == StatusChange.NOT_READY:
            self._interrupt_measurement(self.refused_error("measuring", 10004))
        self.on_change(code)

    def _interrupt_measurement(self, error: DeviceError) -> None:
        if self._accepted and self._measuring is not None and not self._measuring.done():
            self._measuring.set_exception(error)

    def _drop_connection(self, error: DeviceError) -> None:
        """Leave the connection; waiting callers receive the reason."""
        writer, self._writer = self._writer, None
        if writer is not None:
            self._closing_writer, self._why = writer, error
            writer.close()
        if self._pending_command is not None and not self._pending_command[1].done():
            self._pending_command[1].set_exception(error)
        if self._measuring is not None and not self._measuring.done():
            self._measuring.set_exception(error)

    async def _await_closing(self) -> None:
        """See a connection that was left to its end."""
        listener, self._listener = self._listener, None
        closing, self._closing_writer = self._closing_writer, None
        if listener is not None:
            await cancel_until_done(listener, every_s=_CANCEL_AGAIN_S)
        if closing is not None:
            closing.transport.abort()
            with suppress(OSError):
                await closing.wait_closed()

    def _connection_lost_error(self, message: str) -> UnreachableError:
        return UnreachableError(self.device, message, remedy=_CABLE)

    def _damaged_packet_error(self, found: str, data: bytes) -> WireProtocolError:
        message = make_message("the tracker sent {found}, which its document does not allow.", found=found)
        return WireProtocolError(self.device, message, remedy=_BYTES, frame=data.hex())
