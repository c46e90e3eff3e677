"""What the routes' workers need of the runs, imported when the first of them works: the service answers before."""

from typing import TYPE_CHECKING

from service.configuration.cell_file import CellConfig

if TYPE_CHECKING:
    from service.certificates.certificate import Issued
    from service.runs.journal import Journal
    from service.runs.store import Store


def open_journal(config: CellConfig) -> "Journal":
    """Open the cell's journal."""
    from service.runs import cell  # noqa: PLC0415  heavy

    return cell.open_journal(config)


def store_of(journal: "Journal") -> "Store":
    """Return what a journal says."""
    from service.runs.store import Store  # noqa: PLC0415  heavy

    return Store(journal)


def issue(config: CellConfig, run_id: str) -> "Issued":
    """Return the signed certificate of a run, written where it was missing."""
    from service.certificates import certificate  # noqa: PLC0415  heavy

    return certificate.issue(config, run_id)
