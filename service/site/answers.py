"""What a cell answers when the site asks: its outbox, its runs, its certificates. Every verb reads."""

import json
import re
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path

from cellcal.calibration.documents.plain_files import read_plain_bytes
from cellcal.service.record.journal import JournalEvent
from cellcal.service.record.journal_reading import journal_to_read
from cellcal.service.record.robot_lock import runs_under_way
from cellcal.service.site.journal_tail import event_to_json
from cellcal.service.site.keys import SiteError
from cellcal.service.site.ledger import SiteLedger
from cellcal.service.site.outbox import rows_between

MOST_ROWS = 500
QUERY_PARAMETERS = ("from", "most", "id", "after")
LONGEST_DOCUMENT = 16_000_000
_RUN_ID = re.compile(r"[A-Za-z0-9_-]{1,100}")
_EVENTS = (
    "SELECT seq, run_id, idx, kind, idem, body, wall_utc, mono_ns, boot_id, actor, prev, hash FROM event"
    " WHERE run_id = ? AND seq > ? ORDER BY seq LIMIT ?"
)


class CellAnswers:
    """The verbs. Each gives JSON bodies to be signed, or messages that are signed already."""

    def __init__(
        self, journal: Path, outbox: Path, certificates: Path, ledger: SiteLedger, *, leases: Path
    ) -> None:
        self._journal, self._outbox, self._certificates, self._ledger = journal, outbox, certificates, ledger
        self._leases = leases  # who works on which robot
        self.verbs: Mapping[str, Callable[[Mapping[str, str]], Iterator[Mapping[str, object] | bytes]]] = {
            "outbox": self._outbox_rows,
            "runs": self._list_runs,
            "run": self._run_events,
        }

    def answer_query(
        self, verb: str, parameters: Mapping[str, str]
    ) -> Iterator[Mapping[str, object] | bytes]:
        """Return the answer to a question.

        Raises
        ------
        SiteError
            There is no such verb, or the question is not understood.
        """
        if verb not in self.verbs:
            raise SiteError(f"there is no verb {verb!r}; there are {', '.join(self.verbs)}.")
        return self.verbs[verb](parameters)

    def read_certificate(self, run_id: str) -> bytes:
        """Return the signed document of a run, as it was issued.

        Raises
        ------
        SiteError
            None was issued.
        """
        if _RUN_ID.fullmatch(run_id) is not None:
            for name in (f"{run_id}.json", f"{run_id}-refused.json"):
                path = self._certificates / name
                if path.is_file() and path.stat().st_size <= LONGEST_DOCUMENT:
                    return read_plain_bytes(path)
        raise SiteError(f"no certificate of the run {run_id[:100]!r} was issued.")

    def _outbox_rows(self, parameters: Mapping[str, str]) -> Iterator[Mapping[str, object] | bytes]:
        first = _integer_parameter(parameters, "from", 1)
        most = min(_integer_parameter(parameters, "most", MOST_ROWS), MOST_ROWS)
        for row in rows_between(self._outbox, first, most):
            yield row.message

    def _list_runs(self, parameters: Mapping[str, str]) -> Iterator[Mapping[str, object]]:
        del parameters
        yield {"runs": self._ledger.list_runs(runs_under_way(self._leases))}

    def _run_events(self, parameters: Mapping[str, str]) -> Iterator[Mapping[str, object]]:
        run_id, after = parameters.get("id", ""), _integer_parameter(parameters, "after", 0)
        database = journal_to_read(self._journal)
        if database is None:
            return
        try:
            rows = database.execute(_EVENTS, (run_id, after, MOST_ROWS)).fetchall()
        finally:
            database.close()
        for row in rows:
            yield event_to_json(JournalEvent(*row))


def _integer_parameter(parameters: Mapping[str, str], name: str, otherwise: int) -> int:
    text = parameters.get(name, "")
    if not text:
        return otherwise
    if not text.isascii() or not text.isdecimal() or len(text) > 18:
        raise SiteError(f"{name} must be a whole number.")
    return int(text)


def as_error(error: SiteError) -> bytes:
    """Return an error as an answer."""
    return json.dumps({"code": error.code, "message": error.message}).encode()
