"""A slice of `make soak ARGS=program_motion.abb`: programs are moved, and an interpreter says what the robot does."""

import numpy as np
import pytest

from tests.programs.motion.campaign import MotionTally, try_one
from tests.programs.motion.geometry import NamedMisses, TipTarget, moved_wrongly
from tests.programs.motion.languages import LANGUAGES


@pytest.mark.parametrize("part", range(4))
@pytest.mark.parametrize("name", LANGUAGES)
def test_a_motion_goes_along_with_the_work_or_is_named(name: str, part: int) -> None:
    tally = MotionTally()
    for seed in range(40 * part, 40 * part + 40):
        try_one(LANGUAGES[name], seed, tally)
    assert not tally.wrong
    assert tally.changed > 20
    assert tally.findings > 10


@pytest.mark.parametrize("name", LANGUAGES)
def test_the_interpreter_sees_a_program_that_was_not_changed(name: str) -> None:
    language, change = LANGUAGES[name], np.eye(4)
    change[0, 3] = 0.001
    tips = [tip for seed in range(5) for tip in language.interpret(language.generate(seed))]
    placed = [tip for tip in tips if tip.base_tip is not None]
    assert len(moved_wrongly(tips, tips, change, NamedMisses())) == len(placed) > 5


def test_what_is_named_is_not_counted_as_wrong() -> None:
    tip = TipTarget(7, frozenset({"p1", "#3"}), np.eye(4))
    for named in (NamedMisses(lines={7}), NamedMisses(names={"p1"}), NamedMisses(lines={3})):
        assert named.names_motion(tip)
    assert not NamedMisses(lines={1}, names={"p2"}).names_motion(tip)
