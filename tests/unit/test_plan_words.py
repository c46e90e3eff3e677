"""A plan is told in three lines, whatever procedure asks: what moves, how far, how long."""

import math
import re
from pathlib import Path

from cellcal import procedures
from cellcal.procedures.motion.plan_words import PER_POSE_S, PlanTour, plan_words
from cellcal.procedures.motion.speed_limit import TimedMotion


def test_a_plan_has_three_lines_and_names_what_was_not_checked() -> None:
    words = plan_words(
        "the robot, to 3 poses", PlanTour(3, TimedMotion(math.pi, 60.0, 0.1)), ("no workspace box known",)
    )
    lines = words.splitlines()
    assert [line.split(":")[0] for line in lines] == ["What moves", "How far", "How long", "Not checked"]
    assert "180 deg" in lines[1]
    assert "5.7 deg/s" in lines[1]
    assert "no workspace box known" in lines[3]
    assert lines[3].endswith("May it move?")


def test_time_counts_the_stops_and_names_manual_steps() -> None:
    tour = PlanTour(10, TimedMotion(15.0, 30.0, 0.5), "hang the hook into each point")
    assert tour.duration_min == (30.0 + 10 * PER_POSE_S) / 60.0
    assert "hang the hook" in plan_words("the robot", tour, ())


def test_every_procedure_that_asks_for_a_plan_uses_plan_words() -> None:
    room = Path(procedures.__file__).parent
    asking = [
        path
        for path in room.rglob("*.py")
        if path.name != "prompt_answers.py" and re.search(r'"accept_plan"', path.read_text("utf-8"))
    ]
    assert len(asking) >= 6
    for path in asking:
        assert "plan_words(" in path.read_text("utf-8"), path.name
