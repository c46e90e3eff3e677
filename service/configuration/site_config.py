"""The ``[site]`` table of a cell file."""

from pathlib import Path

from pydantic import BaseModel, ConfigDict


class SiteTable(BaseModel):
    """[site]: tell a site of this cell. Without the table nothing leaves the computer."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    folder: Path  # made by `cellcal site enroll`; a relative one is meant from the cell file's own

    def seen_from(self, cell_file: Path) -> "SiteTable":
        """Return it with the folder as the cell file means it."""
        return SiteTable(folder=cell_file.parent / self.folder.expanduser())
