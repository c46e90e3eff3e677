"""The robot interpreter and the submit interpreter of a KUKA controller, for the statements of ``source``.

Imitates
    Execution of KRL: an advance run that plans motions ahead of the arm, interrupts, and lines of the submit
    interpreter that are run over and over.
Source
    KUKA KSS 8.3, operating and programming instructions for system integrators; an article on interrupts (Veronese);
    articles of an integrator on RESUME and on $PRO_STATE1. deploy/controller_setup/kuka.
Modelled
    The main run goes on ahead of up to three motions, until WAIT or a variable of the robot's present state. An
    interrupt fires where its condition changes from FALSE to TRUE while it is on, between two statements; RESUME
    drops all motions and goes on behind the call that stands in the routine where the interrupt was declared, and is
    an error where the advance run is in that routine itself. STOP pauses; START goes on with the same motion. HALT
    pauses behind the motions before it. A sensor context ends where the program is selected anew or cancelled.
Not modelled
    Approximated motion, priorities of several interrupts, single step, times of statements. **Not known**: whether a
    condition that becomes TRUE while the program is stopped fires after START. The worse case is played: it does not.
"""

from collections.abc import Callable, Generator, Sequence
from dataclasses import dataclass, field
from typing import Protocol

from cellcal.fake_devices.krl_programs.source import KrlSource, KrlStatement
from cellcal.fake_devices.program_text.expressions import Expression, ProgramTextError, Scope, Value
from cellcal.fake_devices.program_text.lines import locate_problem

ADVANCE = 3  # motions that are planned ahead after BAS(#INITMOV,0)
FREE, RESET, ACTIVE, STOPPED, ENDED = "#P_FREE", "#P_RESET", "#P_ACTIVE", "#P_STOP", "#P_END"
SENSOR_OK, SENSOR_ERROR = 0, 1  # RSIOK and another answer
_PRESENT_STATE = frozenset(("$AXIS_ACT", "$POS_ACT"))  # reading one of them stops the advance run
Run = Generator[None, None, None]  # ends a cycle with each yield


class KrlMachine(Protocol):
    """The controller, as a program acts on it."""

    def read_variable(self, name: str, index: int | None, member: str) -> Value: ...
    def write_variable(self, name: str, index: int | None, member: str, value: Value) -> None: ...
    def accepts_motion(self, target: Value) -> bool:
        """Say whether a motion can be planned; where it cannot, a message stands at the pendant."""
        ...

    def begin_motion(self, target: Value) -> None: ...
    def brake(self) -> None: ...
    def is_standing(self) -> bool: ...
    def initialise_motion(self) -> None: ...
    def select_tool(self, number: int) -> None: ...
    def create_sensor_context(self, file: str) -> bool: ...
    def start_sensor(self) -> bool: ...
    def end_sensor(self) -> None: ...


class _ReturnSignal(Exception):  # noqa: N818  no error
    """RETURN."""


class _ResumeSignal(Exception):  # noqa: N818  no error
    """RESUME, to the routine where its interrupt was declared."""

    def __init__(self, frame: "_Frame | None" = None) -> None:
        super().__init__()
        self.frame = frame


@dataclass(eq=False)
class _Frame:
    """A routine that is under way, with its own variables."""

    machine: KrlMachine
    own: dict[str, Value] = field(default_factory=dict)

    def read(self, name: str, index: int | None, member: str) -> Value:
        if name == "RSIOK":
            return SENSOR_OK
        value = self.own[name] if name in self.own else self.machine.read_variable(name, index, member)
        if value is None:
            raise ProgramTextError(f"{name}{'.' if member else ''}{member} has no value")
        return value

    def call(self, name: str, arguments: Sequence[Value]) -> Value:
        del arguments
        raise ProgramTextError(f"{name} is no function that is executed here")


@dataclass
class _Interrupt:
    """An interrupt that was declared."""

    condition: Expression
    routine: str
    frame: _Frame
    is_on: bool = False
    held_before: bool = True


