"""The files of an ABB controller, as both web services show them.

Imitates
    ``$HOME`` behind /fileservice.
Source
    ABB 3HAC050973-001 rev L: get, put, delete, copy with ``fs-newname``, ``fs-overwrite``, ``fs-action``.
    ABB OmniCore App SDK 1.5.0: the action as a part of the path, ``fs-size``, ``fs-mdate``, lists page by page.
Modelled
    One folder; copies within it; 404, 409 for a copy that may not overwrite; a list of at most 10 files a page.
Not modelled
    Folders in it, other devices, rights of users.
"""

from collections.abc import Mapping

Entry = dict[str, str]
FOLDER = "/fileservice/$HOME"
PAGE = 10


class FileFolder:
    """Files by name."""

    def __init__(self) -> None:
        self.contents: dict[str, bytes] = {}

    def list_page(self, start: int) -> tuple[list[Entry], int | None]:
        """Return the entries of a page (the first is 1), and the number of the next one."""
        names = sorted(self.contents)
        entries = [
            {
                "_type": "fs-file",
                "_title": name,
                "fs-size": str(len(self.contents[name])),
                "fs-readonly": "false",
                "fs-cdate": "2026-01-01 T 00:00:00",
                "fs-mdate": "2026-01-01 T 00:00:00",
            }
            for name in names[(start - 1) * PAGE : start * PAGE]
        ]
        return entries, start + 1 if len(names) > start * PAGE else None

    def change_file(self, method: str, name: str, body: bytes) -> int:
        """Put or delete a file; return the status."""
        if method == "PUT":
            status = 200 if name in self.contents else 201
            self.contents[name] = body
            return status
        if method == "DELETE":
            return 204 if self.contents.pop(name, None) is not None else 404
        return 405

    def copy_file(self, name: str, form: Mapping[str, str]) -> int:
        """Copy a file; return the status."""
        target = form.get("fs-newname", "")
        if name not in self.contents:
            return 404
        if not target or "/" in target:
            return 400
        if target in self.contents and form.get("fs-overwrite", "false") != "true":
            return 409
        self.contents[target] = self.contents[name]
        return 204
