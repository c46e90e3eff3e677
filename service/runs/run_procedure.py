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
from cellcal.drivers.errors import DeviceError
from cellcal.drivers.interfaces import Answer, Instruction, Operator, Question
from cellcal.procedures.catalogue import entry_named
from cellcal.procedures.cell import Cell, Fingerprint, HeldCertificate, MotionMemory, fingerprint
from cellcal.procedures.entry import Entry, Keepsake, Phase, refuse_unmet
from cellcal.procedures.motion.active_frames import refuse_unnamed, untold
from cellcal.procedures.past import Kind, Past
from cellcal.procedures.progress import Gate, Progress, ignore
from cellcal.procedures.run import (
    Run,
)
from cellcal.procedures.verdict import Characteristic, enough
from cellcal.service.record.journal import Journal, NewEvent, StoreError
from cellcal.service.record.robot_lock import Lease, lease
from cellcal.service.record.run_outcome import Outcome, Verdict, failed_outcome, stored_outcome
from cellcal.service.record.run_store import Store, stored_body
from cellcal.service.record.unconfirmed_mastering import refuse_unconfirmed, unconfirmed_in_force
from cellcal.service.runs.instruments import instruments_behind, shared
from cellcal.service.runs.mastering_rollback import put_back_unconfirmed
from cellcal.service.runs.same_cell import refuse_difference, spec_of
from cellcal.service.runs.software_identity import software

_log = logging.getLogger(__name__)
FREE_BYTES = 200_000_000
NO_MODE = "In which mode the controller was: this robot does not tell it."
_OUTCOMES = (Kind.FINDING, Kind.CONDITION, Kind.FAILED)
OnEvent = Callable[[Progress], None]
OnBegin = Callable[[str, tuple[Phase, ...]], None]


def _nobody_asks(run_id: str, phases: tuple[Phase, ...]) -> None:
    """Tell nobody that a run began."""


@dataclass(frozen=True, slots=True)
class Conditions:
    """How a run is watched and who answers for it."""

    on_event: OnEvent = ignore
    on_begin: OnBegin = _nobody_asks  # its id and outline, once it stands in the journal
    gate: Gate | None = None
    actor: str = "service"
    free_bytes: int = FREE_BYTES
    accept_missing_end: bool = False  # a person's word: go on although the journal's end is missing


class JournalLedger:
    """A run's end of the journal. A finding names the instruments that were read for it."""

    def __init__(self, journal: Journal, run_id: str, actor: str) -> None:
        self._journal, self._run_id, self._actor = journal, run_id, actor
        self._read: set[str] = set()

    def hear(self, role: str, reading: Any) -> None:
        """Note an instrument that gave a reading."""
        if reading is not None:
            self._read.add(role)

    def record(self, kind: Kind, body: Mapping[str, Any], *, key: str = "") -> None:
        """Store one fact durably."""
        if kind is Kind.FINDING and self._read:
            body = {**body, "instruments": sorted(self._read)}
        if kind in _OUTCOMES:
            self._read.clear()
        self._journal.append(self._run_id, kind, body, key=key, actor=self._actor)


async def run_procedure(
    cell: Cell,
    name: str,
    spec: Any,
    journal: Journal,
    on_event: OnEvent = ignore,
    *,
    how: Conditions | None = None,
) -> Outcome:
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
    how = how or Conditions(on_event)
    entry = entry_named(name)
    refuse_unmet(entry, cell)
    _refuse_small_disk(journal.path, how.free_bytes)
    run_id = f"{name}-{uuid4().hex[:12]}"
    serial = (await cell.robot.identify()).serial
    with lease(_leases(journal), serial, f"{how.actor} ({run_id})") as held:
        await _refuse_unconfirmed(cell, journal, entry, serial)
        mark = await fingerprint(cell)
        refuse_unnamed(cell.named_frames, mark.active_frames)
        cell = permitted(cell, held, mark)
        header = {
            "procedure": entry.name,
            "version": entry.version,
            "spec": to_jsonable_python(spec),
            "cell": to_jsonable_python(mark),
            "motion_level": cell.level.value,
            "controller_mode": await _mode_of(cell),
            **software(),
        }
        journal.append(run_id, Kind.STARTED, header, key="started", actor=how.actor)
        how.on_begin(run_id, entry.outline(spec))
        return await _Conductor(cell, entry, journal, run_id, how).conduct(spec, Past())


