"""Run one procedure: take the lease, open the run, replay what is known, finish, say how it ended."""

import asyncio
import logging
import shutil
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any
from uuid import uuid4

from pydantic_core import to_jsonable_python

from cellcal.calibration.errors import CellError
from cellcal.calibration.message import join_messages, make_message
from cellcal.calibration.message_table import MESSAGES, with_messages
from cellcal.drivers.errors import LOOK_FIRST, DeviceError
from cellcal.drivers.interfaces import Answer, GuidesPerson, Instruction, Operator, Question
from cellcal.procedures.catalogue import definition_named
from cellcal.procedures.cell import Cell, DeviceCertificate, Fingerprint, MotionApproval, read_fingerprint
from cellcal.procedures.motion.active_frames import refuse_unnamed, unread_frames
from cellcal.procedures.procedure_definition import Phase, ProcedureDefinition, StoredResult, refuse_unmet
from cellcal.procedures.progress import PauseGate, StepProgress, ignore_progress
from cellcal.procedures.run import (
    Run,
)
from cellcal.procedures.run_history import EventKind, RunHistory
from cellcal.procedures.verdict import Characteristic, state_evidence
from cellcal.service.record.journal import Journal, NewEvent, StoreError
from cellcal.service.record.robot_lock import Lease, acquire_lease
from cellcal.service.record.run_outcome import RunOutcome, RunVerdict, failed_outcome, stored_outcome
from cellcal.service.record.run_store import RunStore, stored_body
from cellcal.service.record.unconfirmed_mastering import refuse_unconfirmed, unconfirmed_in_force
from cellcal.service.runs.instruments import instruments_behind, share_instruments
from cellcal.service.runs.journal_ledger import JournalLedger
from cellcal.service.runs.mastering_rollback import roll_back_unconfirmed
from cellcal.service.runs.resume_check import refuse_difference, spec_of
from cellcal.service.runs.software_identity import software_versions

_log = logging.getLogger(__name__)
FREE_BYTES = 200_000_000
NO_MODE = "In which mode the controller was: this robot does not tell it."
OnEvent = Callable[[StepProgress], None]
OnBegin = Callable[[str, tuple[Phase, ...]], None]


def _ignore_begin(run_id: str, phases: tuple[Phase, ...]) -> None:
    """Do nothing: the default of ``on_begin``."""


@dataclass(frozen=True, slots=True)
class RunConditions:
    """The conditions of a run: how it is watched and who answers for it."""

    on_event: OnEvent = ignore_progress
    on_begin: OnBegin = _ignore_begin  # its id and outline, once it stands in the journal
    gate: PauseGate | None = None
    actor: str = "service"
    free_bytes: int = FREE_BYTES
    accept_missing_end: bool = False  # a person's word: go on although the journal's end is missing
    missing_end: str = ""  # in words, what that person accepted


async def run_procedure(
    cell: Cell,
    name: str,
    spec: Any,
    journal: Journal,
    on_event: OnEvent = ignore_progress,
    *,
    how: RunConditions | None = None,
) -> RunOutcome:
    """Run a procedure of the catalogue from its beginning.

    A cancelled run is journalled as such and the cancellation goes on. How anything else ended is the
    outcome's verdict.

    Raises
    ------
    NeedsUnmetError
        The cell lacks something; nothing was started.
    LeaseHeldError
        Another run has this robot.
    FramesChangedError
        Another tool, user frame or payload is active than the cell file names.
    UnconfirmedMasteringError
        The mastering in force was written by a run that has not confirmed it.
    StoreError
        The journal is damaged, or the disk has no room for a run.
    """
    how = how or RunConditions(on_event)
    entry = definition_named(name)
    refuse_unmet(entry, cell)
    _refuse_small_disk(journal.path, how.free_bytes)
    run_id = f"{name}-{uuid4().hex[:12]}"
    serial = (await cell.robot.identify()).serial
    with acquire_lease(_lease_folder(journal), serial, f"{how.actor} ({run_id})") as run_lease:
        await _refuse_unconfirmed(cell, journal, entry, serial)
        mark = await read_fingerprint(cell)
        refuse_unnamed(cell.named_frames, mark.active_frames)
        cell = with_permit(cell, run_lease, mark)
        header = {
            "procedure": entry.name,
            "version": entry.version,
            "spec": to_jsonable_python(spec),
            "cell": to_jsonable_python(mark),
            "motion_level": cell.level.value,
            "controller_mode": await _mode_of(cell),
            **software_versions(),
            MESSAGES: {},  # this run is recorded with templates and arguments
        }
        journal.append(run_id, EventKind.STARTED, header, key="started", actor=how.actor)
        _note_missing_end(journal, run_id, how)
        how.on_begin(run_id, entry.outline(spec))
        return await _RunExecution(cell, entry, journal, run_id, how).execute_run(spec, RunHistory())


