"""Steps that feel for a surface with a touch probe: slowly, guarded all the way, and stopped at the first contact.

The arm travels on while probe, cable and program notice the touch. Where it was at the touch itself comes from
joint readings around it; what their times leave open is part of the uncertainty.
"""

import math
import statistics
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from cellcal.calibration.message import make_message
from cellcal.drivers.interfaces import ContactEdge, Joints, TouchProbe
from cellcal.procedures.cell import Cell, ProbeSetup
from cellcal.procedures.motion import motion_gate
from cellcal.procedures.motion.guarded_move import GuardedTravel, move_until_contact
from cellcal.procedures.motion.joint_history import ContactPosition, position_between
from cellcal.procedures.motion.motion_gate import MotionCare
from cellcal.procedures.motion.probe_line import Place, ProbeLine, probe_line
from cellcal.procedures.motion.robot_readiness import loop_time
from cellcal.procedures.procedure_definition import NEEDS
from cellcal.procedures.run import NeedsUnmetError
from cellcal.procedures.steps.contact_errors import (
    AlreadyInContactError,
    BouncingContactError,
    ContactError,
    ContactLostError,
    NoContactError,
    OvertravelError,
    StuckContactError,
)
from cellcal.procedures.steps.teach import is_still

PROBING_CAP_M_S = 0.002
STOP_S = 0.2  # a controller's own reaction and its braking at probing speed
SETTLE_S = 0.5
_MOST_APPROACHES = (
    3  # of a contact that opens again: an arm may come to rest just where a surface begins, even twice
)


@dataclass(frozen=True, slots=True)
class ProbeApproach:
    """One straight way towards a surface, and how to travel it. Speeds are of the tip."""

    start_rad: Joints
    end_rad: Joints
    search_m_s: float = PROBING_CAP_M_S
    measure_m_s: float = 0.0005
    repeats: int = 3
    retreat_m: float = 0.001  # from the contact, before each repeat and at the end
    segment_m: float = 0.005  # an arm that does not obey a stop goes no farther than this
    travel_rad_s: float = 0.1  # to the start


@dataclass(frozen=True, slots=True)
class ProbeTouch:
    """One contact: where the arm was, and how well its times tell."""

    joints_rad: Joints
    tip_in_base_m: Place  # by the nominal model
    speed_m_s: float
    skew_s: float
    sigma_m: float  # along the approach: speed times skew, and the probe's own scatter
    overtravel_m: float
    bounces: int


@dataclass(frozen=True, slots=True)
class TouchedPoint:
    """A surface point, felt several times from one side. The tip's centre is meant, at the contact."""

    label: str
    joints_rad: Joints  # mean of the repeats
    tip_in_base_m: Place
    direction_in_base: Place  # of the approach
    sigma_m: float  # along the approach, of the mean
    spread_m: float  # largest difference of the repeats along the approach
    touches: tuple[ProbeTouch, ...]


async def touch_surface(cell: Cell, label: str, approach: ProbeApproach) -> TouchedPoint:
    """Feel for a surface once to find it, then ``repeats`` times more slowly; end clear of it."""
    probe, setup = probe_of(cell)
    line = _probe_line_of(cell, setup, approach)
    _refuse_unsafe(label, line, approach, probe)
    await refuse_contact(label, probe)
    await move_untouched(cell, label, [approach.start_rad], approach.travel_rad_s, care=MotionCare.TOUCHING)
    found = await _probe_contact(cell, label, line, approach, approach.search_m_s)
    await _retreat_from(cell, label, line, approach, found)
    touches: list[ProbeTouch] = []
    for _ in range(approach.repeats):
        touches.append(await _probe_contact(cell, label, line, approach, approach.measure_m_s))
        await _retreat_from(cell, label, line, approach, touches[-1])
    return _touched_point(label, line, touches)


