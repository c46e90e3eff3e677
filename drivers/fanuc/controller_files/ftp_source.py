"""A controller's files over FTP, read only: no command that writes, renames or deletes leaves this module.

A FANUC controller produces its text files when they are read. Facts: it may answer USER with 230 directly; the root
is a list of devices, MD: holds the files; names are upper or lower case; the data connection goes to the peer of the
control connection, whatever address the controller names.
"""

import ftplib
import math
import re
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass

from cellcal.calibration.message import make_message
from cellcal.drivers.errors import DeviceTimeoutError, RefusedError, UnreachableError, WireProtocolError
from cellcal.drivers.fanuc.controller_files.controller_address import ControllerAddress
from cellcal.drivers.fanuc.controller_files.file_sources import MAX_FILE_BYTES, MAX_NAMES
from cellcal.drivers.fanuc.controller_files.ftp_replies import (
    NOT_THERE,
    FileNotGivenError,
    lost_link_error,
    name_refusal,
    plain_reason,
)

READING_COMMANDS = frozenset(("USER", "PASS", "TYPE", "CWD", "PASV", "EPSV", "NLST", "RETR", "QUIT"))
_CHUNK = 65_536
_FAILURES = (OSError, EOFError, ValueError, OverflowError)  # the last two of a port that is none
_MOST_REPLY_LINES = 500
_LEAST_BYTES = 1000  # of a file within the time of an answer: a controller brings a hundred times as much
_CABLE = "Check the cable and the address, and that the controller's FTP server is on (SETUP > Host Comm)."
_AGAIN = "Read it once more; if it happens again, look at the network."
_TRIES, _PAUSE_S = 3, 0.5  # of a file that is refused for now
_EMPTY_LISTING = "450"
_NAME_END = re.compile(r"[^/\\:]+\Z")
# A server may list more than names: type and rights, size and date before each, as Unix or DOS writes them.
_UNIX_LINE = re.compile(
    r"(?P<kind>[-bcdlps])[-rwxsStT]{9}\S*\s+(?:\S+\s+){2,4}?[A-Za-z]{3}\s+\d{1,2}\s+(?:\d{1,2}:\d{2}|\d{4})\s+(?P<name>\S.*)"
)
_DOS_LINE = re.compile(
    r"\d{1,4}[-/.]\d{1,2}[-/.]\d{1,4}\s+\d{1,2}:\d{2}(?:\s?[AaPp][Mm])?\s+(?:(?P<kind><DIR>)|[\d.,]+)\s+(?P<name>\S.*)"
)


@dataclass(frozen=True, slots=True)
class FtpLogin:
    """The user, and how long an answer, a whole file or listing, and all of them may take."""

    user: str = "anonymous"
    password: str = ""
    timeout_s: float = 10.0
    file_timeout_s: float = 120.0
    session_timeout_s: float = 1200.0  # of all files together: one controller must not hold up a night


class ReadOnlyFtp(ftplib.FTP):
    """The standard client without any command that changes something, and with an end to every reply."""

    allowed = READING_COMMANDS
    _reply_lines = 0
    _reply_ends_s = math.inf
    _received = b""

    def getline(self) -> str:
        """Read a line of a reply; one without an end, in lines, octets or time, is no reply."""
        self._reply_lines += 1
        if self._reply_lines > _MOST_REPLY_LINES:
            raise ftplib.error_proto(
                make_message("a reply of more than {count} lines", count=_MOST_REPLY_LINES)
            )
        if self._reply_lines == 1:
            self._reply_ends_s = time.monotonic() + (self.timeout or math.inf)
        while b"\n" not in self._received:
            if len(self._received) > self.maxline:
                raise ftplib.error_proto("a line of a reply without an end")
            self._received += self._receive_piece()
        line, _, self._received = self._received.partition(b"\n")
        return line.decode(self.encoding).removesuffix("\r")

    def _receive_piece(self) -> bytes:
        assert self.sock is not None
        remaining_s = self._reply_ends_s - time.monotonic()
        if remaining_s <= 0.0:
            raise TimeoutError
        self.sock.settimeout(remaining_s)
        try:
            piece = self.sock.recv(_CHUNK)
        finally:
            self.sock.settimeout(self.timeout)
        if not piece:
            raise EOFError
        return piece

    def getmultiline(self) -> str:
        """Read a whole reply, with a time of its own."""
        self._reply_lines = 0
        return super().getmultiline()

    def putcmd(self, line: str) -> None:
        """Send a command that reads; any other is a fault of ours and is not sent."""
        verb = line.split(" ", 1)[0].upper()
        if verb == "ACCT":  # the library's answer to a server that is not content with a password
            raise ftplib.error_perm("530 it asks for an account besides the password")
        if verb not in self.allowed:
            raise AssertionError(verb)
        super().putcmd(line)