async def resume_procedure(
    cell: Cell,
    run_id: str,
    journal: Journal,
    on_event: OnEvent = ignore_progress,
    *,
    how: RunConditions | None = None,
) -> RunOutcome:
    """Go on with an interrupted run: findings are believed, positions never are.

    Raises
    ------
    ReplayMismatchError
        The cell, its settings or the procedure are not those the run began with; the message says which.
    UnconfirmedMasteringError
        The mastering in force was written by another run, which has not confirmed it.
    """
    how = how or RunConditions(on_event)
    view = RunStore(journal).find_run(run_id)
    entry = definition_named(view.procedure)
    if view.state == RunVerdict.PASSED:
        return stored_outcome(view, entry)
    refuse_unmet(entry, cell)
    _refuse_small_disk(journal.path, how.free_bytes)
    now = await read_fingerprint(cell)
    refuse_difference(view, entry, now)
    spec = spec_of(view, entry)
    serial = (await cell.robot.identify()).serial
    with acquire_lease(_lease_folder(journal), serial, f"{how.actor} ({run_id})") as run_lease:
        await _refuse_unconfirmed(cell, journal, entry, serial, run_id)
        cell = with_permit(cell, run_lease, now)
        view = RunStore(journal).find_run(run_id)  # its holder may have gone on until the lease was ours
        body = {"cell": to_jsonable_python(now), **software_versions()}
        journal.append(run_id, EventKind.RESUMED, body, actor=how.actor)
        _note_missing_end(journal, run_id, how)
        how.on_begin(run_id, entry.outline(spec))
        return await _RunExecution(cell, entry, journal, run_id, how).execute_run(spec, view.past)


def _note_missing_end(journal: Journal, run_id: str, how: RunConditions) -> None:
    """Journal who went on from a journal whose end is missing, and what was missing; the event has the time."""
    if how.missing_end:
        body = {"who": how.actor, "missing": how.missing_end}
        journal.append(run_id, EventKind.MISSING_END, body, actor=how.actor)


def with_permit(cell: Cell, run_lease: Lease, mark: Fingerprint) -> Cell:
    """Return the cell for one entry into a run: motion needs the lease, and nothing was approved yet."""
    return replace(cell, permit=run_lease, motion=MotionApproval(frames=mark.active_frames))


