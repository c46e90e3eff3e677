"""A plan in three lines for whoever approves it: what moves, how far, how long; then what nobody checked."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

from drivers.interfaces import Joints

MEAN_TRAVEL_RAD = (
    1.5  # of the slowest joint from one pose to the next, where the next is chosen while measuring
)
PER_POSE_S = 4.0  # to come to rest and measure


@dataclass(frozen=True, slots=True)
class Tour:
    """How far a plan goes: its stops, the way of the slowest joint in all, and how fast."""

    stops: int
    travel_rad: float
    speed_rad_s: float
    hands: str = ""  # what a person does in between, which takes its own time
    moving_s: float | None = None  # where some ways are slower than that; None: all at this speed

    @property
    def minutes(self) -> float:
        """How long it takes, about."""
        moving_s = self.travel_rad / self.speed_rad_s if self.moving_s is None else self.moving_s
        return (moving_s + self.stops * PER_POSE_S) / 60.0


def guessed_tour(stops: int, speed_rad_s: float, hands: str = "") -> Tour:
    """Return the tour of poses that are chosen one after the other, as long as such ways are on average."""
    return Tour(stops, stops * MEAN_TRAVEL_RAD, speed_rad_s, hands)


def travel_of(start_rad: Joints, ways_rad: Sequence[Sequence[Joints]]) -> float:
    """Return the way of the slowest joint along all corners [rad]."""
    travel, here = 0.0, start_rad
    for corner in (corner for way in ways_rad for corner in way):
        travel += max(abs(a - b) for a, b in zip(corner, here, strict=True))
        here = corner
    return travel


def plan_words(what: str, tour: Tour, not_checked: Sequence[str]) -> str:
    """Return the words of a plan; ``what`` says what moves, and to what end."""
    hands = f", and the time to {tour.hands}" if tour.hands else ""
    left_out = "; ".join(not_checked) or "nothing is left out"
    return (
        f"What moves: {what}.\n"
        f"How far: about {math.degrees(tour.travel_rad):.0f} deg of the slowest joint in all, none faster than "
        f"{math.degrees(tour.speed_rad_s):.1f} deg/s; every way keeps limits and distances or is not gone.\n"
        f"How long: about {max(tour.minutes, 1.0):.0f} minutes{hands}.\n"
        f"Not checked: {left_out}. Look: is nobody near, are no cables or hoses in the way? May it move?"
    )
