"""The measuring of a recovery by draw-wire: capture until the gate decides, then look where nothing was fitted."""

from dataclasses import dataclass, field, replace

from pydantic_core import to_jsonable_python

from cellcal.calibration.mastering.counts import MasteringRecord, WireCapture
from cellcal.calibration.mastering.drawn_walk import DrawnWalk
from cellcal.calibration.mastering.turn_recovery import TurnRecovery
from cellcal.drivers.interfaces import Joints
from cellcal.procedures.canonical import sha256_of
from cellcal.procedures.motion.check_plans import Known, plan_checks
from cellcal.procedures.motion.lost_plans import (
    compare_drawn,
    jogging_pace,
    plan_finer,
    plan_first,
    plan_next,
)
from cellcal.procedures.motion.pace import Pace
from cellcal.procedures.motion.plans import MotionPlan
from cellcal.procedures.motion.turn_doubt import Turns, doubt_after
from cellcal.procedures.motors import MotorState
from cellcal.procedures.questions import accept
from cellcal.procedures.recovery.record_seal import shown
from cellcal.procedures.recovery.recovery_result import (
    MEMORY_POWER,
    Effort,
    confirmed,
    confirmed_memory,
    judge,
    lacks_only_power,
    nothing_lost,
    refused,
    widest_u_rad,
)
from cellcal.procedures.recovery.recovery_spec import MasteringRecoverySpec
from cellcal.procedures.run import RefusalError, Run
from cellcal.procedures.steps.capture import StillCapture, capture
from cellcal.procedures.steps.motion import CountsToJoints, jog_to

FULL_CALIBRATION = "Have the robot inspected; a full calibration is advised before it works again."
DOUBT_SIGMAS = 2.0  # a motor this far from a whole turn may be a new one: worth a finer look


@dataclass
class Campaign:
    """What is known so far; rebuilt from the findings on every entry."""

    run: Run
    spec: MasteringRecoverySpec
    record: MasteringRecord
    state: MotorState
    mapping: CountsToJoints
    here: Joints
    doubt_turns: Turns  # of each motor, about where the mapping puts it
    kept: list[WireCapture] = field(default_factory=list)
    checks: list[WireCapture] = field(default_factory=list)
    visited: list[Joints] = field(default_factory=list)
    taken: int = 0
    again: int = 0
    set_aside: list[str] = field(default_factory=list)
    seconds: float = 0.0
    drawn: DrawnWalk | None = None

    async def jog_and_capture(self, pose: Joints, plan: MotionPlan, what: str, k: int) -> WireCapture:
        pace = self.pace()
        self.seconds += pace.jogging_s(self.here, pose)
        await self.run.move(f"go to {what} {k}", jog_to, pose, self.mapping, pace, plan.doubt)
        spec = self.spec
        still = await self.run.step(
            f"{what} {k}", capture, f"{what} {k}", spec.samples, spec.tolerance_counts
        )
        return self.arrived(still)

    def pace(self) -> Pace:
        """Return what no turn of a lost robot exceeds: its own cap, and the one of its flange and joints."""
        return jogging_pace(self.record.model, self.state.limits, self.spec.room)

    def arrived(self, still: StillCapture) -> WireCapture:
        self.here = self.mapping.joints(still.wire.counts)
        self.visited.append(self.here)
        return still.wire

    def effort(self) -> Effort:
        effort = Effort(self.taken, len(self.checks), self.again, self.seconds, tuple(self.set_aside))
        return replace(effort, drawn=self.drawn, jog_speed_rad_s=self.state.limits.jog_speed_rad_s)

    def refusal(self, recovery: TurnRecovery, reason: str, remedy: str, code: str) -> RefusalError:
        evidence = refused(self.record, recovery, self.effort(), reason)
        return RefusalError(f"nothing was written: {reason}", remedy=remedy, code=code, evidence=evidence)


async def check_the_memory(campaign: Campaign) -> TurnRecovery | None:
    """Look whether only the controller's memory was lost: the record's zero must hold at check poses.

    None where it does not hold, or where the poses in reach cannot tell; the captures then serve the search for
    turns.
    """
    run, spec, record = campaign.run, campaign.spec, campaign.record
    mapping, recovery = campaign.mapping, nothing_lost(record)
    campaign.mapping = CountsToJoints(record.drive, record.counts_at_zero, recovery.turns)
    campaign.here = campaign.mapping.joints(campaign.state.counts)
    looks: list[WireCapture] = []
    while len(looks) < spec.max_check_captures:
        looked = tuple(campaign.mapping.joints(look.counts) for look in looks)
        known = Known(
            campaign.here, tuple(campaign.visited), looked, recovery.offset_covariance, campaign.doubt_turns
        )
        name, count = f"plan the memory checks {len(looks) + 1}", 2 if looks else spec.check_captures
        plan = await run.solve(
            name, plan_checks, record, campaign.state, spec.room, known, count, MEMORY_POWER
        )
        if not looks:
            await run.step(
                "accept the memory checks", accept, shown(plan), sha256_of(to_jsonable_python(plan))
            )
        for pose in plan.poses_rad:
            looks.append(await campaign.jog_and_capture(pose, plan, "memory check", len(looks) + 1))
        held = await run.solve(
            f"confirm the memory {len(looks)}", confirmed_memory, record, recovery, tuple(looks)
        )
        if held.accepted:
            campaign.checks = looks
            return held
        if not lacks_only_power(held):
            break
    campaign.kept, campaign.mapping = looks, mapping
    campaign.here = mapping.joints(looks[-1].counts)
    campaign.visited = [mapping.joints(look.counts) for look in looks]
    return None


