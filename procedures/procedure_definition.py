"""The card of a procedure: name, version, what it needs of a cell, what it will do."""

from collections.abc import Awaitable, Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, get_type_hints

from pydantic import TypeAdapter

from cellcal.calibration.message import make_message
from cellcal.procedures.cell import Cell, MotionLevel
from cellcal.procedures.forecast import Forecast, Knowledge
from cellcal.procedures.procedure_guide import NEED_REMEDIES
from cellcal.procedures.refit import Refit
from cellcal.procedures.run import NeedsUnmetError, Run
from cellcal.procedures.run_history import Finding
from cellcal.procedures.verdict import ProcedureVerdict


@dataclass(frozen=True, slots=True)
class Phase:
    """A step of an outline. ``repeats`` steps are called ``name 1``, ``name 2``; None is one step ``name``.

    When ``adaptive``, the number is what is expected; the measurements decide.
    """

    name: str
    repeats: int | None = None
    adaptive: bool = False

    @property
    def step_names(self) -> tuple[str, ...]:
        """The names of the steps expected here."""
        if self.repeats is None:
            return (self.name,)
        return tuple(f"{self.name} {k}" for k in range(1, self.repeats + 1))


def with_planned_counts(phases: tuple[Phase, ...], planned: Mapping[str, int]) -> tuple[Phase, ...]:
    """Return an outline with the numbers of a plan, by the names of its phases, where it has them."""
    return tuple(replace(phase, repeats=planned.get(phase.name, phase.repeats)) for phase in phases)


@dataclass(frozen=True, slots=True)
class StoredResult:
    """A result that outlives its run."""

    what: str  # mastering_record, tool_frame, user_frame
    subject: str
    value: Any


@dataclass(frozen=True, slots=True)
class ProcedureDefinition:
    """One procedure of the catalogue."""

    name: str
    title: str
    version: int  # raised when a step is renamed, added or removed
    procedure: Callable[[Run, Any], Awaitable[Any]]
    spec_type: type
    needs: tuple[str, ...]
    outline: Callable[[Any], tuple[Phase, ...]]
    results_to_store: Callable[[Any, Any], StoredResult | tuple[StoredResult, ...] | None]  # spec, result
    epoch_may_change: bool = False  # it expects a lost position; it checks the epoch itself
    needs_position: bool = True  # it refuses a robot that has lost its position
    commands_motion: bool = True  # else a person moves the arm, or it stands still
    wants: tuple[str, ...] = ()  # what its steps will refuse without; told beforehand in lists and dry runs
    verdict: Callable[[Any, Any], ProcedureVerdict] | None = (
        None  # spec, result: what it claims and what it does not
    )
    forecast: Callable[[Any, Knowledge], Forecast] | None = None  # spec: the dry run
    refit: Callable[[Any, Sequence[Finding]], Refit | None] | None = None  # spec, findings: what if

    def reads_gauge(self, *ways: object) -> bool:
        """Return whether lengths of the cell's gauge are behind a result; ``ways`` are its method and evidence."""
        return "gauge" in self.needs or "wire" in ways

    def result_codec(self) -> TypeAdapter[Any]:
        """Return how the procedure's result is written down."""
        return TypeAdapter(get_type_hints(self.procedure)["return"])

    def expected_steps(self, spec: Any) -> int:
        """Return how many steps a run with this spec is expected to have."""
        return sum(len(phase.step_names) for phase in self.outline(spec))


