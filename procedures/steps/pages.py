"""What a screen draws beside an instruction: plans, points that were taught, results before they are kept.

Everything here is data for a page of some kind (`procedures.instruction_page.InstructionPage`), never an input of a
step: the words of an instruction stand in the journal, its picture does not. A new procedure picks one of these kinds
and needs no page of its own.
"""

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from pydantic_core import to_jsonable_python

from cellcal.calibration.arm.kinematics import RobotModel
from cellcal.calibration.geometry import Pose, log_rotation
from cellcal.drivers.interfaces import Instruction, Joints
from cellcal.procedures.forecast import Prediction
from cellcal.procedures.instruction_page import PagedInstruction, page_of, with_page
from cellcal.procedures.motion.plan_words import PlanTour
from cellcal.procedures.questions import tips_at
from cellcal.procedures.verdict import ProcedureVerdict, ValueChange

Way = Sequence[Joints]
LEVER_M = 0.5  # from a frame's origin: where its change is told as a length
TENTH_RAD = math.radians(0.1)
ARM_CHECKS = ("joint_limits", "speeds", "distances")  # what every plan with a model of the arm was held to
WIRE_CHECKS = (*ARM_CHECKS, "wire")


@dataclass(frozen=True, slots=True)
class PlannedMoves:
    """A plan as it is shown: where the arm goes, how fast, what was checked and what was not.

    ``most`` are the poses that will be gone to at most, where the measurements choose among those shown.
    """

    ways_rad: tuple[Way, ...]  # the corners to each pose; the last of each is the pose
    speed_rad_s: float
    checked: tuple[str, ...]
    not_checked: tuple[str, ...]
    most: int | None = None
    predictions: tuple[Prediction, ...] = ()
    names: tuple[str, ...] = ()
    planned: Mapping[str, int] = field(default_factory=dict)  # how often a phase of the outline is expected


def straight_ways(poses_rad: Iterable[Joints]) -> tuple[Way, ...]:
    """Return ways without corners."""
    return tuple((tuple(pose),) for pose in poses_rad)


def plan_page(instruction: Instruction, tour: PlanTour, moves: PlannedMoves) -> PagedInstruction:
    """Return a plan on its page: a client with a picture draws its poses as ghosts."""
    names = moves.names or tuple(str(k) for k in range(1, len(moves.ways_rad) + 1))
    poses = [
        {"name": name, "joints_rad": list(way[-1]), "way_rad": [list(corner) for corner in way[:-1]]}
        for name, way in zip(names, moves.ways_rad, strict=True)
    ]
    plan = {
        "poses": poses,
        "most": moves.most,
        "planned": dict(moves.planned),
        "speed_rad_s": moves.speed_rad_s,
        "duration_s": 60.0 * tour.duration_min,
        "checked": moves.checked,
        "not_checked": [line for line in moves.not_checked if line],
        "predictions": [_prediction_to_json(one) for one in moves.predictions],
    }
    return with_page(instruction, "approve", plan=plan)


def review_page(
    instruction: Instruction, verdict: ProcedureVerdict, *, writes: bool, write_anyway: str = ""
) -> PagedInstruction:
    """Return a result on its page before it is kept; ``writes`` says that a controller will be changed by a yes."""
    document = verdict.to_json()
    shown_keys = ("word", "limits_from", "characteristics", "changes", "set_aside", "not_verified", "to_sign")
    review = {key: document[key] for key in shown_keys} | {"writes": writes, "write_anyway": write_anyway}
    return with_page(instruction, "review", review=review)


def with_changes(
    instruction: Instruction, changes: Iterable[ValueChange], **displacement: float | str
) -> PagedInstruction:
    """Return a page of review with what goes from old to new.

    ``displacement``: ``most_m``, by how much a point is displaced at most, and ``at``, which point that is.
    """
    shown = with_page(instruction, page_of(instruction).kind)
    review = {**shown.page.data.get("review", {}), "changes": to_jsonable_python(list(changes))}
    return with_page(shown, "review", review=review | {"displacement": displacement or None})


def frame_displacement(before: Pose, after: Pose, *, lever_m: float = LEVER_M) -> dict[str, float | str]:
    """Return by how much a point at ``lever_m`` from a frame's origin is displaced at most, in whatever direction."""
    away_m = math.dist(before.position_m, after.position_m)
    turn = log_rotation(before.rotation_matrix().T @ after.rotation_matrix())
    chord_m = 2.0 * lever_m * math.sin(min(float(np.linalg.norm(turn)), math.pi) / 2.0)
    return {"most_m": away_m + chord_m, "at": "lever" if lever_m else "tip", "lever_m": lever_m}


def joint_displacement(
    model: RobotModel,
    joints_rad: Iterable[Joints],
    turned_rad: Sequence[float],
    tip_in_flange_m: Sequence[float],
) -> dict[str, float | str]:
    """Return by how much the tip is displaced at most, over postures, if every joint is off by ``turned_rad``."""
    here = np.array([tuple(q) for q in joints_rad])
    tips = [tips_at(model, q, tip_in_flange_m) for q in (here, here + np.array(turned_rad))]
    return {"most_m": float(np.linalg.norm(tips[1] - tips[0], axis=1).max()), "at": "postures"}


def axis_levers(
    model: RobotModel, joints_rad: Joints, tip_in_flange_m: Sequence[float] = (0.0, 0.0, 0.0)
) -> list[dict[str, Any]]:
    """Return for each axis by how much a tenth of a degree displaces the tip in a posture [m]."""
    here = np.array([joints_rad])
    turned = here + np.eye(model.axis_count) * TENTH_RAD
    away = tips_at(model, turned, tip_in_flange_m) - tips_at(model, here, tip_in_flange_m)
    lengths = np.linalg.norm(away, axis=1)
    return [
        {"name": name, "tenth_degree_m": float(length)}
        for name, length in zip(model.joint_names, lengths, strict=True)
    ]


def points_page(
    instruction: Instruction, points: Sequence[tuple[str, str]], meter: Mapping[str, Any] | None
) -> PagedInstruction:
    """Return a point to be taught on its page.

    ``points`` are all points of the step's kind in order: their name and ``recorded``, ``now``, ``to_do`` or
    ``anew``. ``meter`` is what `procedures.steps.meters` reads while the arm is brought there.
    """
    listed = [{"name": name, "state": state} for name, state in points]
    return with_page(instruction, "teach", points=listed, meter=None if meter is None else dict(meter))


def point_states(names: Sequence[str], now: int) -> list[tuple[str, str]]:
    """Return points that are taught one after the other, the one at ``now`` being asked for."""
    return [(name, "recorded" if k < now else "now" if k == now else "to_do") for k, name in enumerate(names)]


def _prediction_to_json(one: Prediction) -> dict[str, Any]:
    return {"name": one.name, "expanded": one.expanded, "unit": one.unit, "limits": dict(one.limits)}