class FtpSource:
    """Files of a controller; a context that connects and hangs up."""

    def __init__(self, address: ControllerAddress, login: FtpLogin | None = None) -> None:
        self._address, self._login = address, login or FtpLogin()
        self._ftp = self._make_client()
        self._names: dict[str, str] | None = None
        self._ends_s = math.inf

    def _make_client(self) -> ReadOnlyFtp:
        return ReadOnlyFtp(encoding="latin-1")  # any byte is a character

    @property
    def device(self) -> str:
        return str(self._address)

    @property
    def is_live(self) -> bool:
        return True

    def __enter__(self) -> "FtpSource":
        self._ends_s = time.monotonic() + self._login.session_timeout_s
        try:
            self._open_link()
        except BaseException:
            self._ftp.close()
            raise
        return self

    def __exit__(self, *_exc: object) -> None:
        try:
            self._ftp.quit()
        except (*_FAILURES, ftplib.Error):
            pass  # it has hung up first; what was read was read whole
        finally:
            self._ftp.close()

    def read_file(self, name: str) -> bytes | None:
        found = self._index_names().get(name.lower())
        candidates = (found,) if found is not None else (name.lower(), name.upper())
        for candidate in candidates:
            content = self._retrieve_with_retries(candidate)
            if content is not None:
                return content
        return None

    def list_names(self) -> tuple[str, ...]:
        return tuple(sorted(self._index_names()))

    def _open_link(self) -> None:
        device, login = self.device, self._login
        try:
            self._ftp.connect(self._address.host, self._address.port, timeout=login.timeout_s)
        except TimeoutError as error:
            raise UnreachableError(
                device,
                make_message("no FTP server answers within {timeout_s:g} s.", timeout_s=login.timeout_s),
                remedy=_CABLE,
            ) from error
        except ftplib.error_temp as error:
            raise name_refusal(device, "connecting", error) from error
        except (*_FAILURES, ftplib.Error) as error:
            raise UnreachableError(
                device,
                make_message("no FTP server answers: {reason}.", reason=plain_reason(error)),
                remedy=_CABLE,
            ) from error
        with self._named_failures("logging in"):
            try:
                self._ftp.login(login.user, login.password)
            except ftplib.error_perm as error:
                raise RefusedError(
                    device,
                    make_message(
                        "the FTP login of {user!r} was refused: {reason}.",
                        user=login.user,
                        reason=plain_reason(error),
                    ),
                    remedy="Allow anonymous reading on the controller (SETUP > Host Comm > FTP), or give --user.",
                ) from error
            try:
                self._ftp.cwd("md:")
            except ftplib.error_perm as error:
                if not str(error).startswith(NOT_THERE):
                    raise  # a server without devices, such as a copy of MD:, has its files at the root

    def _index_names(self) -> dict[str, str]:
        if self._names is None:
            ends = [
                end[0]
                for name in map(_listed_name, self._list_lines())
                if (end := _NAME_END.search(name)) and name.isprintable()
            ]
            self._names = {end.lower(): end for end in ends}
        return self._names

    def _list_lines(self) -> list[str]:
        """Return the lines of a listing; none of an empty folder, or of a server that lists nothing."""
        with self._named_failures("listing its files"):
            try:
                self._ftp.voidcmd("TYPE A")
                with self._ftp.transfercmd("NLST") as connection:
                    content = self._receive_content(connection, "the list of its files")
                self._ftp.voidresp()
            except (ftplib.error_perm, ftplib.error_temp) as error:
                if isinstance(error, ftplib.error_temp) and not str(error).startswith(_EMPTY_LISTING):
                    raise
                return []  # names are tried one by one
        lines = content.decode(self._ftp.encoding).replace("\r", "\n").split("\n")
        if len(lines) > MAX_NAMES:
            raise WireProtocolError(
                self.device,
                make_message(
                    "it lists {name_count} files, more than a controller has.", name_count=len(lines)
                ),
                remedy=_CABLE,
            )
        return lines

    def _retrieve_with_retries(self, name: str) -> bytes | None:
        """Return a file; ask again for one that is refused for now."""
        if time.monotonic() > self._ends_s:
            raise DeviceTimeoutError(
                self.device,
                make_message(
                    "its files did not arrive within {session_timeout_s:g} s.",
                    session_timeout_s=self._login.session_timeout_s,
                ),
                remedy=_AGAIN,
            )
        for _ in range(_TRIES - 1):
            try:
                return self._retrieve(name)
            except FileNotGivenError:
                time.sleep(_PAUSE_S)
        return self._retrieve(name)

    def _retrieve(self, name: str) -> bytes | None:
        """Return a file's bytes once the controller has confirmed that they are all; None where it has none."""
        if re.search(r"[\r\n\0]", name):
            return None
        with self._named_failures(make_message("reading {name}", name=name)):
            try:
                self._ftp.voidcmd("TYPE I")
                connection = self._ftp.transfercmd(f"RETR {name}")
            except ftplib.error_perm as error:
                if str(error).startswith(NOT_THERE):
                    return None
                raise
            with connection:
                content = self._receive_content(connection, name)
            self._ftp.voidresp()
        return content

    def _receive_content(self, connection: object, name: str) -> bytes:
        pieces, size, login = [], 0, self._login
        limit_s = time.monotonic() + login.file_timeout_s
        look_s, look_size = time.monotonic() + login.timeout_s, _LEAST_BYTES
        while piece := connection.recv(_CHUNK):  # type: ignore[attr-defined]
            pieces.append(piece)
            size += len(piece)
            if size > MAX_FILE_BYTES:
                raise WireProtocolError(
                    self.device,
                    make_message(
                        "{name} is larger than {max_file_bytes} MB: no file of a controller is.",
                        name=name,
                        max_file_bytes=MAX_FILE_BYTES >> 20,
                    ),
                    remedy=_CABLE,
                )
            now_s = time.monotonic()
            if now_s > limit_s:
                text = make_message(
                    "{name} did not arrive within {file_timeout_s:g} s.",
                    name=name,
                    file_timeout_s=login.file_timeout_s,
                )
                raise DeviceTimeoutError(self.device, text, remedy=_AGAIN)
            if now_s > look_s and size < look_size:
                text = make_message(
                    "of {name} less than {least_byte_count} bytes arrived in {timeout_s:g} s.",
                    name=name,
                    least_byte_count=_LEAST_BYTES,
                    timeout_s=login.timeout_s,
                )
                raise DeviceTimeoutError(self.device, text, remedy=_AGAIN)
            if now_s > look_s:
                look_s, look_size = now_s + login.timeout_s, size + _LEAST_BYTES
        return b"".join(pieces)

    @contextmanager
    def _named_failures(self, doing: str, *, writes: bool = False) -> Iterator[None]:
        """Turn what the library raises into an error that names the device, the cause and what to do."""
        try:
            yield
        except TimeoutError as error:
            if isinstance(error, DeviceTimeoutError):
                raise
            raise DeviceTimeoutError(
                self.device,
                make_message(
                    "no answer within {timeout_s:g} s while {doing}.",
                    timeout_s=self._login.timeout_s,
                    doing=doing,
                ),
                remedy=_AGAIN,
            ) from error
        except ftplib.Error as error:
            raise name_refusal(self.device, doing, error, writes=writes) from error
        except _FAILURES as error:
            raise lost_link_error(self.device, doing, error) from error


def _listed_name(line: str) -> str:
    """Return the name that a line of a listing holds; "" for a folder or a blank line."""
    found = _UNIX_LINE.fullmatch(line.strip()) or _DOS_LINE.fullmatch(line.strip())
    if found is None:
        return line.strip()
    return "" if found["kind"] in ("d", "<DIR>") else str(found["name"])
