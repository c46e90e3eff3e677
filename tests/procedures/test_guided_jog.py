"""Turns of single axes by a person at the pendant, and whole recoveries by hand."""

import math
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import pytest

from cellcal.drivers.errors import RefusedError
from cellcal.drivers.interfaces import Answer, Instruction, MasteringData
from cellcal.procedures.cell import Cell, MotionLevel
from cellcal.procedures.motion.axis_watch import AxisWatch
from cellcal.procedures.motion.guided_jog import TRIES, HandJog, jog_by_hand
from cellcal.procedures.motion.manual_moves import NotThereError
from cellcal.procedures.recovery.pendant_mastering import TRIES as TYPED_TRIES
from cellcal.procedures.recovery.pendant_mastering import PendantMastering
from tests.procedures.ideal_devices import COUNTS, ZERO, IdealArm, ScriptedTechnician, drive_train
from tests.procedures.pendant_recovery import pendant_scene, recover_by_hand
from tests.procedures.procedure_scenes import healthy_scene
from tests.soak.pendant import judge_recoveries

DEGREE = math.radians(1.0)
JOG = HandJog(axis=2, delta_rad=10 * DEGREE, speed_rad_s=0.035, tolerance_rad=0.5 * DEGREE)


@dataclass
class Hand(ScriptedTechnician):
    """Does one scripted turn for each instruction: axis and degrees, more than one if need be."""

    arm: IdealArm = field(default_factory=IdealArm)
    turns: list[list[tuple[int, float]]] = field(default_factory=list)
    texts: list[str] = field(default_factory=list)
    guidance: list[tuple[str, dict[str, Any]]] = field(default_factory=list)

    async def confirm(self, instruction: Instruction) -> Answer:
        self.texts.append(instruction.text)
        for axis, degrees in self.turns.pop(0) if self.turns else []:
            await self.arm.jog_axis(axis, degrees * DEGREE, speed_rad_s=0.035)
        return await super().confirm(instruction)

    def show_guidance(self, text: str, values: Mapping[str, Any]) -> None:
        self.guidance.append((text, dict(values)))


def hand_cell(*turns: list[tuple[int, float]]) -> tuple[Cell, Hand]:
    made = healthy_scene()
    hand = Hand(arm=made.arm, turns=list(turns))
    limits = replace(made.cell.limits, look_s=0.0)
    return replace(made.cell, operator=hand, jogs=None, level=MotionLevel.OBSERVE, limits=limits), hand


async def test_what_is_left_is_asked_for_until_the_counts_show_it() -> None:
    cell, hand = hand_cell([(2, 8.0)], [(2, 1.7)])
    await jog_by_hand(cell, JOG)
    assert "turn J3 alone by +10.00 deg" in hand.texts[0]
    assert "Not there yet." in hand.texts[1]
    assert "turn J3 alone by +2.00 deg" in hand.texts[1]
    assert len(hand.texts) == 2


async def test_a_wrong_axis_is_turned_back_before_the_turn_is_asked_for_again() -> None:
    cell, hand = hand_cell([(4, 9.0)], [(4, -9.2)], [(2, 10.0)])
    await jog_by_hand(cell, JOG)
    assert "J5 turned by +9.00 deg and should have stood." in hand.texts[1]
    assert "turn J5 alone by -9.00 deg" in hand.texts[1]
    assert "turn J3 alone by +10.00 deg" in hand.texts[2]
    assert np.allclose(hand.arm.true_joints, np.array([0, 0, 10.0, 0, -0.2, 0]) * DEGREE, atol=1e-5)


async def test_two_wrong_axes_are_turned_back_one_after_the_other() -> None:
    cell, hand = hand_cell([(0, 3.0), (4, -9.0)], [(4, 9.0)], [(0, -3.0)], [(2, 10.0)])
    await jog_by_hand(cell, JOG)
    assert ["J5 turned by -9.00" in hand.texts[1], "J1 turned by +3.00" in hand.texts[2]] == [True, True]


