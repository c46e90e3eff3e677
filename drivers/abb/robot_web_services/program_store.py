"""RAPID files on an ABB controller, through its file service.

Sources: ABB 3HAC050973-001 rev L (fileservice: get, put, copy, delete) for Robot Web Services 1; ABB OmniCore App SDK
1.5.0 for 2. What is delivered is a file: the program in the controller's memory is another until it is loaded.
"""

from collections.abc import Mapping
from urllib.parse import parse_qsl, quote, urlsplit

from cellcal.calibration.message import make_message
from cellcal.drivers.abb.robot_web_services.web_link import WebLink
from cellcal.drivers.errors import RefusedError, WireProtocolError
from cellcal.drivers.wire.program_drafts import write_through_draft

PROGRAM_SUFFIXES = (".mod", ".modx", ".prg", ".sys", ".sysx", ".pgf")
_NOT_FOUND = 404
_MOST_PAGES = 200
_DRAFT = "cellcal_draft_"  # before the name of a file that is not whole yet


class AbbProgramStore:
    """One folder of the controller, such as ``$HOME``.

    A file arrives under another name, is compared, and is then copied over the old one by the controller itself: a
    transfer that breaks leaves the old file.
    """

    tells_running = True

    def __init__(self, link: WebLink, folder: str) -> None:
        self._link, self._folder = link, folder.strip("/")

    @property
    def device(self) -> str:
        return self._link.device

    async def list_names(self) -> tuple[str, ...]:
        found: list[str] = []
        query: Mapping[str, str] = {}
        for _ in range(_MOST_PAGES):
            document = await self._link.get_document(f"/fileservice/{self._folder}", **query)
            entries = self._link.dialect.states_in(document)
            if entries is None:
                raise WireProtocolError(
                    self.device,
                    make_message("its list of the files of {folder} is not understood.", folder=self._folder),
                    remedy="Check that the address is the controller's, and that nothing stands in between.",
                )
            found += [str(one.get("_title")) for one in entries if one.get("_type") == "fs-file"]
            following = (
                document.get("_links", {}).get("next") if isinstance(document.get("_links"), dict) else None
            )
            if not isinstance(following, dict):
                return tuple(sorted(filter(_is_program, found)))
            query = dict(parse_qsl(urlsplit(str(following.get("href", "")).replace("&amp;", "&")).query))
        raise WireProtocolError(
            self.device, "its list of files does not end.", remedy="Name another folder of the controller."
        )

    async def read_file(self, name: str) -> bytes | None:
        try:
            return await self._link.get_content(self._path_of(name))
        except RefusedError as error:
            if error.vendor_code == _NOT_FOUND:
                return None
            raise

    async def write_file(self, name: str, content: bytes) -> None:
        await write_through_draft(
            self, name, f"{_DRAFT}{name}", content, upload=self._upload, take_place=self._copy
        )

    async def delete_file(self, name: str) -> None:
        try:
            await self._link.delete(self._path_of(name))
        except RefusedError as error:
            if error.vendor_code != _NOT_FOUND:
                raise

    async def refuse_while_running(self) -> None:
        state = await self._link.get_state("/rw/rapid/execution")
        if state.get("ctrlexecstate") != "stopped":
            raise RefusedError(
                self.device,
                "a program runs on the controller.",
                remedy="Stop it at the pendant, then deliver again.",
            )

    def is_same(self, sent: bytes, read: bytes) -> bool:
        return sent == read

    async def _upload(self, name: str, content: bytes) -> None:
        await self._link.put_content(self._path_of(name), content)

    async def _copy(self, draft: str, name: str) -> None:
        path, fields = self._path_of(draft), {"fs-newname": name, "fs-overwrite": "true"}
        if self._link.dialect.generation == 1:
            await self._link.post_action(path, "", **fields, **{"fs-action": "copy"})
        else:
            await self._link.post_action(path, "copy", **fields)

    def _path_of(self, name: str) -> str:
        return f"/fileservice/{self._folder}/{quote(name)}"


def _is_program(name: str) -> bool:
    return name.lower().endswith(PROGRAM_SUFFIXES) and not name.startswith(_DRAFT)
