"""A plan in three lines for approval: what moves, how far, how long; then what was not checked."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

from cellcal.calibration.message import join_messages, make_message
from cellcal.procedures.motion.speed_limit import TimedMotion

PER_POSE_S = 4.0  # to come to rest and measure


@dataclass(frozen=True, slots=True)
class PlanTour:
    """The length of a plan: its stops, and the ways between them at their pace."""

    stops: int
    paced: TimedMotion
    hands: str = ""  # what a person does in between, which takes its own time

    @property
    def duration_min(self) -> float:
        """The duration, about."""
        return (self.paced.moving_s + self.stops * PER_POSE_S) / 60.0


def plan_words(what: str, tour: PlanTour, not_checked: Sequence[str]) -> str:
    """Return the words of a plan; ``what`` says what moves, and to what end."""
    minutes = max(tour.duration_min, 1.0)
    duration_text = (
        make_message(
            "How long: about {minutes:.0f} min, and the time to {hands}.", minutes=minutes, hands=tour.hands
        )
        if tour.hands
        else make_message("How long: about {minutes:.0f} min.", minutes=minutes)
    )
    left_out = join_messages("; ", not_checked) or "nothing is left out"
    lines = (
        make_message("What moves: {what}.", what=what),
        make_message(
            "How far: about {travel_deg:.0f} deg of the slowest joint in all, none faster than {fastest_deg_s:.1f} "
            "deg/s; every way keeps limits and distances or is not gone.",
            travel_deg=math.degrees(tour.paced.travel_rad),
            fastest_deg_s=math.degrees(tour.paced.fastest_rad_s),
        ),
        duration_text,
        make_message(
            "Not checked: {left_out}. Look: is the area clear of people, are no cables or hoses in the way? "
            "May it move?",
            left_out=left_out,
        ),
    )
    return join_messages("\n", lines)
