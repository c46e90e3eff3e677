"""What a survey with one draw-wire is: its rules, the robot before it, its plan, and what its lengths mean."""

import math
from dataclasses import dataclass, field, replace
from functools import cache
from typing import Annotated

import numpy as np
from pydantic import Field

from cellcal.calibration.arm.kinematics import RobotModel, load_model
from cellcal.calibration.geometry import Array, Pose, adjoint_matrix
from cellcal.calibration.mastering.counts import MasteringRecord
from cellcal.calibration.points.fixture import Triple, placing_covariance, worst_expanded_u
from cellcal.calibration.wires.design import with_poses
from cellcal.calibration.wires.model import WirePrior
from cellcal.calibration.wires.network import WireMounting, WireNetworkPrior, WirePlace
from cellcal.calibration.wires.network_fit import WireNetwork, fit_network
from cellcal.drivers.interfaces import Instruction, Joints
from cellcal.procedures.cell import GaugeSetup, MotionCaps
from cellcal.procedures.motion.plans import MotionBounds
from cellcal.procedures.motion.speed_limit import SpeedLimit, TimedMotion
from cellcal.procedures.setting_texts import (
    CANDIDATES,
    DRAWING_SIGMA,
    MAX_CAPTURES,
    MIN_CAPTURES,
    RETAKES,
    ROOM,
    SAMPLES,
    SEAT_SIGMA,
    SEED,
    describe_setting,
)
from cellcal.procedures.steps.length import LengthCapture
from cellcal.procedures.steps.pages import WIRE_CHECKS, PlannedMoves, straight_ways
from cellcal.procedures.survey.survey_motion import Wire

Captures = tuple[tuple[LengthCapture, ...], ...]  # of every spot
EACH_CAPTURE = "choose a pose", "go to pose", "capture"  # the phases that come with each

# Of a limit. How large the disturbances are shows fully at the last spot only, where the others cannot be mended any
# more: surveys that stopped at the limit itself ended above it every second time.
_PROMISE = 0.78


@dataclass(frozen=True, slots=True)
class SurveyRules:
    """The number of poses at each spot, the care of each, and the limits of motion."""

    min_captures: Annotated[int, Field(ge=4, le=100), MIN_CAPTURES] = 6
    max_captures: Annotated[int, Field(ge=4, le=200), MAX_CAPTURES] = 40
    candidates: Annotated[int, Field(ge=8, le=2000), CANDIDATES] = 90
    samples: Annotated[int, Field(ge=1, le=1000), SAMPLES] = 5
    retakes: Annotated[int, Field(ge=0, le=20), RETAKES] = 2
    scale_sigma: Annotated[
        float,
        Field(gt=0, le=0.01),
        describe_setting(
            "Scale error of the wire",
            "Standard deviation of the wire's scale by its certificate; 0.0001 is 0.1 mm per metre.",
            "doubt",
            unit="1",
        ),
    ] = 1e-4
    seat_sigma_m: Annotated[float, Field(gt=0, le=0.005), SEAT_SIGMA] = 2e-5
    drawing_sigma_m: Annotated[float, Field(ge=0, le=0.005), DRAWING_SIGMA] = 0.0
    seed: Annotated[int, Field(ge=0), SEED] = 1
    room: Annotated[MotionBounds, ROOM] = field(default_factory=MotionBounds)

    @property
    def point_sigma_m(self) -> float:
        """Standard uncertainty of one coordinate of a point, drawing and seat [m]."""
        return math.hypot(self.seat_sigma_m, self.drawing_sigma_m)


@dataclass(frozen=True, slots=True)
class RecordedWire:
    """The wire lengths of the mastering record: they tell the arm's errors, the wire's zero and its home."""

    joints_rad: tuple[Joints, ...]
    lengths_m: tuple[float, ...]
    sigma_m: tuple[float, ...]


@dataclass(frozen=True, slots=True)
class SurveyState:
    """The robot and its wire before a survey."""

    serial: str
    model: str
    joints_rad: Joints
    counts_at_zero: tuple[int, ...]  # empty where the robot keeps none
    epoch: int | None
    gauge_setup: GaugeSetup
    gauge_range_m: float
    gauge_sigma_m: float
    limits: MotionCaps
    recorded: RecordedWire | None  # None where there is no record of this very mastering

    def speed_limit(self, hook_in_flange_m: Triple, room: MotionBounds) -> SpeedLimit:
        """Return how fast the robot may go with the wire at this hook."""
        return SpeedLimit(self.model, hook_in_flange_m, self.limits.speed_rad_s, room.capped_tip_speed_m_s)