async def resume(
    cell: Cell, run_id: str, journal: Journal, on_event: OnEvent = ignore, *, how: Conditions | None = None
) -> Outcome:
    """Go on with an interrupted run: findings are believed, positions never are.

    Raises
    ------
    ReplayMismatchError
        The cell, its settings or the procedure are not those the run began with; the message says which.
    UnconfirmedMasteringError
        The mastering in force was written by another run, which has not confirmed it.
    """
    how = how or Conditions(on_event)
    view = Store(journal).run(run_id)
    entry = entry_named(view.procedure)
    if view.state == Verdict.PASSED:
        return stored_outcome(view, entry)
    refuse_unmet(entry, cell)
    _refuse_small_disk(journal.path, how.free_bytes)
    now = await fingerprint(cell)
    refuse_difference(view, entry, now)
    spec = spec_of(view, entry)
    serial = (await cell.robot.identify()).serial
    with lease(_leases(journal), serial, f"{how.actor} ({run_id})") as held:
        await _refuse_unconfirmed(cell, journal, entry, serial, run_id)
        cell = permitted(cell, held, now)
        view = Store(journal).run(run_id)  # its holder may have gone on until the lease was ours
        body = {"cell": to_jsonable_python(now), **software()}
        journal.append(run_id, Kind.RESUMED, body, actor=how.actor)
        how.on_begin(run_id, entry.outline(spec))
        return await _Conductor(cell, entry, journal, run_id, how).conduct(spec, view.past)


def forget_from(journal: Journal, run_id: str, step: str, *, actor: str = "service") -> None:
    """Redo: findings from ``step`` on no longer count when the run is resumed. Nothing is deleted.

    Raises
    ------
    StoreError
        The run has no finding of that name.
    """
    names = [finding.step for finding in Store(journal).run(run_id).past.findings]
    if step not in names:
        raise StoreError(
            f"run {run_id} has no finding {step!r}",
            code="store.no_such_step",
            remedy=f"It has: {', '.join(names) or 'none'}.",
        )
    journal.append(run_id, Kind.FORGOTTEN, {"keep": names.index(step), "step": step}, actor=actor)


def permitted(cell: Cell, held: Lease, mark: Fingerprint) -> Cell:
    """Return the cell for one entry into a run: motion needs the lease, and nothing was approved yet."""
    return replace(cell, permit=held, motion=MotionMemory(frames=mark.active_frames))


