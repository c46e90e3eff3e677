"""What the journal says: runs, their findings and results, mastering records. Nothing is stored twice."""

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import timedelta
from typing import Any, TypedDict

from pydantic import TypeAdapter

from cellcal.calibration.documents.json_text import parse_json
from cellcal.calibration.drift.reference import DriftReference
from cellcal.calibration.mastering.counts import MasteringRecord
from cellcal.calibration.mastering.position_record import ArmPositionRecord
from cellcal.calibration.message import make_message
from cellcal.calibration.message_table import MESSAGES, remember_table
from cellcal.calibration.points.alignment import Alignment
from cellcal.calibration.poses.calibrated_arm import CalibratedArm
from cellcal.procedures.canonical_json import sha256_of
from cellcal.procedures.cell import Cell
from cellcal.procedures.run_history import EventKind, RunHistory, fold_events
from cellcal.service.record.journal import Journal, JournalEvent, StoreError
from cellcal.service.record.mastering_backups import mastering_backups
from cellcal.service.record.proved_cures import POSITION_RECORD, ProvedCure, is_run_of, newest_cures
from cellcal.service.record.robot_lock import state_seen
from cellcal.service.record.unconfirmed_mastering import UnconfirmedMastering, unconfirmed_masterings
from cellcal.service.times import read_time

RECORD = "mastering_record"
_SOFTWARE = ("software", "solver", "definition_sha256")
ALIGNMENT = "alignment"
PARAMETER_SET = "parameter_set"
DRIFT_REFERENCE = "drift_reference"
_RECORDS: TypeAdapter[MasteringRecord] = TypeAdapter(MasteringRecord)
_POSITION_RECORDS: TypeAdapter[ArmPositionRecord] = TypeAdapter(ArmPositionRecord)
_ALIGNMENTS: TypeAdapter[Alignment] = TypeAdapter(Alignment)
_ARMS: TypeAdapter[CalibratedArm] = TypeAdapter(CalibratedArm)
_REFERENCES: TypeAdapter[DriftReference] = TypeAdapter(DriftReference)


@dataclass(frozen=True, slots=True)
class RunView:
    """One run, folded from its events."""

    run_id: str
    procedure: str
    version: int
    spec: Any
    cell: Mapping[str, Any]
    started_utc: str
    state: str  # a verdict, or "interrupted" while no end is journalled
    reason: str
    result: Any
    judgement: Any  # what the procedure claims of its result; None where it says nothing
    past: RunHistory
    begun_by: str = ""  # as who began it was told: a person, the watch, the service
    begun_as: tuple[str, ...] = ()  # roles of the people behind that name; empty where the journal knows none
    motion_level: str = ""  # who moved the robot; empty in journals that do not say it
    controller_mode: str | None = None  # at the start, as the maker calls it; None: not reported
    software: tuple[Mapping[str, str], ...] = ()  # that began the run, and any other that went on with it
    has_templates: bool = True  # False: recorded with English texts alone

    def state_seen(self, under_way: Collection[str]) -> str:
        """Return the state, "running" where the run is one of those that go on in some process."""
        return state_seen(self.state, self.run_id, under_way)


NEVER_BEFORE = "9999-12-31T23:59:59.999+00:00"
_STEP_BACK = timedelta(minutes=1)  # more than a time server corrects


def _datable_utc(events: Sequence[JournalEvent], place: int) -> str:
    """Return when an event was, where the events before it were not stamped later."""
    at_utc = read_time(events[place].wall_utc)
    was_set_back = any(read_time(event.wall_utc) > at_utc + _STEP_BACK for event in events[:place])
    return NEVER_BEFORE if was_set_back else events[place].wall_utc