async def test_a_right_turn_beside_a_wrong_axis_is_not_taken_as_done() -> None:
    cell, hand = hand_cell([(2, 10.0), (1, -4.0)], [(1, 4.0)])
    await jog_by_hand(cell, JOG)
    assert "J2 turned by -4.00 deg" in hand.texts[1]
    assert len(hand.texts) == 2


async def test_a_person_who_never_gets_there_is_refused_with_what_is_left() -> None:
    cell, hand = hand_cell()
    with pytest.raises(NotThereError, match=r"J3 was not turned as asked: \+10.00 deg are left"):
        await jog_by_hand(cell, JOG)
    assert len(hand.texts) == TRIES


@pytest.mark.parametrize(
    ("turns", "asked"),
    [
        ([[(2, -11.0), (2, 1.0)]], 1),
        ([[(2, -10.0)], [(2, 1.0)]], 2),  # at its end, and from above: the side is asked for
        ([[(2, -15.0), (2, 1.0)], [(2, 4.1)]], 2),
        ([[(2, 11.0)], [(2, -22.0), (2, 1.0)]], 2),  # the wrong way first
    ],
)
async def test_a_turn_down_ends_upwards(turns: list[list[tuple[int, float]]], asked: int) -> None:
    cell, hand = hand_cell(*turns)
    jog = replace(JOG, delta_rad=-10 * DEGREE, tolerance_rad=3 * DEGREE, from_below=True)
    await jog_by_hand(cell, jog)
    assert "turn J3 alone by -11.00 deg" in hand.texts[0]
    assert "turn it back by +1.00 deg" in hand.texts[0]
    assert len(hand.texts) == asked
    assert abs(hand.arm.true_joints[2] + 10 * DEGREE) <= 3 * DEGREE


async def test_the_guidance_says_key_rest_and_when_to_stop() -> None:
    cell, hand = hand_cell([(2, 4.0), (2, 4.0), (2, 2.05)])
    await jog_by_hand(cell, JOG)
    advices = [values["advice"] for _, values in hand.guidance]
    assert advices[0] in ("turn", "slow")
    assert "slow" in advices
    assert any(
        re.fullmatch(r"Turn J3 with the \+ key, [12]\.\d deg are left\. Now slowly\.", text)
        for text, _ in hand.guidance
    )
    assert [values["axis"] for _, values in hand.guidance] == [2] * len(hand.guidance)


@pytest.mark.parametrize(
    ("turn", "advice", "words"),
    [
        ((2, -4.0), "wrong_way", "Stop: J3 turns the wrong way. Use the + key, 14.0 deg are left."),
        ((3, 4.0), "wrong_axis", "Stop: J4 turned by +4.0 deg. Only J3 may turn."),
        ((2, 10.0), "stop", "Stop now: J3 is there."),
    ],
)
async def test_a_mistake_is_shown_while_the_person_jogs(
    turn: tuple[int, float], advice: str, words: str
) -> None:
    cell, hand = hand_cell([turn, (2, 0.0)], [(turn[0], -turn[1])], [(2, 10.0)])
    if advice == "wrong_way":
        hand.turns[1:] = [[(2, 14.0)]]
    await jog_by_hand(cell, JOG)
    assert (words, advice) in [(text, values["advice"]) for text, values in hand.guidance]


async def test_axes_are_called_as_the_pendant_of_this_robot_calls_them() -> None:
    cell, hand = hand_cell([(3, 4.0)], [(3, -4.0)], [(2, 10.0)])
    hand.arm.axis_names = ("S", "L", "U", "R", "B", "T")
    await jog_by_hand(cell, JOG)
    assert hand.texts[0].startswith("With the pendant, turn U alone")
    assert hand.texts[1].startswith("R turned by +4.00 deg and should have stood.")
    assert "Stop: R turned by +4.0 deg. Only U may turn." in [text for text, _ in hand.guidance]
    assert not re.search(r"J\d", " ".join([*hand.texts, *(text for text, _ in hand.guidance)]))


