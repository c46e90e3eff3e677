"""The refusal of all guarded readers."""

from pathlib import Path

from cellcal.calibration.errors import CellError


class DocumentError(CellError, ValueError):
    """A document is no whole document of its format, or goes past a limit of its reader.

    ``message`` names the file where one was read; the text of the error is only why, for those who name it.
    """

    code = "usage"

    def __init__(self, why: str, *, remedy: str = "", path: Path | None = None, key: str = "") -> None:
        super().__init__(why if path is None else f"{path} cannot be used: {why}", remedy=remedy)
        self.why, self.key = why, key  # the key whose value is wrong, where one is

    def __str__(self) -> str:
        return self.why


class NotDownloadedError(DocumentError):
    """A file holds only a pointer to the one that was not downloaded."""
