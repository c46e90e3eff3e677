"""A controller's FTP server on loopback: reads only, files made from the controller's state when they are asked for.

Imitates
    The FTP server of a FANUC controller.
Source
    deploy/controller_setup/fanuc_files.md: USER answered with 230, devices at the root, MD:, names in any case,
    550 for writing; what public clients and a log of a controller show.
Modelled
    USER, PASS, CWD, PWD, TYPE, PASV, EPSV, NLST, LIST, RETR, QUIT, NOOP; login refused; slow, dropped
    and cut answers; a file refused for a time.
Not modelled
    Active mode, upload, and users with rights.
"""

import asyncio
import re
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, field

from cellcal.fake_devices.fanuc_files.cabinet import FanucCabinet
from cellcal.fake_devices.fanuc_files.report_texts import (
    axis_text,
    curpos_text,
    dcs_text,
    erract_text,
    program_text,
    version_text,
)
from cellcal.fake_devices.fanuc_files.variable_texts import symotn_text, sysframe_text, sysmast_text
from cellcal.fake_devices.listening_port import ListeningPort

HOST = "127.0.0.1"
_TEXTS: dict[str, Callable[[FanucCabinet], str]] = {
    "axis.dg": axis_text,
    "curpos.dg": curpos_text,
    "version.dg": version_text,
    "erract.ls": erract_text,
    "dcsvrfy.dg": dcs_text,
    "sysmast.va": sysmast_text,
    "symotn.va": symotn_text,
    "sysframe.va": sysframe_text,
}
_WRITING = frozenset(("STOR", "STOU", "APPE", "DELE", "RNFR", "RNTO", "MKD", "RMD", "SITE"))
_DEVICES = frozenset(("md:", "fr:", "mc:", "mdb:"))


@dataclass
class FtpFaults:
    """Faults of the link that last until they are reset."""

    refuses_login: bool = False
    wants_password: bool = False  # answers USER with 331
    names_wrong_address: bool = False  # in 227, as behind a router
    upper_case: bool = False  # of names in listings; they are found in any case
    cut_file: str = ""  # its last part is missing, and the end is confirmed all the same
    drop_in_file: str = ""  # the link is lost in the middle of it
    slow_s: float = 0.0  # before each reply
    missing: frozenset[str] = frozenset()
    replies: dict[str, list[str]] = field(default_factory=dict)  # refusals of files; * after half the data
    lists_nothing: bool = False
    one_segment: bool = False  # 150 and 226 together, before the file


