"""What is wrong in the long-lived tasks of the service and of the cell's process, as screens show it."""

from cellcal.drivers.supervision import SUPERVISOR, TroubleDocument
from cellcal.service.session_documents import SessionDocument


def troubles_of(session: SessionDocument | None) -> list[TroubleDocument]:
    """Return the failures of this process and of the cell's, in words."""
    of_the_cell = [] if session is None else list(session.get("troubles", []))
    return [trouble.to_json() for trouble in SUPERVISOR.list_troubles()] + of_the_cell
