"""Where a move stands, judged from the state stream alone."""

from collections.abc import Sequence
from dataclasses import dataclass

from cellcal.drivers.universal_robots.state import Six, StateSample

_FEWEST = 3  # samples that must agree, however short the span


@dataclass(frozen=True, slots=True)
class MotionTolerances:
    """When the arm counts as standing, and as being there."""

    position_rad: float
    speed_rad_s: float
    settle_s: float


def expected_s(start_rad: Six, target_rad: Six, speed_rad_s: float, acceleration_rad_s2: float) -> float:
    """Return how long a joint move takes at full override: ramps and cruise of the longest joint."""
    distance_rad = max(abs(a - b) for a, b in zip(start_rad, target_rad, strict=True))
    return distance_rad / speed_rad_s + speed_rad_s / acceleration_rad_s2


def farthest_joint(sample: StateSample, target_rad: Six) -> tuple[int, float]:
    """Return the joint that is farthest from its target, and by how much [rad]."""
    errors = [abs(q - t) for q, t in zip(sample.joints_rad, target_rad, strict=True)]
    return max(enumerate(errors), key=lambda pair: pair[1])


def path_deviation_rad(sample: StateSample, start_rad: Six, target_rad: Six) -> float:
    """Return how far the arm is from the straight line in joint space on which a joint move keeps it."""
    step = [t - s for s, t in zip(start_rad, target_rad, strict=True)]
    gone = [q - s for q, s in zip(sample.joints_rad, start_rad, strict=True)]
    length = sum(d * d for d in step)
    share = sum(g * d for g, d in zip(gone, step, strict=True)) / length if length > 0.0 else 0.0
    share = min(max(share, 0.0), 1.0)
    return max(abs(g - share * d) for g, d in zip(gone, step, strict=True))


def is_moving(sample: StateSample, tolerances: MotionTolerances) -> bool:
    """Whether a joint turns in this sample."""
    return max(map(abs, sample.joint_speeds_rad_s)) > tolerances.speed_rad_s


def has_stood(samples: Sequence[StateSample], tolerances: MotionTolerances, span_s: float) -> bool:
    """Whether no joint has moved for ``span_s`` of the controller's time."""
    recent = _latest_samples(samples, span_s)
    if not recent or any(is_moving(sample, tolerances) for sample in recent):
        return False
    columns = zip(*(sample.joints_rad for sample in recent), strict=True)
    return all(max(column) - min(column) <= tolerances.position_rad for column in columns)


def has_arrived(samples: Sequence[StateSample], target_rad: Six, tolerances: MotionTolerances) -> bool:
    """Whether the arm has stood at the target for the settling time."""
    recent = _latest_samples(samples, tolerances.settle_s)
    at_target = all(farthest_joint(sample, target_rad)[1] <= tolerances.position_rad for sample in recent)
    return at_target and has_stood(samples, tolerances, tolerances.settle_s)


def _latest_samples(samples: Sequence[StateSample], span_s: float) -> list[StateSample]:
    """Return the newest samples that cover ``span_s``; none when the record is too short for that."""
    recent: list[StateSample] = []
    for sample in reversed(samples):
        recent.append(sample)
        if len(recent) >= _FEWEST and recent[0].timestamp_s - sample.timestamp_s >= span_s:
            return recent
    return []
