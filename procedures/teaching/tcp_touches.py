"""Touches of one pin in many attitudes: each is judged at once, and the next one is asked for where it tells most.

A touch in an attitude too like the others is taught again before anything is computed from it; so is a touch that
the others contradict. It goes on until the tip is known as well as the class of limits wants.
"""

import math
from dataclasses import dataclass
from typing import Literal

from cellcal.calibration.geometry import Pose
from cellcal.calibration.message import join_messages, make_message
from cellcal.calibration.points.tool_point import ToolPoint, locate_tool_point
from cellcal.calibration.points.touch_design import (
    AlikeTouch,
    alike_touch,
    fixed_plan_touches,
    next_turn,
    predicted_u_m,
)
from cellcal.drivers.interfaces import Instruction
from cellcal.procedures.run import OutOfToleranceError, RefusalError, Run
from cellcal.procedures.steps.meters import tip_meter
from cellcal.procedures.steps.pages import points_page
from cellcal.procedures.steps.teach import teach_pose
from cellcal.procedures.verdict import SetAside

WORST_GAIN = 4.0  # of the tip over a touch, in the worst direction, from three touches: about 20 degrees
AGAIN_RAD = math.radians(2.0)  # a further touch may be like others, but must be a new one
STRAY = 0.005  # how improbable a touch is before it is taught again …
STRAY_SIGMAS = 4.0  # … and how far off: a few touches may agree too well by chance
MANUAL_TILT_RAD = math.radians(30.0)  # what a maker's manual advises: FANUC B-83284EN/09, 3.9
MOST_ANEW = 6


@dataclass(frozen=True, slots=True)
class TouchRules:
    """When there are enough touches, and which are taught again."""

    least: int
    most: int
    sigma_m: float
    arm_sigma_m: float
    tip_u_m: float
    rms_limit_m: float
    min_turn_rad: float
    most_tilt_rad: float


@dataclass(frozen=True, slots=True)
class TouchDecision:
    """The decision from the touches so far, and the next action."""

    do: Literal["touch", "anew", "enough", "wrong"]
    touch: int  # counted from 0
    why: str
    advice: str
    foreseen_u_m: float | None  # by the attitudes alone and sigma_m; None while they do not fix the tip
    tip_u_m: float | None  # by the scatter; None while there is none


@dataclass(frozen=True, slots=True)
class TcpTouches:
    """All touches that count, and what they say of the tip."""

    base_flange: tuple[Pose, ...]
    tip: ToolPoint
    set_aside: tuple[SetAside, ...]
    fixed_plan: int | None  # touches in attitudes fixed beforehand that the same U would take


@dataclass(frozen=True, slots=True)
class FoundTip:
    """The tip, and how many touches in fixed attitudes would have done as much."""

    tip: ToolPoint
    fixed_plan: int | None


async def take_touches(run: Run, rules: TouchRules, named: tuple[tuple[str, Instruction], ...]) -> TcpTouches:
    """Have the pin touched until the tip is known well enough; ``named`` are the method's own touches."""
    steps: list[str] = []
    poses: list[Pose] = []
    aside: list[SetAside] = []
    anew: list[int] = []
    judged, count = TouchDecision("touch", 0, "", "", None, None), 0
    while judged.do in ("touch", "anew"):
        step, instruction = _next_instruction(judged, len(poses), len(anew), named)
        taught = await run.step(step, teach_pose, _touch_page(rules, judged, steps, poses, instruction))
        if judged.do == "anew":
            aside.append(SetAside(steps[judged.touch], judged.why))
            steps[judged.touch], poses[judged.touch] = step, taught.base_flange
        else:
            steps.append(step)
            poses.append(taught.base_flange)
        count += 1
        judged = await run.solve(
            f"judge the touches {count}", judge_touches, rules, tuple(poses), tuple(anew)
        )
        if judged.do == "anew":
            anew.append(judged.touch)
    if judged.do == "wrong":
        raise RefusalError(judged.why, remedy=judged.advice, evidence=tuple(poses))
    found = await run.solve("locate the tip", locate_tip, rules, tuple(poses))
    _refuse_scatter(rules, found.tip)
    return TcpTouches(tuple(poses), found.tip, tuple(aside), found.fixed_plan)


