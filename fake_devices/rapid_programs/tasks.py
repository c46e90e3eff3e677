r"""The motion task of an ABB controller, for the instructions of ``source``.

Imitates
    Execution of RAPID: one program pointer, trap routines that interrupt it, data that outlive the program.
Source
    ABB, basic characteristics of RAPID: a trap begins before an instruction, and during WaitUntil and motions; during
    a trap no other begins; in a stopped program none is handled. ABB 3HAC050917-001 for the instructions.
Modelled
    fine: the instruction ends when the arm stands. A timer of ITimer; what it calls while a trap runs waits in a
    queue. StopMove brakes, ClearPath drops the motion of a stopped path, StartMove goes on with what the path holds.
    ExitCycle ends the trap and sets the program pointer to main: VAR keep their values. Program pointer to main by a
    person: VAR get their first values. A stream needs an identity (four at most) that is set up.
Not modelled
    The program pointer ahead of the arm (every motion ends with fine), several tasks, \Single timers. **Not known**:
    whether interrupts that were ordered outlive ExitCycle (here they do, and a second CONNECT of one is an error);
    whether a timer goes on while the program is stopped (here it does not); whether identities outlive the program
    pointer at main (here they do not) and EGMReset takes one that was never given (here it does).
"""

import struct
from collections.abc import Callable, Generator, Sequence
from typing import Protocol

from cellcal.fake_devices.program_text.expressions import Expression, ProgramTextError, Value
from cellcal.fake_devices.program_text.lines import locate_problem
from cellcal.fake_devices.rapid_programs.source import ExecutedModule, RapidInstruction, fits

Run = Generator[None, None, None]  # ends a cycle with each yield
_SHORTEST_TIMER_S = 0.1
_MOST_IDENTITIES = 4
_MEMBERS = {"jointtarget": ("ROBAX", "EXTAX")}


class RapidMachine(Protocol):
    """The controller, as a program acts on it."""

    def call_function(self, name: str) -> Value: ...
    def begin_motion(self, target: Value, time_s: float, tool: str) -> bool:
        """Begin a joint motion; return False where it cannot be, of which the log tells."""
        ...

    def brake(self) -> None: ...
    def is_standing(self) -> bool: ...


class _ExitSignal(Exception):  # noqa: N818  no error
    """ExitCycle."""


