"""Packets of the Remote Motion Interface: JSON objects that end in CR LF, over one TCP connection.

Source: FANUC B-84184EN/03. A command is answered at once, an instruction after it was executed; the controller also
sends packets of its own accord. A reply is matched by its name, that of an instruction by its SequenceID. The name
does not tell the answer to this question from a late one to the question before: a reply that is still due is passed
over, and one that nothing asked for ends the connection. What was read counts once a question of another name is
answered after it (``confirmed_answers``): replies keep their order, so one too many has shown itself by then.
"""

import asyncio
import contextlib
import json
from collections.abc import AsyncIterator, Mapping
from contextlib import asynccontextmanager
from dataclasses import dataclass
from functools import partial
from typing import Any

from cellcal.calibration.documents.errors import DocumentError
from cellcal.calibration.documents.json_text import parse_json
from cellcal.calibration.message import make_message
from cellcal.drivers.errors import DeviceError, RefusedError, UnreachableError, WireProtocolError
from cellcal.drivers.supervision import start_link_task
from cellcal.drivers.wire.cancellation import cancel_until_done
from cellcal.drivers.wire.deadline import answer_deadline
from cellcal.drivers.wire.link_errors import (
    lost_connection_error,
    no_connection_error,
    unreadable_answer_error,
)
from cellcal.drivers.wire.tables import code_table
from cellcal.drivers.wire.trace import FrameTrace

_MOST_OCTETS = 65_536
_ERROR_BASE = 2_556_928
_CANCEL_AGAIN_S = 0.5
_CONFIRMING = ("FRC_GetStatus", "FRC_GetUFrameUTool")
_SHARE_FOR_LATE_REPLY = 0.25  # of the deadline of a question
_CABLE = "Check that the controller is switched on, the network cable plugged in and option R912 installed."
_OCCUPIED = (
    "End the other client of the Remote Motion Interface; one that hangs keeps it until it is switched off."
)
_REPORT = (
    "Check that address and port are those of this controller's Remote Motion Interface; if they are, report this "
    "with the log of the wire."
)
Packet = Mapping[str, Any]


@dataclass(frozen=True, slots=True)
class RmiVersion:
    """The version of the interface that the controller names when it is connected to."""

    major: int
    minor: int


