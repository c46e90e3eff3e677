"""The measuring of a recovery by draw-wire: capture until the gate decides, then look where nothing was fitted."""

from dataclasses import dataclass, field, replace

from pydantic_core import to_jsonable_python

from cellcal.calibration.mastering.counts import MasteringRecord, WireCapture
from cellcal.calibration.mastering.drawn_walk import DrawnWalk
from cellcal.calibration.mastering.turn_recovery import TurnRecovery
from cellcal.calibration.message import make_message
from cellcal.drivers.interfaces import Joints
from cellcal.procedures.canonical_json import sha256_of
from cellcal.procedures.motion.check_plans import CheckContext, plan_checks
from cellcal.procedures.motion.lost_plans import (
    compare_drawn,
    jogging_timing,
    plan_finer,
    plan_first,
    plan_next,
)
from cellcal.procedures.motion.plans import MotionPlan
from cellcal.procedures.motion.speed_limit import SpeedLimit
from cellcal.procedures.motion.turn_uncertainty import Turns, uncertainty_after
from cellcal.procedures.motors import MotorState
from cellcal.procedures.questions import ask_acceptance
from cellcal.procedures.recovery.record_seal import plan_instruction
from cellcal.procedures.recovery.recovery_result import (
    MEMORY_POWER,
    RecoveryEffort,
    confirm_memory,
    confirm_recovery,
    is_only_underpowered,
    judge_captures,
    nothing_lost_recovery,
    refused_result,
    widest_u_rad,
)
from cellcal.procedures.recovery.recovery_spec import MasteringRecoverySpec
from cellcal.procedures.run import RefusalError, Run
from cellcal.procedures.steps.capture import StillCapture, capture_still
from cellcal.procedures.steps.motion import CountsToJoints, jog_to

FULL_CALIBRATION = "Have the robot inspected; a full calibration is advised before it works again."
MARKS_FIRST = (
    "Did every axis stand at its mark of the reference pose when that was asked? If not, start again with the robot "
    "there. If it did, have the robot inspected; a full calibration is then advised."
)
DOUBT_SIGMAS = 2.0  # a motor this far from a whole turn may be a new one: worth a finer look


@dataclass
class RecoveryCampaign:
    """The captures and decisions so far; rebuilt from the findings on every entry."""

    run: Run
    spec: MasteringRecoverySpec
    record: MasteringRecord
    state: MotorState
    mapping: CountsToJoints
    here: Joints
    doubt_turns: Turns  # of each motor, about where the mapping puts it
    captures: list[WireCapture] = field(default_factory=list)
    checks: list[WireCapture] = field(default_factory=list)
    visited: list[Joints] = field(default_factory=list)
    taken: int = 0
    again: int = 0
    set_aside: list[str] = field(default_factory=list)
    seconds: float = 0.0
    drawn: DrawnWalk | None = None

    async def jog_and_capture(self, pose: Joints, plan: MotionPlan, what: str, k: int) -> WireCapture:
        pace = self.speed_limit()
        self.seconds += pace.jogging_s(self.here, pose)
        await self.run.move(f"go to {what} {k}", jog_to, pose, self.mapping, pace, plan.doubt)
        spec = self.spec
        still = await self.run.step(
            f"{what} {k}", capture_still, f"{what} {k}", spec.samples, spec.tolerance_counts
        )
        return self.add_capture(still)

    def speed_limit(self) -> SpeedLimit:
        """Return what no turn of a lost robot exceeds: its own cap, and the one of its flange and joints."""
        return jogging_timing(self.record.model, self.state.limits, self.spec.room)

    def add_capture(self, still: StillCapture) -> WireCapture:
        self.here = self.mapping.joints_at(still.wire.counts)
        self.visited.append(self.here)
        return still.wire

    def make_effort(self) -> RecoveryEffort:
        effort = RecoveryEffort(self.taken, len(self.checks), self.again, self.seconds, tuple(self.set_aside))
        return replace(effort, drawn=self.drawn, jog_speed_rad_s=self.state.limits.jog_speed_rad_s)

    def refused_error(self, recovery: TurnRecovery, reason: str, remedy: str, code: str) -> RefusalError:
        evidence = refused_result(self.record, recovery, self.make_effort(), reason)
        return RefusalError(
            make_message("nothing was written: {reason}", reason=reason),
            remedy=remedy,
            code=code,
            evidence=evidence,
        )