class _RunExecution:
    """One entry into one run."""

    def __init__(
        self, cell: Cell, entry: ProcedureDefinition, journal: Journal, run_id: str, how: RunConditions
    ) -> None:
        self._entry, self._journal, self._run_id, self._how = entry, journal, run_id, how
        self._cell = replace(cell, operator=_AnnouncingOperator(cell.operator, self._announce_progress))
        self._place = StepProgress("started", "", 0, 0)

    async def execute_run(self, spec: Any, past: RunHistory) -> RunOutcome:
        ledger = JournalLedger(self._journal, self._run_id, self._how.actor)
        expected = self._entry.expected_steps(spec)
        cell = share_instruments(self._cell, ledger.note_reading)
        run = Run(
            cell, ledger, past, expected=expected, announce=self._announce_progress, gate=self._how.gate
        )
        try:
            result = await self._entry.procedure(run, spec)
        except CellError as error:
            return await self._end_early(run, failed_outcome(self._run_id, self._entry.name, error))
        except asyncio.CancelledError:
            ended = RunOutcome(self._run_id, self._entry.name, RunVerdict.CANCELLED, reason="cancelled")
            await self._end_early(run, ended)
            raise
        except Exception:
            await self._roll_back()
            raise
        judgement = self._judge_result(spec, result)
        passed = RunOutcome(self._run_id, self._entry.name, RunVerdict.PASSED, result, judgement=judgement)
        return self._end_run(passed, spec)

    async def _end_early(self, run: Run, outcome: RunOutcome) -> RunOutcome:
        """End without a result; what a person does first is to look at a robot that may not stand."""
        look = LOOK_FIRST if run.is_stop_unconfirmed and LOOK_FIRST not in outcome.remedy else ""
        remedy = _join_sentences(look, await self._roll_back(), outcome.remedy)
        return self._end_run(replace(outcome, remedy=remedy))

    async def _roll_back(self) -> str:
        """Undo what the run wrote and did not get to confirm; return what to tell of it."""
        return await roll_back_unconfirmed(self._cell, self._journal, self._run_id, self._how.actor)

    def _judge_result(self, spec: Any, result: Any) -> Any:
        if self._entry.verdict is None:
            return None
        try:
            verdict = self._entry.verdict(spec, result)
            run = RunStore(self._journal).find_run(self._run_id)
            figures = (*verdict.characteristics, *self._lapsed_certificates(spec, run.past))
            unseen = (*unread_frames(self._cell.motion.frames), *(() if run.controller_mode else (NO_MODE,)))
            verdict = replace(verdict, characteristics=figures, not_verified=(*verdict.not_verified, *unseen))
            return verdict.to_json()
        except Exception:  # noqa: BLE001  a result that was written to a robot is journalled, judged or not
            _log.exception("the verdict of run %s could not be given", self._run_id)
            return None

    def _lapsed_certificates(self, spec: Any, past: RunHistory) -> tuple[Characteristic, ...]:
        """Return what keeps a result from a PASS: instruments behind it whose own calibration does not hold today."""
        day = datetime.now(UTC).date().isoformat()
        ways = getattr(spec, "method", ""), getattr(spec, "evidence", "")
        used = instruments_behind(self._entry, ways, past)
        certificates = {
            role: self._cell.certificates[role] for role in used if role in self._cell.certificates
        }
        return tuple(
            _out_of_date(role, one, day) for role, one in certificates.items() if not one.is_valid_on(day)
        )

    def _end_run(self, outcome: RunOutcome, spec: Any = None) -> RunOutcome:
        passed = outcome.verdict is RunVerdict.PASSED
        value = self._entry.result_codec().dump_python(outcome.result, mode="json") if passed else None
        if not passed:
            value = to_jsonable_python(outcome.result)
        body = {
            "verdict": outcome.verdict.value,
            "result": value,
            "reason": outcome.reason,
            "remedy": outcome.remedy,
            "code": outcome.code,
            "judgement": outcome.judgement,
        }
        facts = [
            *self._results_to_store(spec, outcome.result, passed),
            NewEvent(EventKind.ENDED, with_messages(body)),
        ]
        try:
            self._journal.append_all(self._run_id, facts, actor=self._how.actor)
        except StoreError as error:
            if passed:
                return failed_outcome(self._run_id, self._entry.name, error)
            _log.warning("the end of run %s could not be journalled: %s", self._run_id, error)
        self._announce_progress(
            replace(self._place, kind="ended", step="", message=outcome.verdict.value, value=value)
        )
        return outcome

    def _results_to_store(self, spec: Any, result: Any, passed: bool) -> list[NewEvent]:
        to_store = self._entry.results_to_store(spec, result) if passed else None
        results = to_store if isinstance(to_store, tuple) else (to_store,)
        return [self._storage_event(stored_result) for stored_result in results if stored_result is not None]

    def _storage_event(self, stored_result: StoredResult) -> NewEvent:
        value = to_jsonable_python(stored_result.value)
        body = stored_body(stored_result.what, stored_result.subject, self._robot_serial(), value)
        return NewEvent(EventKind.STORED, body, f"stored {stored_result.what}")

    def _robot_serial(self) -> str:
        header = RunStore(self._journal).find_run(self._run_id).cell
        return str(header["devices"][0]["identity"]["serial"])

    def _announce_progress(self, progress: StepProgress) -> None:
        if progress.step:
            self._place = progress
        else:
            progress = replace(progress, step=self._place.step)
            progress = replace(progress, index=self._place.index, expected=self._place.expected)
        try:
            self._how.on_event(progress)
        except Exception:  # noqa: BLE001  a screen that fails must not stop a robot in mid-procedure
            _log.exception("a listener failed and missed %s", progress.kind)


