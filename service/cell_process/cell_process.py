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
from cellcal.drivers.interfaces import JogsAxes, Readiness, Robot
from cellcal.drivers.supervision import (
    SUPERVISOR,
    guarded,
    raise_lost_cancellation,
    start_task,
    supervise,
    words_of,
)
from cellcal.procedures.catalogue import entry_named
from cellcal.procedures.cell import Cell
from cellcal.procedures.entry import Phase
from cellcal.procedures.past import Kind
from cellcal.procedures.progress import Gate, Progress
from cellcal.service.cell_process.answering import Answering
from cellcal.service.cell_process.hold_to_move import HeldRobot, Hold
from cellcal.service.cell_process.live_values import Glance
from cellcal.service.cell_process.messages import (
    UNGUARDED,
    AnswerIt,
    Command,
    Decline,
    Dismiss,
    GoOn,
    Order,
    Pause,
    Resume,
    SelectRobot,
    SignOff,
    Start,
    Stop,
)
from cellcal.service.cell_process.messages import (
    Hold as HoldOrder,
)
from cellcal.service.cell_process.recording import Recording
from cellcal.service.cell_process.run_in_progress import UnderWay
from cellcal.service.cell_process.running import Running
from cellcal.service.cell_process.screen_operator import DeskOperator
from cellcal.service.cell_process.unselected_robots import OtherRobots
from cellcal.service.cell_process.watching import DeskWatch
from cellcal.service.certificates.certificate import issue
from cellcal.service.certificates.printing import print_beside
from cellcal.service.configuration.cell_file import CellConfig
from cellcal.service.engineering.parameters.simulated_cells import refuse_paths
from cellcal.service.record.journal_end import end_in_words, refuse_missing_end
from cellcal.service.record.journal_files import open_journal
from cellcal.service.record.run_outcome import Outcome
from cellcal.service.record.run_store import Store
from cellcal.service.runs.launch import go_on_with, start_on
from cellcal.service.runs.open_cell import open_cell
from cellcal.service.runs.run_procedure import Conditions
from cellcal.service.runs.settings import build_spec
from cellcal.service.watching.automatic_operator import StandingAnswers
from cellcal.service.watching.loss_response import WATCH, PreparedAnswer

_log = logging.getLogger(__name__)
Tell = Callable[[str, dict[str, Any]], None]  # "session" or "live", and its content
PERIOD_S = 0.1
_RETRY_S = 2.0
_REPLIES_KEPT = 1000
TASK = "devices of the cell"


class DeskError(CellError):
    """An order that the desk does not obey just now."""

    code = "desk.refused"


