"""asyncssh as the SSH server of a controller that serves a folder as ``/programs``."""

from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import asyncssh

USER, PASSWORD = "root", "of the hall"


@dataclass
class WritableSftp:
    """The server; ``spoils`` changes what it writes, ``passwords`` are all that clients sent."""

    port: int = 0
    fingerprint: str = ""
    spoils: bool = False
    refuses_writing: bool = False
    passwords: list[str] = field(default_factory=list)


@asynccontextmanager
async def writable_sftp(root: Path, host: str = "127.0.0.1") -> AsyncIterator[WritableSftp]:
    """Serve ``root`` as / until the block ends."""
    state = WritableSftp()

    class Users(asyncssh.SSHServer):
        def begin_auth(self, username: str) -> bool:
            return True

        def password_auth_supported(self) -> bool:
            return True

        def validate_password(self, username: str, password: str) -> bool:
            state.passwords.append(password)
            return (username, password) == (USER, PASSWORD)

    class Files(asyncssh.SFTPServer):
        def __init__(self, channel: Any) -> None:
            super().__init__(channel, chroot=bytes(root))

        def open(self, path: bytes, pflags: int, attrs: Any) -> object:
            if state.refuses_writing and pflags & asyncssh.FXF_WRITE:
                raise asyncssh.SFTPPermissionDenied("the disk is read-only")
            return super().open(path, pflags, attrs)

        def write(self, file_obj: object, offset: int, data: bytes) -> int:
            spoiled = data.replace(b"moved", b"MOVED") if state.spoils else data
            return super().write(file_obj, offset, spoiled)  # type: ignore[return-value]  # it is synchronous

    key = asyncssh.generate_private_key("ssh-ed25519")
    state.fingerprint = key.get_fingerprint()
    server = await asyncssh.listen(
        host, 0, server_factory=Users, server_host_keys=[key], sftp_factory=Files, process_factory=None
    )
    state.port = server.get_port()
    try:
        yield state
    finally:
        server.close()
        await server.wait_closed()
