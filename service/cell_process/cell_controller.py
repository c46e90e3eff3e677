"""One cell and its devices, for any number of screens: the connection, the session document, the orders of screens.

The run is in `run_control`; screens own no state. The session document is complete each time, so that a screen that
was away needs one message to be right again. ``rev`` grows with every change that a decision depends on: an order
made for an older one is refused.
"""

import asyncio
import logging
import time
from collections.abc import Callable
from dataclasses import replace
from typing import Any, cast

from cellcal.calibration.errors import CellError
from cellcal.calibration.message import make_message
from cellcal.drivers.interfaces import JogsAxes, Readiness, Robot
from cellcal.drivers.supervision import (
    SUPERVISOR,
    message_and_remedy_of,
    raise_lost_cancellation,
    start_task,
    supervise,
)
from cellcal.drivers.wire.cancellation import cancel_until_done
from cellcal.procedures.cell import Cell
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
    PauseRun,
    ResumeRun,
    SelectRobot,
    SessionCommand,
    SignOff,
    StartRun,
    StopRun,
)
from cellcal.service.cell_process.order_replies import OrderRefusedError, OrderReplies
from cellcal.service.cell_process.recording_check import RecordingCheck
from cellcal.service.cell_process.run_control import RunControl
from cellcal.service.cell_process.screen_operator import ScreenOperator
from cellcal.service.cell_process.unselected_robots import UnselectedRobots
from cellcal.service.configuration.cell_file import CellConfig
from cellcal.service.runs.open_cell import open_cell
from cellcal.service.session_documents import (
    LiveValues,
    OnCellEvent,
    OrderReply,
    SessionDocument,
)

_log = logging.getLogger(__name__)
PERIOD_S = 0.1
REST_PERIOD_S = 0.25  # while no run is under way and the arm stands: looks cost the controller and us time
_RETRY_S = 2.0
_CANCEL_AGAIN_S = 1.0
TASK = "devices of the cell"


