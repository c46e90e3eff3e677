"""Variables of a KUKA controller over TCP: the frames of KUKAVARPROXY, which C3 Bridge uses, too.

Source: the C3 Bridge protocol description 1.5 and the source of KUKAVARPROXY. Header big endian: tag, length without
these four octets, type; an answer ends with three octets of which only the last says success with both servers.
"""

import asyncio
import secrets
import struct
from collections import deque
from dataclasses import dataclass

from cellcal.calibration.message import make_message
from cellcal.drivers.errors import DeviceError, RefusedError, UnreachableError, WireProtocolError
from cellcal.drivers.wire.deadline import answer_deadline
from cellcal.drivers.wire.link_errors import lost_connection_error, no_connection_error
from cellcal.drivers.wire.serial_number import check_serial_number
from cellcal.drivers.wire.trace import FrameTrace

_HEADER, _LENGTH = struct.Struct(">HH"), struct.Struct(">H")
_READ, _WRITE = 0, 1
_MOST_TEXT = 2000
_KEPT_TAGS = 64  # of questions whose answers may still come
_CABLE = "Check that the controller is on, its variable server runs, and port 7000 is open in its network."
_NO_SERVER = "Check that the address is that of a KUKA variable server."
_PROXY_VERSION, _SERIAL = "@PROXY_VERSION", "$KR_SERIALNO"


@dataclass(frozen=True, slots=True)
class VariableServer:
    """The program that answers on the controller."""

    name: str
    version: str