class _Conductor:
    """One entry into one run."""

    def __init__(self, cell: Cell, entry: Entry, journal: Journal, run_id: str, how: Conditions) -> None:
        self._entry, self._journal, self._run_id, self._how = entry, journal, run_id, how
        self._cell = replace(cell, operator=_AnnouncingOperator(cell.operator, self._announce))
        self._place = Progress("started", "", 0, 0)

    async def conduct(self, spec: Any, past: Past) -> Outcome:
        ledger = JournalLedger(self._journal, self._run_id, self._how.actor)
        expected = self._entry.expected_steps(spec)
        cell = shared(self._cell, ledger.hear)
        run = Run(cell, ledger, past, expected=expected, announce=self._announce, gate=self._how.gate)
        try:
            result = await self._entry.procedure(run, spec)
        except CellError as error:
            failed = failed_outcome(self._run_id, self._entry.name, error)
            return self._end(replace(failed, remedy=_told(await self._put_back(), failed.remedy)))
        except asyncio.CancelledError:
            ended = Outcome(self._run_id, self._entry.name, Verdict.CANCELLED, reason="cancelled")
            self._end(replace(ended, remedy=await self._put_back()))
            raise
        except Exception:
            await self._put_back()
            raise
        judgement = self._judged(spec, result)
        passed = Outcome(self._run_id, self._entry.name, Verdict.PASSED, result, judgement=judgement)
        return self._end(passed, spec)

    async def _put_back(self) -> str:
        """Undo what the run wrote and did not get to confirm; return what to tell of it."""
        return await put_back_unconfirmed(self._cell, self._journal, self._run_id, self._how.actor)

    def _judged(self, spec: Any, result: Any) -> Any:
        if self._entry.verdict is None:
            return None
        try:
            verdict = self._entry.verdict(spec, result)
            run = Store(self._journal).run(self._run_id)
            figures = (*verdict.characteristics, *self._lapsed(spec, run.past))
            unseen = (*untold(self._cell.motion.frames), *(() if run.controller_mode else (NO_MODE,)))
            verdict = replace(verdict, characteristics=figures, not_verified=(*verdict.not_verified, *unseen))
            return verdict.as_object()
        except Exception:  # noqa: BLE001  a result that was written to a robot is journalled, judged or not
            _log.exception("the verdict of run %s could not be given", self._run_id)
            return None

    def _lapsed(self, spec: Any, past: Past) -> tuple[Characteristic, ...]:
        """Return what keeps a result from a PASS: instruments behind it whose own calibration does not hold today."""
        day = datetime.now(UTC).date().isoformat()
        ways = getattr(spec, "method", ""), getattr(spec, "evidence", "")
        used = instruments_behind(self._entry, ways, past)
        held = {role: self._cell.certificates[role] for role in used if role in self._cell.certificates}
        return tuple(_out_of_date(role, one, day) for role, one in held.items() if not one.holds_on(day))

    def _end(self, outcome: Outcome, spec: Any = None) -> Outcome:
        passed = outcome.verdict is Verdict.PASSED
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
        facts = [*self._kept(spec, outcome.result, passed), NewEvent(Kind.ENDED, body)]
        try:
            self._journal.append_all(self._run_id, facts, actor=self._how.actor)
        except StoreError as error:
            if passed:
                return failed_outcome(self._run_id, self._entry.name, error)
            _log.warning("the end of run %s could not be journalled: %s", self._run_id, error)
        self._announce(
            replace(self._place, kind="ended", step="", message=outcome.verdict.value, value=value)
        )
        return outcome

    def _kept(self, spec: Any, result: Any, passed: bool) -> list[NewEvent]:
        kept = self._entry.keeps(spec, result) if passed else None
        keepsakes = kept if isinstance(kept, tuple) else (kept,)
        return [self._stored(keepsake) for keepsake in keepsakes if keepsake is not None]

    def _stored(self, keepsake: Keepsake) -> NewEvent:
        value = to_jsonable_python(keepsake.value)
        body = stored_body(keepsake.what, keepsake.subject, self._robot_serial(), value)
        return NewEvent(Kind.STORED, body, f"stored {keepsake.what}")

    def _robot_serial(self) -> str:
        header = Store(self._journal).run(self._run_id).cell
        return str(header["devices"][0]["identity"]["serial"])

    def _announce(self, progress: Progress) -> None:
        if progress.step:
            self._place = progress
        else:
            progress = replace(progress, step=self._place.step)
            progress = replace(progress, index=self._place.index, expected=self._place.expected)
        try:
            self._how.on_event(progress)
        except Exception:  # noqa: BLE001  a screen that fails must not stop a robot in mid-procedure
            _log.exception("a listener failed and missed %s", progress.kind)


def _out_of_date(role: str, held: HeldCertificate, day: str) -> Characteristic:
    words = {
        "gauge": "the gauge's calibration is valid",
        "tracker": "the tracker's calibration is valid",
        "probe": "the touch probe's calibration is valid",
        "dial": "the dial gauge's calibration is valid",
    }[role]
    rule = (
        f"certificate {held.number} holds from {held.issued} to {held.due}, this is {day}: have it calibrated"
    )
    return enough(words, False, rule, found=0.0, limit=1.0)


class _AnnouncingOperator:
    """Shows what is asked and answered."""

    def __init__(self, operator: Operator, announce: OnEvent) -> None:
        self._operator, self._show = operator, announce

    async def confirm(self, instruction: Instruction) -> Answer:
        self._show(Progress("asked", "", 0, 0, instruction.text, {"key": instruction.key}))
        answer = await self._operator.confirm(instruction)
        self._show(Progress("answered", "", 0, 0, answer.value, {"key": instruction.key, "who": answer.who}))
        return answer

    async def enter(self, question: Question) -> Answer:
        self._show(Progress("asked", "", 0, 0, question.text, {"key": question.key, "unit": question.unit}))
        answer = await self._operator.enter(question)
        self._show(Progress("answered", "", 0, 0, answer.value, {"key": question.key, "who": answer.who}))
        return answer


def _told(*sentences: str) -> str:
    return " ".join(sentence for sentence in sentences if sentence)


async def _refuse_unconfirmed(
    cell: Cell, journal: Journal, entry: Entry, serial: str, run_id: str = ""
) -> None:
    refuse_unconfirmed(await unconfirmed_in_force(cell, journal.events(), serial), entry, run_id)


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
            f"only {free // 1_000_000} MB are free for the journal; a run needs {needed // 1_000_000} MB",
            code="store.full",
            remedy="Free disk space, then start again.",
        )


def _leases(journal: Journal) -> Path:
    return journal.path.parent / "leases"
