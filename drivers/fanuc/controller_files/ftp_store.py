"""Program listings (.LS) on a FANUC controller over FTP, read and written.

A controller takes a listing only with the ASCII upload option and a login that may write; else it answers 550 and the
delivery is refused. It does not say over FTP whether a program runs. It translates what it is given: read back, a
listing has another head, and the same statements and positions.
"""

import asyncio
import ftplib
import io
import math
from dataclasses import replace
from typing import Self

from cellcal.calibration.message import make_message
from cellcal.drivers.errors import RefusedError
from cellcal.drivers.fanuc.controller_files.controller_address import ControllerAddress
from cellcal.drivers.fanuc.controller_files.ftp_source import (
    READING_COMMANDS,
    FtpLogin,
    FtpSource,
    ReadOnlyFtp,
)
from cellcal.drivers.fanuc.controller_files.program_digests import groups_of, is_program_name, statements_of
from cellcal.drivers.wire.cancellation import run_in_thread_to_end

_NOT_THERE = "550"


class WritingFtp(ReadOnlyFtp):
    """The client that may also store and delete; the record and the watch never use it."""

    allowed = READING_COMMANDS | {"STOR", "DELE"}


class _WritingSource(FtpSource):
    def _make_client(self) -> ReadOnlyFtp:
        return WritingFtp(encoding="latin-1")

    def drop_connection(self) -> None:
        """Close the connection without a word."""
        self._ftp.close()

    def read_listed(self, name: str) -> bytes | None:
        """Return a file; None of one that is not listed.

        Raises
        ------
        RefusedError
            It is listed, and the controller does not give it.
        """
        self._names = None
        content = self.read_file(name)
        if content is None and name.lower() in self._index_names():
            raise RefusedError(
                self.device,
                make_message("{name} is listed and cannot be read.", name=name),
                remedy="Look at the pendant whether it is protected, or open in the editor.",
            )
        return content

    def store(self, name: str, content: bytes) -> None:
        """Write a file, under the name that is there where only the case of letters differs."""
        name = self._index_names().get(name.lower(), name)
        with self._named_failures(make_message("writing {name}", name=name), writes=True):
            self._ftp.storbinary(f"STOR {name}", io.BytesIO(content))

    def delete(self, name: str) -> None:
        """Delete a file; its name counts in any case of letters."""
        name = self._index_names().get(name.lower(), name)
        with self._named_failures(make_message("deleting {name}", name=name), writes=True):
            try:
                self._ftp.delete(name)
            except ftplib.error_perm as error:
                if not str(error).startswith(_NOT_THERE):
                    raise  # 550 is also a refusal: whether the file is gone shows when it is read


class FtpProgramStore:
    """The programs of MD:.

    A call that is cancelled ends when the controller has answered it: no command is sent while another runs.
    """

    tells_running = False

    def __init__(self, address: ControllerAddress, login: FtpLogin) -> None:
        # A person waits for it: there is no end to all files together.
        self._source = _WritingSource(address, replace(login, session_timeout_s=math.inf))

    async def __aenter__(self) -> Self:
        try:
            await run_in_thread_to_end(self._source.__enter__)
        except asyncio.CancelledError:
            self._source.drop_connection()
            raise
        return self

    async def __aexit__(self, *exc: object) -> None:
        await run_in_thread_to_end(self._source.__exit__, *exc)

    @property
    def device(self) -> str:
        return self._source.device

    async def list_names(self) -> tuple[str, ...]:
        names = await run_in_thread_to_end(self._source.list_names)
        return tuple(name for name in names if is_program_name(name))

    async def read_file(self, name: str) -> bytes | None:
        return await run_in_thread_to_end(self._source.read_listed, name)

    async def write_file(self, name: str, content: bytes) -> None:
        if statements_of(content) is None:
            raise RefusedError(
                self.device, make_message("{name} is no whole listing of a program.", name=name)
            )
        await run_in_thread_to_end(self._source.store, name, content)

    async def delete_file(self, name: str) -> None:
        await run_in_thread_to_end(self._source.delete, name)

    async def refuse_while_running(self) -> None:
        """Do nothing: the FTP server does not say what the robot does."""

    def is_same(self, sent: bytes, read: bytes) -> bool:
        statements = statements_of(sent)
        same = statements is not None and statements == statements_of(read)
        return same and groups_of(sent) == groups_of(read)
