"""The hash that a mastering record carries, and the question before its poses are visited."""

from dataclasses import replace

from pydantic_core import to_jsonable_python

from cellcal.calibration.mastering.counts import MasteringRecord
from cellcal.calibration.message import make_message
from cellcal.drivers.interfaces import Instruction
from cellcal.procedures.canonical_json import sha256_of
from cellcal.procedures.motion.plan_words import PlanTour, plan_words
from cellcal.procedures.motion.plans import MotionPlan
from cellcal.procedures.motion.speed_limit import TimedMotion
from cellcal.procedures.steps.pages import WIRE_CHECKS, PlannedMoves, plan_page, straight_ways


def seal_record(record: MasteringRecord) -> MasteringRecord:
    """Return the record with the hash of its canonical JSON."""
    return replace(record, sha256=seal_of(record))


def seal_of(record: MasteringRecord) -> str:
    """Return the hash that a record must carry."""
    content = to_jsonable_python(replace(record, sha256=""))
    if record.kit is None:
        del content["kit"]  # the seal of a record without a kit is that of records older than kits
    return sha256_of(content)


def plan_instruction(plan: MotionPlan) -> Instruction:
    """Return the plan as a question for the technician."""
    fastest_rad_s = max(plan.speeds_rad_s)
    tour = PlanTour(len(plan.poses_rad), TimedMotion(plan.travel_rad, plan.moving_s, fastest_rad_s))
    what = make_message(
        "the robot with the wire hooked in, to {poses_rad_count} poses; the wire keeps its range",
        poses_rad_count=len(plan.poses_rad),
    )
    instruction = Instruction("accept_plan", plan_words(what, tour, plan.not_checked))
    moves = PlannedMoves(
        ways_rad=plan.ways_rad or straight_ways(plan.poses_rad),
        speed_rad_s=fastest_rad_s,
        checked=WIRE_CHECKS,
        not_checked=plan.not_checked,
        planned=dict.fromkeys(("go to pose", "capture"), len(plan.poses_rad)),
    )
    return plan_page(instruction, tour, moves)