def _touch_page(
    rules: TouchRules, judged: TouchDecision, steps: list[str], poses: list[Pose], instruction: Instruction
) -> Instruction:
    """Return the touch on its page: those taken so far, and what this one would tell where the arm stands."""
    again = judged.touch if judged.do == "anew" else None
    others = [pose for k, pose in enumerate(poses) if k != again]
    points = [(step, "anew" if k == again else "recorded") for k, step in enumerate(steps)]
    if again is None:
        points.append((f"touch {len(points) + 1}", "now"))
    points += [(f"touch {k}", "to_do") for k in range(len(points) + 1, rules.least + 1)]
    meter = tip_meter(
        others,
        sigma_m=rules.sigma_m,
        turns_rad=(rules.min_turn_rad, AGAIN_RAD),
        worst_gain=WORST_GAIN,
        limit_m=rules.tip_u_m,
        arm_sigma_m=rules.arm_sigma_m,
    )
    return points_page(instruction, points, meter)


def judge_touches(rules: TouchRules, touches: tuple[Pose, ...], anew: tuple[int, ...]) -> TouchDecision:
    """Say what the touches so far tell and what to do next; ``anew`` are those asked for again already."""
    predicted_u_m = _predicted_u_m(rules, touches)
    alike = _alike_touch(rules, touches)
    if alike is not None:
        return _decide_anew(alike.touch, _alike_text(alike), _mend_advice(alike), anew, predicted_u_m)
    if len(touches) < 3:
        return _decide_more(rules, touches, None)
    tip = locate_tool_point(touches, arm_sigma_m=rules.arm_sigma_m)
    if _is_stray(rules, tip):
        why = make_message(
            "the other touches contradict touch {stray_touch} by {leave_one_out_mm:.2f} mm",
            stray_touch=tip.stray_touch + 1,
            leave_one_out_mm=tip.leave_one_out_m[tip.stray_touch] * 1000.0,
        )
        return _decide_anew(
            tip.stray_touch, why, "Touch the pin in the same attitude as before.", anew, predicted_u_m
        )
    enough = max(tip.tip_u_in_space_m, predicted_u_m or math.inf) <= rules.tip_u_m
    if len(touches) >= rules.most or (enough and len(touches) >= rules.least):
        return TouchDecision("enough", len(touches), "", "", predicted_u_m, tip.tip_u_in_space_m)
    return _decide_more(rules, touches, tip)


def locate_tip(rules: TouchRules, touches: tuple[Pose, ...]) -> FoundTip:
    """Return the tip from all touches that count."""
    arm_m = rules.arm_sigma_m
    fixed = fixed_plan_touches(rules.tip_u_m, rules.sigma_m, MANUAL_TILT_RAD, arm_sigma_m=arm_m)
    return FoundTip(locate_tool_point(touches, arm_sigma_m=arm_m), fixed)


def _predicted_u_m(rules: TouchRules, touches: tuple[Pose, ...]) -> float | None:
    attitudes = [touch.rotation_matrix() for touch in touches]
    return predicted_u_m(attitudes, rules.sigma_m, arm_sigma_m=rules.arm_sigma_m)


def _alike_touch(rules: TouchRules, touches: tuple[Pose, ...]) -> AlikeTouch | None:
    """Look at the last touch: the first three must fix the tip, a further one only not be one read twice."""
    least = rules.min_turn_rad if len(touches) <= 3 else AGAIN_RAD
    return alike_touch(touches, min_turn_rad=least, worst_gain=WORST_GAIN)


def _is_stray(rules: TouchRules, tip: ToolPoint) -> bool:
    if tip.stray_probability >= STRAY or not tip.leave_one_out_m:
        return False
    return tip.leave_one_out_m[tip.stray_touch] > STRAY_SIGMAS * rules.sigma_m


