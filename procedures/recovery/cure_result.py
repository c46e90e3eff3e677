"""What is left of a lost position after the work at the pendant: each axis, as the lengths prove it."""

from dataclasses import dataclass

import numpy as np

from cellcal.calibration.mastering.counts import MasteringRecord
from cellcal.calibration.mastering.hypothesis_report import BLIND_SIGMAS
from cellcal.calibration.mastering.position_record import ArmPositionRecord, ShownValue
from cellcal.calibration.mastering.turn_recovery import TurnRecovery
from cellcal.calibration.mastering.turn_results import GateCheck
from cellcal.calibration.message import make_message
from cellcal.drivers.interfaces import PositionCure
from cellcal.procedures.recovery.pendant_cures import AxisCure, Zero, axis_name


@dataclass(frozen=True, slots=True)
class AxisProof:
    """One axis: where it stands against what the controller shows, and what no measurement could tell."""

    name: str  # as the maker calls it
    brought_back: bool  # in this run
    zero: Zero  # as it was to be set
    found: Zero  # kept: off by whole motor turns, or by none
    turns_off: int
    offset_rad: float  # by which the joint stands beyond what the controller shows
    u_rad: float  # k = 2; 0.0 where whole turns are exact
    hidden_rad: float  # a smaller offset than this could hide in the lengths; of whole turns

    @property
    def is_right(self) -> bool:
        """Whether an axis whose zero was to be kept stands where the controller shows it."""
        return self.found == "kept" and self.turns_off == 0


@dataclass(frozen=True, slots=True)
class PositionCureResult:
    """The actions at the pendant, and what the lengths prove of them."""

    cure: PositionCure
    axes: tuple[AxisProof, ...]
    reason: str
    gate: tuple[GateCheck, ...]
    captures: int
    check_captures: int
    robot_seconds: float
    set_aside: tuple[str, ...]
    changed_constants: tuple[str, ...]  # data of the machine that are not those of the record
    shown: tuple[ShownValue, ...]  # after the cure


def changed_constants(
    record: ArmPositionRecord, shown: tuple[ShownValue, ...], renewed: tuple[int, ...] = ()
) -> tuple[str, ...]:
    """Return which data of the machine differ from those of the record; what one of both lacks is not compared.

    Zeros of the axes in ``renewed``, from 0, were made anew, and must differ.
    """

    def is_compared(value: ShownValue) -> bool:
        return value.is_constant or (value.is_zero and value.axis not in renewed)

    before = {(value.name, value.axis): value.value for value in record.shown if is_compared(value)}
    return tuple(
        make_message(
            "{name} of axis {axis}: {before}, now {now}",
            name=value.name,
            axis=0 if value.axis is None else value.axis + 1,
            before=before[value.name, value.axis],
            now=value.value,
        )
        for value in shown
        if is_compared(value) and before.get((value.name, value.axis), value.value) != value.value
    )


def prove_axes(
    record: MasteringRecord, recovery: TurnRecovery, cure: PositionCure, cures: tuple[AxisCure, ...]
) -> tuple[AxisProof, ...]:
    """Return for every axis what a solution that the gate let pass says of it."""
    planned = {each.axis: each.zero for each in cures}
    axes = range(len(record.counts_at_zero))
    offsets = record.drive.radians_per_turn() @ np.array(recovery.offset_turns)
    per_turn = np.abs(np.diag(record.drive.radians_per_turn()))
    blind = recovery.blind_turns or tuple(BLIND_SIGMAS * sigma for sigma in recovery.sigma_turns)
    real = set(axes) if recovery.mode == "all" else set(recovery.replaced_axes)
    return tuple(
        AxisProof(
            name=axis_name(cure, axis),
            brought_back=axis in planned,
            zero=planned.get(axis, "kept"),
            found="new" if axis in real else "kept",
            turns_off=0 if axis in real else recovery.turns[axis],
            offset_rad=float(offsets[axis]),
            u_rad=recovery.offset_u_rad[axis],
            hidden_rad=0.0 if axis in real else float(blind[axis] * per_turn[axis]),
        )
        for axis in axes
    )
