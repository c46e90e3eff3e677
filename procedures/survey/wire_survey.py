"""A survey with one draw-wire: it is moved from spot to spot by hand, and the robot to poses chosen one by one.

Shared by the fixture alignment (the wire's exit moves) and the end-effector's points (its hook moves). After each
capture the survey knows how well the frame sought would be known; it goes on while that is not enough.
"""

from dataclasses import dataclass

from cellcal.calibration.message import make_message
from cellcal.calibration.wires.network_fit import WireNetwork
from cellcal.drivers.interfaces import Joints
from cellcal.procedures.cell import Cell
from cellcal.procedures.motion.speed_limit import SpeedLimit
from cellcal.procedures.questions import ask_confirmation
from cellcal.procedures.refit import LEFT_OUT, MEASURED_AGAIN
from cellcal.procedures.robot_condition import read_reached_condition
from cellcal.procedures.run import NeedsUnmetError, RefusalError, Run
from cellcal.procedures.steps.length import LengthCapture, capture_length
from cellcal.procedures.steps.mastering import (
    length_gauge,
    nominal_model,
    refuse_other_model,
    refuse_unhealthy,
)
from cellcal.procedures.steps.motion import follow_way
from cellcal.procedures.survey.survey import (
    Captures,
    RecordedWire,
    Survey,
    SurveyPlan,
    SurveyState,
    fit_survey,
    recorded_wire,
)
from cellcal.procedures.survey.survey_choice import SpotChoice, SurveyProgress, choose_pose
from cellcal.procedures.verdict import SetAside

LEAST_LEFT = 4  # lengths at a spot: three fix a point and show no wrong one


async def read_survey_state(cell: Cell) -> SurveyState:
    """Read who the robot is, where it stands and what its record says about the wire; refuse a sick robot."""
    gauge, model = length_gauge(cell), nominal_model(cell)
    if cell.gauge_setup is None:
        raise NeedsUnmetError("the cell file does not say where the wire is fixed", missing=("gauge_setup",))
    condition, identity = await read_reached_condition(cell.robot), await cell.robot.identify()
    mastering = None if cell.mastering is None else await cell.mastering.read_mastering()
    refuse_unhealthy(condition, mastering)
    joints_rad = (await cell.robot.read_joints()).joints_rad
    refuse_other_model(model, joints_rad, await cell.robot.flange_pose())
    counts_at_zero = () if mastering is None else mastering.counts_at_zero
    return SurveyState(
        serial=identity.serial,
        model=model.name,
        joints_rad=joints_rad,
        counts_at_zero=counts_at_zero,
        epoch=None if cell.mastering is None else await cell.mastering.encoder_epoch(),
        gauge_setup=cell.gauge_setup,
        gauge_range_m=gauge.capabilities.range_m,
        gauge_sigma_m=gauge.capabilities.sigma_m,
        limits=cell.limits,
        recorded=_recorded_wire(cell, identity.serial, counts_at_zero),
    )


def _recorded_wire(cell: Cell, serial: str, counts_at_zero: tuple[int, ...]) -> RecordedWire | None:
    record = cell.record
    if record is None or record.wire is None:
        return None
    if (record.robot_serial, record.counts_at_zero) != (serial, counts_at_zero):
        return None
    return recorded_wire(record)


@dataclass(frozen=True, slots=True)
class SurveyCaptures:
    """The captures of every spot that the fit uses, and those that the others contradicted."""

    captures: Captures
    set_aside: tuple[SetAside, ...]


async def measure_spots(run: Run, survey: Survey) -> SurveyCaptures:
    """Have the wire moved to every spot, and measure there until the goal is in reach."""
    walk = _SurveyRun(run, survey)
    for spot, place in enumerate(survey.plan.spots):
        await walk.go_to_rest(spot)
        await run.step(f"move the wire {spot + 1}", ask_confirmation, place.instruction)
        await walk.measure_spot(spot)
    return SurveyCaptures(walk.valid_captures(), tuple(walk.set_aside))


@dataclass(frozen=True, slots=True)
class _SpotLength:
    """A capture, and the step that took it."""

    step: str
    capture: LengthCapture


