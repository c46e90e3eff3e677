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
from dataclasses import dataclass, field
from functools import cache
from typing import Any, Concatenate, ParamSpec, Protocol, TypeVar, get_type_hints

from pydantic import TypeAdapter
from pydantic_core import to_jsonable_python

from calibration.errors import CellError
from drivers.errors import DeviceError, DeviceTimeoutError, RefusedError, UnreachableError
from drivers.interfaces import Instruction
from procedures.canonical import alike
from procedures.cell import Cell
from procedures.past import Effect, Finding, Kind, Past
from procedures.progress import Gate, Progress, ignore

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

    async def ensure(
        self,
        name: str,
        work: Callable[Concatenate[Cell, P], Awaitable[Any]],
        *args: P.args,
        **kwargs: P.kwargs,
    ) -> None:
        """Check a standing condition on every entry, also when resuming."""
        full = self._claim(name)
        await self._perform(full, Effect.NONE, work, Kind.CONDITION, *args, **kwargs)

    async def _once(
        self,
        name: str,
        effect: Effect,
        work: Callable[Concatenate[Cell, P], Awaitable[R]],
        *args: P.args,
        **kwargs: P.kwargs,
    ) -> R:
        full, book = self._claim(name), self._book
        inputs = to_jsonable_python([args, kwargs])
        codec = _codec(work)
        if book.done < len(book.past.findings):
            finding = book.past.findings[book.done]
            _refuse_mismatch(finding, full, inputs)
            book.done += 1
            self._announce("replayed", full, value=finding.value)
        else:
            stored = await self._perform(full, effect, work, Kind.FINDING, *args, **kwargs)
            finding = Finding(full, inputs, stored)
            book.done += 1
            self._announce("finding", full, value=stored)
        result: R = codec.validate_python(finding.value)  # a live step and a replayed one answer alike
        return result

    def _claim(self, name: str) -> str:
        full = self._prefix + name
        if full in self._book.named:
            raise ReplayMismatchError(f"two steps are called {full!r}")
        self._book.named.add(full)
        return full

    async def _perform(
        self,
        name: str,
        effect: Effect,
        work: Callable[Concatenate[Cell, P], Awaitable[Any]],
        kind: Kind,
        *args: P.args,
        **kwargs: P.kwargs,
    ) -> Any:
        await self._wait_at_the_gate(name)
        await self._clear_doubt(name, effect)
        tries = 0
        while True:
            tries += 1
            try:
                return await self._live(name, effect, work, kind, *args, **kwargs)
            except RETRYABLE as error:
                if tries == ATTEMPTS or not await self._may_retry(name, error):
                    raise

    async def _live(
        self,
        name: str,
        effect: Effect,
        work: Callable[Concatenate[Cell, P], Awaitable[Any]],
        kind: Kind,
        *args: P.args,
        **kwargs: P.kwargs,
    ) -> Any:
        book = self._book
        attempt = book.attempts[name] = book.attempts.get(name, 0) + 1
        inputs = to_jsonable_python([args, kwargs])
        body = {"step": name, "attempt": attempt, "effect": effect.value, "inputs": inputs}
        opening = Kind.ENTERED if effect is Effect.NONE else Kind.INTENT
        book.ledger.record(opening, body, key=f"{name}/{attempt}/{opening}")
        self._announce("started", name)
        try:
            value = await work(book.cell, *args, **kwargs)
            stored = _codec(work).dump_python(value, mode="json")
            book.ledger.record(kind, body | {"value": stored}, key=f"{name}/{attempt}/{kind}")
        except BaseException as error:
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
        """Ask the robot to stop and wait, whatever else is cancelled meanwhile; True once it stands still."""
        stop = asyncio.ensure_future(_stopped(self._book.cell))
        while not stop.done():
            try:
                await asyncio.wait({stop})
            except asyncio.CancelledError:
                continue  # the first one is re-raised by our caller, after the robot stands still
        return stop.result()

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

    def _announce(self, kind: str, step: str, *, message: str = "", value: Any = None) -> None:
        book = self._book
        index = min(book.done + (kind not in ("finding", "replayed")), max(book.expected, book.done + 1))
        book.announce(Progress(kind, step, index, max(book.expected, index), message, value))


async def _stopped(cell: Cell) -> bool:
    try:
        async with asyncio.timeout(STOP_DEADLINE_S):
            await cell.robot.stop()
    except (CellError, TimeoutError):
        return False
    return True


def _refuse_mismatch(finding: Finding, name: str, inputs: Any) -> None:
    if finding.step != name:
        raise ReplayMismatchError(
            f"the journal has {finding.step!r} where the procedure asks for {name!r}",
            remedy="The run was made by another version: start it anew.",
        )
    if not alike(finding.inputs, inputs):
        raise ReplayMismatchError(
            f"step {name!r} was done with other inputs than it is asked for",
            remedy="Redo the run from the step before it.",
        )


@cache
def _codec(work: Callable[..., Any]) -> TypeAdapter[Any]:
    hints = get_type_hints(work)
    if "return" not in hints:
        raise TypeError(f"{work} needs a return annotation: its result is journalled")
    return TypeAdapter(hints["return"])
