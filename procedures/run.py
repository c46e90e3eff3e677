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
from collections.abc import Awaitable, Callable, Coroutine, Mapping
from dataclasses import dataclass, field, replace
from functools import cache
from typing import Any, Concatenate, ParamSpec, Protocol, TypeVar, get_type_hints

from pydantic import TypeAdapter
from pydantic_core import to_jsonable_python

from cellcal.calibration.errors import CellError
from cellcal.drivers.errors import DeviceError, DeviceTimeoutError, RefusedError, UnreachableError
from cellcal.drivers.interfaces import Instruction, Joints
from cellcal.procedures.canonical import alike, sha256_of
from cellcal.procedures.cell import Cell
from cellcal.procedures.past import Effect, Finding, Kind, Past
from cellcal.procedures.progress import Gate, Progress, ignore
from cellcal.procedures.shown import Page, Shown, page_of

P = ParamSpec("P")
R = TypeVar("R")
ATTEMPTS = 3
STOP_DEADLINE_S = 5.0
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
    """Where facts go. A fact is durable when ``record`` returns; the same key is stored once."""

    def record(self, kind: Kind, body: Mapping[str, Any], *, key: str = "") -> None: ...


@dataclass(slots=True)
class _Book:
    """What a run and its sub-procedures share."""

    cell: Cell
    ledger: Ledger
    past: Past
    expected: int
    announce: Callable[[Progress], None]
    gate: Gate
    named: set[str] = field(default_factory=set)
    done: int = 0
    attempts: dict[str, int] = field(default_factory=dict)
    cleared: bool = False


@dataclass(frozen=True, slots=True)
class _Task:
    """One step as the journal sees it."""

    name: str
    effect: Effect
    kind: Kind
    inputs: Any
    codec: TypeAdapter[Any]
    act: Callable[[Cell], Awaitable[Any]]
    solves: bool = False
    page: Page | None = None
    goal_rad: Joints | None = None

    @property
    def does(self) -> str:
        """What a screen says of it while it goes on: read, move, write, solve."""
        return "solve" if self.solves else "read" if self.effect is Effect.NONE else self.effect.value


