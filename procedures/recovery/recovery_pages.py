"""What a screen draws of a recovery: what a tenth of a degree is worth at the tool, and what goes from old to new."""

from typing import Any

import numpy as np

from cellcal.calibration.arm.kinematics import load_model
from cellcal.calibration.mastering.counts import MasteringRecord
from cellcal.calibration.mastering.turn_recovery import TurnRecovery
from cellcal.calibration.message import make_message
from cellcal.drivers.interfaces import Instruction
from cellcal.procedures.instruction_page import PagedInstruction, with_page
from cellcal.procedures.steps.pages import axis_levers, joint_displacement


def levers_page(instruction: Instruction, record: MasteringRecord) -> PagedInstruction:
    """Return an instruction with what a tenth of a degree of each axis displaces the hook, where the record began."""
    levers = axis_levers(load_model(record.model), record.reference_joints_rad, _hook_position(record))
    return with_page(instruction, "ask", axes=levers)


def correction_page(
    instruction: Instruction, record: MasteringRecord, recovery: TurnRecovery
) -> PagedInstruction:
    """Return the correction of a mastering on its page: old and new counts, their effect at the tool, the gate."""
    model = load_model(record.model)
    offsets = record.drive.radians_per_turn() @ np.array(recovery.offset_turns)
    postures = np.array([record.reference_joints_rad])
    if record.wire is not None and record.captures:
        postures = record.capture_joints_rad()
    levers = axis_levers(model, record.reference_joints_rad, _hook_position(record))
    rows = zip(
        levers, record.counts_at_zero, recovery.counts_at_zero, offsets, recovery.offset_u_rad, strict=True
    )
    axes = [
        {
            **lever,
            "before": float(old),
            "after": float(new),
            "offset_rad": float(off),
            "u_rad": u,
            "turns": turns,
        }
        for (lever, old, new, off, u), turns in zip(rows, recovery.turns, strict=True)
    ]
    changes: list[dict[str, Any]] = [
        {
            "name": make_message("{name}: counts at zero", name=axis["name"]),
            "before": axis["before"],
            "after": axis["after"],
            "unit": "count",
        }
        for axis in axes
    ]
    gate = [
        {
            "name": check.name,
            "decision": "pass" if check.passed else "fail",
            "value": check.found,
            "limit": check.limit,
            "unit": "1",
            "rule": check.sentence,
            "expanded_uncertainty": 0.0,
        }
        for check in recovery.gate
    ]
    review = {
        "word": "pass" if recovery.accepted else "undecided",
        "limits_from": "",
        "characteristics": gate,
        "changes": changes,
        "displacement": joint_displacement(
            model, [tuple(q) for q in postures], tuple(float(v) for v in offsets), _hook_position(record)
        ),
        "set_aside": [],
        "not_verified": [],
        "to_sign": [],
        "writes": True,
        "write_anyway": "",
    }
    return with_page(instruction, "review", axes=axes, review=review)


def _hook_position(record: MasteringRecord) -> tuple[float, ...]:
    return (0.0, 0.0, 0.0) if record.prior is None else tuple(record.prior.hook_in_flange_m)