class RobotInterpreter:
    """One selected program."""

    def __init__(self, source: KrlSource, machine: KrlMachine, statements_per_cycle: int = 500) -> None:
        self._source, self._machine, self._most = source, machine, statements_per_cycle
        self.state = FREE
        self._now_s, self._remaining = 0.0, statements_per_cycle
        self._frame = _Frame(machine)  # where conditions of interrupts are computed: of global variables
        self._main = self._run_routine(source.main)
        self._called: Run | None = None  # the interrupt's routine
        self._interrupts: dict[int, _Interrupt] = {}
        self._motions: list[Value] = []
        self._is_under_way = False
        self._refuse_missing_routines()

    def _refuse_missing_routines(self) -> None:
        for statement in _all_statements(self._source):
            if statement.kind in ("call", "declare") and statement.name not in self._source.routines:
                raise self._locate_problem(statement, f"there is no routine {statement.name}")

    # what a person does

    def select_program(self) -> None:
        """Select the program, or reset it: START begins at its first line."""
        self._give_up_motions()
        self._machine.end_sensor()
        self._main, self._called, self._interrupts = self._run_routine(self._source.main), None, {}
        self.state = RESET

    def press_start(self) -> None:
        """Start, or go on."""
        if self.state == ENDED:
            self.select_program()
        if self.state in (RESET, STOPPED):
            self.state = ACTIVE
            for interrupt in self._interrupts.values():
                interrupt.held_before = bool(interrupt.condition.evaluate(self._frame))

    def stop_program(self) -> None:
        """Stop: the arm brakes, and START goes on with the same motion."""
        if self.state == ACTIVE:
            self.state = STOPPED
            self._machine.brake()
            self._is_under_way = False

    def cancel_program(self) -> None:
        """Deselect the program."""
        self.stop_program()
        self._give_up_motions()
        self._machine.end_sensor()
        self.state = FREE

    # running

    def run_cycle(self, now_s: float) -> None:
        """Run statements until they wait, at a time of the controller."""
        if self.state != ACTIVE:
            return
        self._now_s, self._remaining = now_s, self._most
        self._drive_arm()
        self._fire_interrupt()
        try:
            next(self._called or self._main)
        except StopIteration:
            if self._called is None:
                self.state = ENDED
            self._called = None
        except _ResumeSignal as signal:
            self._resume_main(signal)

    def _drive_arm(self) -> None:
        if self._is_under_way and self._machine.is_standing():
            self._motions.pop(0)
            self._is_under_way = False
        if self._motions and not self._is_under_way and self._called is None:
            self._machine.begin_motion(self._motions[0])
            self._is_under_way = True

    def _fire_interrupt(self) -> None:
        for interrupt in self._interrupts.values():
            holds = bool(interrupt.condition.evaluate(self._frame))
            fires = interrupt.is_on and holds and not interrupt.held_before
            interrupt.held_before = holds
            if fires and self._called is None:
                self._called = self._run_interrupt(interrupt)

    def _run_interrupt(self, interrupt: _Interrupt) -> Run:
        try:
            yield from self._run_routine(interrupt.routine)
        except _ResumeSignal:
            raise _ResumeSignal(interrupt.frame) from None

    def _resume_main(self, signal: _ResumeSignal) -> None:
        self._called = None
        self._give_up_motions()
        try:
            self._main.throw(signal)
        except StopIteration:
            self.state = ENDED
        except _ResumeSignal:
            raise ProgramTextError(
                f"{self._source.file}: RESUME where the advance run is in the routine that declares the interrupt"
            ) from None

    def _give_up_motions(self) -> None:
        self._motions.clear()
        self._is_under_way = False

    def _run_routine(self, name: str) -> Run:
        frame = _Frame(self._machine)
        try:
            yield from self._run_body(self._source.routines[name], frame)
        except _ReturnSignal:
            return

    def _run_body(self, body: Sequence[KrlStatement], frame: _Frame) -> Run:
        for statement in body:
            self._remaining -= 1
            if self._remaining < 0:
                yield
            try:
                if statement.kind in _WAITING:
                    yield from _WAITING[statement.kind](self, statement, frame)
                elif statement.kind.startswith("rsi_"):
                    self._answer_sensor(statement, frame)
                else:
                    yield from self._stop_advance(statement.expression)
                    self._execute_at_once(statement, frame)
            except ProgramTextError as problem:
                raise self._locate_problem(statement, str(problem)) from problem

    def _execute_at_once(self, statement: KrlStatement, frame: _Frame) -> None:
        """Execute a statement that takes no time."""
        if statement.kind in _SIGNALS:
            raise _SIGNALS[statement.kind]()
        match statement.kind:
            case "local":
                frame.own |= dict.fromkeys(name.strip() for name in statement.name.split(","))
            case "assign":
                _assign_value(statement, frame)
            case "declare":
                assert statement.expression is not None
                self._interrupts[statement.number] = _Interrupt(statement.expression, statement.name, frame)
            case "on" | "off":
                self._switch_interrupt(statement)
            case "initmov":
                self._machine.initialise_motion()
            case "tool":
                self._machine.select_tool(int(_evaluate_value(statement, frame)))

    def _answer_sensor(self, statement: KrlStatement, frame: _Frame) -> None:
        """Create or start a sensor context; its number, and whether it was done, go into variables."""
        if statement.kind == "rsi_create":
            is_done = self._machine.create_sensor_context(statement.name)
            _store_value(statement.body[0], frame, 1)
        else:
            is_done = self._machine.start_sensor()
        _store_value(statement, frame, SENSOR_OK if is_done else SENSOR_ERROR)

    def _run_halt(self, _statement: KrlStatement, _frame: _Frame) -> Run:
        while self._motions:
            yield
        self.stop_program()
        yield

    def _switch_interrupt(self, statement: KrlStatement) -> None:
        if statement.number not in self._interrupts:
            raise ProgramTextError("the interrupt is not declared")
        interrupt = self._interrupts[statement.number]
        interrupt.is_on = statement.kind == "on"
        interrupt.held_before = bool(interrupt.condition.evaluate(self._frame))

    def _stop_advance(self, expression: Expression | None) -> Run:
        while expression is not None and expression.names & _PRESENT_STATE and self._motions:
            yield

    def _run_call(self, statement: KrlStatement, frame: _Frame) -> Run:
        try:
            yield from self._run_routine(statement.name)
        except _ResumeSignal as signal:
            if signal.frame is not frame:
                raise

    def _run_loop(self, statement: KrlStatement, frame: _Frame) -> Run:
        while True:
            yield from self._run_body(statement.body, frame)

    def _run_branch(self, statement: KrlStatement, frame: _Frame) -> Run:
        yield from self._stop_advance(statement.expression)
        if _evaluate_flag(statement, frame):
            yield from self._run_body(statement.body, frame)

    def _run_for(self, statement: KrlStatement, frame: _Frame) -> Run:
        assert statement.target is not None
        first = int(statement.target.place(frame) or 0)
        for count in range(first, statement.number + 1):
            frame.own[statement.target.name] = count
            yield from self._run_body(statement.body, frame)

    def _wait_for(self, statement: KrlStatement, frame: _Frame) -> Run:
        while self._motions or not _evaluate_flag(statement, frame):
            yield

    def _wait_seconds(self, statement: KrlStatement, frame: _Frame) -> Run:
        while self._motions:
            yield
        due_s = self._now_s + float(_evaluate_value(statement, frame))
        while self._now_s < due_s:
            yield

    def _run_motion(self, statement: KrlStatement, frame: _Frame) -> Run:
        yield from self._stop_advance(statement.expression)
        while len(self._motions) > ADVANCE:
            yield
        target = _evaluate_value(statement, frame)
        while not self._machine.accepts_motion(target):  # START tries the same line again
            self.stop_program()
            yield
        self._motions.append(target)

    def _run_brake(self, statement: KrlStatement, _frame: _Frame) -> Run:
        if self._called is None:
            raise self._locate_problem(statement, "BRAKE stands in the routine of an interrupt only")
        self._machine.brake()
        self._is_under_way = False
        while not self._machine.is_standing():
            yield

    def _locate_problem(self, statement: KrlStatement, text: str) -> ProgramTextError:
        return locate_problem(self._source.file, statement.line, text)


