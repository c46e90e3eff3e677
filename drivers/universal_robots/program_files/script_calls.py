"""What an argument of a URScript call is for: where the arm goes, what it starts from, a frame, a tool."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Literal, TypeAlias

Role: TypeAlias = Literal["target", "near", "frame", "in_frame", "tool", "value", "other"]

# How many arguments, from the first, are places to go to; and what these are called when they are named.
MOVES = {
    "movej": 1, "movel": 1, "movep": 1, "movec": 2, "servoc": 1, "servoj": 1, "optimovej": 1, "optimovel": 1,
}  # fmt: skip
_MOVE_KEYWORDS = frozenset({"q", "pose", "pose_via", "pose_to"})
_TARGETS = {
    **{move: (count, _MOVE_KEYWORDS) for move, count in MOVES.items()},
    "get_inverse_kin": (1, frozenset({"x"})),
    "get_forward_kin": (1, frozenset({"q"})),
    "set_tcp": (1, frozenset({"pose"})),
}
# What takes lists of numbers that are no joints to go to (speeds, forces, tables), or tells itself what they are for.
NUMBER_TAKERS = frozenset(_TARGETS) | frozenset(
    (
        "if", "elif", "while", "and", "or", "not", "xor", "return",
        "abs", "acos", "asin", "atan", "atan2", "ceil", "cos", "d2r", "floor", "log", "pow",
        "r2d", "sin", "sqrt", "tan", "sleep", "path_offset_set", "set_analog_out",
        "set_standard_analog_out",
        "speedj", "speedl", "force_mode", "set_payload", "set_target_payload", "set_gravity",
        "torque_command", "direct_torque", "wrench_trans", "tool_contact", "joint_stop", "estimate_payload",
        "get_list_length", "length", "norm", "dot_product", "transpose", "inv", "size", "to_str", "str_cat",
        "textmsg",
        "popup", "write_output_float_register", "rtde_set_watchdog", "rpc_factory", "make_list", "struct", "clear",
        "append", "insert", "extend", "remove", "slice", "is_within_safety_limits", "set_conveyor_tick_count",
        "set_joint_friction_parameters", "freedrive_mode", "reset_revolution_counter", "socket_send_string",
    )
)  # fmt: skip


@dataclass(slots=True)
class OpenCall:
    """A bracket that is open: a call's, or a list's."""

    opens: str
    function: str  # "" where it is a list or brackets of an expression; "p" for a pose
    offset: int
    argument: int = 0
    spoiled: bool = False  # one of the list's numbers is none
    index: bool = False  # it chooses from a list: Places[0]
    keyword: str = ""
    first_name: str = ""  # the first argument, where it is a name and nothing else
    reached: set[int] = field(default_factory=set)  # arguments that are a place to go to, and known to be one

    def next_argument(self) -> None:
        self.argument += 1
        self.keyword = ""

    def look_for_spoiled(self, kind: str, text: str, before: str) -> None:
        """Note a number of a list that is spoiled, doubled or not there; ``before`` is the kind of token before."""
        is_doubled = kind == "number" and before in ("number", "spoiled")
        is_absent = (text in (",", "]") and before == "sign") or (text == "," and before == "open")
        self.spoiled = self.spoiled or kind == "spoiled" or is_doubled or is_absent

    @property
    def is_understood(self) -> bool:
        """Whether every place that this move goes to is one we know."""
        return len(self.reached) >= min(MOVES.get(self.function, 1), self.argument + 1)


def role_in(stack: Sequence[OpenCall]) -> tuple[Role, str]:
    """Return what the argument that is being read is for, and the frame's or the function's name."""
    if not stack:
        return "other", ""
    call = stack[-1]
    if call.function == "pose_trans" and call.argument < 2 and role_in(stack[:-1])[0] == "target":
        return ("in_frame", call.first_name) if call.argument else ("frame", "pose_trans")
    targets, keywords = _TARGETS.get(call.function, (0, frozenset()))
    if call.keyword in keywords if call.keyword else call.argument < targets:
        return ("tool" if call.function == "set_tcp" else "target"), call.function
    near = call.keyword == "qnear" or (not call.keyword and call.argument == 1)
    return ("near" if near and call.function == "get_inverse_kin" else "other"), call.function
