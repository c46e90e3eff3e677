"""What the buttons of each question say, the question in a positive form, and the drawing that shows what to do.

The words of an instruction stand in the journal and do not change with this table: a run that is resumed after an
update finds its inputs as they were. Keys are those of `Instruction`; a pattern stands for keys that are numbered.
"""

import re
from dataclasses import dataclass
from functools import lru_cache


@dataclass(frozen=True, slots=True)
class PromptAnswers:
    """The texts with which a screen shows one question. An empty ``question`` leaves the instruction's own words."""

    yes: str
    no: str
    drawing: str  # of web/public/steps
    question: str = ""
    is_folded: bool = False  # all words and figures stand behind "show"


_HERE = "It is not possible here"
_UNCHANGED = "Leave it as it was"
_MOVE = ("It may move", "Not now")
_TOUCHED = ("Record this point", "I cannot reach it")

_PATTERNS: tuple[tuple[str, PromptAnswers], ...] = (
    (
        "saved_counts",
        PromptAnswers(
            "Use these counts",
            "I have newer ones",
            "counts",
            "Start from the encoder counts that were saved while the robot was healthy?",
            is_folded=True,
        ),
    ),
    ("new_battery", PromptAnswers("New batteries are in", "I have no batteries", "battery")),
    ("power_cycle", PromptAnswers("It is switched on again", "I may not switch it off", "power")),
    ("at_reference", PromptAnswers("It stands by the marks", "The marks are not readable", "marks")),
    (
        "compare_plate",
        PromptAnswers("It is this arm, unchanged", "It is another arm or part", "plate"),
    ),
    ("may_move|approve_move", PromptAnswers(*_MOVE, "look")),
    ("may_still_move", PromptAnswers("It may go on moving", "Not now", "look")),
    ("may_move_faster", PromptAnswers("It may move that fast", "Keep it slow", "look")),
    ("accept_plan", PromptAnswers(*_MOVE, "approve")),
    (
        "retry",
        PromptAnswers("Try it again", "Stop here", "again"),
    ),
    ("move_by_hand", PromptAnswers("The arm stands there", _HERE, "pendant")),
    ("reset_alarms_by_hand", PromptAnswers("The alarms are reset", "An alarm stays", "pendant")),
    ("clear_mastered_by_hand", PromptAnswers("It is cleared", "I cannot clear it", "pendant")),
    ("type_mastering", PromptAnswers("The six numbers are typed", "I cannot type them", "pendant")),
    ("near_record_pose", PromptAnswers("The arm stands there", _HERE, "pendant")),
    ("bring_back_.*", PromptAnswers("The axis is brought back", _HERE, "pendant")),
    ("position_kept", PromptAnswers("None of this happened", "Something was done", "pendant")),
    ("position_still_lost", PromptAnswers("It is brought back", "An alarm stays", "pendant")),
    ("jog_by_hand", PromptAnswers("The arm stands there", _HERE, "pendant")),
    (
        "accept_mastering",
        PromptAnswers("Write the mastering", _UNCHANGED, "write", "Write this mastering to the controller?"),
    ),
    (
        "accept_zeros",
        PromptAnswers("Write the zeros", _UNCHANGED, "write", "Write these zeros to the controller?"),
    ),
    (
        "accept_tool",
        PromptAnswers("Write the tool", _UNCHANGED, "write", "Write this tool frame to the controller?"),
    ),
    (
        "accept_frame|accept_offset",
        PromptAnswers("Write the frame", _UNCHANGED, "write", "Write this user frame to the controller?"),
    ),
    (
        "accept_alignment|accept_bases|accept_parameters|accept_part",
        PromptAnswers("Keep this result", "Throw it away", "review", "Keep this result?"),
    ),
    (
        "use_kit",
        PromptAnswers("Record these places", "Choose another way", "places", is_folded=False),
    ),
    ("choose_kit", PromptAnswers("Use this kit", "None of them is here", "places")),
    ("fixture_not_moved", PromptAnswers("Nothing was moved", "Something was moved", "fixture")),
    ("wire_stands", PromptAnswers("The draw-wire stands there", "It stands elsewhere", "wire")),
    ("wire_is_hooked|hook_wire_back", PromptAnswers("The wire is hooked in", "I have no draw-wire", "hook")),
    ("hook_wire_.*", PromptAnswers("The wire is hooked in", _HERE, "hook")),
    ("hook_stays_on", PromptAnswers("The adaptor is fixed", "I have no adaptor", "hook")),
    ("mount_wire_.*", PromptAnswers("The wire is mounted", _HERE, "mount_wire")),
    ("target_is_mounted|target_back", PromptAnswers("The target is in place", "I have no target", "target")),
    ("target_to_point_.*", PromptAnswers("The target is in place", _HERE, "target")),
    ("pointer_is_mounted", PromptAnswers("The pointer is mounted", "I have no pointer", "pointer")),
    ("pin_is_fixed", PromptAnswers("The pin is fixed", "I have no pin", "pin")),
    ("probe_at_corner", PromptAnswers("The probe is over the corner", _HERE, "probe")),
    ("visit_seat_.*", PromptAnswers("It sits in the seat", _HERE, "seat")),
    ("visit_(target|nest)_.*", PromptAnswers("The target is in place", _HERE, "target")),
    ("visit_.*", PromptAnswers("It touches the point", _HERE, "touch")),
    ("touch_about_.", PromptAnswers(*_TOUCHED, "turn_touch")),
    (
        "touch_origin.*|touch_on_.*|touch_more_.*|touch_above|touch_point_.*",
        PromptAnswers(*_TOUCHED, "touch_frame"),
    ),
    ("touch|touch_anew_.*", PromptAnswers(*_TOUCHED, "touch")),
    ("touch_.*", PromptAnswers(*_TOUCHED, "turn_touch")),
    ("orient_origin|hold_tool", PromptAnswers("Record this attitude", _HERE, "square")),
    ("along_.", PromptAnswers("Record this point", _HERE, "along")),
    ("type_.*|read_.*|enter_.*", PromptAnswers("Take this value", "I cannot read it", "enter")),
    ("run_is_old", PromptAnswers("Go on with this run", "Leave it", "again")),
    ("discard.*", PromptAnswers("Measure again from there", "Keep what was measured", "again")),
)
PLAIN = PromptAnswers("Done, go on", "Not possible", "ask")


@lru_cache(maxsize=256)
def answers_for(key: str) -> PromptAnswers:
    """Return what a screen shows of a question with this key."""
    return next((answers for pattern, answers in _PATTERNS if re.fullmatch(pattern, key)), PLAIN)


def all_answers() -> tuple[PromptAnswers, ...]:
    """Return all that a screen can show, for catalogues and tests."""
    return (*(answers for _, answers in _PATTERNS), PLAIN)
