"""Functions that a URScript calls: as statements, and in expressions where the name tells of motion."""

import re

from cellcal.drivers.programs.called_routines import CalledRoutine, RoutineNames, function_moves
from cellcal.drivers.programs.errors import ProgramFileError
from cellcal.drivers.programs.line_numbers import LineNumbers
from cellcal.drivers.universal_robots.program_files.script_calls import MOVES, NUMBER_TAKERS
from cellcal.drivers.universal_robots.program_files.urp_archive import unpack_file

_HIDDEN = re.compile(r'"[^"\n]*"|\'[^\'\n]*\'|#[^\n]*')
_STATEMENT = re.compile(r"^[ \t]*(?:run[ \t]+|join[ \t]+)?([A-Za-z_]\w*)[ \t]*\(", re.MULTILINE)
_SCRIPT_NODE = re.compile(r"<cachedContents\b[^>]*>([^<]*)</cachedContents")
_NO_BREAK = re.compile(r"[^\n]")
_IN_EXPRESSION = re.compile(r"(?<![\w.])(?<!def )(?<!thread )(?<!sec )([A-Za-z_]\w*)[ \t]*\(")
_FUNCTION = re.compile(r"^[ \t]*(?:def|thread|sec)[ \t]+([A-Za-z_]\w*)", re.MULTILINE)
_PREFIXES = (
    "set_", "get_", "is_", "write_", "read_", "modbus_", "socket_", "rtde_", "tool_", "force_mode", "freedrive_",
    "end_", "start_", "stop", "textmsg", "popup", "enter_", "exit_", "reset_", "enable_", "disable_", "request_",
    "conveyor_", "track_", "teach_mode", "interpreter_", "clear_", "power", "screw_driving", "skip", "trigger",
    "zero_", "unlock_", "position_deviation", "encoder_", "pause", "halt", "protective", "time", "to_", "str_",
    "integer_to", "binary_", "point_dist", "pose_", "wrench_", "interpolate", "rotvec", "rpy2", "random", "rpc_",
    "hand_eye", "calibrate", "assert", "sync", "sleep", "joint_stop", "payload", "direct_", "torque_", "servo",
    "speed", "mc_", "path_", "jacobian", "collision", "gravity", "log_", "print",
)  # fmt: skip
_WORDS_TEXT = (
    "if elif while for def thread sec return not and or xor run join kill enter_critical sin cos tan asin acos "
    "atan atan2 sqrt pow abs floor ceil log d2r r2d norm length struct make_list global local move_to "
)
_WORDS = frozenset(_WORDS_TEXT.split())


def called_functions(data: bytes) -> tuple[CalledRoutine, ...]:
    """Return the calls of functions that are none of the language, in the order of the lines."""
    text = _HIDDEN.sub(lambda each: " " * len(each[0]), _script_of(data))
    lines = LineNumbers(text)
    stated = {each.start(1): each[1] for each in _STATEMENT.finditer(text)}
    used = {each.start(1): each[1] for each in _IN_EXPRESSION.finditer(text) if function_moves(each[1])}
    return tuple(
        CalledRoutine(lines.line_of(start), name)
        for start, name in sorted({**used, **stated}.items())
        if name not in MOVES and name not in NUMBER_TAKERS and name not in _WORDS
        and not name.startswith(_PREFIXES)
    )  # fmt: skip


def own_functions(data: bytes) -> frozenset[str]:
    """Return the functions and threads of a script."""
    return frozenset(name.upper() for name in _FUNCTION.findall(_script_of(data)))


def _script_of(data: bytes) -> str:
    """Return a script, or of a program of PolyScope its script nodes: what else it calls stands in the file."""
    if data[:2] != b"\x1f\x8b" and data[:1] != b"<":
        return data.decode("latin-1")
    try:
        xml = unpack_file("", data)[1].decode("latin-1")
    except ProgramFileError:
        return ""  # refused when it is read
    pieces, at = [], 0
    for node in _SCRIPT_NODE.finditer(xml):
        pieces += [_NO_BREAK.sub(" ", xml[at : node.start(1)]), node[1].replace("&quot;", '"     ')]
        at = node.end(1)
    return "".join(pieces)


NAMES = RoutineNames(called_functions, own_functions)
