"""What a person is shown while turning an axis: which key, how much is left, when to stop, and what went wrong."""

import math
from dataclasses import dataclass, replace
from enum import StrEnum
from typing import Any

from cellcal.calibration.geometry import Array
from cellcal.calibration.message import make_message
from cellcal.procedures.motion.axis_watch import OTHER_AXIS_RAD, AxisWatch

SLOW_RAD = math.radians(3.0)  # before the end: at 2 deg/s a person has a second and a half
WRONG_WAY_RAD = math.radians(0.3)


class Advice(StrEnum):
    """The next action for the person."""

    TURN = "turn"
    SLOW = "slow"
    STOP = "stop"
    WRONG_WAY = "wrong_way"
    WRONG_AXIS = "wrong_axis"


@dataclass(frozen=True, slots=True)
class JogLeg:
    """A turn of one joint, and the short way back up at its end where the gears need it."""

    axis: int
    turn_rad: float
    back_rad: float
    axis_names: tuple[str, ...]  # of all axes, as the pendant shows them

    @property
    def name(self) -> str:
        """The axis as the pendant shows it."""
        return self.axis_names[self.axis]

    def sentence(self, speed_rad_s: float) -> str:
        """Return the leg in words: the axis, the amount, the key of the pendant."""
        degrees, pace = math.degrees(self.turn_rad), math.degrees(speed_rad_s)
        words = make_message(
            "With the pendant, turn {axis} alone by {degrees:+.2f} deg, at most {pace:.1f} deg/s.",
            axis=self.name,
            degrees=degrees,
            pace=pace,
        )
        if self.back_rad:
            return make_message(
                "{words} Then turn it back by {back_deg:+.2f} deg, with its plus key.",
                words=words,
                back_deg=math.degrees(self.back_rad),
            )
        return words


@dataclass(frozen=True, slots=True)
class JogGuidance:
    """One moment of a leg."""

    leg: JogLeg
    began_rad: float  # where the joint stood before the leg, since the watch began
    tolerance_rad: float
    left_rad: float
    advice: Advice = Advice.TURN
    other_axis: int | None = None
    other_rad: float = 0.0
    reached: bool = False  # the end of the turn; what is left is then the way back

    @staticmethod
    def begin(leg: JogLeg, watch: AxisWatch, tolerance_rad: float) -> "JogGuidance":
        """Return it before the joint turns."""
        return JogGuidance(leg, float(watch.turned_rad[leg.axis]), tolerance_rad, leg.turn_rad)

    def after(self, watch: AxisWatch, allowed_rad: Array) -> "JogGuidance":
        """Return it after another look at the counts; ``allowed_rad`` (n,) is what other joints may turn."""
        turned = float(watch.turned_rad[self.leg.axis]) - self.began_rad
        reached = self.reached or (self.leg.turn_rad - turned) * self.leg.turn_rad <= 0.0
        goal = self.leg.turn_rad + (self.leg.back_rad if reached else 0.0)
        left_rad = goal - turned
        other = watch.other_axis(self.leg.axis, allowed_rad)
        if other is not None:
            away = float(watch.turned_rad[other] - watch.accepted_rad[other])
            return replace(
                self,
                left_rad=left_rad,
                advice=Advice.WRONG_AXIS,
                other_axis=other,
                other_rad=away,
                reached=reached,
            )
        advice = _advice(left_rad, turned, self.leg, reached=reached)
        return replace(
            self, left_rad=left_rad, advice=advice, other_axis=None, other_rad=0.0, reached=reached
        )

    @property
    def key(self) -> str:
        """The key of the pendant that takes the joint nearer."""
        return "+" if self.left_rad >= 0.0 else "-"

    @property
    def sentence(self) -> str:
        """The next action, in words."""
        name, left_deg = self.leg.name, abs(math.degrees(self.left_rad))
        if self.advice is Advice.WRONG_AXIS and self.other_axis is not None:
            other = self.leg.axis_names[self.other_axis]
            return make_message(
                "Stop: {other} turned by {other_deg:+.1f} deg. Only {name} may turn.",
                other=other,
                other_deg=math.degrees(self.other_rad),
                name=name,
            )
        if self.advice is Advice.WRONG_WAY:
            return make_message(
                "Stop: {name} turns the wrong way. Use the {key} key, {left:.1f} deg are left.",
                name=name,
                key=self.key,
                left=left_deg,
            )
        if self.advice is Advice.STOP:
            return make_message("Stop now: {name} is there.", name=name)
        words = make_message(
            "Turn {name} with the {key} key, {left:.1f} deg are left.", name=name, key=self.key, left=left_deg
        )
        return make_message("{words} Now slowly.", words=words) if self.advice is Advice.SLOW else words

    def as_json(self) -> dict[str, Any]:
        """Return it for a screen."""
        return {
            "axis": self.leg.axis,
            "key": self.key,
            "left_rad": self.left_rad,
            "turn_rad": self.leg.turn_rad,
            "advice": self.advice.value,
            "other_axis": self.other_axis,
            "other_rad": self.other_rad,
        }


def _advice(left_rad: float, turned_rad: float, leg: JogLeg, *, reached: bool) -> Advice:
    onward = leg.back_rad if reached and leg.back_rad else leg.turn_rad
    if left_rad * onward <= 0.0 or abs(left_rad) < OTHER_AXIS_RAD:
        return Advice.STOP
    if not reached and turned_rad * leg.turn_rad < 0.0 and abs(turned_rad) > WRONG_WAY_RAD:
        return Advice.WRONG_WAY
    return Advice.SLOW if abs(left_rad) < SLOW_RAD else Advice.TURN