async def leave_face(cell: Cell, label: str, approach: ProbeApproach) -> None:
    """Where a touch that was broken off still presses its face: go back along its own line, and see the contact open.

    Raises
    ------
    AlreadyInContactError
        The contact is closed and the arm does not stand on that line: it is something else that touches.
    StuckContactError
        The contact stays closed at the start of the line.
    """
    probe, setup = probe_of(cell)
    if not (await probe.read_contact()).closed:
        return
    line = _probe_line_of(cell, setup, approach)
    if not line.is_on_line((await cell.robot.read_joints()).joints_rad):
        await refuse_contact(label, probe)
        return
    speed = line.joint_speed_rad_s(PROBING_CAP_M_S)
    await motion_gate.move_along(cell, [approach.start_rad], speed, care=MotionCare.TOUCHING)
    trouble = make_message("{label}: the contact stays closed at the start of its approach", label=label)
    await _check_open(probe, trouble)


def probe_of(cell: Cell) -> tuple[TouchProbe, ProbeSetup]:
    """Return the probe and where its tip is; NeedsUnmetError without one."""
    if cell.probe is None or cell.probe_setup is None:
        what = NEEDS["probe"][0]
        raise NeedsUnmetError(
            make_message("this cell has no {what}", what=what),
            missing=(what,),
            remedy="Add a [[probe]] to cell.toml.",
        )
    return cell.probe, cell.probe_setup


def _probe_line_of(cell: Cell, setup: ProbeSetup, approach: ProbeApproach) -> ProbeLine:
    if cell.model is None:
        what = NEEDS["model"][0]
        raise NeedsUnmetError(
            make_message("this cell has no {what}", what=what),
            missing=(what,),
            remedy="Name it in cell.toml.",
        )
    return probe_line(cell.model, setup.tip_in_flange_m, approach.start_rad, approach.end_rad)


def _refuse_unsafe(label: str, line: ProbeLine, approach: ProbeApproach, probe: TouchProbe) -> None:
    """Refuse before anything moves: speeds, ways, and what the probe's stylus would have to bear."""
    speeds = (approach.search_m_s, approach.measure_m_s)
    if not all(0 < speed <= PROBING_CAP_M_S for speed in speeds) or not approach.travel_rad_s > 0:
        raise ContactError(
            make_message(
                "{label}: probing speeds must be above 0 and at most {probing_cap_m_s:g} mm/s",
                label=label,
                probing_cap_m_s=PROBING_CAP_M_S * 1000.0,
            ),
            remedy="Nothing has moved. Correct the speeds of the approach.",
        )
    ways_fit = 0 < approach.retreat_m < line.length_m and approach.segment_m > 0
    if not ways_fit or not math.isfinite(approach.segment_m) or approach.repeats < 1:
        raise ContactError(
            make_message(
                "{label}: retreat, segment and repeats do not fit an approach of {length_mm:.2f} mm",
                label=label,
                length_mm=line.length_m * 1000.0,
            ),
            remedy="Nothing has moved. Correct the approach.",
        )
    can = probe.capabilities
    push_m = max(speeds) * (can.reaction_s + STOP_S)
    if push_m > can.overtravel_m:
        raise OvertravelError(
            make_message(
                "{label}: at {speeds:.2f} mm/s the tip may be pushed in by {push_mm:.2f} mm, the probe "
                "allows {overtravel_mm:.2f} mm",
                label=label,
                speeds=max(speeds) * 1000.0,
                push_mm=push_m * 1000.0,
                overtravel_mm=can.overtravel_m * 1000.0,
            ),
            remedy=make_message(
                "Probe at {overtravel_mm:.2f} mm/s or slower.",
                overtravel_mm=can.overtravel_m / (can.reaction_s + STOP_S) * 1000.0,
            ),
        )


async def refuse_contact(label: str, probe: TouchProbe) -> None:
    """Refuse to begin with a contact that is closed."""
    if (await probe.read_contact()).closed:
        raise AlreadyInContactError(
            make_message("{label}: the probe's contact is closed before the approach begins", label=label),
            remedy="Move the tip clear by hand; if it stays closed, check probe and cable. Then resume.",
        )


