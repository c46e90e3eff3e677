"""Tasks of a FANUC controller: a foreground program that may move, and a background logic program.

Imitates
    Execution of TP programs: one line after the other until it waits; background logic from the first line to the
    last in each scan, whatever the mode, an emergency stop or an alarm.
Source
    deploy/controller_setup/fanuc_tp.md.
Modelled
    Pause and continuation (a motion goes on where its skip condition does not hold), abort, start; labels are only
    jumped to forward in background logic.
Not modelled
    Time that lines take, several foreground tasks, single step.
"""

from dataclasses import dataclass
from enum import Enum
from typing import Protocol

from cellcal.fake_devices.tp_programs.expressions import TpState, TpSyntaxError, Value
from cellcal.fake_devices.tp_programs.listing import (
    Assignment,
    ConditionalStep,
    Instruction,
    JointMotion,
    Jump,
    PresentPosition,
    SkipCondition,
    TpListing,
    WaitTime,
    WaitUntil,
)

_MOST_LINES = 10_000  # without waiting: a program that loops for ever


class TaskStatus(Enum):
    """The state of a task."""

    RUNNING = "running"
    PAUSED = "paused"
    ABORTED = "aborted"


class TpMachine(TpState, Protocol):
    """The controller, as a program acts on it."""

    def write_item(self, kind: str, number: int, element: int, value: Value) -> None: ...
    def store_position(self, number: int) -> None: ...
    def start_motion(self, position: int, percent: float) -> None:
        """Start a joint motion; it may pause the task by an alarm."""
        ...

    def stop_motion(self, at_real_s: float) -> None: ...
    def is_at_rest(self) -> bool: ...


def run_background(listing: TpListing, machine: TpMachine) -> None:
    """Run one scan of background logic.

    Raises
    ------
    TpSyntaxError
        The program would wait, move or jump, or has a motion group.
    """
    for instruction in listing.instructions:
        if isinstance(instruction, ConditionalStep) and isinstance(instruction.then, Assignment):
            if instruction.holds(machine):
                execute_assignment(instruction.then, machine)
        elif isinstance(instruction, Assignment):
            execute_assignment(instruction, machine)
        elif instruction is not None:
            raise TpSyntaxError(f"{listing.name}: background logic only assigns")
    if listing.has_group:
        raise TpSyntaxError(f"{listing.name}: background logic has no motion group")


def execute_assignment(assignment: Assignment, machine: TpMachine) -> None:
    """Compute a value and store it."""
    element = 0 if assignment.element is None else int(assignment.element(machine))
    machine.write_item(assignment.kind, assignment.number, element, assignment.value(machine))


@dataclass
class ForegroundTask:
    """One program with motion; ``run_lines`` goes on until it waits."""

    listing: TpListing
    machine: TpMachine
    status: TaskStatus = TaskStatus.ABORTED
    line: int = 0
    skip_flag: int | None = None
    motion: JointMotion | None = None  # under way
    skipped: bool = False
    due_s: float | None = None  # of WAIT with a time

    def start_program(self) -> None:
        """Press START: from the first line, or on where it was paused."""
        if self.status is TaskStatus.ABORTED:
            self.line, self.motion, self.due_s, self.skip_flag = 0, None, None, None
        elif self.motion is not None and not self.skipped:
            self.motion = None  # the line is executed again: the motion goes on from here
        self.status = TaskStatus.RUNNING

    def pause_task(self) -> None:
        """Stop at the present line; START goes on there."""
        if self.status is TaskStatus.RUNNING:
            self.status = TaskStatus.PAUSED

    def abort_task(self) -> None:
        """End the program; START begins at the first line."""
        self.status, self.motion, self.due_s = TaskStatus.ABORTED, None, None

    def run_lines(self, real_s: float) -> None:
        """Execute lines until one waits, at a time of the controller's cycle."""
        for _ in range(_MOST_LINES):
            if self.status is not TaskStatus.RUNNING:
                return
            if self.line >= len(self.listing.instructions):
                self.abort_task()
                return
            if not self._execute(self.listing.instructions[self.line], real_s):
                return
        raise TpSyntaxError(f"{self.listing.name} never waits")

    def _execute(self, instruction: Instruction, real_s: float) -> bool:
        """Execute the present line; tell whether the program goes on in this cycle."""
        match instruction:
            case Jump():
                self.line = self.listing.labels[instruction.label]
                return True
            case ConditionalStep():
                return self._decide(instruction, real_s)
            case JointMotion():
                return self._move(instruction, real_s)
            case WaitTime() | WaitUntil():
                return self._wait(instruction, real_s)
        self._act(instruction)
        self.line += 1
        return True

    def _act(self, instruction: Instruction) -> None:
        match instruction:
            case Assignment():
                execute_assignment(instruction, self.machine)
            case PresentPosition():
                self.machine.store_position(instruction.number)
            case SkipCondition():
                self.skip_flag = instruction.flag

    def _decide(self, instruction: ConditionalStep, real_s: float) -> bool:
        if instruction.holds(self.machine):
            return self._execute(instruction.then, real_s)
        self.line += 1
        return True

    def _wait(self, instruction: WaitTime | WaitUntil, real_s: float) -> bool:
        if isinstance(instruction, WaitUntil):
            is_over = bool(instruction.holds(self.machine))
        else:
            self.due_s = real_s + instruction.seconds if self.due_s is None else self.due_s
            is_over = real_s >= self.due_s
        if is_over:
            self.due_s = None
            self.line += 1
        return is_over

    def _move(self, instruction: JointMotion, real_s: float) -> bool:
        skip = self.skip_flag is not None and bool(self.machine.read_item("F", self.skip_flag, 0))
        if self.motion is None:
            if skip:  # it holds before the motion begins: there is none
                self.line += 1
                return True
            self.motion, self.skipped = instruction, False
            percent = float(self.machine.read_item("R", instruction.speed, 0))
            self.machine.start_motion(instruction.position, percent)
            return False
        if self.machine.is_at_rest():
            self.motion = None
            self.line = self.line + 1 if self.skipped else self.listing.labels[instruction.label]
            return True
        if skip and not self.skipped:
            self.skipped = True
            self.machine.stop_motion(real_s)
        return False
