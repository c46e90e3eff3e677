"""Points of a user frame, touched one after the other: what is not known well enough yet is touched again.

Origin, a point on +x and a point on the +y side come first, and the further ones that were asked for. Then the
program asks for the point that tells most, until the frame is known within its limits; where the limits are out of
reach of so many touches it asks for none. A point that the others contradict is touched anew, once.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

from cellcal.calibration.errors import CalibrationError
from cellcal.calibration.geometry import Pose
from cellcal.calibration.message import make_message
from cellcal.calibration.points.frame_design import (
    FIRST_FIXED,
    FrameGoal,
    FramePoint,
    FramePrediction,
    FrameRole,
    predict_frame,
    touches_needed_in_turn,
)
from cellcal.calibration.points.frames import (
    PointsDisagreeError,
    TaughtFrame,
    frame_from_more_points,
    frame_from_three_points,
)
from cellcal.drivers.interfaces import Instruction
from cellcal.procedures.refit import MEASURED_AGAIN
from cellcal.procedures.run import Run
from cellcal.procedures.steps.meters import frame_meter, tip_in_base
from cellcal.procedures.steps.pages import point_states, points_page
from cellcal.procedures.steps.teach import teach_pose
from cellcal.procedures.verdict import SetAside

Triple = tuple[float, float, float]
Role = Literal[FrameRole, "above"]
ORIGIN_STEP, ON_X_STEP, Y_SIDE_STEP = "touch the origin", "touch a point on x", "touch a point on the y side"
ABOVE_STEP, ANEW_STEP = "touch a point above", "touch anew"

ORIGIN = Instruction("touch_origin", "Touch the origin of the frame with the pointer.")
ON_X = Instruction("touch_on_x", "Touch a point on the +x axis, as far from the origin as possible.")
ON_XY = Instruction(
    "touch_on_xy", "Touch a point of the x-y plane on the +y side, well away from the x axis."
)
ABOVE = Instruction("touch_above", "Touch any point that lies above the plane, on the +z side.")
_MORE: dict[FrameRole, tuple[str, Instruction]] = {
    "origin": (
        "touch the origin again",
        Instruction("touch_origin_again", "Go away from the origin and touch it once more."),
    ),
    "on_x": (
        "touch another point on x",
        Instruction("touch_more_on_x", "Touch another point on the +x axis."),
    ),
    "in_plane": (
        "touch another point of the plane",
        Instruction("touch_more_on_xy", "Touch another point of the x-y plane, on any side of the x axis."),
    ),
}


@dataclass(frozen=True, slots=True)
class FrameRules:
    """With which pointer, how many further points in any case, how many touches at most, and for which goal."""

    tip_in_flange_m: Triple
    more_on_x: int
    more_in_plane: int
    check_above: bool
    most: int
    goal: FrameGoal


@dataclass(frozen=True, slots=True)
class FrameTouch:
    """One touch: its step, what the point is, where the flange stood."""

    step: str
    role: FrameRole
    base_flange: Pose


@dataclass(frozen=True, slots=True)
class FrameTouches:
    """All touches that count."""

    points: tuple[FrameTouch, ...]
    above: Pose | None
    set_aside: tuple[SetAside, ...]


@dataclass(frozen=True, slots=True)
class FrameEffort:
    """The touches that the frame took, and what it would have taken otherwise. U with k = 2."""

    touches: int
    in_turn: int  # touches for the goal, were the three points touched in turn
    most: int
    reached: bool
    best_origin_u_m: float  # with as many touches as are allowed
    best_angle_u_rad: float

    @property
    def saving_text(self) -> str:
        """Return what was saved, or why nothing more was asked for, as a sentence."""
        if not self.reached:
            return make_message(
                "{touches} touches; further ones were not asked for: {most} would leave the origin "
                "within {origin_u_mm:.2f} mm and the axes within {angle_u_rad:.2f} mm per metre (k=2)",
                touches=self.touches,
                most=self.most,
                origin_u_mm=self.best_origin_u_m * 1000.0,
                angle_u_rad=self.best_angle_u_rad * 1000.0,
            )
        if self.touches >= self.in_turn:
            return make_message(
                "no saving: {touches} touches, as many as the three points in turn would take",
                touches=self.touches,
            )
        return make_message(
            "{touches} touches, each where it tells most; the three points touched in turn would "
            "take {in_turn} for the U of the limits",
            touches=self.touches,
            in_turn=self.in_turn,
        )


def named_touches(rules: FrameRules) -> tuple[tuple[str, FrameRole, Instruction], ...]:
    """Return the touches that are made in any case: step, what the point is, words."""
    return (
        (ORIGIN_STEP, "origin", ORIGIN),
        (ON_X_STEP, "on_x", ON_X),
        (Y_SIDE_STEP, "in_plane", ON_XY),
        *(_further_touch("on_x", k) for k in range(1, rules.more_on_x + 1)),
        *(_further_touch("in_plane", k) for k in range(1, rules.more_in_plane + 1)),
    )


def further_step(role: FrameRole) -> str:
    """Return what the steps of further touches are called, before their number."""
    return _MORE[role][0]


def role_of(step: str) -> FrameRole | None:
    """Return what a touch's step says of its point; None for a touch anew, and for other steps."""
    first: dict[str, FrameRole] = {ORIGIN_STEP: "origin", ON_X_STEP: "on_x", Y_SIDE_STEP: "in_plane"}
    more = (role for role, (name, _) in _MORE.items() if step.startswith(f"{name} "))
    return first.get(step) or next(more, None)