def _decide_anew(
    touch: int, why: str, advice: str, anew: tuple[int, ...], predicted_u_m: float | None
) -> TouchDecision:
    if anew.count(touch) >= 2 or len(anew) >= MOST_ANEW:
        return TouchDecision(
            "wrong",
            touch,
            make_message("{why}, also after it was taught again", why=why),
            _WRONG,
            predicted_u_m,
            None,
        )
    return TouchDecision("anew", touch, why, advice, predicted_u_m, None)


_WRONG = "Check that the pin is firm and the tool tight, and that the arm moves as the instruction says."


def _decide_more(rules: TouchRules, touches: tuple[Pose, ...], tip: ToolPoint | None) -> TouchDecision:
    turn = next_turn(touches, rules.most_tilt_rad)
    return TouchDecision(
        "touch",
        len(touches),
        "",
        make_message(
            "From the first touch's attitude, turn the tool {turn} of the flange, about; touch the pin.",
            turn=turn.describe_turn(),
        ),
        _predicted_u_m(rules, touches),
        None if tip is None else tip.tip_u_in_space_m,
    )


def _alike_text(alike: AlikeTouch) -> str:
    if alike.like is None:
        return make_message(
            "touch {touch} leaves the tip open: all touches are turned about nearly one axis",
            touch=alike.touch + 1,
        )
    return make_message(
        "touch {touch} is turned only {apart_deg:.1f} degrees from touch {like}",
        touch=alike.touch + 1,
        apart_deg=math.degrees(alike.apart_rad),
        like=alike.like + 1,
    )


def _mend_advice(alike: AlikeTouch) -> str:
    return make_message(
        "Turn the tool {turn} of the flange, or further, and touch the pin again.",
        turn=alike.turn.describe_turn(),
    )


def _next_instruction(
    judged: TouchDecision, count: int, anew: int, named: tuple[tuple[str, Instruction], ...]
) -> tuple[str, Instruction]:
    """Return the next step's name and what the technician is told."""
    if judged.do == "anew":
        number = judged.touch + 1
        text = make_message(
            "Teach touch {number} again: {why}. {text}", number=number, why=judged.why, text=judged.advice
        )
        return f"touch anew {anew}", Instruction(f"touch_anew_{number}", text)
    if count < len(named):
        step, instruction = named[count]
        return step, Instruction(instruction.key, join_messages("", (instruction.text, _known_text(judged))))
    number = count + 1
    return f"touch in another attitude {number - len(named)}", Instruction(
        f"touch_{number}", join_messages("", (judged.advice, _known_text(judged)))
    )


_KNOWN_BY = {  # the attitudes, the scatter of the touches
    (True, False): " So far the tip is known within {attitudes_mm:.2f} mm by the attitudes (95 %).",
    (False, True): " So far the tip is known within {scatter_mm:.2f} mm by the touches' scatter (95 %).",
    (True, True): " So far the tip is known within {attitudes_mm:.2f} mm by the attitudes and "
    "{scatter_mm:.2f} mm by the touches' scatter (95 %).",
}


def _known_text(judged: TouchDecision) -> str:
    attitudes_mm, scatter_mm = (
        None if each is None else each * 1e3 for each in (judged.foreseen_u_m, judged.tip_u_m)
    )
    if attitudes_mm is None and scatter_mm is None:
        return ""
    template = _KNOWN_BY[attitudes_mm is not None, scatter_mm is not None]
    return make_message(template, attitudes_mm=attitudes_mm or 0.0, scatter_mm=scatter_mm or 0.0)


def _refuse_scatter(rules: TouchRules, tip: ToolPoint) -> None:
    if tip.rms_m > rules.rms_limit_m:
        raise OutOfToleranceError(
            make_message(
                "the touches disagree by {rms_mm:.2f} mm RMS, limit {rms_limit_mm:.2f} mm.",
                rms_mm=tip.rms_m * 1000.0,
                rms_limit_mm=rules.rms_limit_m * 1000.0,
            ),
            found=tip.rms_m,
            limit=rules.rms_limit_m,
            unit="m",
            remedy=make_message(
                "Check that the pin did not move, then redo touch {stray_touch}.",
                stray_touch=tip.stray_touch + 1,
            ),
        )