class RunStore:
    """Reads a journal; writes only what is imported from outside."""

    def __init__(self, journal: Journal) -> None:
        self._journal = journal

    def list_runs(self) -> list[RunView]:
        """Return every run, oldest first."""
        grouped: dict[str, list[JournalEvent]] = {}
        for event in self._journal.list_events():
            grouped.setdefault(event.run_id, []).append(event)
        return [_fold_run(events) for events in grouped.values() if events[0].kind == EventKind.STARTED]

    def find_run(self, run_id: str) -> RunView:
        """Return one run.

        Raises
        ------
        StoreError
            There is no such run.
        """
        events = self._journal.list_events(run_id)
        if not events or events[0].kind != EventKind.STARTED:
            raise StoreError(
                make_message("there is no run {run_id!r}", run_id=run_id),
                code="store.no_such_run",
                remedy="See `cellcal runs`.",
            )
        return _fold_run(events)

    def last_begun_utc(self, procedure: str, robot_serial: str) -> str | None:
        """Return when a procedure was begun last on a robot, however that run ended; raises as `kept`.

        `NEVER_BEFORE` where the clock was set back before that: nothing then counts as later.
        """
        self._journal.refuse_damaged()
        return self._newest_utc(EventKind.STARTED, lambda body: is_run_of(body, procedure, robot_serial))

    def last_stored_utc(self, what: str, robot_serial: str) -> str | None:
        """Return when something of one kind was kept last of a robot; as `last_begun_utc` says."""
        self._journal.refuse_damaged()
        key = (what, robot_serial)
        return self._newest_utc(EventKind.STORED, lambda body: (body["what"], body["robot_serial"]) == key)

    def _newest_utc(self, kind: EventKind, right: Callable[[Any], bool]) -> str | None:
        events = self._journal.list_events()
        for place in range(len(events) - 1, -1, -1):
            if events[place].kind == kind and right(parse_json(events[place].body)):
                return _datable_utc(events, place)
        return None

    def resolve_run_id(self, run_id: str) -> str:
        """Return the id of the newest run for ``last``, else the id itself."""
        if run_id != "last":
            return run_id
        self._journal.refuse_damaged()
        views = self.list_runs()
        if not views:
            raise StoreError(
                "no run was made yet", code="store.no_such_run", remedy="Begin with `cellcal run`."
            )
        return views[-1].run_id

    def with_events(self, run_id: str) -> tuple[RunView, list[JournalEvent]]:
        """Return a run and everything that its journal holds of it; ``last`` is the newest run.

        Raises
        ------
        StoreError
            There is no such run.
        """
        view = self.find_run(self.resolve_run_id(run_id))
        return view, self._journal.list_events(view.run_id)

    def list_stored(self, what: str, robot_serial: str) -> list[Mapping[str, Any]]:
        """Return every kept result of one kind for one robot, oldest first.

        Raises
        ------
        StoreError
            The journal is damaged: which one is in force cannot be told. So for all that is read by it below.
        """
        self._journal.refuse_damaged()
        facts = [
            parse_json(event.body) for event in self._journal.list_events() if event.kind == EventKind.STORED
        ]
        return [fact for fact in facts if (fact["what"], fact["robot_serial"]) == (what, robot_serial)]

    def mastering_record(self, robot_serial: str) -> MasteringRecord | None:
        """Return the latest mastering record of a robot; None when none was ever taken."""
        facts = self.list_stored(RECORD, robot_serial)
        return _RECORDS.validate_python(facts[-1]["value"]) if facts else None

    def position_record(self, robot_serial: str) -> ArmPositionRecord | None:
        """Return the latest position record of a robot; None when none was ever taken."""
        facts = self.list_stored(POSITION_RECORD, robot_serial)
        return _POSITION_RECORDS.validate_python(facts[-1]["value"]) if facts else None

    def cures_since_record(self, robot_serial: str) -> tuple[ProvedCure | None, str]:
        """Return the newest cure that passed after a robot's position record, and the run of an unproved one since.

        Raises as `kept`.
        """
        self._journal.refuse_damaged()
        return newest_cures(self._journal.list_events(), robot_serial)

    def list_alignments(self) -> tuple[Alignment, ...]:
        """Return every alignment of every robot, oldest first; raises as `kept`."""
        self._journal.refuse_damaged()
        facts = [
            parse_json(event.body) for event in self._journal.list_events() if event.kind == EventKind.STORED
        ]
        return tuple(_ALIGNMENTS.validate_python(f["value"]) for f in facts if f["what"] == ALIGNMENT)

    def calibrated_arm(self, robot_serial: str) -> CalibratedArm | None:
        """Return what the newest calibration of a robot found; None when none was ever kept."""
        facts = self.list_stored(PARAMETER_SET, robot_serial)
        return _ARMS.validate_python(facts[-1]["value"]) if facts else None

    def drift_references(self, robot_serial: str) -> tuple[DriftReference, ...]:
        """Return every reference for drift checks of a robot, oldest first."""
        return tuple(
            _REFERENCES.validate_python(f["value"]) for f in self.list_stored(DRIFT_REFERENCE, robot_serial)
        )

    def with_history(self, cell: Cell, robot_serial: str) -> Cell:
        """Return the cell with all that the journal holds of its robot, and all alignments."""
        return replace(
            cell,
            record=self.mastering_record(robot_serial),
            position_record=self.position_record(robot_serial),
            backups=mastering_backups(self._journal.list_events(), robot_serial),
            alignments=self.list_alignments(),
            calibrated=self.calibrated_arm(robot_serial),
            drift_references=self.drift_references(robot_serial),
        )

    def list_unconfirmed(self, robot_serial: str) -> tuple[UnconfirmedMastering, ...]:
        """Return what was written as a robot's mastering and neither confirmed nor undone since; raises as `kept`."""
        self._journal.refuse_damaged()
        return unconfirmed_masterings(self._journal.list_events(), robot_serial)

    def put_mastering_record(self, record: MasteringRecord, *, actor: str) -> None:
        """Take in a record that was exported elsewhere; it is the one in force from then on."""
        if self.mastering_record(record.robot_serial) == record:
            return
        value = _RECORDS.dump_python(record, mode="json")
        body = stored_body(RECORD, record.robot_serial, record.robot_serial, value)
        self._journal.append(f"import-{body['sha256'][:12]}", EventKind.STORED, body, actor=actor)