class VariableLink:
    """One TCP connection; one question at a time, matched by its tag; opened again by the next one after a loss.

    KUKAVARPROXY hangs up on a client that is silent for 30 s: that is no loss. Another controller may answer at the
    same address later, so the ``serial`` is compared on each new connection, once it is set.
    """

    def __init__(self, device: str, address: str, port: int, *, deadline_s: float) -> None:
        self.device = device
        self._address, self._port, self._deadline_s = address, port, deadline_s
        self._streams: tuple[asyncio.StreamReader, asyncio.StreamWriter] | None = None
        self._lock = asyncio.Lock()
        self._tag = 0
        self._question_tags: deque[int] = deque(maxlen=_KEPT_TAGS)  # tags of this connection
        self.serial = ""
        self.known_variables: set[str] = set()  # of this controller, which has answered with them once
        self._is_half = False  # an answer has begun, and its end is waited for
        self.trace = FrameTrace(device)

    async def close(self) -> None:
        """Hang up."""
        if self._streams is not None:
            self._streams[1].close()
            self._streams = None

    async def identify_server(self) -> VariableServer:
        """Return which server answers: only C3 Bridge knows its own version as a variable."""
        try:
            version = await self.read_variable(_PROXY_VERSION)
        except RefusedError:
            return VariableServer("KUKAVARPROXY", "")
        return VariableServer("C3 Bridge", version.strip('"'))

    async def read_serial(self) -> str:
        """Return the serial number of the robot; errors as for ``read_variable``."""
        return unquoted_text(await self.read_variable(_SERIAL))

    async def read_variable(self, variable: str) -> str:
        """Return a variable's value as the controller writes it.

        Raises
        ------
        RefusedError
            There is no such variable; KUKAVARPROXY answers success with an empty value.
        DeviceError
            No connection, no answer, or an answer that is none.
        """
        value = await self._exchange(_READ, variable, None)
        if not value.strip():
            raise self._refused(variable)
        self.known_variables.add(variable)
        return value

    async def write_variable(self, variable: str, value: str) -> None:
        """Write a variable; errors as for ``read_variable``."""
        await self._exchange(_WRITE, variable, value)

    async def _exchange(self, kind: int, variable: str, value: str | None) -> str:
        deadline = answer_deadline(
            self.device, self._deadline_s, "waiting for an answer", is_half=lambda: self._is_half
        )
        async with self._lock, deadline:
            if await self._open_streams() and self.serial:
                await self._check_serial()
            return await self._ask(kind, variable, value)

    async def _check_serial(self) -> None:
        """Check that the controller of the last connection answers on this one, too."""
        found = await self._ask(_READ, _SERIAL, None)
        try:
            check_serial_number(self.device, unquoted_text(found), self.serial)
        except DeviceError:
            await self.close()  # the next question looks again
            raise

    async def _ask(self, kind: int, variable: str, value: str | None) -> str:
        assert self._streams is not None
        reader, writer = self._streams
        self._is_half = False
        self.expect_tag(self._new_tag())
        body = struct.pack(">B", kind) + _packed(variable)
        if value is not None:
            body += _packed(value)
        frame = _HEADER.pack(self._tag, len(body)) + body
        self.trace.add_frame(">", frame.hex())
        try:
            writer.write(frame)
            await writer.drain()
            return await self.read_answer(reader, kind, variable)
        except (OSError, asyncio.IncompleteReadError) as error:
            await self.close()
            raise self._lost(error) from error
        except (DeviceError, TimeoutError, asyncio.CancelledError) as error:
            if not isinstance(error, RefusedError):
                await self.close()  # what is still on its way must not answer the next question
            raise

    def _new_tag(self) -> int:
        """Return a tag that an answer sent before the question, or to another client, does not bear."""
        while (tag := 1 + secrets.randbelow(0xFFFF)) in self._question_tags:
            pass
        return tag

    def expect_tag(self, tag: int) -> None:
        """Let only the answer with this tag count."""
        self._tag = tag
        self._question_tags.append(tag)

    async def read_answer(self, reader: asyncio.StreamReader, kind: int, variable: str) -> str:
        """Return the value of the answer to a question; answers to earlier ones are passed over."""
        while True:
            header = await reader.readexactly(1)
            self._is_half = True
            header += await reader.readexactly(_HEADER.size - 1)
            tag, length = _HEADER.unpack(header)
            if (
                tag not in self._question_tags
            ):  # no question had it: the length is none either, and is not waited for
                raise self._no_protocol(header)
            body = await reader.readexactly(length)
            self._is_half = False
            self.trace.add_frame("<", f"{tag:04x}{length:04x}{body.hex()}")
            if tag == self._tag:
                break
        if length < 6 or body[0] != kind:
            raise self._unreadable(body)
        size = _LENGTH.unpack_from(body, 1)[0]
        if len(body) != 3 + size + 3:
            raise self._unreadable(body)
        if body[-1] != 1:
            raise self._refused(variable)
        return body[3 : 3 + size].decode("ascii", "replace")

    async def _open_streams(self) -> bool:
        """Connect where there is no connection; return whether it is a new one."""
        if self._streams is not None:
            reader = self._streams[0]
            if not reader.at_eof() and reader.exception() is None:
                return False
            await self.close()
        try:
            self._streams = await asyncio.open_connection(self._address, self._port)
            self._question_tags.clear()
        except OSError as error:
            raise no_connection_error(self.device, self._address, error, _CABLE) from error
        return True

    def _lost(self, error: Exception) -> UnreachableError:
        return lost_connection_error(self.device, error, _CABLE)

    def _refused(self, variable: str) -> RefusedError:
        return RefusedError(
            self.device,
            make_message("the controller does not give {variable}.", variable=variable),
            remedy="Check that the variable exists in this version of the controller's software.",
        )

    def _no_protocol(self, header: bytes) -> WireProtocolError:
        return WireProtocolError(
            self.device,
            "what answers does not speak the protocol of a KUKA variable server.",
            remedy=_NO_SERVER,
            frame=header.hex(),
        )

    def _unreadable(self, body: bytes) -> WireProtocolError:
        return WireProtocolError(
            self.device,
            "an answer cannot be read: its lengths do not fit.",
            remedy=_NO_SERVER,
            frame=body[:200].hex(),
        )


def unquoted_text(text: str) -> str:
    """Return a variable of characters without the quotes around it."""
    return text.strip().strip('"')


def _packed(text: str) -> bytes:
    octets = text.encode("ascii")
    if len(octets) > _MOST_TEXT:
        raise ValueError(
            make_message("a text of {octet_count} octets is too long for one frame", octet_count=len(octets))
        )
    return _LENGTH.pack(len(octets)) + octets
