"""What the site is told of a cell's history at a glance: the last certificate, the trend of drift, the run under way.

A fold over the journal's events, one at a time, so that a long journal is read once.
"""

from collections import deque
from collections.abc import Collection, Mapping
from dataclasses import dataclass, field
from typing import Any, TypedDict

from cellcal.calibration.documents.json_text import parse_json
from cellcal.procedures.run_history import EventKind
from cellcal.service.record.journal import JournalEvent
from cellcal.service.record.robot_lock import state_seen

_RUNS_KEPT = 100
_TREND_KEPT = 20
_ENDED_WELL = "passed"
_WITH_A_RECORD = ("refused", "out_of_tolerance")  # their certificate is the record of a refusal


class CertificateSummary(TypedDict):
    """The newest certificate, or refusal, of the cell."""

    run_id: str
    procedure: str
    robot_serial: str
    word: str
    ended_utc: str


class DriftEntry(TypedDict):
    """The result of a drift check, in metres at the tip."""

    run_id: str
    robot_serial: str
    ended_utc: str
    change_rms_m: float
    change_max_m: Any  # as the journal has it
    word: str


@dataclass(slots=True)
class _RunSummary:
    run_id: str
    procedure: str
    robot_serial: str
    started_utc: str
    state: str = "interrupted"
    word: str = ""
    ended_utc: str = ""
    reason: str = ""
    step: str = ""

    def as_json(self) -> dict[str, object]:
        return {name: getattr(self, name) for name in self.__slots__}


@dataclass(slots=True)
class SiteLedger:
    """Grows with every event of the journal; ``head`` is the last one taken."""

    head: int = 0
    head_hash: str = ""
    certificate: CertificateSummary | None = None
    drift: deque[DriftEntry] = field(default_factory=lambda: deque(maxlen=_TREND_KEPT))
    _runs: dict[str, _RunSummary] = field(default_factory=dict)

    def take_event(self, event: JournalEvent) -> None:
        """Take the next event."""
        self.head, self.head_hash = event.seq, event.hash.hex()
        if event.kind == EventKind.STARTED:
            self._begin_run(event, parse_json(event.body))
            return
        run = self._runs.get(event.run_id)
        if run is None:
            return
        if event.kind in (EventKind.ENTERED, EventKind.INTENT):
            run.step = str(parse_json(event.body)["step"])
        elif event.kind in (EventKind.RESUMED, EventKind.FORGOTTEN):
            run.state, run.word, run.ended_utc, run.reason = "interrupted", "", "", ""
        elif event.kind == EventKind.ENDED:
            self._end_run(run, event, parse_json(event.body))

    def find_run(self, run_id: str) -> _RunSummary | None:
        """Return one of the newest runs as it stands."""
        return self._runs.get(run_id)

    def list_runs(self, under_way: Collection[str] = ()) -> list[dict[str, object]]:
        """Return the newest runs, newest first; those that go on in some process are running."""
        newest = reversed(list(self._runs.values()))  # zenoh's threads ask, too
        return [run.as_json() | {"state": state_seen(run.state, run.run_id, under_way)} for run in newest]

    def _begin_run(self, event: JournalEvent, header: Mapping[str, object]) -> None:
        serial = _value_at(header, "cell", "devices", 0, "identity", "serial")
        self._runs[event.run_id] = _RunSummary(
            event.run_id, str(header["procedure"]), str(serial or ""), event.wall_utc
        )
        while len(self._runs) > _RUNS_KEPT:
            self._runs.pop(next(iter(self._runs)))

    def _end_run(self, run: _RunSummary, event: JournalEvent, body: Mapping[str, object]) -> None:
        run.state, run.reason = str(body.get("verdict", "")), str(body.get("reason", ""))
        run.ended_utc = event.wall_utc
        run.word = str(_value_at(body, "judgement", "word") or "")
        if run.state == _ENDED_WELL:
            self._note_certificate(run, run.word or "undecided")
            self._note_drift(run, body)
        elif run.state in _WITH_A_RECORD:
            self._note_certificate(run, "refused")

    def _note_certificate(self, run: _RunSummary, word: str) -> None:
        self.certificate = {
            "run_id": run.run_id,
            "procedure": run.procedure,
            "robot_serial": run.robot_serial,
            "word": word,
            "ended_utc": run.ended_utc,
        }

    def _note_drift(self, run: _RunSummary, body: Mapping[str, object]) -> None:
        change_m = _value_at(body, "result", "look", "finding", "change_rms_m")
        if isinstance(change_m, int | float):
            self.drift.append(
                {
                    "run_id": run.run_id,
                    "robot_serial": run.robot_serial,
                    "ended_utc": run.ended_utc,
                    "change_rms_m": change_m,
                    "change_max_m": _value_at(body, "result", "look", "finding", "change_max_m"),
                    "word": run.word,
                }
            )


def _value_at(value: Any, *path: str | int) -> Any:
    """Return what stands at a path of a JSON value, or None."""
    for part in path:
        try:
            value = value[part]
        except (KeyError, IndexError, TypeError):
            return None
    return value
