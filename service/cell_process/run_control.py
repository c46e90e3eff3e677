"""The run of a cell: it is started, resumed, paused, stopped, signed and dismissed here; there is at most one."""

import asyncio
import logging
import time
from collections.abc import Callable
from dataclasses import replace

from pydantic_core import to_jsonable_python

from cellcal.calibration.errors import CellError
from cellcal.calibration.message import make_message
from cellcal.drivers.supervision import (
    log_failures,
)
from cellcal.drivers.wire.cancellation import cancel_until_done
from cellcal.procedures.catalogue import definition_named
from cellcal.procedures.cell import Cell, MotionLevel
from cellcal.procedures.procedure_definition import Phase
from cellcal.procedures.progress import PauseGate, StepProgress
from cellcal.procedures.run_history import EventKind
from cellcal.service.cell_process.hold_to_move import HoldButton
from cellcal.service.cell_process.messages import (
    ResumeRun,
    SessionCommand,
    SignOff,
    StartRun,
)
from cellcal.service.cell_process.order_replies import OrderRefusedError
from cellcal.service.cell_process.run_in_progress import RunInProgress
from cellcal.service.cell_process.run_status import RunStatus
from cellcal.service.cell_process.screen_operator import ScreenOperator
from cellcal.service.cell_process.signer_roles import SignerRoles
from cellcal.service.certificates.certificate import NoResultError, issue_certificate
from cellcal.service.certificates.printing import print_beside
from cellcal.service.configuration.cell_file import CellConfig
from cellcal.service.engineering.parameters.simulated_cells import refuse_paths
from cellcal.service.record.journal import StoreError
from cellcal.service.record.journal_end import NOT_ACCEPTED, describe_missing_end, refuse_missing_end
from cellcal.service.record.journal_files import open_journal
from cellcal.service.record.run_outcome import RunOutcome
from cellcal.service.record.run_store import RunStore
from cellcal.service.runs.launch import resume_run_on, start_run_on
from cellcal.service.runs.run_procedure import RunConditions
from cellcal.service.runs.settings import build_spec
from cellcal.service.session_documents import (
    CertificateDocument,
    OutcomeDocument,
)
from cellcal.service.watching.automatic_operator import AutomaticOperator
from cellcal.service.watching.loss_response import WATCH, PreparedAnswer

_log = logging.getLogger(__name__)
_CANCEL_AGAIN_S = 75.0  # longer than a written mastering takes to be undone