async def _probe_contact(
    cell: Cell, label: str, line: ProbeLine, approach: ProbeApproach, speed_m_s: float
) -> ProbeTouch:
    """Travel the line from where the arm stands until the contact closes.

    A segment may end just where the surface begins: the arm swings as it comes to rest there, and the contact opens
    again. That is felt for again, from nearer: its segments end elsewhere.
    """
    probe, _ = probe_of(cell)
    for approaches in range(1, _MOST_APPROACHES + 1):
        travel, edge = await _travel_to_contact(cell, label, line, approach, speed_m_s)
        standing = await _standing_joints(cell, label)
        if edge.steady or approaches == _MOST_APPROACHES:
            break
        back_m = approaches * approach.retreat_m + speed_m_s * (probe.capabilities.reaction_s + STOP_S)
        await _move_back(cell, label, line, line.distance_of(standing), back_m)
    await _refuse_uncertain(label, edge, probe)
    tips = line.tips_m(np.array([reading.joints_rad for reading in travel.readings]))
    at = position_between(travel.readings, tips, edge.earliest_s, edge.latest_s)
    found = _make_touch(line, at, standing, edge, probe)
    if found.overtravel_m > probe.capabilities.overtravel_m:
        raise OvertravelError(
            make_message(
                "{label}: the arm pushed the tip in by {overtravel_mm:.2f} mm, the probe allows "
                "{overtravel_limit_mm:.2f} mm",
                label=label,
                overtravel_mm=found.overtravel_m * 1000.0,
                overtravel_limit_mm=probe.capabilities.overtravel_m * 1000.0,
            ),
            remedy="Look whether the stylus is bent; measure its tip again before anything else.",
        )
    return found


async def _travel_to_contact(
    cell: Cell, label: str, line: ProbeLine, approach: ProbeApproach, speed_m_s: float
) -> tuple[GuardedTravel, ContactEdge]:
    probe, _ = probe_of(cell)
    here_m = line.distance_of((await cell.robot.read_joints()).joints_rad)
    pieces = max(math.ceil((line.length_m - here_m) / approach.segment_m), 1)
    stops = [line.joints_at(float(at)) for at in np.linspace(here_m, line.length_m, pieces + 1)[1:]]
    travel = await move_until_contact(
        cell, probe, stops, line.joint_speed_rad_s(speed_m_s), MotionCare.TOUCHING
    )
    if travel.edge is None:
        raise NoContactError(
            make_message(
                "{label}: no contact within {length_mm:.1f} mm",
                label=label,
                length_mm=(line.length_m - here_m) * 1000.0,
            ),
            remedy="See that the surface is where it is expected and the probe is plugged in and signals, "
            "then resume from a nearer start.",
        )
    return travel, travel.edge


async def _retreat_from(
    cell: Cell, label: str, line: ProbeLine, approach: ProbeApproach, found: ProbeTouch
) -> None:
    """Move back from a touch along the line; where it was is known no better than it says."""
    clear_m = approach.retreat_m + math.sqrt(3) * found.sigma_m
    await _move_back(cell, label, line, line.distance_of(found.joints_rad), clear_m)


async def _move_back(cell: Cell, label: str, line: ProbeLine, from_m: float, by_m: float) -> None:
    """Move back along the line, and see the contact open."""
    probe, _ = probe_of(cell)
    target = line.joints_at(max(from_m - by_m, 0.0))
    speed = line.joint_speed_rad_s(PROBING_CAP_M_S)
    await motion_gate.move_along(cell, [target], speed, care=MotionCare.TOUCHING)
    await _check_open(
        probe,
        make_message(
            "{label}: the contact stays closed {by_mm:.1f} mm away from the surface",
            label=label,
            by_mm=by_m * 1000.0,
        ),
    )


async def _check_open(probe: TouchProbe, trouble: str) -> None:
    if not await _contact_becomes(probe, closed=False):
        raise StuckContactError(
            trouble,
            remedy="Move the tip clear by hand; clean the probe or check its cable. Then resume.",
        )