def _out_of_date(role: str, certificate: DeviceCertificate, day: str) -> Characteristic:
    words = {
        "gauge": "the gauge's calibration is valid",
        "tracker": "the tracker's calibration is valid",
        "probe": "the touch probe's calibration is valid",
        "dial": "the dial gauge's calibration is valid",
    }[role]
    rule = make_message(
        "certificate {certificate_number} holds from {issued} to {due}, this is {day}: have it calibrated",
        certificate_number=certificate.number,
        issued=certificate.issued,
        due=certificate.due,
        day=day,
    )
    return state_evidence(words, False, rule, found=0.0, limit=1.0)


class _AnnouncingOperator:
    """Shows what is asked and answered."""

    def __init__(self, operator: Operator, announce: OnEvent) -> None:
        self._operator, self._show = operator, announce

    async def confirm(self, instruction: Instruction) -> Answer:
        self._show(StepProgress("asked", "", 0, 0, instruction.text, {"key": instruction.key}))
        answer = await self._operator.confirm(instruction)
        self._show(
            StepProgress("answered", "", 0, 0, answer.value, {"key": instruction.key, "who": answer.who})
        )
        return answer

    async def ask_question(self, question: Question) -> Answer:
        self._show(
            StepProgress("asked", "", 0, 0, question.text, {"key": question.key, "unit": question.unit})
        )
        answer = await self._operator.ask_question(question)
        self._show(StepProgress("answered", "", 0, 0, answer.value, {"key": question.key, "who": answer.who}))
        return answer

    def show_guidance(self, text: str, values: Mapping[str, Any]) -> None:
        if isinstance(self._operator, GuidesPerson):
            self._operator.show_guidance(text, values)


def _join_sentences(*sentences: str) -> str:
    return join_messages(" ", filter(None, sentences))


async def _refuse_unconfirmed(
    cell: Cell, journal: Journal, entry: ProcedureDefinition, serial: str, run_id: str = ""
) -> None:
    refuse_unconfirmed(await unconfirmed_in_force(cell, journal.list_events(), serial), entry, run_id)


async def _mode_of(cell: Cell) -> str | None:
    """Return how the controller is switched; what it does not tell keeps no run from its beginning."""
    if cell.mode is None:
        return None
    try:
        return await cell.mode.controller_mode()
    except DeviceError as error:
        _log.warning("the mode of %s is not known: %s", cell.robot.name, error)
        return None


def _refuse_small_disk(path: Path, needed: int) -> None:
    free = shutil.disk_usage(path.parent).free
    if free < needed:
        raise StoreError(
            make_message(
                "only {free} MB are free for the journal; a run needs {needed} MB",
                free=free // 1000000,
                needed=needed // 1000000,
            ),
            code="store.full",
            remedy="Free disk space, then start again.",
        )


def _lease_folder(journal: Journal) -> Path:
    return journal.path.parent / "leases"
