"""Programs on a Universal Robots controller over SFTP; the dashboard says whether one runs.

Sources: the maker's user manual of software 5.20 (Secure Shell: enabled in the settings; the administrator's password
is that of ``root``) and dashboard guide (``programState``); public client code (user ``root``, folder ``/programs``).
What is delivered is a file: the program in PolyScope's memory is another until it is loaded.
"""

from typing import Self

from cellcal.calibration.documents.plain_files import MOST_BYTES
from cellcal.drivers.errors import RefusedError, UnreachableError
from cellcal.drivers.universal_robots.dashboard import UrDashboard
from cellcal.drivers.wire.program_drafts import write_through_draft
from cellcal.drivers.wire.sftp_link import SftpLink, SshLogin

SSH_PORT = 22
USUAL_USER, USUAL_PASSWORD = "root", "easybot"  # the maker's
PROGRAM_FOLDER = "/programs"
_SUFFIXES = (".urp", ".script", ".txt", ".installation", ".variables")
_DRAFT = ".cellcal_draft_"  # before the name of a file that is not whole yet


class UrProgramStore:
    """One folder of one controller; a context that signs in.

    A file arrives under another name, is compared, and then takes the place of the old one in one step: a transfer
    that breaks leaves the old file.
    """

    def __init__(
        self, device: str, address: tuple[str, int], folder: str, login: SshLogin, *, deadline_s: float
    ) -> None:
        self._link = SftpLink(device, address, login, deadline_s=deadline_s)
        self._dashboard = UrDashboard(device, address[0], deadline_s=deadline_s)
        self._folder = folder
        self._has_dashboard = False

    async def __aenter__(self) -> Self:
        try:
            await self._link.open()
            self._has_dashboard = await self._find_dashboard()
        except BaseException:
            await self._link.close()
            raise
        return self

    async def __aexit__(self, *_exc: object) -> None:
        await self._link.close()

    @property
    def device(self) -> str:
        return self._link.device

    @property
    def tells_running(self) -> bool:
        return self._has_dashboard

    async def list_names(self) -> tuple[str, ...]:
        names = await self._link.list_files(self._folder)
        return tuple(name for name in names if name.lower().endswith(_SUFFIXES) and not name.startswith("."))

    async def list_folders(self) -> tuple[str, ...]:
        return await self._link.list_folders(self._folder)

    async def read_file(self, name: str) -> bytes | None:
        return await self._link.read_file(self._path_of(name), MOST_BYTES)

    async def write_file(self, name: str, content: bytes) -> None:
        await write_through_draft(
            self, name, f"{_DRAFT}{name}", content, upload=self._upload, take_place=self._take_place
        )

    async def delete_file(self, name: str) -> None:
        await self._link.delete_file(self._path_of(name))

    async def refuse_while_running(self) -> None:
        if self._has_dashboard and await self._dashboard.is_program_active():
            raise RefusedError(
                self.device,
                "a program runs on the controller, or is paused.",
                remedy="Stop it at the pendant, then deliver again.",
            )

    def is_same(self, sent: bytes, read: bytes) -> bool:
        return sent == read

    async def _upload(self, name: str, content: bytes) -> None:
        await self._link.write_file(self._path_of(name), content)

    async def _take_place(self, draft: str, name: str) -> None:
        await self._link.replace_file(self._path_of(draft), self._path_of(name))

    async def _find_dashboard(self) -> bool:
        """Return whether the dashboard answers; PolyScope X has none, and security settings may block it."""
        try:
            await self._dashboard.is_program_active()
        except UnreachableError:
            return False
        return True

    def _path_of(self, name: str) -> str:
        return f"{self._folder}/{name}"