@dataclass
class FanucFtpServer:
    """One controller's server; an async context. ``commands`` are those that it was sent."""

    cabinet: FanucCabinet
    port: int = 0
    faults: FtpFaults = field(default_factory=FtpFaults)
    commands: list[str] = field(default_factory=list)
    transfers: list[str] = field(default_factory=list)

    async def __aenter__(self) -> "FanucFtpServer":
        self._command_port = ListeningPort(HOST, self.port, self._serve_client)
        await self._command_port.open()
        self.port = self._command_port.port
        return self

    async def __aexit__(self, *_exc: object) -> None:
        await self._command_port.wait_closed()

    def file_bytes(self, name: str) -> bytes | None:
        """Return a file as it is at this moment; None where there is none of that name."""
        state = self.cabinet.stale or self.cabinet
        key = name.lower()
        if key in self.faults.missing:
            return None
        program = key.removesuffix(".ls").upper()
        if key in _TEXTS:
            text = _TEXTS[key](state)
        elif key.endswith(".ls") and program in state.programs:
            text = program_text(state, program)
        else:
            return None
        if key == "axis.dg":
            self.cabinet.readings += 1
        content = text.replace("\n", "\r\n").encode("cp437")
        return content[: len(content) // 2] if key == self.faults.cut_file else content

    def list_names(self) -> list[str]:
        """Return the names of MD:."""
        names = [*_TEXTS, *(f"{name.lower()}.ls" for name in self.cabinet.programs)]
        names = [name for name in names if name not in self.faults.missing]
        return [name.upper() for name in names] if self.faults.upper_case else names

    async def _serve_client(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        session = _FtpSession(self, reader, writer)
        try:
            await session.serve_commands()
        finally:
            await session.close_data_connections()


class _FtpSession:
    """One client: its login, its folder, its data connection."""

    def __init__(
        self, server: FanucFtpServer, reader: asyncio.StreamReader, writer: asyncio.StreamWriter
    ) -> None:
        self._server, self._reader, self._writer = server, reader, writer
        self._logged_in = False
        self._folder = ""
        self._data_port: ListeningPort | None = None
        self._data: asyncio.Queue[asyncio.StreamWriter] = asyncio.Queue()

    async def close_data_connections(self) -> None:
        if self._data_port is not None:
            await self._data_port.wait_closed()

    async def serve_commands(self) -> None:
        await self._reply(f"220 R-30iB Plus FTP server ready. [LR {self._server.cabinet.software}]")
        while line := await self._reader.readline():
            verb, _, argument = line.decode("cp437").strip().partition(" ")
            verb = verb.upper()
            self._server.commands.append(f"{verb} {argument}".strip())
            if verb == "QUIT":
                await self._reply("221 Goodbye.")
                return
            await self._obey(verb, argument.strip())

    async def _obey(self, verb: str, argument: str) -> None:
        if verb in ("USER", "PASS"):
            await self._log_in(verb)
        elif not self._logged_in:
            await self._reply("530 Not logged in.")
        elif verb in _WRITING:
            await self._reply("550 Permission denied: read only.")
        elif verb == "CWD":
            await self._change_folder(argument)
        elif verb in ("PASV", "EPSV"):
            await self._listen(verb)
        elif verb in ("NLST", "LIST", "RETR"):
            await self._transfer(verb, argument)
        else:
            replies = {"TYPE": "200 Type set.", "PWD": f'257 "{self._folder or "/"}"', "NOOP": "200 OK."}
            await self._reply(replies.get(verb, "502 Command not implemented."))

    async def _log_in(self, verb: str) -> None:
        faults = self._server.faults
        if faults.refuses_login:
            await self._reply("530 Login incorrect.")
        elif verb == "USER" and faults.wants_password:
            await self._reply("331 Password required.")
        else:
            self._logged_in = True
            await self._reply("230 User logged in.")

    async def _change_folder(self, argument: str) -> None:
        device = argument.lower().rstrip("/\\").lstrip("/")
        if device in _DEVICES:
            self._folder = device
            await self._reply(f"250 Working directory is {device}.")
        else:
            await self._reply("550 No such device.")

    async def _listen(self, verb: str) -> None:
        await self.close_data_connections()
        self._data = asyncio.Queue()
        self._data_port = ListeningPort(HOST, 0, self._offer_connection)
        await self._data_port.open()
        port = self._data_port.port
        if verb == "EPSV":
            await self._reply(f"229 Entering extended passive mode (|||{port}|).")
            return
        host = "10,0,0,9" if self._server.faults.names_wrong_address else HOST.replace(".", ",")
        await self._reply(f"227 Entering passive mode ({host},{port >> 8},{port & 255}).")

    async def _offer_connection(self, _: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        """Hand a data connection to the transfer that waits for it, which closes it."""
        self._data.put_nowait(writer)
        await writer.wait_closed()

    async def _transfer(self, verb: str, argument: str) -> None:
        name, content = argument.lower(), self._content_of(verb, argument)
        refusal = self._refusal_of(verb, name, content)
        if content is None or (refusal and not refusal.startswith("*")):
            await self._reply(refusal)
            return
        if verb == "RETR":
            self._server.transfers.append(name)
        if self._server.faults.one_segment:
            await self._reply("150 Opening data connection.\r\n226 Transfer complete.")
        else:
            await self._reply("150 Opening data connection.")
        data = await self._data.get()
        dropped = bool(name) and self._server.faults.drop_in_file == name
        data.write(content[: len(content) // 2] if dropped or refusal else content)
        with suppress(ConnectionError):
            await data.drain()
            data.close()
            await data.wait_closed()
        if dropped:
            self._writer.transport.abort()
            raise ConnectionResetError
        if not self._server.faults.one_segment:
            await self._reply(refusal.removeprefix("*") or "226 Transfer complete.")

    def _refusal_of(self, verb: str, name: str, content: bytes | None) -> str:
        """Return why a transfer is refused; "" of one that is not."""
        faults = self._server.faults
        if verb != "RETR" and faults.lists_nothing:
            return "502 Command not implemented."
        if self._data_port is None:
            return "425 No data connection."
        if content is None:
            return "550 No such file."
        replies = faults.replies.get(name, [])
        return replies.pop(0) if verb == "RETR" and replies else ""

    def _content_of(self, verb: str, argument: str) -> bytes | None:
        if self._folder != "md:" and not argument.lower().startswith("md:"):
            return b"MD:\r\nFR:\r\nMC:\r\n" if verb != "RETR" else None
        if verb == "RETR":
            return self._server.file_bytes(re.sub(r"(?i)^md:[\\/]?", "", argument))
        return "".join(f"{name}\r\n" for name in self._server.list_names()).encode()

    async def _reply(self, text: str) -> None:
        if self._server.faults.slow_s:
            await asyncio.sleep(self._server.faults.slow_s)
        self._writer.write(f"{text}\r\n".encode())
        await self._writer.drain()