class Run:
    """Lends the cell to steps and hands their findings to the procedure.

    ``step`` asks or reads; ``move`` moves the robot; ``write`` changes a controller. A crash inside the last
    two leaves the step in doubt: a resumed run asks a person to look before anything moves, then does the
    step again, which is why every step is written so that it can be done twice.
    """

    def __init__(
        self,
        cell: Cell,
        ledger: Ledger,
        past: Past | None = None,
        *,
        expected: int = 0,
        announce: Callable[[Progress], None] = ignore,
        gate: Gate | None = None,
    ) -> None:
        past = past or Past()
        self._book = _Book(cell, ledger, past, expected, announce, gate or Gate())
        self._book.attempts.update(past.attempts)
        self._prefix = ""

    def under(self, prefix: str) -> "Run":
        """Return the same run for a sub-procedure: its steps are called ``prefix: name``."""
        inner = Run(self._book.cell, self._book.ledger)
        inner._book = self._book
        inner._prefix = f"{self._prefix}{prefix}: "
        return inner

    async def step(
        self, name: str, work: Callable[Concatenate[Cell, P], Awaitable[R]], *args: P.args, **kwargs: P.kwargs
    ) -> R:
        """Do ``work`` once per run; afterwards answer from the journal."""
        return await self._once(name, Effect.NONE, work, *args, **kwargs)

    async def move(
        self, name: str, work: Callable[Concatenate[Cell, P], Awaitable[R]], *args: P.args, **kwargs: P.kwargs
    ) -> R:
        """Do ``work`` that moves the robot once per run."""
        return await self._once(name, Effect.MOVE, work, *args, **kwargs)

    async def write(
        self, name: str, work: Callable[Concatenate[Cell, P], Awaitable[R]], *args: P.args, **kwargs: P.kwargs
    ) -> R:
        """Do ``work`` that changes a controller once per run; it decides by reading back whether to write."""
        return await self._once(name, Effect.WRITE, work, *args, **kwargs)

    async def solve(self, name: str, calculation: Callable[P, R], *args: P.args, **kwargs: P.kwargs) -> R:
        """Calculate once per run, beside the event loop; the journal keeps the result and an input hash.

        The inputs must be findings: those come back exactly, so that the hash does.
        """
        inputs = {"sha256": sha256_of(to_jsonable_python([args, kwargs]))}

        async def act(_: Cell) -> R:
            return await asyncio.to_thread(calculation, *args, **kwargs)

        task = _Task(
            self._claim(name), Effect.NONE, Kind.FINDING, inputs, _codec(calculation), act, solves=True
        )
        result: R = await self._answer(task)
        return result

    async def ensure(
        self,
        name: str,
        work: Callable[Concatenate[Cell, P], Awaitable[Any]],
        *args: P.args,
        **kwargs: P.kwargs,
    ) -> None:
        """Check a standing condition on every entry, also when resuming."""
        inputs = _asked_for(args, kwargs)

        async def act(cell: Cell) -> Any:
            return await work(cell, *args, **kwargs)

        await self._perform(_Task(self._claim(name), Effect.NONE, Kind.CONDITION, inputs, _codec(work), act))

    async def _once(
        self,
        name: str,
        effect: Effect,
        work: Callable[Concatenate[Cell, P], Awaitable[R]],
        *args: P.args,
        **kwargs: P.kwargs,
    ) -> R:
        inputs = _asked_for(args, kwargs)

        async def act(cell: Cell) -> R:
            return await work(cell, *args, **kwargs)

        page = next(
            (page_of(each) for each in (*args, *kwargs.values()) if isinstance(each, Instruction)), None
        )
        goal_rad = _goal_of(*args) if effect is Effect.MOVE else None
        result: R = await self._answer(
            _Task(
                self._claim(name),
                effect,
                Kind.FINDING,
                inputs,
                _codec(work),
                act,
                page=page,
                goal_rad=goal_rad,
            )
        )
        return result

    async def _answer(self, task: _Task) -> Any:
        book = self._book
        replayed = book.done < len(book.past.findings)
        if replayed:
            finding = book.past.findings[book.done]
            _refuse_mismatch(finding, task)
            stored = finding.value
        else:
            stored = await self._perform(task)
        book.done += 1
        self._announce("replayed" if replayed else "finding", task.name, value=stored, task=task)
        return task.codec.validate_python(stored)  # a live step and a replayed one answer alike

    def _claim(self, name: str) -> str:
        full = self._prefix + name
        if full in self._book.named:
            raise ReplayMismatchError(f"two steps are called {full!r}")
        self._book.named.add(full)
        return full

    async def _perform(self, task: _Task) -> Any:
        await self._wait_at_the_gate(task.name)
        await self._clear_doubt(task.name, task.effect)
        tries = 0
        while True:
            tries += 1
            try:
                return await self._live(task)
            except RETRYABLE as error:
                if tries == ATTEMPTS or not await self._may_retry(task.name, error):
                    raise

    async def _live(self, task: _Task) -> Any:
        book, name = self._book, task.name
        attempt = book.attempts[name] = book.attempts.get(name, 0) + 1
        body = {"step": name, "attempt": attempt, "effect": task.effect.value, "inputs": task.inputs}
        opening = Kind.ENTERED if task.effect is Effect.NONE else Kind.INTENT
        book.ledger.record(opening, body, key=f"{name}/{attempt}/{opening}")
        self._announce("started", name, task=task)
        try:
            stored = task.codec.dump_python(await task.act(book.cell), mode="json")
            book.ledger.record(task.kind, body | {"value": stored}, key=f"{name}/{attempt}/{task.kind}")
        except BaseException as error:
            book.cell.motion.approved = False
            stopped = await self._stop_robot()
            self._record_failure(body, error, stopped)
            raise
        return stored

    def _record_failure(self, body: Mapping[str, Any], error: BaseException, stopped: bool) -> None:
        told = {"error": type(error).__name__, "code": getattr(error, "code", ""), "message": str(error)}
        fact = {
            "step": body["step"],
            "attempt": body["attempt"],
            "effect": body["effect"],
            "stopped": stopped,
        }
        self._announce("failed", str(body["step"]), message=str(error) or type(error).__name__)
        try:
            key = f"{body['step']}/{body['attempt']}/{Kind.FAILED}"
            self._book.ledger.record(Kind.FAILED, fact | told, key=key)
        except CellError as second:  # the first error is the one to act on
            error.add_note(f"and the failure could not be journalled: {second}")

    async def _stop_robot(self) -> bool:
        """Ask the robot to stop and wait; True once it stands still."""
        return await to_the_end(_stopped(self._book.cell))

    async def _wait_at_the_gate(self, name: str) -> None:
        gate = self._book.gate
        if not gate.closed:
            return
        self._book.ledger.record(Kind.PAUSED, {"before": name})
        self._announce("paused", name)
        await gate.passed()
        self._book.ledger.record(Kind.CONTINUED, {"before": name})
        self._announce("resumed", name)

    async def _clear_doubt(self, name: str, effect: Effect) -> None:
        """Before a resumed run acts for the first time, a person has looked."""
        book = self._book
        if book.cleared or not book.past.resumed or (effect is Effect.NONE and book.past.in_doubt is None):
            return
        doubt = (
            f"Step '{book.past.in_doubt}' was interrupted and may have acted. " if book.past.in_doubt else ""
        )
        text = f"{doubt}Look at the robot. May it move from where it stands? Next: {name}."
        await self._confirm(Instruction("may_move", text), name)
        book.cleared = True
        book.cell.motion.agree(asyncio.get_running_loop().time())

    async def _may_retry(self, name: str, error: CellError) -> bool:
        text = f"{error} Look at the robot. Try '{name}' again?"
        try:
            await self._confirm(Instruction("retry", text), name)
        except (DeclinedError, DeviceError):
            return False
        return True

    async def _confirm(self, instruction: Instruction, name: str) -> None:
        try:
            answer = await self._book.cell.operator.confirm(instruction)
        except RefusedError as error:
            raise DeclinedError(f"declined: {instruction.text}", remedy="Resume when it is safe.") from error
        self._book.ledger.record(
            Kind.APPROVAL,
            {"before": name, "key": instruction.key, "who": answer.who, "text": instruction.text},
        )

    def _announce(
        self, kind: str, step: str, *, message: str = "", value: Any = None, task: _Task | None = None
    ) -> None:
        book = self._book
        index = min(book.done + (kind not in ("finding", "replayed")), max(book.expected, book.done + 1))
        told = Progress(kind, step, index, max(book.expected, index), message, value)
        if task is not None:
            told = replace(told, does=task.does, page=task.page, goal_rad=task.goal_rad)
        book.announce(told)


