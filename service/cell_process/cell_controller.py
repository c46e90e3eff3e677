"""The desk: one cell, its devices, and at most one run, for any number of screens.

It owns the run; screens own nothing. What it says is whole each time (`session`), so that a screen that was away
needs one message to be right again. ``rev`` grows with every change that a decision depends on: an order made for
an older one is refused.
"""

import asyncio
import logging
import time
from collections import OrderedDict
from collections.abc import Callable
from dataclasses import replace
from typing import Any, cast

from pydantic_core import to_jsonable_python

from cellcal.calibration.errors import CellError
from cellcal.calibration.message import make_message
from cellcal.drivers.interfaces import JogsAxes, Readiness, Robot
from cellcal.drivers.supervision import (
    SUPERVISOR,
    log_failures,
    message_and_remedy_of,
    raise_lost_cancellation,
    start_task,
    supervise,
)
from cellcal.procedures.catalogue import definition_named
from cellcal.procedures.cell import Cell
from cellcal.procedures.procedure_definition import Phase
from cellcal.procedures.progress import PauseGate, StepProgress
from cellcal.procedures.run_history import EventKind
from cellcal.service.cell_process.hold_to_move import HoldButton, HoldToMoveRobot
from cellcal.service.cell_process.live_values import LivePoller
from cellcal.service.cell_process.loss_watch import LossWatch
from cellcal.service.cell_process.messages import (
    REVISION_FREE,
    AnswerPrompt,
    ContinueRun,
    DeclinePrompt,
    DismissRun,
    HoldOrder,
    Order,
    PauseRun,
    ResumeRun,
    SelectRobot,
    SessionCommand,
    SignOff,
    StartRun,
    StopRun,
)
from cellcal.service.cell_process.recording_check import RecordingCheck
from cellcal.service.cell_process.run_in_progress import RunInProgress
from cellcal.service.cell_process.run_status import RunStatus
from cellcal.service.cell_process.screen_operator import ScreenOperator
from cellcal.service.cell_process.signer_roles import SignerRoles
from cellcal.service.cell_process.unselected_robots import UnselectedRobots
from cellcal.service.certificates.certificate import issue_certificate
from cellcal.service.certificates.printing import print_beside
from cellcal.service.configuration.cell_file import CellConfig
from cellcal.service.engineering.parameters.simulated_cells import refuse_paths
from cellcal.service.record.journal import StoreError
from cellcal.service.record.journal_end import NOT_ACCEPTED, describe_missing_end, refuse_missing_end
from cellcal.service.record.journal_files import open_journal
from cellcal.service.record.run_outcome import RunOutcome
from cellcal.service.record.run_store import RunStore
from cellcal.service.runs.launch import resume_run_on, start_run_on
from cellcal.service.runs.open_cell import open_cell
from cellcal.service.runs.run_procedure import RunConditions
from cellcal.service.runs.settings import build_spec
from cellcal.service.session_documents import (
    CertificateDocument,
    LiveValues,
    OnCellEvent,
    OrderReply,
    OutcomeDocument,
    SessionDocument,
)
from cellcal.service.watching.automatic_operator import AutomaticOperator
from cellcal.service.watching.loss_response import WATCH, PreparedAnswer

_log = logging.getLogger(__name__)
PERIOD_S = 0.1
_RETRY_S = 2.0
_REPLIES_KEPT = 1000
TASK = "devices of the cell"


class OrderRefusedError(CellError):
    """An order that the desk does not obey just now."""

    code = "desk.refused"