@dataclass(frozen=True, slots=True)
class WireSpot:
    """One place of the wire: which exit and which hook, which of both is sought, and how to get it there."""

    exit: int
    hook: int
    seeks_exit: bool
    instruction: Instruction


@dataclass(frozen=True, slots=True)
class SurveyGoal:
    """The frame that the spots' places stand for, roughly, and how well it must be known.

    With ``through``, the goal is another robot's base seen through that frame: the covariance of the other's
    alignment, or none yet, which is then expected to be as good as this one.
    """

    outer_inner: Pose
    points_in_inner_m: tuple[Triple, ...]
    origin_u_m: float
    angle_u_rad: float
    through: tuple[tuple[float, ...], ...] | None = None

    def is_promised_by(self, origin_u_m: float, angle_u_rad: float) -> bool:
        """Return whether what is expected at a spot will hold when all is measured."""
        return origin_u_m <= _PROMISE * self.origin_u_m and angle_u_rad <= _PROMISE * self.angle_u_rad


@dataclass(frozen=True, slots=True)
class SurveyPlan:
    """Limits of a survey: spots, the poses it may choose from, and what was not checked."""

    goal: SurveyGoal
    exits: tuple[WirePlace, ...]  # the wire's home comes first …
    hooks: tuple[WirePlace, ...]  # … and so does its first hook
    spots: tuple[WireSpot, ...]
    mouth_at_m: Triple | None  # where the wire's mouth is turned to at every spot; None where it stays
    way_to_rest_rad: tuple[Joints, ...]  # at the beginning; its end is the rest
    pools: tuple[tuple[Joints, ...], ...]  # of each spot, as drawn
    best: tuple[tuple[int, ...], ...]  # of each pool, those that tell most
    paces: tuple[SpeedLimit, ...]  # at each spot
    not_checked: tuple[str, ...]

    def planned_moves(self, rules: SurveyRules) -> PlannedMoves:
        """Return the plan as it is shown: at each spot the poses that tell most, as many as are surely gone to."""
        count = rules.min_captures
        chosen = [
            (f"{spot}.{k}", pose)
            for spot in range(1, len(self.spots) + 1)
            for k, pose in enumerate(self._expected_poses(spot - 1, count), 1)
        ]
        return PlannedMoves(
            ways_rad=straight_ways(pose for _, pose in chosen),
            speed_rad_s=self.total_motion(count).fastest_rad_s,
            checked=WIRE_CHECKS,
            not_checked=self.not_checked,
            most=len(self.spots) * rules.max_captures,
            names=tuple(name for name, _ in chosen),
        )

    def total_motion(self, count: int) -> TimedMotion:
        """Return how far and how long the arm goes, about: to so many poses of each spot, from the rest and back."""
        there = (
            straight_ways((*self._expected_poses(spot, count), self.rest_rad))
            for spot in range(len(self.spots))
        )
        tours = [pace.time_ways(self.rest_rad, ways) for pace, ways in zip(self.paces, there, strict=True)]
        return sum(tours[1:], start=tours[0])

    def _expected_poses(self, spot: int, count: int) -> tuple[Joints, ...]:
        pool = self.pools[spot]
        return tuple(pool[index] for index in (self.best[spot] or range(len(pool)))[:count])

    @property
    def rest_rad(self) -> Joints:
        """Where the robot stands while the wire is moved, and through which detours lead."""
        return self.way_to_rest_rad[-1]