class RunControl:
    """At most one run, its status for the screens, and the end of the journal that it would be written to.

    ``on_change`` is called where decisions of a screen depend on what changed, ``on_progress`` where none does.
    """

    def __init__(
        self,
        config: CellConfig,
        operator: ScreenOperator,
        hold: HoldButton,
        on_change: Callable[[], None],
        on_progress: Callable[[], None],
    ) -> None:
        self._config, self._operator, self._hold = config, operator, hold
        self._on_change, self._on_progress = on_change, on_progress
        self._gate = PauseGate()
        self._run_in_progress = RunInProgress(config.cell.data_dir)
        self._signer_roles = SignerRoles(config)
        self._task: asyncio.Task[None] | None = None
        self.status: RunStatus | None = None
        self.journal_end = ""  # in words, that it is missing

    @property
    def is_busy(self) -> bool:
        """Whether a run goes on."""
        return self._task is not None and not self._task.done()

    @property
    def waits_for_signatures(self) -> bool:
        """Whether the run that ended left lines to a person that are not signed."""
        outcome = None if self.status is None else self.status.outcome
        return (
            outcome is not None
            and bool((outcome.get("judgement") or {}).get("to_sign"))
            and "signed" not in outcome
        )

    def refuse_while_busy(self) -> None:
        """Raise `OrderRefusedError` while a run goes on."""
        if self.is_busy:
            raise OrderRefusedError(
                "a run is under way.", remedy="Wait until it has ended, or ask the robot to stop."
            )

    async def check_journal_end(self) -> None:
        """Look whether the end of the journal is missing."""
        self.journal_end = await asyncio.to_thread(describe_missing_end, self._config)

    async def note_signers(self, command: SessionCommand) -> None:
        """Journal in which roles people answer and sign."""
        await self._signer_roles.note_signers("" if self.status is None else self.status.run_id, command)

    def begin_run(self, cell: Cell, order: StartRun | ResumeRun, who: str) -> None:
        """Start or resume a run as a screen orders.

        Raises
        ------
        CellError
            A run goes on, there is no such procedure or run, or the end of the journal is missing.
        """
        self.refuse_while_busy()
        self._launch_run(cell, order, who)

    @property
    def unfinished_robot(self) -> str:
        """The robot of the run that was in progress when the service ended; "" where none was, or one goes on."""
        unfinished = None if self.is_busy else self._run_in_progress.read_unfinished()
        return "" if unfinished is None else unfinished.robot

    def resume_unfinished(self, cell: Cell) -> None:
        """Resume the run that was in progress on this robot when the service ended."""
        unfinished = self._run_in_progress.read_unfinished()
        if unfinished is not None:
            order = ResumeRun(op="resume", run_id=unfinished.run_id, hold_to_move=unfinished.hold_to_move)
            with log_failures("going on with the run that was under way"):  # a person decides instead
                self.begin_run(cell, order, "service")

    def pause_run(self) -> None:
        """Let the run wait before its next step."""
        self._gate.pause()

    def continue_run(self) -> None:
        """Let a paused run go on."""
        self._gate.resume()

    async def cancel_run(self) -> None:
        """Cancel the run and wait for its end; it is resumed when the robot can be reached again."""
        if self._task is not None and not self._task.done():
            await cancel_until_done(self._task, every_s=_CANCEL_AGAIN_S)

    async def stop_run(self) -> None:
        """Stop the run, which is not resumed by itself; a disk that fails must not keep the robot moving."""
        task = self._task
        if task is not None and not task.done():
            task.cancel()
        try:
            self._run_in_progress.clear_run()  # a person has ended it
        except OSError as error:
            raise OrderRefusedError(
                make_message(
                    "the run was ended, but the disk refuses to note it: {strerror}.", strerror=error.strerror
                ),
                remedy="Free or repair the disk; the run goes on by itself at the next start until then.",
            ) from error
        finally:
            if task is not None:
                await asyncio.wait({task})

    def dismiss_run(self) -> None:
        """Forget the status of the run that ended."""
        self.refuse_while_busy()
        self.status = None
        self._on_change()

    async def sign_run(self, order: SignOff, who: str) -> None:
        """Journal who did what the run left to a person; every line that it named has to be there."""
        run = self.status
        if run is None or not run.has_ended or run.run_id != order.run_id or run.outcome is None:
            raise OrderRefusedError(
                "this run cannot be signed just now.", remedy="Sign on the page where it ended."
            )
        required_lines = (run.outcome.get("judgement") or {}).get("to_sign", [])
        if not required_lines or set(required_lines) != set(order.lines):
            raise OrderRefusedError(
                "not every line is signed.", remedy="Do what each line says, and tick it."
            )
        with open_journal(self._config) as journal:
            body = {"who": who, "lines": list(order.lines)}
            journal.append(run.run_id, EventKind.SIGNED, body, key="signed", actor=who)
        certificate = await self._write_certificate(run.run_id)
        run.outcome = {**run.outcome, **certificate, "signed": {"who": who, "at_s": time.time()}}
        self._on_change()

    def start_unattended(self, cell: Cell, answer: PreparedAnswer) -> None:
        """Start what the cell file allows; it answers what it can, and a person at any screen the rest."""
        if answer.procedure is None or self.is_busy:
            return
        order = StartRun(
            op="start", procedure=answer.procedure, settings=dict(answer.settings), hold_to_move=False
        )
        operator = AutomaticOperator(self._config.watch, cell.operator)
        with log_failures("recovery without a person"):  # the loss stays on the screen: a person decides
            self._launch_run(replace(cell, operator=operator), order, WATCH)

    def _launch_run(self, cell: Cell, order: StartRun | ResumeRun, who: str) -> None:
        self._refuse_missing_end(accepted=order.accept_missing_end)
        holds = (
            order.hold_to_move and cell.level is MotionLevel.COMMANDED
        )  # a person's own moves need no key here
        self._hold.is_required = holds
        self._gate.resume()
        if isinstance(order, StartRun):
            entry = definition_named(order.procedure)
            refuse_paths(entry.spec_type, order.settings)
        else:
            with open_journal(self._config) as journal:
                view = RunStore(journal).find_run(order.run_id)
            entry = definition_named(view.procedure)
        self.status = RunStatus(entry.name, entry.title, who, hold_to_move=holds)
        if isinstance(order, ResumeRun) and order.redo_from is None:
            self.status.found = [finding.step for finding in view.past.findings]
        self._task = asyncio.create_task(self._run_procedure(cell, order, who, self.status), name="run")
        self._on_change()

    def _refuse_missing_end(self, *, accepted: bool) -> None:
        try:
            with open_journal(self._config) as journal:
                refuse_missing_end(self._config, journal, accepted=accepted)
        except StoreError as error:
            if error.code == NOT_ACCEPTED:  # it may have been cut since the cell was connected
                self.journal_end = f"{error.message} {error.remedy}"
                self._on_progress()
            raise

    async def _run_procedure(self, cell: Cell, order: StartRun | ResumeRun, who: str, run: RunStatus) -> None:
        def on_begin(run_id: str, phases: tuple[Phase, ...]) -> None:
            run.run_id, run.phases = run_id, phases
            self._operator.run_id = run_id
            self._signer_roles.note_beginning(run_id, who)
            self._run_in_progress.save_run(run_id, cell.robot.name, hold_to_move=order.hold_to_move)

        how = RunConditions(
            lambda progress: self._on_event(run, progress), on_begin, self._gate, who,
            accept_missing_end=order.accept_missing_end,
        )  # fmt: skip
        try:
            run.outcome = await self._outcome_to_json(await self._run_to_outcome(cell, order, how))
        except CellError as error:
            run.outcome = _outcome_fields("refused", error.message, error.remedy)
        except asyncio.CancelledError:
            run.outcome = _outcome_fields("cancelled", "The run was ended; it can be resumed.")
            raise
        except Exception:  # noqa: BLE001  the screen shows any error, and the process goes on
            _log.exception("run %s broke", run.run_id)
            run.outcome = _outcome_fields(
                "broken", "The program failed; its log has the cause.", "Resume the run."
            )
        finally:
            run.state = "ended"
            self._hold.is_required = False
            self._on_change()

    async def _run_to_outcome(
        self, cell: Cell, order: StartRun | ResumeRun, how: RunConditions
    ) -> RunOutcome:
        if isinstance(order, StartRun):
            spec = build_spec(self._config, cell.robot.name, order.procedure, order.settings)
            outcome = await start_run_on(self._config, cell, order.procedure, spec, how)
        else:
            outcome = await resume_run_on(self._config, cell, order.run_id, how, redo_from=order.redo_from)
        self._run_in_progress.clear_run()
        return outcome

    async def _outcome_to_json(self, outcome: RunOutcome) -> OutcomeDocument:
        document: OutcomeDocument = to_jsonable_python(
            {
                "verdict": outcome.verdict,
                "reason": outcome.reason,
                "remedy": outcome.remedy,
                "code": outcome.code,
                "judgement": outcome.judgement,
                "result": outcome.result,
            }
        )
        return {**document, **await self._write_certificate(outcome.run_id)}

    async def _write_certificate(self, run_id: str) -> CertificateDocument:
        """Write the certificate of a run as its journal now stands; say where, or why there is none."""
        try:
            issued = await asyncio.to_thread(issue_certificate, self._config, run_id)
            await asyncio.to_thread(print_beside, issued.json_path)
        except NoResultError:  # how the run ended says why; it would stand there twice
            return {"certificate": None, "no_certificate": ""}
        except CellError as error:
            return {"certificate": None, "no_certificate": error.message}
        return {"certificate": issued.json_path.name}

    def _on_event(self, run: RunStatus, progress: StepProgress) -> None:
        run.record_progress(progress)
        self._operator.step = progress.step
        self._on_progress()


def _outcome_fields(verdict: str, reason: str, remedy: str = "") -> OutcomeDocument:
    return {"verdict": verdict, "reason": reason, "remedy": remedy}
