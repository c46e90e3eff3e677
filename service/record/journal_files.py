"""Where the journal, the leases and the certificates of a cell are, and the journal opened for writing."""

import sqlite3
from pathlib import Path

from cellcal.calibration.message import make_message
from cellcal.service.configuration.cell_file import CellConfig
from cellcal.service.draft_files import remove_drafts_once
from cellcal.service.record.journal import Journal, StoreError


def journal_path(config: CellConfig) -> Path:
    """Return the folder of the cell's journal."""
    return config.cell.data_dir / "journal.db"


def lease_folder(config: CellConfig) -> Path:
    """Return where it is kept who works on which robot."""
    return config.cell.data_dir / "leases"


def open_journal(config: CellConfig) -> Journal:
    """Open the cell's journal, or create it; what a killed process left beside it is removed.

    Raises
    ------
    StoreError
        The folder that the cell file names cannot be used.
    """
    path = journal_path(config)
    remedy = "See that data_dir of the cell file is a folder that may be written, on a disk with room."
    remove_drafts_once(path.parent)
    try:
        return Journal.open_file(path)
    except (OSError, sqlite3.Error) as error:
        raise StoreError(
            make_message("the journal {path} cannot be opened: {error}", path=path, error=error),
            remedy=remedy,
            code="store.io",
        ) from error
    except StoreError as error:
        raise StoreError(error.message, remedy=error.remedy or remedy, code=error.code) from error


def certificates_folder(config: CellConfig) -> Path:
    """Return where certificates are kept."""
    return config.cell.data_dir / "certificates"