def test_a_joint_that_sank_again_is_not_from_below() -> None:
    watch = AxisWatch(drive_train(), ZERO)
    for degrees, from_below in (
        (5.0, True),
        (4.0, False),
        (4.1, False),
        (4.3, True),
        (4.29, True),
        (3.9, False),
    ):
        turned = np.array([0, degrees, 0, 0, 0, 0]) * DEGREE
        watch.take_counts(tuple(int(c) for c in drive_train().to_counts(turned, np.array(ZERO))))
        assert watch.is_from_below(1) is from_below, degrees


def typing(arm: IdealArm, *entered: tuple[int, ...]) -> Callable[[], None]:
    left_entries = list(entered)

    def enter() -> None:
        if left_entries:
            arm.data = MasteringData(left_entries.pop(0), mastered=True)

    return enter


async def test_a_mistyped_count_is_named_and_typed_again() -> None:
    arm, hands = IdealArm(), ScriptedTechnician()
    goal = tuple(zero + COUNTS for zero in ZERO)
    hands.does["type_mastering"] = typing(arm, (*goal[:3], goal[3] + 1000, *goal[4:]), goal)
    found = await PendantMastering(arm, hands).write_mastering(goal)
    assert found == MasteringData(goal, mastered=True)
    assert f"J4 reads {goal[3] + 1000}, not {goal[3]}" in hands.read["type_mastering"]
    assert arm.writes == 0


async def test_a_count_that_stays_mistyped_is_refused() -> None:
    arm, hands = IdealArm(), ScriptedTechnician()
    goal = tuple(zero + COUNTS for zero in ZERO)
    with pytest.raises(RefusedError, match="J1 reads"):
        await PendantMastering(arm, hands).write_mastering(goal)
    assert hands.instructions == ["type_mastering"] * TYPED_TRIES


async def test_counts_that_stay_mistyped_are_no_mastering_of_a_robot_that_had_none() -> None:
    arm, hands = IdealArm(), ScriptedTechnician()
    arm.data = MasteringData(ZERO, mastered=False)
    goal = tuple(zero + COUNTS for zero in ZERO)
    hands.does["type_mastering"] = lambda: setattr(arm, "data", MasteringData(ZERO, mastered=True))
    hands.does["clear_mastered_by_hand"] = lambda: setattr(arm, "data", replace(arm.data, mastered=False))
    for refuses in (set(), {"clear_mastered_by_hand"}):
        hands.refuses = refuses
        hands.instructions.clear()
        with pytest.raises(RefusedError, match="J1 reads"):
            await PendantMastering(arm, hands).write_mastering(goal)
        assert hands.instructions == [*["type_mastering"] * TYPED_TRIES, "clear_mastered_by_hand"]
        assert arm.data.mastered is bool(refuses)
        arm.data = MasteringData(ZERO, mastered=False)


async def test_right_counts_without_mastering_are_not_enough() -> None:
    arm, hands = IdealArm(), ScriptedTechnician()
    arm.data = MasteringData(ZERO, mastered=False)
    with pytest.raises(RefusedError, match="not mastered by them yet"):
        await PendantMastering(arm, hands).write_mastering(ZERO)


async def test_data_that_were_not_in_force_are_put_back_as_they_were() -> None:
    arm, hands = IdealArm(), ScriptedTechnician()
    old = MasteringData(tuple(zero - 5 for zero in ZERO), mastered=False)
    hands.does["type_mastering"] = typing(arm, old.counts_at_zero)
    hands.does["clear_mastered_by_hand"] = lambda: setattr(arm, "data", replace(arm.data, mastered=False))
    assert await PendantMastering(arm, hands).restore_mastering(old) == old
    assert hands.instructions == ["type_mastering", "clear_mastered_by_hand"]


async def test_a_person_who_misjudges_every_jog_recovers_the_robot() -> None:
    found = [await recover_by_hand(seed) for seed in (3, 4, 5)]
    assert all(each.commands == () for each in found)  # nothing but the person moved it
    assert judge_recoveries(found).reached, [each.reason for each in found]


async def test_no_wire_is_needed_to_jog_or_write() -> None:
    made, hands = await pendant_scene(1)
    assert made.cell.jogs is None
    assert hands.mistyped > 0.0
    assert made.cell.is_jogged_by_hand
