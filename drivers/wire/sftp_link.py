"""One SFTP session with a controller whose SSH key is pinned.

Nothing of the user's own SSH set-up is used: no configuration, no agent, no keys, no list of known hosts. A password
goes to a controller only after its key was recognised.
"""

from collections.abc import AsyncIterator, Collection
from contextlib import asynccontextmanager
from dataclasses import dataclass

import asyncssh

from cellcal.calibration.message import make_message
from cellcal.drivers.errors import DeviceError, RefusedError, UnreachableError, WireProtocolError
from cellcal.drivers.wire.deadline import answer_deadline
from cellcal.drivers.wire.link_errors import bracket_host, lost_connection_error, no_connection_error

_PART = 1 << 18  # octets that are read or written within one deadline
_MOST_NAMES = 10_000  # of a folder
_FILES = frozenset(  # what a link leads to shows when it is read, as does what a server gives no kind of
    (asyncssh.FILEXFER_TYPE_REGULAR, asyncssh.FILEXFER_TYPE_SYMLINK, asyncssh.FILEXFER_TYPE_UNKNOWN)
)
_FOLDERS = frozenset((asyncssh.FILEXFER_TYPE_DIRECTORY,))
_CHECK = "Check the address, the cable, and that SSH is enabled in the controller's settings."


@dataclass(frozen=True, slots=True)
class SshLogin:
    """The user, and which SSH keys the controller may show: fingerprints such as ``SHA256:…``, any of them."""

    user: str
    password: str
    host_keys: Collection[str] = ()