async def check_memory(campaign: RecoveryCampaign) -> TurnRecovery | None:
    """Look whether only the controller's memory was lost: the record's zero must hold at check poses.

    None where it does not hold, or where the poses in reach cannot tell; the captures then serve the search for
    turns.
    """
    run, spec, record = campaign.run, campaign.spec, campaign.record
    mapping, recovery = campaign.mapping, nothing_lost_recovery(record)
    campaign.mapping = CountsToJoints(record.drive, record.counts_at_zero, recovery.turns)
    campaign.here = campaign.mapping.joints_at(campaign.state.counts)
    looks: list[WireCapture] = []
    while len(looks) < spec.max_check_captures:
        looked = tuple(campaign.mapping.joints_at(look.counts) for look in looks)
        context = CheckContext(
            campaign.here, tuple(campaign.visited), looked, recovery.offset_covariance, campaign.doubt_turns
        )
        name, count = f"plan the memory checks {len(looks) + 1}", 2 if looks else spec.check_captures
        plan = await run.solve(
            name, plan_checks, record, campaign.state, spec.room, context, count, MEMORY_POWER
        )
        if not looks:
            await run.step(
                "accept the memory checks",
                ask_acceptance,
                plan_instruction(plan),
                sha256_of(to_jsonable_python(plan)),
            )
        for pose in plan.poses_rad:
            looks.append(await campaign.jog_and_capture(pose, plan, "memory check", len(looks) + 1))
        memory_check = await run.solve(
            f"confirm the memory {len(looks)}", confirm_memory, record, recovery, tuple(looks)
        )
        if memory_check.accepted:
            campaign.checks = looks
            return memory_check
        if not is_only_underpowered(memory_check):
            break
    campaign.captures, campaign.mapping = looks, mapping
    campaign.here = mapping.joints_at(looks[-1].counts)
    campaign.visited = [mapping.joints_at(look.counts) for look in looks]
    return None


async def measure_until_decided(campaign: RecoveryCampaign, guess: tuple[int, ...]) -> TurnRecovery:
    """Walk, capture and judge until the gate holds; refuse with the evidence where it cannot.

    Raises
    ------
    RefusalError
        The geometry changed, or all captures allowed did not decide.
    """
    run, spec = campaign.run, campaign.spec
    known_values = (campaign.record, campaign.state, spec.room)
    plan = await run.solve(
        "plan the first poses",
        plan_first,
        *known_values,
        campaign.here,
        spec.first_captures,
        campaign.doubt_turns,
    )
    await run.step(
        "accept the plan", ask_acceptance, plan_instruction(plan), sha256_of(to_jsonable_python(plan))
    )
    for pose in plan.poses_rad:
        await _capture_one_more(campaign, pose, plan)

    changed = False
    while True:
        captures = tuple(campaign.captures)
        name = f"judge the captures {campaign.taken}"
        known_new = tuple(axis - 1 for axis in spec.exchanged_axes)
        recovery = await run.solve(name, judge_captures, campaign.record, captures, guess, known_new)
        campaign.doubt_turns = uncertainty_after(recovery, guess, campaign.doubt_turns)
        exhausted = campaign.taken >= spec.max_captures
        if recovery.accepted:
            if exhausted or not await _measure_finer(campaign, recovery):
                return recovery
            continue
        if (
            recovery.mode == "geometry" and changed
        ):  # two judgements in a row, the second with one capture more
            remedy = MARKS_FIRST if spec.last_counts is None else FULL_CALIBRATION
            raise campaign.refused_error(recovery, recovery.reason, remedy, "procedure.geometry_changed")
        if exhausted:
            reason = make_message(
                "not decidable after {taken} captures, the most that this run takes: {recovery_reason}.",
                taken=campaign.taken,
                recovery_reason=recovery.reason,
            )
            remedy = "Check the wire's places and the hook, then start again or master by the marks."
            raise campaign.refused_error(recovery, reason, remedy, "procedure.undecided")
        changed = recovery.mode == "geometry"
        await _measure_next(campaign, recovery)


