"""Where an arm was when something happened: readings of its joints, each true some time between two times.

A robot that is asked over a link answers with joints that were true after the question and before the answer.
A controller that stamps its readings tells more: all readings share one offset between its clock and ours, which
must fit between question and answer of every single one.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from cellcal.calibration.errors import DegenerateDataError
from cellcal.calibration.geometry import Array
from cellcal.drivers.interfaces import Joints


@dataclass(frozen=True, slots=True)
class TimedJoints:
    """One reading, with the times of its question and its answer [host monotonic] and the controller's own."""

    asked_s: float
    answered_s: float
    joints_rad: Joints
    device_time_s: float | None = None


@dataclass(frozen=True, slots=True)
class ContactPosition:
    """The position of the arm at a contact, as well as the times tell."""

    joints_rad: Joints
    speed_m_s: float  # of the tip, the fastest near by
    skew_s: float  # half the time within which it happened, seen from the readings
    bound_m: float  # how far the tip may have been from there along its way


def reading_times(readings: Sequence[TimedJoints]) -> tuple[Array, Array]:
    """Return when each reading was true [s], and by how much that may be wrong [s]; (N,) each."""
    asked_at = np.array([reading.asked_s for reading in readings])
    answered = np.array([reading.answered_s for reading in readings])
    stamps = [reading.device_time_s for reading in readings]
    if all(stamp is not None for stamp in stamps):
        stamped = np.array(stamps, dtype=float)
        least, most = float((asked_at - stamped).max()), float((answered - stamped).min())
        if least <= most:  # else the clocks run apart, and the stamps tell nothing
            return stamped + (least + most) / 2, np.full(len(readings), (most - least) / 2)
    return (asked_at + answered) / 2, (answered - asked_at) / 2


def position_between(
    readings: Sequence[TimedJoints], tips_m: Array, earliest_s: float, latest_s: float
) -> ContactPosition:
    """Return where the arm was in the middle of a span of time, between the readings around it.

    Parameters
    ----------
    readings
        In the order they were taken, from before the span to after it.
    tips_m : (N, 3)
        The tip for every reading [m].
    earliest_s, latest_s
        The span in which it happened [host monotonic].

    Notes
    -----
    ``bound_m`` is the tip's speed times half the span plus the readings' own half width, plus what a change of
    speed between two readings can bend the way (a |dv| / 8 of the time between them).

    Raises
    ------
    DegenerateDataError
        No reading before it, or none after it.
    """
    times, halves = reading_times(readings)
    when = (earliest_s + latest_s) / 2
    after = int(np.searchsorted(times, when, side="right"))
    if after == 0 or after == len(readings):
        raise DegenerateDataError(
            "the robot's joints were not read on both sides of the touch",
            remedy="Look at the link to the robot, then repeat the touch.",
        )
    before = after - 1
    share = (when - times[before]) / (times[after] - times[before])
    one, other = np.array(readings[before].joints_rad), np.array(readings[after].joints_rad)
    first, last = max(before - 1, 0), min(after + 1, len(readings) - 1)
    passed = np.maximum(np.diff(times[first : last + 1]), 1e-6)
    speeds = np.linalg.norm(np.diff(tips_m[first : last + 1], axis=0), axis=1) / passed
    skew_s = (latest_s - earliest_s) / 2 + float(halves[[before, after]].max())
    bend_m = float(speeds.max() - speeds.min()) * float(times[after] - times[before]) / 8
    return ContactPosition(
        tuple(float(q) for q in one + share * (other - one)),
        float(speeds.max()),
        skew_s,
        float(speeds.max()) * skew_s + bend_m,
    )