async def measure_until_decided(campaign: Campaign, guess: tuple[int, ...]) -> TurnRecovery:
    """Walk, capture and judge until the gate holds; refuse with the evidence where it cannot.

    Raises
    ------
    RefusalError
        The geometry changed, or all captures allowed did not decide.
    """
    run, spec = campaign.run, campaign.spec
    known = (campaign.record, campaign.state, spec.room)
    plan = await run.solve(
        "plan the first poses", plan_first, *known, campaign.here, spec.first_captures, campaign.doubt_turns
    )
    await run.step("accept the plan", accept, shown(plan), sha256_of(to_jsonable_python(plan)))
    for pose in plan.poses_rad:
        await _one_more(campaign, pose, plan)

    changed = False
    while True:
        captures = tuple(campaign.kept)
        name = f"judge the captures {campaign.taken}"
        known_new = tuple(axis - 1 for axis in spec.exchanged_axes)
        recovery = await run.solve(name, judge, campaign.record, captures, guess, known_new)
        campaign.doubt_turns = doubt_after(recovery, guess, campaign.doubt_turns)
        exhausted = campaign.taken >= spec.max_captures
        if recovery.accepted:
            if exhausted or not await _measure_finer(campaign, recovery):
                return recovery
            continue
        if (
            recovery.mode == "geometry" and changed
        ):  # two judgements in a row, the second with one capture more
            raise campaign.refusal(recovery, recovery.reason, FULL_CALIBRATION, "procedure.geometry_changed")
        if exhausted:
            reason = f"not decidable after {campaign.taken} captures: {recovery.reason}"
            remedy = "Check the wire's places and the hook, then start again or master by the marks."
            raise campaign.refusal(recovery, reason, remedy, "procedure.undecided")
        changed = recovery.mode == "geometry"
        await _measure_next(campaign, recovery)


async def _measure_finer(campaign: Campaign, recovery: TurnRecovery) -> bool:
    """Measure once more where offsets are no whole turns and not sure enough, or whole turns fit badly.

    A new motor that stands near a whole turn looks like lost turns; the doubt it leaves is what betrays it.
    """
    sure = widest_u_rad(recovery) <= campaign.spec.wanted_u_rad
    if sure and recovery.doubt_sigmas <= DOUBT_SIGMAS:
        return False
    known = (campaign.record, campaign.state, campaign.spec.room)
    name = f"plan one more pose {campaign.taken}"
    plan = await campaign.run.solve(name, plan_finer, *known, *_standing(campaign))
    if plan is None:
        return False
    await _one_more(campaign, plan.poses_rad[0], plan)
    return True


async def _measure_next(campaign: Campaign, recovery: TurnRecovery) -> None:
    """Measure a suspect capture again, once; otherwise the pose that tells most."""
    suspect = recovery.suspect_capture
    known = (campaign.record, campaign.state, campaign.spec.room)
    name = f"plan one more pose {campaign.taken}"
    plan = await campaign.run.solve(name, plan_next, *known, *_standing(campaign))
    target = plan.poses_rad[0]
    if suspect is not None:
        doubtful = campaign.kept.pop(suspect)
        campaign.set_aside.append(doubtful.label)
        target = campaign.mapping.joints(doubtful.counts)
        campaign.again += 1
    await _one_more(campaign, target, plan)


def _standing(campaign: Campaign) -> tuple[Joints, tuple[Joints, ...], Turns]:
    return campaign.here, tuple(campaign.visited), campaign.doubt_turns


async def _one_more(campaign: Campaign, pose: Joints, plan: MotionPlan) -> None:
    campaign.taken += 1
    campaign.kept.append(await campaign.jog_and_capture(pose, plan, "capture", campaign.taken))


async def confirm_elsewhere(campaign: Campaign, recovery: TurnRecovery) -> TurnRecovery:
    """Measure at poses that were not fitted, until a wrong turn of any motor would show."""
    run, spec, record = campaign.run, campaign.spec, campaign.record
    campaign.mapping = CountsToJoints(record.drive, recovery.counts_at_zero, (0,) * len(recovery.turns))
    count = spec.check_captures
    while True:
        checked = tuple(campaign.mapping.joints(check.counts) for check in campaign.checks)
        known = Known(campaign.here, tuple(campaign.visited), checked, recovery.offset_covariance)
        name = f"plan the checks {len(campaign.checks) + 1}"
        plan = await run.solve(name, plan_checks, record, campaign.state, spec.room, known, count)
        for pose in plan.poses_rad:
            k = len(campaign.checks) + 1
            campaign.checks.append(await campaign.jog_and_capture(pose, plan, "check", k))
        checks = tuple(campaign.checks)
        verified = await run.solve(f"confirm by checks {len(checks)}", confirmed, record, recovery, checks)
        if verified.accepted:
            return verified
        if not lacks_only_power(verified) or len(checks) >= spec.max_check_captures:
            remedy = "Check the wire, then start the recovery again."
            raise campaign.refusal(verified, verified.reason, remedy, "procedure.not_confirmed")
        count = 2


async def compare_with_drawn(campaign: Campaign, recovery: TurnRecovery) -> None:
    """Find how many evenly drawn poses would have been as sure; nothing depends on it but a remark."""
    record = campaign.record
    mapping = CountsToJoints(record.drive, recovery.counts_at_zero, (0,) * len(recovery.turns))
    walked = tuple(mapping.joints(capture.counts) for capture in campaign.kept)
    known = (record, campaign.state, campaign.spec.room)
    campaign.drawn = await campaign.run.solve("compare with drawn poses", compare_drawn, *known, walked)