class SftpLink:
    """Files of a controller, each call within ``deadline_s`` or, for contents, each part of them."""

    def __init__(self, device: str, address: tuple[str, int], login: SshLogin, *, deadline_s: float) -> None:
        self.device = device
        self._address, self._login, self._deadline_s = address, login, deadline_s
        self._connection: asyncssh.SSHClientConnection | None = None
        self._open_sftp: asyncssh.SFTPClient | None = None

    async def open(self) -> None:
        """Connect, compare the controller's key, sign in and start SFTP.

        Raises
        ------
        UnreachableError, DeviceTimeoutError
            Nothing answers there.
        RefusedError
            The key is not pinned or another one, or user and password are not accepted.
        WireProtocolError
            What answers does not speak SSH.
        """
        shown = _ShownKey(self._login.host_keys)
        host, port = self._address
        try:
            async with answer_deadline(self.device, self._deadline_s, "signing in over SSH"):
                self._connection = await asyncssh.connect(
                    host,
                    port,
                    username=self._login.user,
                    password=self._login.password,
                    known_hosts=([], [], []),
                    client_factory=lambda: shown,
                    preferred_auth="password,keyboard-interactive",
                    x509_trusted_certs=None,
                    config=None,
                    client_keys=None,
                    agent_path=None,
                )
                self._open_sftp = await self._connection.start_sftp_client()
        except asyncssh.HostKeyNotVerifiable as error:
            raise self._wrong_key(shown.fingerprint) from error
        except asyncssh.PermissionDenied as error:
            raise RefusedError(
                self.device,
                "the controller does not accept user and password.",
                remedy="Give --user and --password-file, and allow passwords in the controller's SSH settings.",
            ) from error
        except DeviceError:  # one that took too long is an OSError as well
            raise
        except OSError as error:
            where = f"{bracket_host(host)}:{port}"
            raise no_connection_error(self.device, where, error, _CHECK) from error
        except (asyncssh.Error, ValueError) as error:
            raise self._no_ssh(error) from error

    async def close(self) -> None:
        """Close the session; a controller that does not answer is left."""
        if self._connection is not None:
            self._connection.abort()
            async with _quiet_deadline(self.device, self._deadline_s):
                await self._connection.wait_closed()
            self._connection = self._open_sftp = None

    async def list_files(self, folder: str) -> tuple[str, ...]:
        """Return the names of the files of a folder, sorted; links are among them."""
        return await self._list_entries(folder, _FILES)

    async def list_folders(self, folder: str) -> tuple[str, ...]:
        """Return the names of the folders in a folder, sorted, without hidden ones."""
        names = await self._list_entries(folder, _FOLDERS)
        return tuple(name for name in names if not name.startswith("."))

    async def _list_entries(self, folder: str, kinds: Collection[int]) -> tuple[str, ...]:
        names: list[str] = []
        async with self._named_errors("reading the list of files"):
            async for entry in self._sftp.scandir(folder.encode()):  # in bytes: a name need not be UTF-8
                if entry.attrs.type in kinds:
                    names.append(_text(entry.filename))
                if len(names) > _MOST_NAMES:
                    raise RefusedError(
                        self.device,
                        make_message(
                            "{folder} holds more than {most} files.", folder=folder, most=_MOST_NAMES
                        ),
                        remedy="Name a folder that holds programs only.",
                    )
        return tuple(sorted(names))

    async def read_file(self, path: str, most_bytes: int) -> bytes | None:
        """Return the bytes of a file; None where there is none."""
        try:
            return await self._read_whole(path, most_bytes)
        except _NotThereError:
            return None

    async def write_file(self, path: str, content: bytes) -> None:
        """Write a file from its beginning to its end."""
        async with self._named_errors("opening a file to write"):
            file = await self._sftp.open(path, "wb")
        try:
            for start in range(0, len(content), _PART):
                async with self._named_errors("writing a file"):
                    await file.write(content[start : start + _PART])
        finally:
            async with self._named_errors("closing a file"):
                await file.close()

    async def replace_file(self, path: str, target: str) -> None:
        """Give a file the name of another, which it replaces in one step, with the rights of the other."""
        async with self._named_errors("replacing a file"):
            if await self._sftp.exists(target):
                rights = (await self._sftp.stat(target)).permissions
                if rights is not None:
                    await self._sftp.chmod(path, rights & 0o777)
            await self._sftp.posix_rename(path, target)

    async def delete_file(self, path: str) -> None:
        """Delete a file; one that is not there is no fault."""
        try:
            async with self._named_errors("deleting a file"):
                await self._sftp.remove(path)
        except _NotThereError:
            pass

    async def _read_whole(self, path: str, most_bytes: int) -> bytes:
        async with self._named_errors("opening a file to read"):
            file = await self._sftp.open(path, "rb")
        content = bytearray()
        try:
            while len(content) <= most_bytes:
                async with self._named_errors("reading a file"):
                    part = await file.read(_PART)
                if not part:
                    return bytes(content)
                content += _octets(part)
        finally:
            async with self._named_errors("closing a file"):
                await file.close()
        raise RefusedError(
            self.device,
            make_message("{name} is larger than {most} MB.", name=path, most=most_bytes // 1_000_000),
            remedy="Only program files belong in this folder.",
        )

    @property
    def _sftp(self) -> asyncssh.SFTPClient:
        if self._open_sftp is None:
            raise UnreachableError(self.device, "the SSH connection is closed.", remedy=_CHECK)
        return self._open_sftp

    @asynccontextmanager
    async def _named_errors(self, doing: str) -> AsyncIterator[None]:
        try:
            async with answer_deadline(self.device, self._deadline_s, doing):
                yield
        except DeviceError:  # one that took too long is an OSError as well
            raise
        except asyncssh.SFTPNoSuchFile as error:
            raise _NotThereError(
                self.device,
                "the controller has no such file or folder.",
                remedy="Check the folder behind the address.",
            ) from error
        except (asyncssh.SFTPConnectionLost, asyncssh.SFTPNoConnection, asyncssh.DisconnectError) as error:
            raise lost_connection_error(self.device, error, _CHECK) from error
        except asyncssh.SFTPError as error:
            raise RefusedError(
                self.device,
                make_message("{doing} was refused: {reason}.", doing=doing, reason=error.reason.rstrip(".")),
                remedy="Check the rights of the user and the room on the controller's disk.",
                vendor_code=error.code,
            ) from error
        except OSError as error:
            raise lost_connection_error(self.device, error, _CHECK) from error
        except asyncssh.Error as error:
            raise self._no_ssh(error) from error

    def _wrong_key(self, fingerprint: str) -> RefusedError:
        if not self._login.host_keys:
            return RefusedError(
                self.device,
                make_message("its SSH key {fingerprint} is not known here.", fingerprint=fingerprint),
                remedy=make_message(
                    "Compare it over a cable straight to the controller (ssh-keyscan HOST | ssh-keygen -lf -), then "
                    "add --host-key {fingerprint}",
                    fingerprint=fingerprint,
                ),
            )
        return RefusedError(
            self.device,
            make_message(
                "it shows the SSH key {fingerprint}, which is none of those given.", fingerprint=fingerprint
            ),
            remedy="Check the address: a new system on the controller has a new key, else another device answers.",
        )

    def _no_ssh(self, error: Exception) -> WireProtocolError:
        return WireProtocolError(
            self.device,
            make_message("SSH could not be started: {reason}.", reason=str(error).rstrip(".")),
            remedy=_CHECK,
        )


class _NotThereError(RefusedError):
    """The file or folder is not on the controller."""


class _ShownKey(asyncssh.SSHClient):
    """Compares the key that a controller shows with the pinned ones, before anything is sent."""

    def __init__(self, pinned: Collection[str]) -> None:
        self._pinned = pinned
        self.fingerprint = ""

    def validate_host_public_key(self, host: str, addr: str, port: int, key: asyncssh.SSHKey) -> bool:
        self.fingerprint = key.get_fingerprint()
        return self.fingerprint in self._pinned


@asynccontextmanager
async def _quiet_deadline(device: str, seconds: float) -> AsyncIterator[None]:
    try:
        async with answer_deadline(device, seconds, "closing the SSH connection"):
            yield
    except (DeviceError, OSError, asyncssh.Error):
        pass


def _text(name: str | bytes) -> str:
    return name.decode("utf-8", "replace") if isinstance(name, bytes) else name


def _octets(part: str | bytes) -> bytes:
    return part.encode() if isinstance(part, str) else part  # bytes, as the file was opened for them