class MotionTask:
    """T_ROB1 with one module."""

    def __init__(
        self, module: ExecutedModule, machine: RapidMachine, instructions_per_cycle: int = 500
    ) -> None:
        self._module, self._machine, self._most = module, machine, instructions_per_cycle
        self.data: dict[str, Value] = {name: datum.first for name, datum in module.data.items()}
        self.is_running = False
        self.repeats = True  # the run mode is continuous, not a single cycle
        self._now_s, self._remaining = 0.0, instructions_per_cycle
        self._connected: dict[str, str] = {}  # trap by intnum
        self._timers: dict[str, tuple[float, float]] = {}  # period and next time by intnum
        self._queued: list[str] = []
        self._identities: dict[float, str] = {}  # of streams: the device that each is set up for
        self.streams = False
        self._trap: Run | None = None
        self._motion: tuple[Value, float, str] | None = None
        self._is_path_stopped = self._is_under_way = False
        self._main = self._run_body(module.procedures["MAIN"])
        self._refuse_missing_routines()

    def _refuse_missing_routines(self) -> None:
        for body in (*self._module.procedures.values(), *self._module.traps.values()):
            for each in _all_instructions(body):
                missing = each.kind == "call" and each.names[0] not in self._module.procedures
                if missing or (each.kind == "connect" and each.names[1] not in self._module.traps):
                    raise self._locate_problem(each, f"there is no routine {each.names[-1]}")

    # what a person does

    def move_pointer_to_main(self) -> None:
        """Set the program pointer to main: nothing is under way, interrupts are gone, VAR have their first values."""
        for name, datum in self._module.data.items():
            if not datum.is_persistent:
                self.data[name] = datum.first
        self._connected, self._timers, self._queued = {}, {}, []
        self._identities, self.streams = {}, False
        self._enter_main()
        self._clear_path()

    def press_start(self) -> None:
        """Start, or go on: with the same motion where one was interrupted."""
        self.is_running = True
        self._timers = {name: (period, self._now_s + period) for name, (period, _) in self._timers.items()}

    def stop_program(self) -> None:
        """Stop: the arm brakes and keeps its motion."""
        if self.is_running:
            self.is_running = self._is_under_way = False
            self._machine.brake()

    # running

    def run_cycle(self, now_s: float) -> None:
        """Run instructions until one waits, at a time of the controller."""
        self._now_s, self._remaining = now_s, self._most
        if not self.is_running:
            return
        self._queue_timers()
        if self._trap is None and self._queued:
            trap = self._connected.get(self._queued.pop(0))
            self._trap = None if trap is None else self._run_body(self._module.traps[trap])
        self._drive_arm()
        try:
            if self._has_trap_ended():
                next(self._main)
        except (StopIteration, _ExitSignal):
            self._enter_main()
            self.is_running = self.repeats

    def _has_trap_ended(self) -> bool:
        """Run the trap that is under way; return whether the program itself goes on in this cycle."""
        if self._trap is not None:
            for _ in self._trap:
                return False
            self._trap = None
        return True

    def _queue_timers(self) -> None:
        for name, (period_s, due_s) in self._timers.items():
            if self._now_s >= due_s:
                self._queued.append(name)
                self._timers[name] = (period_s, max(due_s + period_s, self._now_s))

    def _enter_main(self) -> None:
        self._main, self._trap = self._run_body(self._module.procedures["MAIN"]), None

    def _clear_path(self) -> None:
        self._motion, self._is_under_way, self._is_path_stopped = None, False, False

    def _drive_arm(self) -> None:
        if self._motion is None or self._is_path_stopped:
            return
        if self._is_under_way and self._machine.is_standing():
            self._motion, self._is_under_way = None, False
        elif not self._is_under_way:
            self._is_under_way = self._machine.begin_motion(*self._motion)
            if not self._is_under_way:
                self.stop_program()

    def _run_body(self, body: Sequence[RapidInstruction]) -> Run:
        for instruction in body:
            self._remaining -= 1
            if self._remaining < 0:
                yield
            try:
                if instruction.kind in _LASTING:
                    yield from _LASTING[instruction.kind](self, instruction)
                else:
                    _ACTIONS[instruction.kind](self, instruction)
            except ProgramTextError as problem:
                raise self._locate_problem(instruction, str(problem)) from problem

    # instructions that take time

    def _run_call(self, instruction: RapidInstruction) -> Run:
        yield from self._run_body(self._module.procedures[instruction.names[0]])

    def _run_loop(self, instruction: RapidInstruction) -> Run:
        while self._evaluate_flag(instruction):
            yield from self._run_body(instruction.body)

    def _run_branch(self, instruction: RapidInstruction) -> Run:
        yield from self._run_body(
            instruction.body if self._evaluate_flag(instruction) else instruction.otherwise
        )

    def _run_wait(self, instruction: RapidInstruction) -> Run:
        while not self._evaluate_flag(instruction):
            due_s = self._now_s + float(instruction.names[0])
            while self._now_s < due_s:
                yield

    def _run_motion(self, instruction: RapidInstruction) -> Run:
        target, time, tool = instruction.names
        self._motion = (_single_value(self.data[target]), self.data[time], tool)
        self._is_under_way = False
        while self._motion is not None:
            yield

    def _run_pause(self, instruction: RapidInstruction) -> Run:
        due_s = self._now_s + float(self._evaluate_value(instruction))
        while self._now_s < due_s:
            yield

    # instructions that take none

    def _end_stream(self, instruction: RapidInstruction) -> None:
        if self._identities.pop(self.data[instruction.names[0]], None) is not None:
            self.streams = False

    def _give_identity(self, instruction: RapidInstruction) -> None:
        free = [number for number in range(1, _MOST_IDENTITIES + 1) if number not in self._identities]
        if not free:
            raise ProgramTextError("no identity of a stream is free")
        self._identities[float(free[0])] = ""
        self.data[instruction.names[0]] = float(free[0])

    def _set_up_stream(self, instruction: RapidInstruction) -> None:
        name, device = instruction.names
        if self.data[name] not in self._identities:
            raise ProgramTextError(f"{name} was not given by EGMGetId")
        self._identities[self.data[name]] = device

    def _start_stream(self, instruction: RapidInstruction) -> None:
        if not self._identities.get(self.data[instruction.names[0]]):
            raise ProgramTextError(f"{instruction.names[0]} is not set up")
        self.streams = True

    def _assign_value(self, instruction: RapidInstruction) -> None:
        target = instruction.target
        assert target is not None
        if target.name not in self.data:
            raise ProgramTextError(f"{target.name} is not declared")
        kind, value = self._module.data[target.name].kind, _single_value(self._evaluate_value(instruction))
        if target.member:
            place = _member_place(kind, target.member)
            value = [value if k == place else part for k, part in enumerate(self.data[target.name])]
        if not fits(kind, value):
            raise ProgramTextError(f"{value!r} is no {kind}")
        self.data[target.name] = value

    def _connect_trap(self, instruction: RapidInstruction) -> None:
        name, trap = instruction.names
        if name in self._connected:
            raise ProgramTextError(f"{name} is connected already")
        self._connected[name] = trap

    def _delete_interrupt(self, instruction: RapidInstruction) -> None:
        name = instruction.names[0]
        self._connected.pop(name, None)
        self._timers.pop(name, None)
        self._queued = [each for each in self._queued if each != name]

    def _order_timer(self, instruction: RapidInstruction) -> None:
        name, period_s = instruction.names[0], float(self._evaluate_value(instruction))
        if name not in self._connected or period_s < _SHORTEST_TIMER_S - 1e-9:
            raise ProgramTextError(f"{name} is not connected, or {period_s} s is too short for a timer")
        self._timers[name] = (period_s, self._now_s + period_s)

    def _stop_move(self, _instruction: RapidInstruction) -> None:
        self._machine.brake()
        self._is_path_stopped, self._is_under_way = True, False

    def _drop_path(self, _instruction: RapidInstruction) -> None:
        if not self._is_path_stopped:
            raise ProgramTextError("the path is cleared while the arm moves on it")
        self._motion = None

    def _start_move(self, _instruction: RapidInstruction) -> None:
        self._is_path_stopped = False

    def _exit_cycle(self, _instruction: RapidInstruction) -> None:
        raise _ExitSignal

    # values

    def read(self, name: str, index: int | None, member: str) -> Value:
        """Return data of the module."""
        del index
        if name not in self.data:
            raise ProgramTextError(f"{name} is not declared")
        value = self.data[name]
        return value[_member_place(self._module.data[name].kind, member)] if member else value

    def call(self, name: str, arguments: Sequence[Value]) -> Value:
        """Return the value of a function of the controller."""
        del arguments
        return self._machine.call_function(name)

    def _evaluate_value(self, instruction: RapidInstruction) -> Value:
        expression: Expression | None = instruction.expression
        assert expression is not None
        return expression.evaluate(self)

    def _evaluate_flag(self, instruction: RapidInstruction) -> bool:
        value = self._evaluate_value(instruction)
        if not isinstance(value, bool):
            raise ProgramTextError(f"{value!r} is neither TRUE nor FALSE")
        return value

    def _locate_problem(self, instruction: RapidInstruction, text: str) -> ProgramTextError:
        return locate_problem(self._module.file, instruction.line, text)