NEEDS: dict[str, tuple[str, Callable[[Cell], bool]]] = {
    "moves_joints": (
        "a robot that moves on command",  # a person's moves do as well
        lambda cell: cell.robot.capabilities.moves_joints or cell.level is not MotionLevel.COMMANDED,
    ),
    "tells_flange_pose": (
        "a controller that shows where its flange is",
        lambda cell: cell.robot.capabilities.tells_flange_pose,
    ),
    "commanded": (
        "a robot that this software moves",
        lambda cell: cell.level is MotionLevel.COMMANDED,
    ),
    "writes_mastering": ("access to encoder counts and mastering", lambda cell: cell.mastering is not None),
    "writes_tool_frame": ("access to the tool frames", lambda cell: cell.tool_frames is not None),
    "writes_user_frame": ("access to the user frames", lambda cell: cell.user_frames is not None),
    "gauge": ("a length gauge", lambda cell: cell.gauge is not None),
    "probe": ("a touch probe", lambda cell: cell.probe is not None and cell.probe_setup is not None),
    "dial": ("a dial gauge", lambda cell: cell.dial is not None and cell.dial_setup is not None),
    "model": ("a kinematic model of the robot", lambda cell: cell.model is not None),
    "gauge_setup": ("where the wire is fixed (cell.toml)", lambda cell: cell.gauge_setup is not None),
    "record": (
        "a mastering record of this robot, taken before the loss",
        lambda cell: cell.record is not None,
    ),
    "position_cure": (
        "a controller whose lost position a person brings back at its pendant",
        lambda cell: cell.position_data is not None,
    ),
    "drive_data": (
        "the gear ratio of each axis in the cell file",
        lambda cell: cell.shown_motors is not None,
    ),
    "position_record": (
        "a position record of this robot, taken before the loss",
        lambda cell: cell.position_record is not None,
    ),
    "backup": ("a mastering that an earlier run wrote", lambda cell: bool(cell.backups)),
    "evidence": (
        "a draw-wire, touch probe or tracker, or a record with touched places or a seat",
        lambda cell: (
            (cell.gauge is not None and cell.gauge_setup is not None)
            or (cell.probe is not None and cell.probe_setup is not None)
            or (cell.tracker is not None and cell.tracker_setup is not None)
            or (cell.record is not None and cell.record.kit is not None)
        ),
    ),
    "tracker": ("an instrument that measures points", lambda cell: cell.tracker is not None),
    "sees_the_flange": (
        "a draw-wire or a tracker on the flange, and where it is (cell.toml)",
        lambda cell: (
            (cell.gauge is not None and cell.gauge_setup is not None)
            or (cell.tracker is not None and cell.tracker_setup is not None)
        ),
    ),
    "tracker_setup": ("where the target sits (cell.toml)", lambda cell: cell.tracker_setup is not None),
    "measures_poses": (
        "an instrument that measures poses",
        lambda cell: cell.tracker is not None and cell.tracker.capabilities.measures_poses,
    ),
}


def missing_needs(entry: ProcedureDefinition, cell: Cell) -> tuple[str, ...]:
    """Return what this cell lacks for a procedure, in a technician's words."""
    return tuple(NEEDS[need][0] for need in entry.needs if not NEEDS[need][1](cell))


def missing_remedies(entry: ProcedureDefinition, cell: Cell) -> tuple[str, ...]:
    """Return how each thing that `all_missing` names can be had, in the same order."""
    unmet = [need for need in (*entry.needs, *entry.wants) if not NEEDS[need][1](cell)]
    return tuple(NEED_REMEDIES[need] for need in unmet)


def all_missing(entry: ProcedureDefinition, cell: Cell) -> tuple[str, ...]:
    """Return all that this cell lacks for a procedure, what its steps would refuse without included."""
    missing_data = tuple(NEEDS[want][0] for want in entry.wants if not NEEDS[want][1](cell))
    return (*missing_needs(entry, cell), *missing_data)


def is_for_other_controllers(entry: ProcedureDefinition, cell: Cell) -> bool:
    """Return whether nothing that a person adds makes a procedure possible here: this controller has its own way.

    A lost position is brought back either by writing the mastering or by a person at the pendant; of the two a list
    for people leaves out the one that belongs to controllers of another kind.
    """
    at_pendant = cell.position_data is not None
    if "position_cure" in entry.needs:
        return not at_pendant
    return at_pendant and cell.mastering is None and "writes_mastering" in entry.needs


def refuse_unmet(entry: ProcedureDefinition, cell: Cell) -> None:
    """Raise NeedsUnmetError when the cell lacks something."""
    lacks = missing_needs(entry, cell)
    if lacks:
        raise NeedsUnmetError(
            make_message("{entry_title} needs {lacks}", entry_title=entry.title, lacks=", ".join(lacks)),
            missing=lacks,
            remedy="Add it to cell.toml, or choose another procedure.",
        )