class RmiLink:
    """One client connection. After a loss the next question opens it again; a motion is never sent again."""

    def __init__(self, device: str, address: str, port: int, *, deadline_s: float) -> None:
        self.device = device
        self._address, self._port, self._deadline_s = address, port, deadline_s
        self._writer: asyncio.StreamWriter | None = None
        self._reading: asyncio.Task[None] | None = None
        self._commands = asyncio.Lock()
        self._opening = asyncio.Lock()
        self._answer: tuple[str, asyncio.Future[Packet]] | None = None
        self._last_asked = ""
        self._due: dict[str, asyncio.Event] = {}  # commands whose reply nothing waits for any more
        self._instructions: dict[int, asyncio.Future[Packet]] = {}
        self._failure: DeviceError | None = None
        self.version = RmiVersion(0, 0)
        self.connections = 0  # counts up with each new one, so that a user notices a change
        self.trace = FrameTrace(device)

    async def open(self) -> None:
        """Connect where there is no connection.

        Raises
        ------
        UnreachableError, DeviceTimeoutError, WireProtocolError, RefusedError
            No controller, no answer, no such interface, or another client has it.
        """
        async with self._opening:
            if self._writer is not None and self._failure is None:
                return
            await self._drop_connection()
            async with answer_deadline(self.device, self._deadline_s, "connecting"):
                port = await self._ask_for_port()
                reader, self._writer = await self._open_port(port, _OCCUPIED)
            self._failure = None
            self._due.clear()
            self.connections += 1
            self._reading = start_link_task(
                make_message("answers of {device}", device=self.device),
                partial(self._read_packets, reader),
                self._end_broken,
            )

    async def close(self) -> None:
        """Say goodbye and hang up."""
        if self._writer is not None and self._failure is None:
            with contextlib.suppress(DeviceError, OSError):
                await self._send_packet({"Communication": "FRC_Disconnect"})
        await self._drop_connection()

    async def send_command(self, name: str, **fields: Any) -> Packet:
        """Return the reply of a command.

        Raises
        ------
        RefusedError
            The controller refuses; its error number is in ``vendor_code``.
        DeviceError
            No connection, no answer, or an answer that is none.
        """
        await self.open()
        async with self._commands, answer_deadline(self.device, self._deadline_s, "waiting for an answer"):
            await self._await_due_reply(name)
            answer: asyncio.Future[Packet] = asyncio.get_running_loop().create_future()
            self._answer, self._last_asked = (name, answer), name
            try:
                await self._send_packet({"Command": name, **fields})
                return self.accept_reply(await answer)
            except asyncio.CancelledError:  # by a caller, or by a deadline
                if self._answer is not None:  # its reply has not come yet
                    self._due[name] = asyncio.Event()
                raise
            finally:
                self._answer = None

    @asynccontextmanager
    async def confirmed_answers(self) -> AsyncIterator[None]:
        """Check that the answers read inside belong to their questions: nothing of it counts where this raises.

        Raises
        ------
        WireProtocolError
            A reply too many has come: each question since was answered by the reply to the one before.
        DeviceError
            As for ``send_command``, but for a refusal of the last question, which is an answer, too.
        """
        await self.open()
        connection = self.connections
        yield
        if self._failure is None:
            with contextlib.suppress(RefusedError):
                await self.send_command(next(each for each in _CONFIRMING if each != self._last_asked))
        if self._failure is not None:
            raise self._failure
        if self.connections != connection:
            raise UnreachableError(self.device, "the connection was lost.", remedy=_CABLE)

    async def send_instruction(self, name: str, sequence_id: int, **fields: Any) -> "asyncio.Future[Packet]":
        """Send a motion once and return what will hold its reply, which comes when it was executed."""
        executed: asyncio.Future[Packet] = asyncio.get_running_loop().create_future()
        self._instructions = {
            sequence_id: executed
        }  # one at a time: the reply to an earlier one is forgotten
        await self._send_packet({"Instruction": name, "SequenceID": sequence_id, **fields})
        return executed

    def accept_reply(self, reply: Packet) -> Packet:
        """Return a reply; raise RefusedError where the controller refuses."""
        code = reply.get("ErrorID", 0)
        if type(code) is not int:  # neither true nor 0.0
            raise self._unreadable_error("an ErrorID is no number")
        if code == 0:
            return reply
        number = code - _ERROR_BASE
        entry = code_table("cellcal.drivers.fanuc.rmi", "refusals.tsv").get(number)
        text = (
            make_message("RMIT-{number:03d}, {entry_text}", number=number, entry_text=entry.text)
            if entry
            else make_message("error {code}", code=code)
        )
        raise RefusedError(
            self.device,
            make_message("the controller refuses: {text}.", text=text),
            remedy=entry.remedy if entry else "Read the message on the pendant.",
            vendor_code=code,
        )

    async def _await_due_reply(self, name: str) -> None:
        """Let the late reply to an earlier question of this name come first; connect anew where it does not."""
        due = self._due.get(name)
        if due is None:
            return
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(self._deadline_s * _SHARE_FOR_LATE_REPLY):
                await due.wait()
        if name in self._due:
            self._fail_waiting(UnreachableError(self.device, "a reply did not come.", remedy=_CABLE))
            await self.open()

    # the connection

    async def _ask_for_port(self) -> int:
        reader, writer = await self._open_port(self._port, _CABLE)
        try:
            writer.write(_encode_packet({"Communication": "FRC_Connect"}))
            reply = self.decode_packet(await self._read_line(reader))
        finally:
            writer.close()
        self.accept_reply(reply)
        port, major, minor = (reply.get(key) for key in ("PortNumber", "MajorVersion", "MinorVersion"))
        if not (isinstance(port, int) and 0 < port < 65536):
            raise self._unreadable_error("the reply to FRC_Connect names no port")
        self.version = RmiVersion(
            major if isinstance(major, int) else 0, minor if isinstance(minor, int) else 0
        )
        return port

    async def _open_port(self, port: int, remedy: str) -> tuple[asyncio.StreamReader, asyncio.StreamWriter]:
        try:
            return await asyncio.open_connection(self._address, port, limit=_MOST_OCTETS)
        except OSError as error:
            raise no_connection_error(self.device, self._address, error, remedy) from error

    async def _drop_connection(self) -> None:
        if self._reading is not None:
            await cancel_until_done(self._reading, every_s=_CANCEL_AGAIN_S)
        if self._writer is not None:
            self._writer.close()
        self._reading = self._writer = None

    async def _send_packet(self, packet: Packet) -> None:
        if self._writer is None or self._failure is not None:
            raise self._failure or UnreachableError(self.device, "the connection is closed.", remedy=_CABLE)
        octets = _encode_packet(packet)
        self.trace.add_frame(">", octets.decode())
        try:
            self._writer.write(octets)
            await self._writer.drain()
        except OSError as error:
            self._fail_waiting(self._lost_error(error))
            raise self._lost_error(error) from error

    # what comes

    async def _read_packets(self, reader: asyncio.StreamReader) -> None:
        """Hand each packet to who waits for it, until the connection ends."""
        try:
            while True:
                line = await self._read_line(reader)
                self.trace.add_frame("<", line.decode("ascii", "replace"))
                self._hand_over(self.decode_packet(line))
        except DeviceError as error:
            self._fail_waiting(error)

    async def _read_line(self, reader: asyncio.StreamReader) -> bytes:
        try:
            return await reader.readuntil(b"\r\n")
        except asyncio.LimitOverrunError as error:
            raise self._unreadable_error("a packet does not end") from error
        except (OSError, asyncio.IncompleteReadError) as error:
            raise self._lost_error(error) from error

    def _hand_over(self, packet: Packet) -> None:
        sequence_id = packet.get("SequenceID")
        if packet.get("Communication") == "FRC_Terminate":
            raise UnreachableError(self.device, "the controller ended the connection.", remedy="Try again.")
        if packet.get("Communication") == "FRC_SystemFault":
            self._end_instructions(
                RefusedError(
                    self.device,
                    "the controller reports a fault that ended the motion.",
                    remedy="Read the alarm at the pendant and reset it.",
                )
            )
        elif "Instruction" in packet and type(sequence_id) is int:
            executed = self._instructions.get(sequence_id)
            if executed is not None and not executed.done():
                executed.set_result(packet)
        elif "Command" in packet:
            self._hand_over_reply(packet)

    def _hand_over_reply(self, packet: Packet) -> None:
        if packet["Command"] in self._due:
            self._due.pop(packet["Command"]).set()
        elif self._answer is not None and packet["Command"] in (self._answer[0], "Unknown"):
            if not self._answer[1].done():
                self._answer[1].set_result(packet)
            self._answer = None
        elif packet["Command"] == "Unknown" and (open_ones := self._open_instructions()):
            for executed in open_ones:  # a motion that the controller could not read
                executed.set_result(packet)
        else:  # a reply more than questions: the next one would answer another question
            raise self._unreadable_error("a reply came that nothing had asked for")

    def _end_broken(self, error: Exception) -> None:
        """End a connection whose reading failed in a way that nothing foresees; the next question connects anew."""
        self._fail_waiting(self._lost_error(error))

    def _fail_waiting(self, error: DeviceError) -> None:
        self._failure = error
        for due in self._due.values():
            due.set()
        if self._answer is not None and not self._answer[1].done():
            self._answer[1].set_exception(error)
        self._end_instructions(error)

    def _open_instructions(self) -> "list[asyncio.Future[Packet]]":
        return [executed for executed in self._instructions.values() if not executed.done()]

    def _end_instructions(self, error: DeviceError) -> None:
        for executed in self._open_instructions():
            executed.set_exception(error)
            executed.exception()  # read here: the motion may have been given up meanwhile

    def decode_packet(self, line: bytes) -> Packet:
        """Return the fields of a line; raise WireProtocolError where it is none."""
        try:
            packet = parse_json(line)
        except (DocumentError, ValueError) as error:
            raise self._unreadable_error("a packet is no JSON", line) from error
        if not isinstance(packet, dict):
            raise self._unreadable_error("a packet is no JSON object", line)
        return packet

    def _lost_error(self, error: Exception) -> UnreachableError:
        return lost_connection_error(self.device, error, _CABLE)

    def _unreadable_error(self, what: str, frame: bytes = b"") -> WireProtocolError:
        return unreadable_answer_error(self.device, what, _REPORT, frame[:200].hex())


def _encode_packet(packet: Packet) -> bytes:
    return json.dumps(packet, allow_nan=False).encode("ascii") + b"\r\n"