async def touch_points(run: Run, rules: FrameRules) -> FrameTouches:
    """Have the points touched until they tell the frame well enough."""
    taken = _TouchSeries(rules, [], [])
    for step, role, instruction in named_touches(rules):
        await taken.touch_point(run, step, role, instruction)
    while (prediction := taken.predict_frame()) is not None and prediction.reached and prediction.again:
        role = taken.point_roles[prediction.again[0]]
        step, _, instruction = _further_touch(role, taken.point_roles.count(role))
        await taken.touch_point(run, step, role, _with_known_text(instruction, taken.construct_now()))
    above = await taken.touch_above(run) if rules.check_above else None
    return FrameTouches(tuple(taken.points), above, tuple(taken.aside))


def effort_of(rules: FrameRules, touches: FrameTouches, taught: TaughtFrame) -> FrameEffort:
    """Compare what was touched with the three points in turn, and with all that is allowed."""
    points = _frame_points(rules, touches.points)
    later = predict_frame(taught.base_frame, points, rules.goal, max(rules.most, len(points)))
    first = [next(point for point in points if point.role == role) for role in FIRST_FIXED]
    return FrameEffort(
        touches=len(points),
        in_turn=touches_needed_in_turn(taught.base_frame, first, rules.goal),
        most=rules.most,
        reached=later.reached,
        best_origin_u_m=later.origin_u_m,
        best_angle_u_rad=later.angle_u_rad,
    )


def construct_frame(rules: FrameRules, points: Sequence[FrameTouch], above: Pose | None) -> TaughtFrame:
    """Return the frame through the pointer's tip at these points; fitted where there are more than three."""
    of = {
        role: [point.at_m for point in _frame_points(rules, points) if point.role == role]
        for role in FIRST_FIXED
    }
    above_m = None if above is None else tip_in_base(above, rules.tip_in_flange_m)
    sigma_m = rules.goal.sigma_m
    if len(points) > 3:
        return frame_from_more_points(
            of["origin"], of["on_x"], of["in_plane"], above_m=above_m, sigma_m=sigma_m
        )
    return frame_from_three_points(
        of["origin"][0], of["on_x"][0], of["in_plane"][0], above_m=above_m, sigma_m=sigma_m
    )