_SIGNALS: dict[str, type[Exception]] = {"return": _ReturnSignal, "resume": _ResumeSignal}
_WAITING: dict[str, Callable[[RobotInterpreter, KrlStatement, _Frame], Run]] = {
    "call": RobotInterpreter._run_call,  # noqa: SLF001  its own
    "loop": RobotInterpreter._run_loop,  # noqa: SLF001
    "if": RobotInterpreter._run_branch,  # noqa: SLF001
    "for": RobotInterpreter._run_for,  # noqa: SLF001
    "wait for": RobotInterpreter._wait_for,  # noqa: SLF001
    "wait sec": RobotInterpreter._wait_seconds,  # noqa: SLF001
    "ptp": RobotInterpreter._run_motion,  # noqa: SLF001
    "brake": RobotInterpreter._run_brake,  # noqa: SLF001
    "halt": RobotInterpreter._run_halt,  # noqa: SLF001
}


def run_submit_lines(source: KrlSource, machine: KrlMachine) -> None:
    """Run the lines of the submit interpreter once; raise ProgramTextError where one of them waits or moves."""
    _run_submit_body(source.file, source.routines[source.main], _Frame(machine))


def _run_submit_body(file: str, body: Sequence[KrlStatement], frame: _Frame) -> None:
    for statement in body:
        if statement.kind == "if":
            if _evaluate_flag(statement, frame):
                _run_submit_body(file, statement.body, frame)
        elif statement.kind == "assign":
            _assign_value(statement, frame)
        else:
            raise locate_problem(file, statement.line, "the submit interpreter only assigns here")


def _assign_value(statement: KrlStatement, frame: _Frame) -> None:
    _store_value(statement, frame, _evaluate_value(statement, frame))


def _store_value(statement: KrlStatement, frame: _Frame, value: Value) -> None:
    target = statement.target
    assert target is not None
    if target.name in frame.own:
        frame.own[target.name] = value
    else:
        frame.machine.write_variable(target.name, target.place(frame), target.member, value)


def _evaluate_value(statement: KrlStatement, scope: Scope) -> Value:
    assert statement.expression is not None
    return statement.expression.evaluate(scope)


def _evaluate_flag(statement: KrlStatement, scope: Scope) -> bool:
    value = _evaluate_value(statement, scope)
    if not isinstance(value, bool):
        raise ProgramTextError(f"line {statement.line}: {value!r} is neither TRUE nor FALSE")
    return value


def _all_statements(source: KrlSource) -> list[KrlStatement]:
    found: list[KrlStatement] = []
    pending = [statement for body in source.routines.values() for statement in body]
    while pending:
        found.append(pending.pop())
        pending += found[-1].body
    return found