async def to_the_end(work: Coroutine[Any, Any, R]) -> R:
    """Wait for a clean-up, whatever else is cancelled meanwhile."""
    cleaning = asyncio.ensure_future(work)
    while not cleaning.done():
        try:
            await asyncio.wait({cleaning})
        except asyncio.CancelledError:
            continue  # the first one is re-raised by our caller, once all is settled
    return cleaning.result()


async def _stopped(cell: Cell) -> bool:
    try:
        async with asyncio.timeout(STOP_DEADLINE_S):
            await cell.robot.stop()
    except (CellError, TimeoutError):
        return False
    return True


def _asked_for(args: tuple[Any, ...], kwargs: Mapping[str, Any]) -> Any:
    """Return a step's inputs as the journal keeps them: how a screen shows an instruction is none of them."""

    def words(given: Any) -> Any:
        return given.words if isinstance(given, Shown) else given

    return to_jsonable_python([[*map(words, args)], {name: words(given) for name, given in kwargs.items()}])


def _goal_of(way: Any = None, *_: Any) -> Joints | None:
    """Return where a move ends by its first input: a pose, or a way whose last corner is one; None: not told."""
    end = way[-1] if isinstance(way, tuple) and way and isinstance(way[-1], tuple) else way
    return end if isinstance(end, tuple) and all(isinstance(angle, float) for angle in end) else None


def _refuse_mismatch(finding: Finding, task: _Task) -> None:
    if finding.step != task.name:
        raise ReplayMismatchError(
            f"the journal has {finding.step!r} where the procedure asks for {task.name!r}",
            remedy="The run was made by another version: start it anew.",
        )
    if not alike(finding.inputs, task.inputs):
        raise ReplayMismatchError(
            f"step {task.name!r} was done with other inputs than it is asked for",
            remedy="Redo the run from the step before it.",
        )


@cache
def _codec(work: Callable[..., Any]) -> TypeAdapter[Any]:
    hints = get_type_hints(work)
    if "return" not in hints:
        raise TypeError(f"{work} needs a return annotation: its result is journalled")
    return TypeAdapter(hints["return"])