def _member_place(kind: str, member: str) -> int:
    members = _MEMBERS.get(kind, ())
    if member not in members:
        raise ProgramTextError(f"{kind} has no member {member}")
    return members.index(member)


def _single_value(value: Value) -> Value:
    """Return numbers as the 32 bits of a num hold them."""
    if isinstance(value, list):
        return [_single_value(each) for each in value]
    if isinstance(value, bool) or value is None:
        return value
    return float(struct.unpack("f", struct.pack("f", value))[0])


def _all_instructions(body: Sequence[RapidInstruction]) -> list[RapidInstruction]:
    found: list[RapidInstruction] = []
    pending = list(body)
    while pending:
        found.append(pending.pop())
        pending += [*found[-1].body, *found[-1].otherwise]
    return found


_LASTING: dict[str, Callable[[MotionTask, RapidInstruction], Run]] = {
    "call": MotionTask._run_call,  # noqa: SLF001  its own
    "while": MotionTask._run_loop,  # noqa: SLF001
    "if": MotionTask._run_branch,  # noqa: SLF001
    "wait": MotionTask._run_wait,  # noqa: SLF001
    "move": MotionTask._run_motion,  # noqa: SLF001
    "pause": MotionTask._run_pause,  # noqa: SLF001
}
_ACTIONS: dict[str, Callable[[MotionTask, RapidInstruction], None]] = {
    "assign": MotionTask._assign_value,  # noqa: SLF001
    "connect": MotionTask._connect_trap,  # noqa: SLF001
    "delete": MotionTask._delete_interrupt,  # noqa: SLF001
    "timer": MotionTask._order_timer,  # noqa: SLF001
    "stopmove": MotionTask._stop_move,  # noqa: SLF001
    "clearpath": MotionTask._drop_path,  # noqa: SLF001
    "startmove": MotionTask._start_move,  # noqa: SLF001
    "exitcycle": MotionTask._exit_cycle,  # noqa: SLF001
    "egmreset": MotionTask._end_stream,  # noqa: SLF001
    "egmgetid": MotionTask._give_identity,  # noqa: SLF001
    "egmsetupuc": MotionTask._set_up_stream,  # noqa: SLF001
    "egmstreamstart": MotionTask._start_stream,  # noqa: SLF001
}