class _SurveyRun:
    """The progress of a survey between steps; everything in it comes from findings."""

    def __init__(self, run: Run, survey: Survey) -> None:
        self._run, self._survey = run, survey
        self._taken: list[list[_SpotLength]] = [[] for _ in survey.plan.spots]
        self._lost_one: set[int] = set()  # spots that a length was left out of
        self.set_aside: list[SetAside] = []
        self._here_rad, self._factor = survey.state.joints_rad, 1.0
        self._choices = self._poses = self._looks = 0

    def valid_captures(self) -> Captures:
        return tuple(tuple(length.capture for length in spot) for spot in self._taken)

    async def go_to_rest(self, spot: int) -> None:
        """Bring the robot where the wire can be moved: every pose gone to has a free way there."""
        plan = self._survey.plan
        way_rad = plan.way_to_rest_rad if spot == 0 else (plan.rest_rad,)
        await self._go_along(f"go to rest {spot + 1}", way_rad, plan.paces[spot])
        self._here_rad = plan.rest_rad

    async def measure_spot(self, spot: int) -> None:
        """Capture at one spot until more is not needed, or not allowed."""
        looked = False
        while True:
            choice = await self._choose_pose(spot)
            if choice.way_rad:
                self._taken[spot].append(await self._visit_pose(spot, choice.way_rad))
                looked = False
            elif not looked:
                await self._check_lengths(spot)
                looked = True
            else:
                return

    async def _choose_pose(self, spot: int) -> SpotChoice:
        self._choices += 1
        standing = SurveyProgress(self.valid_captures(), spot, self._here_rad, self._factor)
        choice = await self._run.solve(f"choose a pose {self._choices}", choose_pose, self._survey, standing)
        if choice.ambiguous or choice.unreachable:
            raise _no_pose_error(spot, choice)
        return choice

    async def _visit_pose(self, spot: int, way_rad: tuple[Joints, ...]) -> _SpotLength:
        self._poses += 1
        number = self._poses
        await self._go_along(f"go to pose {number}", way_rad, self._survey.plan.paces[spot])
        self._here_rad = way_rad[-1]
        label = f"spot {spot + 1}, pose {number}"
        step = f"capture {number}"
        return _SpotLength(
            step, await self._run.step(step, capture_length, label, self._survey.rules.samples)
        )

    async def _go_along(self, name: str, way_rad: tuple[Joints, ...], pace: SpeedLimit) -> None:
        await self._run.move(name, follow_way, way_rad, pace.joint_speed_rad_s, pace=pace)

    async def _check_lengths(self, spot: int) -> None:
        """Fit what is there, and mend the length that the others contradict; refuse what stays contradictory.

        Here it is taken again. One that stays as it was, or is of a spot that the wire has left, is left out: one at
        each spot, for what is wrong with more of them is wrong with the spot.
        """
        retakes = self._survey.rules.retakes
        while True:
            self._looks += 1
            name = f"look at the lengths {self._looks}"
            network = await self._run.solve(name, fit_survey, self._survey, self.valid_captures())
            self._factor = network.disturbance_factor
            if network.is_consistent():
                return
            at = network.worst_mounting - (self._survey.state.recorded is not None)
            if at == spot and retakes > 0:
                retakes -= 1
                await self._take_again(spot, network.worst_capture)
            elif self._is_redundant(at):
                self._leave_out(at, network.worst_capture)
            else:
                raise _contradiction_error(self._survey.plan, network, at, self.valid_captures())

    async def _take_again(self, spot: int, worst: int) -> None:
        doubted = self._taken[spot][worst]
        self.set_aside.append(SetAside(doubted.step, MEASURED_AGAIN))
        way_rad = (self._survey.plan.rest_rad, doubted.capture.joints_rad)
        self._taken[spot][worst] = await self._visit_pose(spot, way_rad)

    def _is_redundant(self, spot: int) -> bool:
        return spot >= 0 and spot not in self._lost_one and len(self._taken[spot]) > LEAST_LEFT

    def _leave_out(self, spot: int, worst: int) -> None:
        self._lost_one.add(spot)
        self.set_aside.append(SetAside(self._taken[spot].pop(worst).step, LEFT_OUT))


def _no_pose_error(spot: int, choice: SpotChoice) -> RefusalError:
    if choice.ambiguous:
        return RefusalError(
            choice.ambiguous,
            code="procedure.ambiguous",
            remedy="Widen the workspace box, or put the wire where the robot reaches well to both sides of it; then "
            "start a new run.",
            evidence=choice,
        )
    return RefusalError(
        make_message(
            "no further pose at spot {spot} can be reached with the wire clear of the arm", spot=spot + 1
        ),
        code="procedure.unreachable",
        remedy="Widen the workspace box, allow more candidates, or move fixture or wire; then start a new run.",
        evidence=choice,
    )


def _contradiction_error(plan: SurveyPlan, network: WireNetwork, spot: int, taken: Captures) -> RefusalError:
    if spot < 0:
        return RefusalError(
            "the lengths contradict those of the mastering record: arm, wire or hook have changed since",
            code="procedure.record_outdated",
            remedy="Take a new mastering record, then start a new run.",
            evidence=network,
        )
    label = taken[spot][network.worst_capture].label
    return RefusalError(
        make_message(
            "the lengths contradict each other: {label} stands out by {worst_deviation:.1f} "
            "deviations, residual {residual_rms_mm:.2f} mm RMS",
            label=label,
            worst_deviation=network.worst_deviation,
            residual_rms_mm=network.residual_rms_m * 1000.0,
        ),
        code="procedure.lengths_inconsistent",
        remedy=make_message(
            "See that the wire is where '{instruction_text}' says, hangs free and is not touched; "
            "then start a new run.",
            instruction_text=plan.spots[spot].instruction.text,
        ),
        evidence=network,
    )
