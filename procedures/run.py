"""The engine of journalled steps: a finding is stored before the next step starts, and a resumed run replays.

::

    CellError                      calibration/errors.py
    └─ ProcedureError
        ├─ OutOfToleranceError     .found, .limit, .unit: a result, not a malfunction
        ├─ RefusalError            it looked and will not go on; .evidence is what it found
        ├─ DeclinedError           the technician said no
        ├─ NeedsUnmetError         this cell cannot do this procedure; .missing
        └─ ReplayMismatchError     journal and procedure disagree
"""

import asyncio
from collections.abc import Awaitable, Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any, Concatenate, ParamSpec, Protocol, TypeVar

from pydantic_core import to_jsonable_python

from cellcal.calibration.errors import CellError
from cellcal.calibration.message import make_message
from cellcal.drivers.errors import DeviceError, DeviceTimeoutError, RefusedError, UnreachableError
from cellcal.drivers.interfaces import Instruction
from cellcal.procedures.canonical_json import is_alike, sha256_of
from cellcal.procedures.cell import Cell
from cellcal.procedures.instruction_page import page_of
from cellcal.procedures.progress import PauseGate, StepProgress, ignore_progress
from cellcal.procedures.robot_stop import finish_cleanup, raise_if_cancelled, stop_and_wait
from cellcal.procedures.run_history import EventKind, Finding, RunHistory, StepEffect
from cellcal.procedures.step_record import StepTask, goal_of, journalled_inputs, result_codec

P = ParamSpec("P")
R = TypeVar("R")
ATTEMPTS = 3
RETRYABLE = (UnreachableError, DeviceTimeoutError)


class ProcedureError(CellError):
    """A procedure ended without its result, for a reason a technician can read."""

    code = "procedure"


class OutOfToleranceError(ProcedureError):
    """The measurement is good and the result is not."""

    code = "procedure.out_of_tolerance"

    def __init__(self, message: str, *, found: float, limit: float, unit: str, remedy: str = "") -> None:
        super().__init__(message, remedy=remedy)
        self.found, self.limit, self.unit = found, limit, unit


class RefusalError(ProcedureError):
    """The procedure looked and will not go on: a wrong answer would be worse than none."""

    code = "procedure.refused"

    def __init__(
        self, message: str, *, remedy: str = "", code: str | None = None, evidence: object = None
    ) -> None:
        super().__init__(message, remedy=remedy, code=code)
        self.evidence = evidence


class DeclinedError(ProcedureError):
    """The technician said no."""

    code = "procedure.declined"


class NeedsUnmetError(ProcedureError):
    """The cell lacks something the procedure needs."""

    code = "procedure.needs_unmet"

    def __init__(self, message: str, *, missing: tuple[str, ...], remedy: str = "") -> None:
        super().__init__(message, remedy=remedy)
        self.missing = missing


class ReplayMismatchError(ProcedureError):
    """The journal and the procedure disagree: findings of one cannot be used by the other."""

    code = "procedure.replay_mismatch"


class Ledger(Protocol):
    """The store of facts. A fact is durable when ``record`` returns; the same key is stored once."""

    def record(self, kind: EventKind, body: Mapping[str, Any], *, key: str = "") -> None: ...


@dataclass(slots=True)
class _RunState:
    """The state that a run and its sub-procedures share."""

    cell: Cell
    ledger: Ledger
    past: RunHistory
    expected: int
    announce: Callable[[StepProgress], None]
    gate: PauseGate
    named: set[str] = field(default_factory=set)
    done: int = 0
    attempts: dict[str, int] = field(default_factory=dict)
    cleared: bool = False
    stop_unconfirmed: bool = False  # the last step failed, and the robot has not said that it stands