class StoredBody(TypedDict):
    """The body of a STORED event: a value that outlives its run, with its hash."""

    what: str
    subject: str
    robot_serial: str
    value: Any
    sha256: str


def stored_body(what: str, subject: str, robot_serial: str, value: Any) -> StoredBody:
    """Return the body of a STORED event."""
    return {
        "what": what,
        "subject": subject,
        "robot_serial": robot_serial,
        "value": value,
        "sha256": sha256_of(value),
    }


def _fold_run(events: list[JournalEvent]) -> RunView:
    bodies = [(event.kind, parse_json(event.body)) for event in events]
    for _, body in bodies:
        remember_table(body)
    header = bodies[0][1]
    ended: Mapping[str, Any] = {}
    for kind, body in bodies:
        if kind == EventKind.ENDED:
            ended = body
        elif kind in (EventKind.RESUMED, EventKind.FORGOTTEN):
            ended = {}
    return RunView(
        run_id=events[0].run_id,
        procedure=header["procedure"],
        version=header["version"],
        spec=header["spec"],
        cell=header["cell"],
        started_utc=events[0].wall_utc,
        state=ended.get("verdict", "interrupted"),
        reason=ended.get("reason", ""),
        result=ended.get("result"),
        judgement=ended.get("judgement"),
        past=fold_events(bodies),
        begun_by=events[0].actor,
        begun_as=_roles_of(events[0].actor, bodies),
        motion_level=header.get("motion_level", ""),
        controller_mode=header.get("controller_mode"),
        software=_software_versions(bodies),
        has_templates=MESSAGES in header,
    )


def _roles_of(who: str, bodies: list[tuple[str, Any]]) -> tuple[str, ...]:
    """Return the roles of the people behind a name, as they were first noted in a run."""
    noted = (body["people"] for kind, body in bodies if kind == EventKind.ANSWERS_AS and body["who"] == who)
    return tuple(signer["role"] for signer in next(noted, ()))


def _software_versions(bodies: list[tuple[str, Any]]) -> tuple[Mapping[str, str], ...]:
    entered = [body for kind, body in bodies if kind in (EventKind.STARTED, EventKind.RESUMED)]
    versions = [{key: body[key] for key in _SOFTWARE if key in body} for body in entered]
    return tuple(made for k, made in enumerate(versions) if made and made not in versions[:k])
