"""Routines that a KUKA program calls as statements, and handlers of its interrupts.

Calls inside the folds of inline forms are those of KUKA's own packages, which move to points that the fold names.
"""

import re
from collections.abc import Iterator

from cellcal.drivers.kuka.program_files import patterns
from cellcal.drivers.programs.called_routines import CalledRoutine, RoutineNames, function_moves

_STATEMENT = re.compile(r"[ \t\r]*([A-Za-z_]\w*)[ \t]*\([^;\n]*", re.ASCII)
_HANDLER = re.compile(
    r"[^;\n]*\bINTERRUPT[ \t]+DECL\b[^;\n]*\bDO[ \t]+([A-Za-z_]\w*)", re.IGNORECASE | re.ASCII
)
_IN_EXPRESSION = re.compile(r"(?<![\w.$#])([A-Za-z_]\w*)[ \t]*\(", re.ASCII)
_DECLARES = re.compile(r"[ \t]*(?:GLOBAL[ \t]+)?(?:DEF|DEFFCT|DECL|EXT|EXTFCT|SIGNAL)\b", re.IGNORECASE)
_STRING = re.compile(r'"[^"\n]*"')
_ROUTINE = re.compile(
    r"^[ \t]*(?:GLOBAL[ \t]+)?(?:DEF|DEFFCT[ \t]+\w+(?:[ \t]*\[[^\]\n]*\])?)[ \t]+([A-Za-z_]\w*)",
    re.IGNORECASE | re.MULTILINE | re.ASCII,
)
_INLINE = re.compile(r"%\{PE\}|%MKUKA|%\{E\}%M|;%\{", re.IGNORECASE)
_FOLD = re.compile(r"[ \t]*;[ \t]*(FOLD|ENDFOLD)\b", re.IGNORECASE)
# Of the language, of its interfaces and of KUKA's packages: none of them moves to a point of another file.
_OF_LANGUAGE_TEXT = (
    "PULSE SYNC CWRITE CREAD COPEN CCLOSE SWRITE SREAD CAST_TO CAST_FROM CIOCTL DELETE_BACKWARD_BUFFER "
    "CLEAR_KRLMSG SET_KRLMSG SET_KRLDLG EXISTS_KRLMSG EXISTS_KRLDLG GET_MSGBUFFER SET_OPT_FILTER DIAG_START "
    "DIAG_STOP M_COMMENT IOCTL WAITFOR ERR_RAISE ERR_CLEAR CHECK_CONFIG MBX_REC GET_DECL_PLACE GET_SIG_INF STRADD "
    "STRCLEAR STRCOPY STRCOMP STRFIND STRLEN STRDECLLEN STRTOBOOL STRTOINT STRTOREAL STRTOSTRING STRTOFRAME "
    "STRTOPOS STRTOE3POS STRTOE6POS STRTOAXIS STRTOE3AXIS STRTOE6AXIS TIMER_LIMIT USER_GRP USERSPOT A10 A10_INI "
    "A20 A50 H50 H70 GRP MAXIMIZE_USED_SPEED SET_TORQUE_LIMITS RESET_TORQUE_LIMITS TRIGGER WAIT RETURN ANIN ANOUT "
    "SIGNAL RESUME BRAKE HALT CONFIRM NAT_LANG TOUCHDOWN RSI_CREATE RSI_DELETE RSI_ON RSI_OFF RSI_ENABLE "
    "MSGNOTIFY MSGQUIT MSGDIALOG MSGLOOP LOAD_DATA VARSTATE RSI_DISABLE RSI_RESET "
    "RSI_SHOW RSI_MOVECORR ST_ON1 CONVEYOR GRIPPERTECH SPOT "
)
_OF_LANGUAGE = frozenset(_OF_LANGUAGE_TEXT.split())


def called_routines(data: bytes) -> tuple[CalledRoutine, ...]:
    """Return the calls that stand as statements outside inline forms, in the order of the lines."""
    found: list[CalledRoutine] = []
    folds: list[bool] = []
    for number, line in enumerate(data.decode("latin-1").split("\n"), 1):
        fold = _FOLD.match(line)
        if fold is not None:
            if fold[1].upper() == "FOLD":
                folds.append(_INLINE.search(line) is not None)
            elif folds:
                folds.pop()
            continue
        if any(folds) or "(" not in line:
            continue
        found += [CalledRoutine(number, name) for name in _functions_in(line)]
        called = _STATEMENT.match(line) or _HANDLER.match(line)
        if called is None or _is_of_language(called[1]) or "=" in line[called.end() :].partition(";")[0]:
            continue
        if called.re is _STATEMENT and not called[0].rstrip().endswith(")"):
            continue
        found.append(CalledRoutine(number, called[1]))
    return tuple(found)


def _functions_in(line: str) -> Iterator[str]:
    """Yield the functions whose value a line uses, and whose names tell of motion."""
    if _DECLARES.match(line):
        return
    code = _STRING.sub('""', line).partition(";")[0]
    stated = _STATEMENT.match(code)
    for each in _IN_EXPRESSION.finditer(code):
        is_stated = stated is not None and stated.start(1) == each.start(1)
        if not is_stated and function_moves(each[1]) and not _is_of_language(each[1]):
            yield each[1]


def _is_of_language(name: str) -> bool:
    upper = name.upper()
    return (
        upper in patterns.KNOWN_CALLS
        or upper in patterns.CALLS_NOTHING
        or upper in patterns.BEGIN_ROUTINE
        or upper in _OF_LANGUAGE
        or upper.startswith(("EKI_", "RSI_GET", "RSI_SET", "RSI_CHECK", "KRL_", "IR_", "DIAG_"))
    )


def own_routines(data: bytes) -> frozenset[str]:
    """Return the routines of a file."""
    return frozenset(name.upper() for name in _ROUTINE.findall(data.decode("latin-1")))


NAMES = RoutineNames(called_routines, own_routines)