async def _measure_finer(campaign: RecoveryCampaign, recovery: TurnRecovery) -> bool:
    """Measure once more where offsets are no whole turns and not sure enough, or whole turns fit badly.

    A new motor that stands near a whole turn looks like lost turns; the doubt it leaves is what betrays it.
    """
    sure = widest_u_rad(recovery) <= campaign.spec.wanted_u_rad
    if sure and recovery.doubt_sigmas <= DOUBT_SIGMAS:
        return False
    known_values = (campaign.record, campaign.state, campaign.spec.room)
    name = f"plan one more pose {campaign.taken}"
    plan = await campaign.run.solve(name, plan_finer, *known_values, *_arm_position(campaign))
    if plan is None:
        return False
    await _capture_one_more(campaign, plan.poses_rad[0], plan)
    return True


async def _measure_next(campaign: RecoveryCampaign, recovery: TurnRecovery) -> None:
    """Measure a suspect capture again, once; otherwise the pose that tells most."""
    suspect = recovery.suspect_capture
    known_values = (campaign.record, campaign.state, campaign.spec.room)
    name = f"plan one more pose {campaign.taken}"
    plan = await campaign.run.solve(name, plan_next, *known_values, *_arm_position(campaign))
    target = plan.poses_rad[0]
    if suspect is not None:
        doubtful = campaign.captures.pop(suspect)
        campaign.set_aside.append(doubtful.label)
        target = campaign.mapping.joints_at(doubtful.counts)
        campaign.again += 1
    await _capture_one_more(campaign, target, plan)


def _arm_position(campaign: RecoveryCampaign) -> tuple[Joints, tuple[Joints, ...], Turns]:
    return campaign.here, tuple(campaign.visited), campaign.doubt_turns


async def _capture_one_more(campaign: RecoveryCampaign, pose: Joints, plan: MotionPlan) -> None:
    campaign.taken += 1
    campaign.captures.append(await campaign.jog_and_capture(pose, plan, "capture", campaign.taken))


async def confirm_elsewhere(campaign: RecoveryCampaign, recovery: TurnRecovery) -> TurnRecovery:
    """Measure at poses that were not fitted, until a wrong turn of any motor would show."""
    run, spec, record = campaign.run, campaign.spec, campaign.record
    campaign.mapping = CountsToJoints(record.drive, recovery.counts_at_zero, (0,) * len(recovery.turns))
    count = spec.check_captures
    while True:
        checked = tuple(campaign.mapping.joints_at(check.counts) for check in campaign.checks)
        context = CheckContext(campaign.here, tuple(campaign.visited), checked, recovery.offset_covariance)
        name = f"plan the checks {len(campaign.checks) + 1}"
        plan = await run.solve(name, plan_checks, record, campaign.state, spec.room, context, count)
        for pose in plan.poses_rad:
            k = len(campaign.checks) + 1
            campaign.checks.append(await campaign.jog_and_capture(pose, plan, "check", k))
        checks = tuple(campaign.checks)
        verified = await run.solve(
            f"confirm by checks {len(checks)}", confirm_recovery, record, recovery, checks
        )
        if verified.accepted:
            return verified
        if not is_only_underpowered(verified) or len(checks) >= spec.max_check_captures:
            remedy = "Check the wire, then start the recovery again."
            raise campaign.refused_error(verified, verified.reason, remedy, "procedure.not_confirmed")
        count = 2


async def compare_with_drawn(campaign: RecoveryCampaign, recovery: TurnRecovery) -> None:
    """Find how many evenly drawn poses would have been as sure; nothing depends on it but a remark."""
    record = campaign.record
    mapping = CountsToJoints(record.drive, recovery.counts_at_zero, (0,) * len(recovery.turns))
    walked = tuple(mapping.joints_at(capture.counts) for capture in campaign.captures)
    known_values = (record, campaign.state, campaign.spec.room)
    campaign.drawn = await campaign.run.solve(
        "compare with drawn poses", compare_drawn, *known_values, walked
    )