class CellController:
    """One cell at work. `attend` keeps the devices and shows them; `obey` does what a screen orders."""

    def __init__(
        self, config: CellConfig, tell: OnCellEvent, *, clock: Callable[[], float] = time.monotonic
    ) -> None:
        self._config, self._tell, self._clock = config, tell, clock
        self._operator = ScreenOperator(self._advance_revision)
        self._hold = HoldButton(self._advance_revision)
        self._recording = RecordingCheck()
        self._poller: LivePoller | None = None
        self._gate = PauseGate()
        self._watch = LossWatch(config, self._show_loss, self._describe_obstacle)
        self._others = UnselectedRobots(config, self._watch, clock=clock)
        self._run_in_progress = RunInProgress(config.cell.data_dir)
        self._signer_roles = SignerRoles(config)
        self._robot = config.robots[0].name
        self._cell: Cell | None = None
        self._trouble = "connecting"
        self._remedy = ""
        self._journal_end = ""  # in words, that it is missing
        self._run: RunStatus | None = None
        self._task: asyncio.Task[None] | None = None
        self._replies: OrderedDict[str, asyncio.Task[OrderReply]] = OrderedDict()
        self._orders: dict[str, tuple[str, Order]] = {}
        self._leave = asyncio.Event()
        self.rev = int(time.time() * 1000)  # a restart never repeats one

    # what screens see

    def describe_session(self) -> SessionDocument:
        """Return everything that is not a live value."""
        run, prompt = self._run, self._operator.prompt
        return {
            "rev": self.rev,
            "cell": self._config.cell.name,
            "robots": [
                {"name": robot.name, "model": robot.model, "serial": robot.serial}
                for robot in self._config.robots
            ],
            "robot": self._robot,
            "level": self._config.motion_of(self._robot).level.value,
            "connection": {
                "connected": self._cell is not None,
                "message": self._trouble,
                "remedy": self._remedy,
            },
            "run": None if run is None else run.as_json(),
            "prompt": None if prompt is None else prompt.as_json(),
            "waits_for_hold": self._hold.waiting,
            "losses": self._watch.as_json(),
            "journal_end": self._journal_end,
            "troubles": [trouble.to_json() for trouble in SUPERVISOR.list_troubles()],
        }

    def _advance_revision(self) -> None:
        self.rev += 1
        self._publish_session()

    def _show_loss(self, robot: str) -> None:
        """Show what a robot lost or has back; orders to the selected one do not depend on the others."""
        self.rev += robot == self._robot
        self._publish_session()

    def _publish_session(self) -> None:
        self._tell("session", self.describe_session())

    # devices

    async def stay_connected(self) -> None:
        """Keep the devices connected and show them, until cancelled. What was under way goes on by itself."""
        unlisten = SUPERVISOR.add_listener(self._publish_session)
        telling = start_task("news of other robots", self._publish_other_robots)
        try:
            await supervise(TASK, self._reconnect_forever)
        finally:
            unlisten()
            telling.cancel()
            await asyncio.wait({telling})
            await self._others.stop_following()
            await self._end_run()

    async def _reconnect_forever(self) -> None:
        while True:
            self._leave.clear()
            self._journal_end = await asyncio.to_thread(describe_missing_end, self._config)
            await self._others.follow_all_but(self._robot)
            await self._connect_once()
            raise_lost_cancellation()
            self._advance_revision()
            await asyncio.sleep(0.0 if self._leave.is_set() else _RETRY_S)

    async def _publish_other_robots(self) -> None:
        """Tell of the other robots also while the selected one cannot be reached."""
        while True:
            if self._cell is None:
                self._publish_live({"devices": []})
            await asyncio.sleep(_RETRY_S)

    def _publish_live(self, live_values: LiveValues) -> None:
        devices = [*live_values["devices"], *self._others.as_json()]
        if devices:
            self._tell("live", {"rev": self.rev, "at_s": time.time(), **live_values, "devices": devices})

    async def _connect_once(self) -> None:
        try:
            async with open_cell(self._config, self._operator, self._robot) as cell:
                poller = self._poller = LivePoller(
                    self._require_hold(cell), reads=self._note_instrument, clock=self._clock
                )
                self._cell, self._trouble, self._remedy = poller.cell, "", ""
                self._advance_revision()
                self._resume_unfinished_run()
                try:
                    await self._poll_devices(poller)
                finally:
                    await poller.cancel_polls()
        except CellError as error:
            if error.message != self._trouble:
                _log.warning("the cell cannot be used: %s", error)
            self._trouble, self._remedy = error.message, error.remedy
        except Exception as error:  # named and retried by the supervisor; shown on the screen here
            self._trouble, self._remedy = message_and_remedy_of(error)
            raise
        finally:
            self._cell = None
            await self._end_run()
            self._advance_revision()

    def _require_hold(self, cell: Cell) -> Cell:
        robot: Any = HoldToMoveRobot(cell.robot, self._hold)
        jogs = None if cell.jogs is None else cast(JogsAxes, robot)
        return replace(cell, robot=cast(Robot, robot), jogs=jogs)

    def _note_instrument(self, role: str) -> None:
        """Note for the screens which instrument the run asks."""
        if self._run is not None and self._run.instrument != role:
            self._run.instrument = role
            self._publish_session()

    async def _poll_devices(self, poller: LivePoller) -> None:
        cell, gone_since_s = poller.cell, None
        while not self._leave.is_set():
            raise_lost_cancellation()
            began_s = self._clock()
            busy = self._is_busy
            await poller.poll_once()
            await self._recording.check_prompt(
                cell, self._operator.prompt, poller.observe_motion(), self._clock()
            )
            live, guidance = poller.as_json(), self._operator.guidance
            self._publish_live({**live, "record": self._recording.as_json(), "guidance": guidance})
            allowed = await self._watch.check_robot(cell, now_s=self._clock(), busy=busy)
            if allowed is not None:
                self._start_unattended(cell, allowed)
            gone_since_s = self._unreachable_since(poller, gone_since_s, busy=busy)
            if gone_since_s is not None and self._clock() - gone_since_s > _RETRY_S:
                raise OrderRefusedError(
                    poller.robot.error or "the robot does not answer.", remedy="Check its cable."
                )
            await asyncio.sleep(max(PERIOD_S - (self._clock() - began_s), 0.01))

    def _unreachable_since(self, poller: LivePoller, since_s: float | None, *, busy: bool) -> float | None:
        condition = poller.robot.condition
        gone = condition is not None and condition.readiness is Readiness.UNREACHABLE
        if busy or not gone:
            return None
        return self._clock() if since_s is None else since_s

    # orders

    async def execute_command(self, command: SessionCommand) -> OrderReply:
        """Do what a screen orders; the same command sent twice is obeyed once, also while it is being obeyed.

        A stop is obeyed each time: no id and no revision keeps it back.
        """
        if isinstance(command.order, HoldOrder | StopRun):
            return await self._execute_order(command)
        if command.id in self._replies and self._orders.get(command.id) != (command.who, command.order):
            return {
                "ok": False,
                "code": "desk.id_used",
                "message": "This press was used for another order.",
                "remedy": "Press again.",
            }
        if command.id not in self._replies:
            if command.rev != self.rev and not isinstance(command.order, REVISION_FREE):
                return {
                    "ok": False,
                    "code": "desk.stale",
                    "message": "The page was out of date.",
                    "remedy": "Look at the present step.",
                    "session": self.describe_session(),
                }
            self._orders[command.id] = (command.who, command.order)
            self._replies[command.id] = asyncio.create_task(self._execute_order(command))
            while len(self._replies) > _REPLIES_KEPT:
                self._orders.pop(self._replies.popitem(last=False)[0])
        return await asyncio.shield(self._replies[command.id])

    async def _execute_order(self, command: SessionCommand) -> OrderReply:
        try:
            await self._signer_roles.note_signers("" if self._run is None else self._run.run_id, command)
            await self._dispatch_order(command)
        except CellError as error:
            return {"ok": False, "code": error.code, "message": error.message, "remedy": error.remedy}
        except Exception as error:  # noqa: BLE001  whatever it was, the page is told and the desk goes on
            _log.exception("an order (%s) broke", command.order.op)
            message = make_message(
                "The program failed at this order: {name}: {error}", name=type(error).__name__, error=error
            )
            return {"ok": False, "code": "desk.broken", "message": message, "remedy": "Look into its log."}
        return {"ok": True, "rev": self.rev}

    async def _dispatch_order(self, command: SessionCommand) -> None:
        order = command.order
        if isinstance(order, AnswerPrompt):
            await self._answer_prompt(order, command.who)
        elif isinstance(order, DeclinePrompt):
            self._operator.decline_prompt(order.prompt_id)
        elif isinstance(order, HoldOrder):
            self._update_hold(order)
        elif isinstance(order, StartRun | ResumeRun):
            self._begin_run(order, command.who)
        elif isinstance(order, SelectRobot):
            self._select_robot(order.robot)
        elif isinstance(order, DismissRun):
            self._dismiss_run()
        elif isinstance(order, SignOff):
            await self._sign_run(order, command.who)
        else:
            await self._control_run(order)

    def _update_hold(self, order: HoldOrder) -> None:
        """Take note of the button; "held" counts for what is left of its time, and not from the future."""
        if not order.held or order.at_s is None:
            self._hold.update_state(is_held=False)
            return
        age_s = self._clock() - order.at_s
        if age_s < 0.0:
            raise OrderRefusedError(
                "the moment at which the button was held is still to come.", remedy="Load the page again."
            )
        self._hold.update_state(is_held=True, age_s=age_s)

    async def _answer_prompt(self, order: AnswerPrompt, who: str) -> None:
        """Take an answer; one that records is looked at first: a press may be older than what it was made for."""
        cell, poller = self._cell, self._poller
        if cell is not None and poller is not None:
            await self._recording.check_prompt(
                cell, self._operator.prompt, poller.observe_motion(), self._clock()
            )
        self._recording.refuse_early(order.prompt_id)
        self._operator.answer_prompt(order.prompt_id, who, order.value)

    async def _control_run(self, order: StopRun | PauseRun | ContinueRun) -> None:
        if isinstance(order, PauseRun):
            self._gate.pause()
        elif isinstance(order, ContinueRun):
            self._gate.resume()
        else:
            await self._stop_run()

    async def _stop_run(self) -> None:
        """Stop first: a disk that refuses to forget the run must not keep the robot moving."""
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

    def _dismiss_run(self) -> None:
        self._refuse_while_busy()
        self._run = None
        self._advance_revision()

    async def _sign_run(self, order: SignOff, who: str) -> None:
        """Journal who did what the run left to a person; every line that it named has to be there."""
        run = self._run
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
        self._advance_revision()

    def _select_robot(self, robot: str) -> None:
        self._refuse_while_busy()
        self._robot = self._config.robot_named(robot).name
        self._cell = None  # that of the robot before: nothing is begun on it any more
        self._run = None
        self._trouble = "connecting"
        self._leave.set()
        self._advance_revision()

    # runs

    @property
    def _is_busy(self) -> bool:
        return self._task is not None and not self._task.done()

    def _refuse_while_busy(self) -> None:
        if self._is_busy:
            raise OrderRefusedError(
                "a run is under way.", remedy="Wait until it has ended, or ask the robot to stop."
            )

    def _begin_run(self, order: StartRun | ResumeRun, who: str) -> None:
        self._refuse_while_busy()
        if self._cell is None:
            raise OrderRefusedError(
                make_message("the cell cannot be used: {trouble}", trouble=self._trouble), remedy=self._remedy
            )
        self._launch_run(self._cell, order, who)

    def _start_unattended(self, cell: Cell, answer: PreparedAnswer) -> None:
        """Start what the cell file allows; it answers what it can, and a person at any screen the rest."""
        if answer.procedure is None or self._is_busy:
            return
        order = StartRun(
            op="start", procedure=answer.procedure, settings=dict(answer.settings), hold_to_move=False
        )
        operator = AutomaticOperator(self._config.watch, cell.operator)
        with log_failures("recovery without a person"):  # the loss stays on the screen: a person decides
            self._launch_run(replace(cell, operator=operator), order, WATCH)

    def _describe_obstacle(self, robot: str) -> str:
        """Say what keeps the desk from starting anything by itself on a robot; runs are told of by the watch."""
        if robot != self._robot:
            return "another robot was selected at the desk"
        outcome = None if self._run is None else self._run.outcome
        if (
            outcome is not None
            and (outcome.get("judgement") or {}).get("to_sign")
            and "signed" not in outcome
        ):
            return "the run before it waited for its signatures"
        return ""

    def _launch_run(self, cell: Cell, order: StartRun | ResumeRun, who: str) -> None:
        self._refuse_missing_end(accepted=order.accept_missing_end)
        self._hold.is_required = order.hold_to_move
        self._gate.resume()
        if isinstance(order, StartRun):
            entry = definition_named(order.procedure)
            refuse_paths(entry.spec_type, order.settings)
        else:
            with open_journal(self._config) as journal:
                view = RunStore(journal).find_run(order.run_id)
            entry = definition_named(view.procedure)
        self._run = RunStatus(entry.name, entry.title, who, hold_to_move=order.hold_to_move)
        if isinstance(order, ResumeRun) and order.redo_from is None:
            self._run.found = [finding.step for finding in view.past.findings]
        self._task = asyncio.create_task(self._run_procedure(cell, order, who, self._run), name="run")
        self._advance_revision()

    def _refuse_missing_end(self, *, accepted: bool) -> None:
        try:
            with open_journal(self._config) as journal:
                refuse_missing_end(self._config, journal, accepted=accepted)
        except StoreError as error:
            if error.code == NOT_ACCEPTED:  # it may have been cut since the cell was connected
                self._journal_end = f"{error.message} {error.remedy}"
                self._publish_session()
            raise

    async def _run_procedure(self, cell: Cell, order: StartRun | ResumeRun, who: str, run: RunStatus) -> None:
        def on_begin(run_id: str, phases: tuple[Phase, ...]) -> None:
            run.run_id, run.phases = run_id, phases
            self._operator.run_id = run_id
            self._signer_roles.note_beginning(run_id, who)
            self._run_in_progress.save_run(run_id, self._robot, hold_to_move=order.hold_to_move)

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
        except Exception:  # noqa: BLE001  whatever it was, the screen says so and the desk goes on
            _log.exception("run %s broke", run.run_id)
            run.outcome = _outcome_fields(
                "broken", "The program failed; its log has the cause.", "Resume the run."
            )
        finally:
            run.state = "ended"
            self._hold.is_required = False
            self._advance_revision()

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
        except CellError as error:
            return {"certificate": None, "no_certificate": error.message}
        return {"certificate": issued.json_path.name}

    def _on_event(self, run: RunStatus, progress: StepProgress) -> None:
        run.record_progress(progress)
        self._operator.step = progress.step
        self._publish_session()

    def _resume_unfinished_run(self) -> None:
        unfinished = self._run_in_progress.read_unfinished()
        if unfinished is not None and unfinished.robot == self._robot and not self._is_busy:
            order = ResumeRun(op="resume", run_id=unfinished.run_id, hold_to_move=unfinished.hold_to_move)
            with log_failures("going on with the run that was under way"):  # a person decides instead
                self._begin_run(order, "service")

    async def _end_run(self) -> None:
        task = self._task
        if task is None or task.done():
            return
        task.cancel()
        await asyncio.wait({task})


def _outcome_fields(verdict: str, reason: str, remedy: str = "") -> OutcomeDocument:
    return {"verdict": verdict, "reason": reason, "remedy": remedy}
