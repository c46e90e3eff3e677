"""pyftpdlib over a folder, in a process of its own: prints its port, and serves until its input is closed.

``python -m tests.wire.foreign_ftp FOLDER plain|devices``: with ``devices``, MD: is understood and names have any case.
"""

import sys
import threading

from pyftpdlib.authorizers import DummyAuthorizer
from pyftpdlib.filesystems import AbstractedFS
from pyftpdlib.handlers import FTPHandler
from pyftpdlib.servers import FTPServer


class DeviceNames(AbstractedFS):
    """Names as a controller has them."""

    def ftp2fs(self, ftppath: str) -> str:
        return super().ftp2fs(ftppath.lower().replace("md:", "").replace("\\", "/") or "/")


class Handler(FTPHandler):
    authorizer = DummyAuthorizer()


def serve_folder(folder: str, kind: str) -> None:
    Handler.authorizer.add_anonymous(folder, perm="elr")
    if kind == "devices":
        Handler.abstracted_fs = DeviceNames
    server = FTPServer(("127.0.0.1", 0), Handler)
    print(server.address[1], flush=True)
    threading.Thread(target=server.serve_forever, daemon=True).start()
    sys.stdin.read()


if __name__ == "__main__":
    serve_folder(*sys.argv[1:])
