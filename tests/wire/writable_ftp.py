"""pyftpdlib as a controller that takes listings: it translates them, and may lose the link in a transfer."""

import errno
import re
import threading
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

with warnings.catch_warnings():
    warnings.simplefilter("ignore", DeprecationWarning)  # of asyncore, which it stands on
    from pyftpdlib.authorizers import DummyAuthorizer
    from pyftpdlib.filesystems import AbstractedFS
    from pyftpdlib.handlers import DTPHandler, FTPHandler
    from pyftpdlib.ioloop import IOLoop
    from pyftpdlib.servers import FTPServer

READ, WRITE = "elr", "elrdw"
USER, PASSWORD = "engineer", "of the hall"


@dataclass
class WritableFtp:
    """The server; ``cuts`` uploads lose their link in the middle, ``spoils`` change a statement.

    ``locked`` files are listed and not given; ``line`` writes a line of a listing from a name.
    """

    port: int = 0
    cuts: int = 0
    spoils: bool = False
    locked: tuple[str, ...] = ()
    line: str = "{name}"


@contextmanager
def writable_ftp(folder: Path, *, rights: str = WRITE) -> Iterator[WritableFtp]:
    """Serve a folder as MD: until the block ends."""
    state = WritableFtp()

    class DeviceNames(AbstractedFS):  # type: ignore[misc]  # pyftpdlib has no types
        def ftp2fs(self, ftppath: str) -> str:
            return str(super().ftp2fs(ftppath.lower().replace("md:", "").replace("\\", "/") or "/"))

        def open(self, filename: str, mode: str) -> Any:
            if Path(filename).name in state.locked:
                raise PermissionError(errno.EACCES, "in the editor")
            return super().open(filename, mode)

    class Data(DTPHandler):  # type: ignore[misc]  # as above
        def handle_read(self) -> None:
            if state.cuts > 0 and self.receive:
                state.cuts -= 1
                octets = self.recv(40)
                self.file_obj.write(octets)
                self.file_obj.flush()
                self.cmd_channel.close()
                self.close()
                return
            super().handle_read()

        handle_read_event = handle_read  # the library calls this one

    class Handler(FTPHandler):  # type: ignore[misc]  # as above
        authorizer = DummyAuthorizer()
        abstracted_fs = DeviceNames
        dtp_handler = Data

        def ftp_NLST(self, path: str) -> str:  # noqa: N802  the library's name
            lines = [state.line.format(name=entry.name) for entry in sorted(folder.iterdir())]
            self.push_dtp_data("".join(f"{line}\r\n" for line in lines).encode(), cmd="NLST")
            return path

        def on_file_received(self, file: str) -> None:
            path = Path(file)
            text = path.read_bytes()
            text = re.sub(rb"MODIFIED[^;]*;", b"MODIFIED\t= DATE 26-11-26  TIME 10:00:00;", text)
            path.write_bytes(text.replace(b"R[1]", b"R[2]") if state.spoils else text)

    Handler.authorizer.add_user(USER, PASSWORD, str(folder), perm=rights)
    loop = IOLoop()
    server = FTPServer(("127.0.0.1", 0), Handler, ioloop=loop)
    state.port = server.address[1]
    ended = threading.Event()

    def serve() -> None:
        while not ended.is_set():
            loop.loop(timeout=0.02, blocking=False)
        server.close_all()

    thread = threading.Thread(target=serve, name="ftp server")
    thread.start()
    try:
        yield state
    finally:
        ended.set()
        thread.join(timeout=30)
