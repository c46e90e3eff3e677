"""What the routes' workers need of the runs, imported when the first of them works: the service answers before."""

from typing import TYPE_CHECKING

from cellcal.service.configuration.cell_file import CellConfig

if TYPE_CHECKING:
    from cellcal.service.certificates.certificate import IssuedCertificate
    from cellcal.service.record.journal import Journal
    from cellcal.service.record.run_store import RunStore


def open_journal(config: CellConfig) -> "Journal":
    """Open the cell's journal."""
    from cellcal.service.record import journal_files  # noqa: PLC0415  heavy

    return journal_files.open_journal(config)


def store_of(journal: "Journal") -> "RunStore":
    """Return what a journal says."""
    from cellcal.service.record.run_store import RunStore  # noqa: PLC0415  heavy

    return RunStore(journal)


def issue_certificate(config: CellConfig, run_id: str) -> "IssuedCertificate":
    """Return the signed certificate of a run, written where it was missing."""
    from cellcal.service.certificates import certificate  # noqa: PLC0415  heavy

    return certificate.issue_certificate(config, run_id)