@dataclass(slots=True)
class _TouchSeries:
    """The touches so far."""

    rules: FrameRules
    points: list[FrameTouch]
    aside: list[SetAside]

    @property
    def point_roles(self) -> list[FrameRole]:
        return [point.role for point in self.points]

    def construct_now(self) -> TaughtFrame:
        return construct_frame(self.rules, self.points, None)

    def predict_frame(self) -> FramePrediction | None:
        """Return what to touch again; None where the points tell no frame, which is said where it is constructed."""
        try:
            base_frame = self.construct_now().base_frame
        except CalibrationError:
            return None
        points = _frame_points(self.rules, self.points)
        return predict_frame(base_frame, points, self.rules.goal, self.rules.most)

    async def touch_point(self, run: Run, step: str, role: FrameRole, instruction: Instruction) -> None:
        """Have a point touched, and once more where the others contradict it."""
        await self._record_touch(run, step, role, instruction)
        why = self._contradiction_text()
        if why:
            self.aside.append(SetAside(self.points.pop().step, MEASURED_AGAIN))
            again = Instruction(
                instruction.key,
                make_message("{why} {instruction_text}", why=why, instruction_text=instruction.text),
            )
            await self._record_touch(run, f"{ANEW_STEP} {len(self.aside)}", role, again)

    async def touch_above(self, run: Run) -> Pose:
        """Have the point touched that tells the frame's upper side."""
        taught = await run.step(ABOVE_STEP, teach_pose, self._touch_page(ABOVE_STEP, "above", ABOVE))
        return taught.base_flange

    async def _record_touch(self, run: Run, step: str, role: FrameRole, instruction: Instruction) -> None:
        taught = await run.step(step, teach_pose, self._touch_page(step, role, instruction))
        self.points.append(FrameTouch(step, role, taught.base_flange))

    def _contradiction_text(self) -> str:
        """Return what the last point is at odds with; only one beyond three can be."""
        if len(self.points) <= 3:
            return ""
        try:
            self.construct_now()
        except PointsDisagreeError:
            return "The points touched before contradict the last touch: make it again."
        except CalibrationError:
            return ""  # said where the frame is constructed
        return ""

    def _touch_page(self, step: str, role: Role, instruction: Instruction) -> Instruction:
        """Return a touch on its page: those made, those to come in any case, what this one would tell."""
        rules = self.rules
        named = [name for name, _, _ in named_touches(rules)]
        steps = [*(point.step for point in self.points), step]
        if step in named:
            steps += named[named.index(step) + 1 :]
        if rules.check_above and role != "above":
            steps.append(ABOVE_STEP)
        points_m: dict[str, list[Triple]] = {
            of: [p.at_m for p in _frame_points(rules, self.points) if p.role == of] for of in FIRST_FIXED
        }
        meter = frame_meter(
            role,
            points_m,
            tip_in_flange_m=rules.tip_in_flange_m,
            sigma_m=rules.goal.sigma_m,
            limits=(rules.goal.origin_u_m, rules.goal.angle_u_rad),
        )
        return points_page(instruction, point_states(steps, len(self.points)), meter)


def _further_touch(role: FrameRole, number: int) -> tuple[str, FrameRole, Instruction]:
    name, instruction = _MORE[role]
    return f"{name} {number}", role, instruction


def _with_known_text(instruction: Instruction, taught: TaughtFrame) -> Instruction:
    origin, turn = 2e3 * max(taught.origin_sigma_m), 2e3 * max(taught.rotation_sigma_rad)
    known_text = make_message(
        "So far the origin is known within {origin:.2f} mm, the axes within {turn:.2f} mm per metre (95 %).",
        origin=origin,
        turn=turn,
    )
    return Instruction(
        instruction.key,
        make_message(
            "{instruction_text} {known_text}", instruction_text=instruction.text, known_text=known_text
        ),
    )


def _frame_points(rules: FrameRules, points: Sequence[FrameTouch]) -> list[FramePoint]:
    return [FramePoint(p.role, tip_in_base(p.base_flange, rules.tip_in_flange_m)) for p in points]