@dataclass(frozen=True, slots=True)
class Survey:
    """A survey from its beginning: the robot and wire as found, the plan, the rules."""

    state: SurveyState
    plan: SurveyPlan
    rules: SurveyRules

    def nominal_model(self) -> RobotModel:
        """Return the robot's nominal model."""
        return _load_model(self.state.model)

    def wire_network_prior(self) -> WireNetworkPrior:
        """Return what is known of places, wire and arm before anything is measured."""
        at = self.state.gauge_setup
        wire = WirePrior(at.anchor_in_base_m, at.hook_in_flange_m)
        tight = WireNetworkPrior.with_certified_scale(
            wire, self.plan.exits, self.plan.hooks, self.rules.scale_sigma
        )
        return replace(tight, range_m=self.state.gauge_range_m)

    def place_of(self, spot: int) -> int:
        """Return which place a spot seeks: exits from 0, then hooks."""
        at = self.plan.spots[spot]
        return at.exit if at.seeks_exit else len(self.plan.exits) + at.hook

    def list_places(self) -> tuple[int, ...]:
        """Return which places the spots seek."""
        return tuple(self.place_of(spot) for spot in range(len(self.plan.spots)))

    def wire_at(self, spot: int) -> Wire:
        """Return where the wire runs at a spot, as far as is known before measuring."""
        at = self.plan.spots[spot]
        return (self.plan.exits[at.exit].at_m, self.plan.hooks[at.hook].at_m, self.state.gauge_range_m)

    def stations_at(self, spot: int, joints_rad: Array) -> Array:
        """Return from where a spot's place is seen, (N, 3): hooks in the base, or the exit in the flange [m]."""
        exit_m, hook_m, _ = self.wire_at(spot)
        if self.plan.spots[spot].seeks_exit:
            return np.asarray(self.nominal_model().tip_positions(joints_rad, np.array(hook_m)))
        flanges = self.nominal_model().base_flange(joints_rad)
        away = np.array(exit_m) - flanges[:, :3, 3]
        return np.asarray(np.einsum("nji,nj->ni", flanges[:, :3, :3], away))

    def make_mountings(self, captures: Captures) -> list[WireMounting]:
        """Return the record's lengths, then those of every spot that has some."""
        mountings = []
        if self.state.recorded is not None:
            wire, mouth = self.state.recorded, self.state.gauge_setup.mouth_at_m
            mountings.append(
                WireMounting(0, 0, wire.joints_rad, wire.lengths_m, wire.sigma_m, mouth, another_day=True)
            )
        for spot, taken in zip(self.plan.spots, captures, strict=True):
            if taken:
                joints = tuple(capture.joints_rad for capture in taken)
                lengths = tuple(capture.length_m for capture in taken)
                sigmas = tuple(capture.sigma_m for capture in taken)
                mountings.append(
                    WireMounting(spot.exit, spot.hook, joints, lengths, sigmas, self.plan.mouth_at_m)
                )
        return mountings

    def planned_mounting(self, spot: int, poses: Array) -> WireMounting:
        """Return captures that could be taken at a spot."""
        at = self.plan.spots[spot]
        sigma_m = self.state.gauge_sigma_m / 2.0 / self.rules.samples**0.5
        return with_poses(WireMounting(at.exit, at.hook, (), (), (), self.plan.mouth_at_m), poses, sigma_m)

    def best_poses(self, spot: int, count: int) -> Array:
        """Return the poses of a spot's pool that tell most, taken alone."""
        pool = self.plan.pools[spot]
        return np.array([pool[i] for i in self.plan.best[spot][:count]])

    def empty_captures(self) -> Captures:
        """Return captures of a survey that has not begun."""
        return ((),) * len(self.plan.spots)


def recorded_wire(record: MasteringRecord) -> RecordedWire:
    """Return the wire lengths of a mastering record."""
    wire, _ = record.wire_lengths()
    return RecordedWire(wire.joints_rad, wire.lengths_m, wire.sigma_m)


def goal_uncertainties(goal: SurveyGoal, covariance_m2: Array, seat_sigma_m: float) -> tuple[float, float]:
    """Return U (k = 2) of the goal's origin [m] and angle [rad]; with one point, its own and none of the angle.

    Two alignments of a base goal are taken as independent; `calibration.points.joint_bases` knows what they share.
    """
    if len(goal.points_in_inner_m) == 1:
        return worst_expanded_u(covariance_m2 + seat_sigma_m**2 * np.eye(3)), 0.0
    covariance = placing_covariance(goal.outer_inner, goal.points_in_inner_m, covariance_m2, seat_sigma_m)
    if goal.through is not None:
        other = np.array(goal.through) if goal.through else covariance
        carry = adjoint_matrix(goal.outer_inner.to_matrix())
        covariance = carry @ (covariance + other) @ carry.T
    return worst_expanded_u(covariance[:3, :3]), worst_expanded_u(covariance[3:, 3:])


def fit_survey(survey: Survey, captures: Captures) -> WireNetwork:
    """Fit all lengths taken so far, the record's included."""
    return fit_network(survey.nominal_model(), survey.wire_network_prior(), survey.make_mountings(captures))


@cache
def _load_model(name: str) -> RobotModel:
    return load_model(name)