async def _contact_becomes(probe: TouchProbe, *, closed: bool) -> bool:
    """Whether the contact comes to that within the time in which arm and springs come to rest."""
    give_up_s = loop_time() + SETTLE_S
    while (await probe.read_contact()).closed is not closed:
        if loop_time() > give_up_s:
            return False
    return True


async def move_untouched(
    cell: Cell, label: str, stops: Sequence[Joints], speed_rad_s: float, *, care: MotionCare = MotionCare.FREE
) -> None:
    """Move from stop to stop where nothing should be touched; the arm stands where the contact closes after all."""
    probe, _ = probe_of(cell)
    travel = await move_until_contact(cell, probe, stops, min(speed_rad_s, cell.limits.speed_rad_s), care)
    if travel.edge is not None:
        raise ContactError(
            make_message(
                "{label}: the probe touched something on its way to the start of the approach", label=label
            ),
            remedy="Move the tip clear by hand, look for what is in the way, choose another start. Then resume.",
        )


async def _standing_joints(cell: Cell, label: str) -> Joints:
    """Return where the arm stands; refuse one that does not."""
    before = await cell.robot.read_joints()
    after = await cell.robot.read_joints()
    if not is_still(before, after):
        await cell.robot.stop()
        raise ContactError(
            make_message("{label}: the arm moved on after it was stopped at the contact", label=label),
            remedy="Press the emergency stop if it still moves; find out who else commands it.",
        )
    return after.joints_rad


async def _refuse_uncertain(label: str, edge: ContactEdge, probe: TouchProbe) -> None:
    """Refuse a contact that flickers, or that is open although the arm stands beyond it."""
    if not edge.steady:
        raise BouncingContactError(
            make_message(
                "{label}: the contact did not settle; times it opened: {bounces}",
                label=label,
                bounces=edge.bounces,
            ),
            remedy="Probe more slowly; if it stays so, clean the probe and check its cable. Then resume.",
        )
    if not await _contact_becomes(probe, closed=True):
        raise ContactLostError(
            make_message(
                "{label}: the contact closed, and is open although the arm has not moved back", label=label
            ),
            remedy="Check the probe's cable and that the surface does not give way. Then resume.",
        )


def _make_touch(
    line: ProbeLine, at: ContactPosition, standing: Joints, edge: ContactEdge, probe: TouchProbe
) -> ProbeTouch:
    tips = line.tips_m(np.array([at.joints_rad, standing]))
    return ProbeTouch(
        at.joints_rad,
        _as_triple(tips[0]),
        at.speed_m_s,
        at.skew_s,
        math.hypot(at.bound_m / math.sqrt(3), probe.capabilities.sigma_m),
        float(np.linalg.norm(tips[1] - tips[0])) + at.bound_m,
        edge.bounces,
    )


def _touched_point(label: str, line: ProbeLine, touches: Sequence[ProbeTouch]) -> TouchedPoint:
    joints = np.array([one.joints_rad for one in touches]).mean(axis=0)
    along = [line.distance_of(one.joints_rad) for one in touches]
    scatter = statistics.stdev(along) / math.sqrt(len(along)) if len(along) > 1 else 0.0
    ends = line.tips_m(np.array([line.joints_at(0.0), line.joints_at(line.length_m)]))
    # the mean does not help against a delay that is wrong every time
    sigma = math.hypot(max(one.sigma_m for one in touches), scatter)
    return TouchedPoint(
        label,
        tuple(float(q) for q in joints),
        _as_triple(line.tips_m(joints)[0]),
        _as_triple((ends[1] - ends[0]) / np.linalg.norm(ends[1] - ends[0])),
        sigma,
        max(along) - min(along),
        tuple(touches),
    )


def _as_triple(values: np.ndarray[tuple[int, ...], np.dtype[np.float64]]) -> Place:
    x, y, z = (float(value) for value in values)
    return x, y, z