class CellController:
    """One cell at work. `stay_connected` connects and polls the devices; `execute_command` obeys a screen."""

    def __init__(
        self, config: CellConfig, on_event: OnCellEvent, *, clock: Callable[[], float] = time.monotonic
    ) -> None:
        self._config, self._on_event, self._clock = config, on_event, clock
        self._operator = ScreenOperator(self._advance_revision)
        self._hold = HoldButton(self._advance_revision)
        self._recording = RecordingCheck()
        self._poller: LivePoller | None = None
        self._runs = RunControl(
            config, self._operator, self._hold, self._advance_revision, self._publish_session
        )
        self._watch = LossWatch(config, self._show_loss, self._describe_obstacle)
        self._others = UnselectedRobots(config, self._watch, clock=clock)
        names = [robot.name for robot in config.robots]
        unfinished_robot = self._runs.unfinished_robot
        self._robot = unfinished_robot if unfinished_robot in names else names[0]
        self._cell: Cell | None = None
        self._trouble = "connecting"
        self._remedy = ""
        self._replies = OrderReplies()
        self._leave = asyncio.Event()
        self.rev = int(time.time() * 1000)  # a restart never repeats one

    # what screens see

    def describe_session(self) -> SessionDocument:
        """Return everything that is not a live value."""
        run, prompt = self._runs.status, self._operator.prompt
        return {
            "rev": self.rev,
            "cell": self._config.cell.name,
            "robots": [
                {
                    "name": robot.name,
                    "model": robot.model,
                    "serial": robot.serial,
                    "axis_names": list(robot.capabilities.all_axis_names()),
                }
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
            "journal_end": self._runs.journal_end,
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
        self._on_event("session", self.describe_session())

    # devices

    async def stay_connected(self) -> None:
        """Keep the devices connected and show them, until cancelled. What was under way goes on by itself."""
        unlisten = SUPERVISOR.add_listener(self._publish_session)
        telling = start_task("news of other robots", self._publish_other_robots)
        try:
            await supervise(TASK, self._reconnect_forever)
        finally:
            unlisten()
            await cancel_until_done(telling, every_s=_CANCEL_AGAIN_S)
            await self._others.stop_following()
            await self._runs.cancel_run()

    async def _reconnect_forever(self) -> None:
        while True:
            self._leave.clear()
            await self._runs.check_journal_end()
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
            self._on_event("live", {"rev": self.rev, "at_s": time.time(), **live_values, "devices": devices})

    async def _connect_once(self) -> None:
        try:
            async with open_cell(self._config, self._operator, self._robot) as cell:
                poller = self._poller = LivePoller(
                    self._require_hold(cell), reads=self._note_instrument, clock=self._clock
                )
                resumes = self._runs.unfinished_robot == self._robot
                if resumes:
                    await self._watch.look_before_resuming(poller.cell, now_s=self._clock())
                if self._leave.is_set():
                    return  # another robot was selected meanwhile
                # Not before the look: what a screen started meanwhile would take the place of the unfinished run
                self._cell, self._trouble, self._remedy = poller.cell, "", ""
                if resumes:
                    self._runs.resume_unfinished(poller.cell)
                self._advance_revision()
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
            await self._runs.cancel_run()
            self._advance_revision()

    def _require_hold(self, cell: Cell) -> Cell:
        robot: Any = HoldToMoveRobot(cell.robot, self._hold)
        jogs = None if cell.jogs is None else cast(JogsAxes, robot)
        return replace(cell, robot=cast(Robot, robot), jogs=jogs)

    def _note_instrument(self, role: str) -> None:
        """Note for the screens which instrument the run asks."""
        run = self._runs.status
        if run is not None and run.instrument != role:
            run.instrument = role
            self._publish_session()

    async def _poll_devices(self, poller: LivePoller) -> None:
        cell, gone_since_s = poller.cell, None
        while not self._leave.is_set():
            raise_lost_cancellation()
            began_s = self._clock()
            busy = self._runs.is_busy
            await poller.poll_once()
            await self._recording.check_prompt(
                cell, self._operator.prompt, poller.observe_motion(), self._clock()
            )
            live, guidance = poller.as_json(), self._operator.guidance
            self._publish_live({**live, "record": self._recording.as_json(), "guidance": guidance})
            allowed = await self._watch.check_robot(cell, now_s=self._clock(), busy=busy)
            if allowed is not None:
                self._runs.start_unattended(cell, allowed)
            gone_since_s = self._unreachable_since(poller, gone_since_s, busy=busy)
            if gone_since_s is not None and self._clock() - gone_since_s > _RETRY_S:
                raise OrderRefusedError(
                    poller.robot.error or "the robot does not answer.", remedy="Check its cable."
                )
            period_s = REST_PERIOD_S if poller.is_at_rest and not (busy or self._runs.is_busy) else PERIOD_S
            await asyncio.sleep(max(period_s - (self._clock() - began_s), 0.01))

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
        is_new = command.id not in self._replies
        if is_new and command.rev != self.rev and not isinstance(command.order, REVISION_FREE):
            return {
                "ok": False,
                "code": "desk.stale",
                "message": "The page was out of date.",
                "remedy": "Look at the present step.",
                "session": self.describe_session(),
            }
        return await self._replies.reply_once(command, self._execute_order)

    async def _execute_order(self, command: SessionCommand) -> OrderReply:
        try:
            await self._runs.note_signers(command)
            await self._dispatch_order(command)
        except CellError as error:
            return {"ok": False, "code": error.code, "message": error.message, "remedy": error.remedy}
        except Exception as error:  # noqa: BLE001  the page shows any error, and the process goes on
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
            self._runs.begin_run(self._usable_cell(), order, command.who)
        elif isinstance(order, SelectRobot):
            self._select_robot(order.robot)
        elif isinstance(order, DismissRun):
            self._runs.dismiss_run()
        elif isinstance(order, SignOff):
            await self._runs.sign_run(order, command.who)
        else:
            await self._control_run(order)

    async def _control_run(self, order: StopRun | PauseRun | ContinueRun) -> None:
        if isinstance(order, PauseRun):
            self._runs.pause_run()
        elif isinstance(order, ContinueRun):
            self._runs.continue_run()
        else:
            await self._runs.stop_run()

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

    def _select_robot(self, robot: str) -> None:
        self._runs.refuse_while_busy()
        self._robot = self._config.robot_named(robot).name
        self._cell = None  # that of the robot before: nothing is begun on it any more
        self._runs.status = None
        self._trouble = "connecting"
        self._leave.set()
        self._advance_revision()

    def _usable_cell(self) -> Cell:
        self._runs.refuse_while_busy()
        if self._cell is None:
            raise OrderRefusedError(
                make_message("the cell cannot be used: {trouble}", trouble=self._trouble), remedy=self._remedy
            )
        return self._cell

    def _describe_obstacle(self, robot: str) -> str:
        """Return what keeps the watch from starting anything on a robot; a run in progress is known to the watch."""
        if robot != self._robot:
            return "another robot was selected at the desk"
        if self._runs.waits_for_signatures:
            return "the run before it waited for its signatures"
        return ""