class Desk:
    """One cell at work. `attend` keeps the devices and shows them; `obey` does what a screen orders."""

    def __init__(
        self, config: CellConfig, tell: Tell, *, clock: Callable[[], float] = time.monotonic
    ) -> None:
        self._config, self._tell, self._clock = config, tell, clock
        self._operator = DeskOperator(self._decided)
        self._hold = Hold(self._decided)
        self._recording = Recording()
        self._glance: Glance | None = None
        self._gate = Gate()
        self._watch = DeskWatch(config, self._lost, self._occupied)
        self._others = OtherRobots(config, self._watch, clock=clock)
        self._under_way = UnderWay(config.cell.data_dir)
        self._answering = Answering(config)
        self._robot = config.robots[0].name
        self._cell: Cell | None = None
        self._trouble = "connecting"
        self._remedy = ""
        self._journal_end = ""  # in words, that it is missing
        self._run: Running | None = None
        self._task: asyncio.Task[None] | None = None
        self._replies: OrderedDict[str, asyncio.Task[dict[str, Any]]] = OrderedDict()
        self._orders: dict[str, tuple[str, Order]] = {}
        self._leave = asyncio.Event()
        self.rev = int(time.time() * 1000)  # a restart never repeats one

    # what screens see

    def session(self) -> dict[str, Any]:
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
            "troubles": [trouble.as_json() for trouble in SUPERVISOR.troubles()],
        }

    def _decided(self) -> None:
        self.rev += 1
        self._show()

    def _lost(self, robot: str) -> None:
        """Show what a robot lost or has back; orders to the selected one do not depend on the others."""
        self.rev += robot == self._robot
        self._show()

    def _show(self) -> None:
        self._tell("session", self.session())

    # devices

    async def attend(self) -> None:
        """Keep the devices connected and show them, until cancelled. What was under way goes on by itself."""
        unlisten = SUPERVISOR.listen(self._show)
        telling = start_task("news of other robots", self._tell_while_apart)
        try:
            await supervise(TASK, self._keep_attending)
        finally:
            unlisten()
            telling.cancel()
            await asyncio.wait({telling})
            await self._others.end()
            await self._end_run()

    async def _keep_attending(self) -> None:
        while True:
            self._leave.clear()
            self._journal_end = await asyncio.to_thread(end_in_words, self._config)
            await self._others.follow_all_but(self._robot)
            await self._attend_once()
            raise_lost_cancellation()
            self._decided()
            await asyncio.sleep(0.0 if self._leave.is_set() else _RETRY_S)

    async def _tell_while_apart(self) -> None:
        """Tell of the other robots also while the selected one cannot be reached."""
        while True:
            if self._cell is None:
                self._tell_live({"devices": []})
            await asyncio.sleep(_RETRY_S)

    def _tell_live(self, told: dict[str, Any]) -> None:
        devices = [*told["devices"], *self._others.as_json()]
        if devices:
            self._tell("live", {"rev": self.rev, "at_s": time.time(), **told, "devices": devices})

    async def _attend_once(self) -> None:
        try:
            async with open_cell(self._config, self._operator, self._robot) as cell:
                glance = self._glance = Glance(self._held(cell), reads=self._reads, clock=self._clock)
                self._cell, self._trouble, self._remedy = glance.cell, "", ""
                self._decided()
                self._go_on_where_it_broke_off()
                try:
                    await self._look_until_left(glance)
                finally:
                    await glance.leave()
        except CellError as error:
            if error.message != self._trouble:
                _log.warning("the cell cannot be used: %s", error)
            self._trouble, self._remedy = error.message, error.remedy
        except Exception as error:  # named and retried by whoever supervises; here the screen is told
            self._trouble, self._remedy = words_of(error)
            raise
        finally:
            self._cell = None
            await self._end_run()
            self._decided()

    def _held(self, cell: Cell) -> Cell:
        robot: Any = HeldRobot(cell.robot, self._hold)
        jogs = None if cell.jogs is None else cast(JogsAxes, robot)
        return replace(cell, robot=cast(Robot, robot), jogs=jogs)

    def _reads(self, role: str) -> None:
        """Note for the screens which instrument the run asks."""
        if self._run is not None and self._run.instrument != role:
            self._run.instrument = role
            self._show()

    async def _look_until_left(self, glance: Glance) -> None:
        cell, gone_since_s = glance.cell, None
        while not self._leave.is_set():
            raise_lost_cancellation()
            began_s = self._clock()
            busy = self._busy
            await glance.look()
            await self._recording.look(cell, self._operator.prompt, glance.standing(), self._clock())
            self._tell_live({**glance.as_json(), "record": self._recording.as_json()})
            allowed = await self._watch.look(cell, now_s=self._clock(), busy=busy)
            if allowed is not None:
                self._start_alone(cell, allowed)
            gone_since_s = self._gone(glance, gone_since_s, busy=busy)
            if gone_since_s is not None and self._clock() - gone_since_s > _RETRY_S:
                raise DeskError(glance.robot.error or "the robot does not answer.", remedy="Check its cable.")
            await asyncio.sleep(max(PERIOD_S - (self._clock() - began_s), 0.01))

    def _gone(self, glance: Glance, since_s: float | None, *, busy: bool) -> float | None:
        condition = glance.robot.condition
        gone = condition is not None and condition.readiness is Readiness.UNREACHABLE
        if busy or not gone:
            return None
        return self._clock() if since_s is None else since_s

    # orders

    async def obey(self, command: Command) -> dict[str, Any]:
        """Do what a screen orders; the same command sent twice is obeyed once, also while it is being obeyed.

        A stop is obeyed each time: no id and no revision keeps it back.
        """
        if isinstance(command.order, HoldOrder | Stop):
            return await self._obeyed(command)
        if command.id in self._replies and self._orders.get(command.id) != (command.who, command.order):
            used = {"ok": False, "code": "desk.id_used", "message": "This press was used for another order."}
            return {**used, "remedy": "Press again."}
        if command.id not in self._replies:
            if command.rev != self.rev and not isinstance(command.order, UNGUARDED):
                stale = {"ok": False, "code": "desk.stale", "message": "The page was out of date."}
                return {**stale, "remedy": "Look at the present step.", "session": self.session()}
            self._orders[command.id] = (command.who, command.order)
            self._replies[command.id] = asyncio.create_task(self._obeyed(command))
            while len(self._replies) > _REPLIES_KEPT:
                self._orders.pop(self._replies.popitem(last=False)[0])
        return await asyncio.shield(self._replies[command.id])

    async def _obeyed(self, command: Command) -> dict[str, Any]:
        try:
            await self._answering.note("" if self._run is None else self._run.run_id, command)
            await self._do(command)
        except CellError as error:
            return {"ok": False, "code": error.code, "message": error.message, "remedy": error.remedy}
        except Exception as error:  # noqa: BLE001  whatever it was, the page is told and the desk goes on
            _log.exception("an order (%s) broke", command.order.op)
            message = f"The program failed at this order: {type(error).__name__}: {error}"
            return {"ok": False, "code": "desk.broken", "message": message, "remedy": "Look into its log."}
        return {"ok": True, "rev": self.rev}

    async def _do(self, command: Command) -> None:
        order = command.order
        if isinstance(order, AnswerIt):
            await self._answer(order, command.who)
        elif isinstance(order, Decline):
            self._operator.decline(order.prompt_id)
        elif isinstance(order, HoldOrder):
            self._hear_hold(order)
        elif isinstance(order, Start | Resume):
            self._begin(order, command.who)
        elif isinstance(order, SelectRobot):
            self._select(order.robot)
        elif isinstance(order, Dismiss):
            self._dismiss()
        elif isinstance(order, SignOff):
            await self._sign(order, command.who)
        else:
            await self._steer(order)

    def _hear_hold(self, order: HoldOrder) -> None:
        """Take note of the button; "held" counts for what is left of its time, and not from the future."""
        if not order.held or order.at_s is None:
            self._hold.heard(held=False)
            return
        age_s = self._clock() - order.at_s
        if age_s < 0.0:
            raise DeskError(
                "the moment at which the button was held is still to come.", remedy="Load the page again."
            )
        self._hold.heard(held=True, age_s=age_s)

    async def _answer(self, order: AnswerIt, who: str) -> None:
        """Take an answer; one that records is looked at first: a press may be older than what it was made for."""
        cell, glance = self._cell, self._glance
        if cell is not None and glance is not None:
            await self._recording.look(cell, self._operator.prompt, glance.standing(), self._clock())
        self._recording.refuse_early(order.prompt_id)
        self._operator.answer(order.prompt_id, who, order.value)

    async def _steer(self, order: Stop | Pause | GoOn) -> None:
        if isinstance(order, Pause):
            self._gate.pause()
        elif isinstance(order, GoOn):
            self._gate.resume()
        else:
            await self._stop()

    async def _stop(self) -> None:
        """Stop first: a disk that refuses to forget the run must not keep the robot moving."""
        task = self._task
        if task is not None and not task.done():
            task.cancel()
        try:
            self._under_way.forget()  # a person has ended it
        except OSError as error:
            raise DeskError(
                f"the run was ended, but the disk refuses to note it: {error.strerror}.",
                remedy="Free or repair the disk; the run goes on by itself at the next start until then.",
            ) from error
        finally:
            if task is not None:
                await asyncio.wait({task})

    def _dismiss(self) -> None:
        self._refuse_while_busy()
        self._run = None
        self._decided()

    async def _sign(self, order: SignOff, who: str) -> None:
        """Journal who did what the run left to a person; every line that it named has to be there."""
        run = self._run
        if run is None or not run.ended or run.run_id != order.run_id or run.outcome is None:
            raise DeskError("this run cannot be signed just now.", remedy="Sign on the page where it ended.")
        wanted = (run.outcome.get("judgement") or {}).get("to_sign", [])
        if not wanted or set(wanted) != set(order.lines):
            raise DeskError("not every line is signed.", remedy="Do what each line says, and tick it.")
        with open_journal(self._config) as journal:
            body = {"who": who, "lines": list(order.lines)}
            journal.append(run.run_id, Kind.SIGNED, body, key="signed", actor=who)
        run.outcome |= await self._certified(run.run_id)
        run.outcome["signed"] = {"who": who, "at_s": time.time()}
        self._decided()

    def _select(self, robot: str) -> None:
        self._refuse_while_busy()
        self._robot = self._config.robot(robot).name
        self._cell = None  # that of the robot before: nothing is begun on it any more
        self._run = None
        self._trouble = "connecting"
        self._leave.set()
        self._decided()

    # runs

    @property
    def _busy(self) -> bool:
        return self._task is not None and not self._task.done()

    def _refuse_while_busy(self) -> None:
        if self._busy:
            raise DeskError(
                "a run is under way.", remedy="Wait until it has ended, or ask the robot to stop."
            )

    def _begin(self, order: Start | Resume, who: str) -> None:
        self._refuse_while_busy()
        if self._cell is None:
            raise DeskError(f"the cell cannot be used: {self._trouble}", remedy=self._remedy)
        self._set_going(self._cell, order, who)

    def _start_alone(self, cell: Cell, answer: PreparedAnswer) -> None:
        """Start what the cell file allows; it answers what it can, and a person at any screen the rest."""
        if answer.procedure is None or self._busy:
            return
        order = Start(op="start", procedure=answer.procedure, settings=answer.settings, hold_to_move=False)
        operator = StandingAnswers(self._config.watch, cell.operator)
        with guarded("recovery without a person"):  # the loss stays on the screen: a person decides
            self._set_going(replace(cell, operator=operator), order, WATCH)

    def _occupied(self, robot: str) -> str:
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

    def _set_going(self, cell: Cell, order: Start | Resume, who: str) -> None:
        with open_journal(self._config) as journal:
            refuse_missing_end(self._config, journal, accepted=order.accept_missing_end)
        self._hold.wanted = order.hold_to_move
        self._gate.resume()
        if isinstance(order, Start):
            entry = entry_named(order.procedure)
            refuse_paths(entry.spec_type, order.settings)
        else:
            with open_journal(self._config) as journal:
                view = Store(journal).run(order.run_id)
            entry = entry_named(view.procedure)
        self._run = Running(entry.name, entry.title, who, hold_to_move=order.hold_to_move)
        if isinstance(order, Resume) and order.redo_from is None:
            self._run.found = [finding.step for finding in view.past.findings]
        self._task = asyncio.create_task(self._conduct(cell, order, who, self._run), name="run")
        self._decided()

    async def _conduct(self, cell: Cell, order: Start | Resume, who: str, run: Running) -> None:
        def began(run_id: str, phases: tuple[Phase, ...]) -> None:
            run.run_id, run.phases = run_id, phases
            self._operator.run_id = run_id
            self._answering.began(run_id, who)
            self._under_way.keep(run_id, self._robot, hold_to_move=order.hold_to_move)

        how = Conditions(
            lambda progress: self._on_event(run, progress), began, self._gate, who,
            accept_missing_end=order.accept_missing_end,
        )  # fmt: skip
        try:
            run.outcome = await self._told(await self._outcome(cell, order, how))
        except CellError as error:
            run.outcome = _outcome("refused", error.message, error.remedy)
        except asyncio.CancelledError:
            run.outcome = _outcome("cancelled", "The run was ended; it can be resumed.")
            raise
        except Exception:  # noqa: BLE001  whatever it was, the screen says so and the desk goes on
            _log.exception("run %s broke", run.run_id)
            run.outcome = _outcome("broken", "The program failed; its log has the cause.", "Resume the run.")
        finally:
            run.state = "ended"
            self._hold.wanted = False
            self._decided()

    async def _outcome(self, cell: Cell, order: Start | Resume, how: Conditions) -> Outcome:
        if isinstance(order, Start):
            spec = build_spec(self._config, cell.robot.name, order.procedure, order.settings)
            outcome = await start_on(self._config, cell, order.procedure, spec, how)
        else:
            outcome = await go_on_with(self._config, cell, order.run_id, how, redo_from=order.redo_from)
        self._under_way.forget()
        return outcome

    async def _told(self, outcome: Outcome) -> dict[str, Any]:
        told: dict[str, Any] = to_jsonable_python(
            {
                "verdict": outcome.verdict,
                "reason": outcome.reason,
                "remedy": outcome.remedy,
                "code": outcome.code,
                "judgement": outcome.judgement,
                "result": outcome.result,
            }
        )
        return told | await self._certified(outcome.run_id)

    async def _certified(self, run_id: str) -> dict[str, Any]:
        """Write the certificate of a run as its journal now stands; say where, or why there is none."""
        try:
            issued = await asyncio.to_thread(issue, self._config, run_id)
            await asyncio.to_thread(print_beside, issued.json_path)
        except CellError as error:
            return {"certificate": None, "no_certificate": error.message}
        return {"certificate": issued.json_path.name}

    def _on_event(self, run: Running, progress: Progress) -> None:
        run.take(progress)
        self._operator.step = progress.step
        self._show()

    def _go_on_where_it_broke_off(self) -> None:
        left = self._under_way.left()
        if left is not None and left.robot == self._robot and not self._busy:
            order = Resume(op="resume", run_id=left.run_id, hold_to_move=left.hold_to_move)
            with guarded("going on with the run that was under way"):  # a person decides instead
                self._begin(order, "service")

    async def _end_run(self) -> None:
        task = self._task
        if task is None or task.done():
            return
        task.cancel()
        await asyncio.wait({task})


def _outcome(verdict: str, reason: str, remedy: str = "") -> dict[str, Any]:
    return {"verdict": verdict, "reason": reason, "remedy": remedy}