class Run:
    """Gives the cell to steps, and their findings to the procedure.

    ``step`` asks or reads; ``move`` moves the robot; ``write`` changes a controller. A crash inside the last
    two leaves the step in doubt: a resumed run asks a person to look before anything moves, then does the
    step again, which is why every step is written so that it can be done twice.
    """

    def __init__(
        self,
        cell: Cell,
        ledger: Ledger,
        past: RunHistory | None = None,
        *,
        expected: int = 0,
        announce: Callable[[StepProgress], None] = ignore_progress,
        gate: PauseGate | None = None,
    ) -> None:
        self._state = _RunState(cell, ledger, past or RunHistory(), expected, announce, gate or PauseGate())
        self._state.attempts.update(self._state.past.attempts)
        self._adapt_cell: Callable[[Cell], Cell] = lambda cell: cell

    @property
    def is_jogged_by_hand(self) -> bool:
        """Whether a person turns the axes of a robot that does not know where it is; the cell file says so."""
        return self._adapt_cell(self._state.cell).is_jogged_by_hand

    @property
    def is_replaying(self) -> bool:
        """Whether the next step was done in an entry before this one."""
        return self._state.done < len(self._state.past.findings)

    @property
    def is_stop_unconfirmed(self) -> bool:
        """Whether the last step failed and the robot has not confirmed that it stands."""
        return self._state.stop_unconfirmed

    def with_devices(self, change: Callable[[Cell], Cell]) -> "Run":
        """Return the same run whose steps get another view of the cell, such as other motors of the robot."""
        inner = Run(self._state.cell, self._state.ledger)
        inner._state, inner._adapt_cell = self._state, change
        return inner

    async def step(
        self, name: str, work: Callable[Concatenate[Cell, P], Awaitable[R]], *args: P.args, **kwargs: P.kwargs
    ) -> R:
        """Do ``work`` once per run; afterwards answer from the journal."""
        return await self._run_once(name, StepEffect.NONE, work, *args, **kwargs)

    async def move(
        self, name: str, work: Callable[Concatenate[Cell, P], Awaitable[R]], *args: P.args, **kwargs: P.kwargs
    ) -> R:
        """Do ``work`` that moves the robot once per run."""
        return await self._run_once(name, StepEffect.MOVE, work, *args, **kwargs)

    async def write(
        self, name: str, work: Callable[Concatenate[Cell, P], Awaitable[R]], *args: P.args, **kwargs: P.kwargs
    ) -> R:
        """Do ``work`` that changes a controller once per run; it decides by reading back whether to write."""
        return await self._run_once(name, StepEffect.WRITE, work, *args, **kwargs)

    async def solve(self, name: str, calculation: Callable[P, R], *args: P.args, **kwargs: P.kwargs) -> R:
        """Calculate once per run, beside the event loop; the journal keeps the result and an input hash.

        The inputs must be findings: those come back exactly, so that the hash does.
        """
        inputs = {"sha256": sha256_of(to_jsonable_python([args, kwargs]))}

        async def run_calculation(_: Cell) -> R:
            return await asyncio.to_thread(calculation, *args, **kwargs)

        task = StepTask(
            self._claim_name(name),
            StepEffect.NONE,
            EventKind.FINDING,
            inputs,
            result_codec(calculation),
            run_calculation,
            solves=True,
        )
        result: R = await self._answer_step(task)
        return result

    async def ensure(
        self,
        name: str,
        work: Callable[Concatenate[Cell, P], Awaitable[Any]],
        *args: P.args,
        **kwargs: P.kwargs,
    ) -> None:
        """Check a standing condition on every entry, also when resuming."""
        inputs = journalled_inputs(args, kwargs)

        async def run_check(cell: Cell) -> Any:
            return await work(cell, *args, **kwargs)

        await self._perform_task(
            StepTask(
                self._claim_name(name),
                StepEffect.NONE,
                EventKind.CONDITION,
                inputs,
                result_codec(work),
                run_check,
            )
        )

    async def _run_once(
        self,
        name: str,
        effect: StepEffect,
        work: Callable[Concatenate[Cell, P], Awaitable[R]],
        *args: P.args,
        **kwargs: P.kwargs,
    ) -> R:
        inputs = journalled_inputs(args, kwargs)

        async def run_work(cell: Cell) -> R:
            return await work(cell, *args, **kwargs)

        page = next(
            (page_of(each) for each in (*args, *kwargs.values()) if isinstance(each, Instruction)), None
        )
        goal_rad = goal_of(*args) if effect is StepEffect.MOVE else None
        result: R = await self._answer_step(
            StepTask(
                self._claim_name(name),
                effect,
                EventKind.FINDING,
                inputs,
                result_codec(work),
                run_work,
                page=page,
                goal_rad=goal_rad,
            )
        )
        return result

    async def _answer_step(self, task: StepTask) -> Any:
        state = self._state
        replayed = self.is_replaying
        if replayed:
            finding = state.past.findings[state.done]
            _refuse_mismatch(finding, task)
            stored = finding.value
        else:
            stored = await self._perform_task(task)
        state.done += 1
        self._announce_progress("replayed" if replayed else "finding", task.name, value=stored, task=task)
        return task.codec.validate_python(stored)  # a live step and a replayed one answer alike

    def _claim_name(self, name: str) -> str:
        if name in self._state.named:
            raise ReplayMismatchError(make_message("two steps are called {full!r}", full=name))
        self._state.named.add(name)
        return name

    async def _perform_task(self, task: StepTask) -> Any:
        await self._wait_at_gate(task.name)
        await self._confirm_after_resume(task.name, task.effect)
        tries = 0
        while True:
            tries += 1
            try:
                return await self._run_live(task)
            except RETRYABLE as error:
                if tries == ATTEMPTS or not await self._may_retry(task.name, error):
                    raise

    async def _run_live(self, task: StepTask) -> Any:
        state, name = self._state, task.name
        attempt = state.attempts[name] = state.attempts.get(name, 0) + 1
        body = {"step": name, "attempt": attempt, "effect": task.effect.value, "inputs": task.inputs}
        opening = EventKind.ENTERED if task.effect is StepEffect.NONE else EventKind.INTENT
        state.ledger.record(opening, body, key=f"{name}/{attempt}/{opening}")
        self._announce_progress("started", name, task=task)
        try:
            stored = task.codec.dump_python(await task.act(self._adapt_cell(state.cell)), mode="json")
            state.ledger.record(task.kind, body | {"value": stored}, key=f"{name}/{attempt}/{task.kind}")
        except BaseException as error:
            state.cell.motion.approved = False
            state.stop_unconfirmed = not await self._stop_robot()
            self._record_failure(body, error)
            raise_if_cancelled()  # it came while the robot was being stopped: nothing is tried again
            raise
        state.stop_unconfirmed = False
        return stored

    def _record_failure(self, body: Mapping[str, Any], error: BaseException) -> None:
        error_body = {
            "error": type(error).__name__,
            "code": error.code if isinstance(error, CellError) else "",
            "message": str(error),
        }
        what = {key: body[key] for key in ("step", "attempt", "effect")}
        fact = what | {"stopped": not self._state.stop_unconfirmed}
        self._announce_progress("failed", str(body["step"]), message=str(error) or type(error).__name__)
        try:
            key = f"{body['step']}/{body['attempt']}/{EventKind.FAILED}"
            self._state.ledger.record(EventKind.FAILED, fact | error_body, key=key)
        except CellError as second:  # the first error is the one to act on
            error.add_note(f"and the failure could not be journalled: {second}")

    async def _stop_robot(self) -> bool:
        """Ask the robot to stop and wait; True once it stands still."""
        return await finish_cleanup(stop_and_wait(self._state.cell))

    async def _wait_at_gate(self, name: str) -> None:
        gate = self._state.gate
        if not gate.is_closed:
            return
        self._state.ledger.record(EventKind.PAUSED, {"before": name})
        self._announce_progress("paused", name)
        await gate.wait_until_open()
        self._state.ledger.record(EventKind.CONTINUED, {"before": name})
        self._announce_progress("resumed", name)

    async def _confirm_after_resume(self, name: str, effect: StepEffect) -> None:
        """Before a resumed run acts for the first time, a person has looked."""
        state = self._state
        if (
            state.cleared
            or not state.past.resumed
            or (effect is StepEffect.NONE and state.past.in_doubt is None)
        ):
            return
        doubt = (
            make_message("Step '{step}' was interrupted and may have acted. ", step=state.past.in_doubt)
            if state.past.in_doubt
            else ""
        )
        text = make_message(
            "{doubt}Look at the robot. May it move from where it stands? Next: {recommended}.",
            doubt=doubt,
            recommended=name,
        )
        await self._confirm_go_on(Instruction("may_move", text), name)
        state.cleared = True
        state.cell.motion.note_approval(asyncio.get_running_loop().time())

    async def _may_retry(self, name: str, error: CellError) -> bool:
        text = make_message("{error} Look at the robot. Try '{name}' again?", error=error, name=name)
        try:
            await self._confirm_go_on(Instruction("retry", text), name)
        except (DeclinedError, DeviceError):
            return False
        return True

    async def _confirm_go_on(self, instruction: Instruction, name: str) -> None:
        try:
            answer = await self._state.cell.operator.confirm(instruction)
        except RefusedError as error:
            raise DeclinedError(
                make_message("declined: {instruction_text}", instruction_text=instruction.text),
                remedy="Resume when it is safe.",
            ) from error
        self._state.ledger.record(
            EventKind.APPROVAL,
            {"before": name, "key": instruction.key, "who": answer.who, "text": instruction.text},
        )

    def _announce_progress(
        self, kind: str, step: str, *, message: str = "", value: Any = None, task: StepTask | None = None
    ) -> None:
        state = self._state
        index = min(state.done + (kind not in ("finding", "replayed")), max(state.expected, state.done + 1))
        progress = StepProgress(kind, step, index, max(state.expected, index), message, value)
        if task is not None:
            progress = replace(progress, does=task.activity_name, page=task.page, goal_rad=task.goal_rad)
        state.announce(progress)


def _refuse_mismatch(finding: Finding, task: StepTask) -> None:
    if finding.step != task.name:
        raise ReplayMismatchError(
            make_message(
                "the journal has {step!r} where the procedure asks for {task_name!r}",
                step=finding.step,
                task_name=task.name,
            ),
            remedy="The run was made by another version: start it anew.",
        )
    if not is_alike(finding.inputs, task.inputs):
        raise ReplayMismatchError(
            make_message(
                "step {task_name!r} was done with other inputs than it is asked for", task_name=task.name
            ),
            remedy="Redo the run from the step before it.",
        )
