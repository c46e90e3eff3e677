"""Routines that a file calls by name, and whether the name says that they move no robot."""

import re
from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

_WORD = re.compile(r"[A-Z]+(?![a-z])|[A-Z]?[a-z]+")
_LETTERS = re.compile(r"[a-z]+")
_STILL_TEXT = (
    "open close opened closed grip gripper grippers clamp unclamp clamps vac vacuum suction blow blowoff valve "
    "air lamp light lights beacon horn io di do dout din ao ai sig signal signals output outputs input inputs "
    "reset clear clr init initialise initialize initialisation ini msg message messages print display hmi popup "
    "log logging logger alarm alarms error errors err fault faults warn warning timer time timers clock wait "
    "delay check chk read write send recv receive socket comm plc handshake count counter counters speed override "
    "payload calc calculate compute math string strings date mode status state stat config cfg safety rq robotiq "
    "schunk onrobot greifer spanner spannen auf zu oeffnen schliessen melden meldung meldungen warten zeit "
    "zaehler ausgang eingang ausgaenge eingaenge takt pinza abrir cerrar mensaje esperar "
)
_TRAVEL_TEXT = "move mov go goto pos position fahr fahre fahren anfahren weg mover"
_PROCESS_TEXT = "weld glue dispense polish grind cut feed spray screw"
_WORK_TEXT = (
    "pick place put drop get appr approach retract load unload path positions hole holen lege ablegen greifen "
    "abholen change wechsel wechseln dress probe touch search scan pallet palletize depal stack insert transfer "
    "main process coger dejar "
)
_STILL = frozenset(_STILL_TEXT.split())  # signals, grippers, messages, counts and waits
_TRAVEL = frozenset(_TRAVEL_TEXT.split())
_PROCESS = frozenset(_PROCESS_TEXT.split())  # with on or off: a signal to the process
_WORK = frozenset(_WORK_TEXT.split())
_AT_REST = frozenset(
    ("home", "gohome", "perch", "park", "grundstellung")
)  # the robot's own place, as of registers
_SWITCHED = frozenset(("on", "off", "ein", "aus"))
_STILL_WITHIN = ("gripper", "greifer", "vacuum", "message", "handshake")  # also where nothing parts the words
_WORK_WITHIN = ("pick", "place", "drop", "move", "weld", "approach")


_ASKS = frozenset(
    ("get", "is", "has", "calc", "compute", "read", "find", "check", "count", "eval", "convert", "to")
)
_NO_WORK_ALONE = frozenset(
    ["pos", "position", "positions", "path", "main", "process", "weg", "change", "appr"]
)


class CalledRoutine(NamedTuple):
    """A call as it stands in a file."""

    line: int  # from 1
    name: str  # as it is written
    pattern: str = ""  # of the names that it may mean, where they are computed; in capitals


@dataclass(frozen=True, slots=True)
class RoutineNames:
    """How a brand's files name routines."""

    find_calls: Callable[[bytes], tuple[CalledRoutine, ...]]  # that may move the robot
    find_routines: Callable[[bytes], frozenset[str]]  # of the file, in capitals
    calls_itself: bool = True  # a computed name may mean a routine of its own file, which holds several


def moves_no_robot(name: str) -> bool:
    """Return whether a routine's name says that it sets signals, waits, tells or counts, or goes to the robot's home.

    A word of motion goes before: what opens a door along a path, or checks a pick, may move the robot.
    """
    words = {word.lower() for word in _WORD.findall(name)}
    if words & _WORK:
        return False
    if words & _AT_REST:
        return not words & _PROCESS
    if words & _TRAVEL:
        return False
    if words & _PROCESS or any(word in name.lower() for word in _WORK_WITHIN):
        return bool(words & _SWITCHED)
    return bool(words & (_STILL | _SWITCHED)) or any(word in name.lower() for word in _STILL_WITHIN)


def function_moves(name: str) -> bool:
    """Return whether the name of a function whose value is used says that it moves the robot before it returns.

    Other functions compute, as most do; what they return is judged where a move goes to it.
    """
    words = [word.lower() for word in _WORD.findall(name)]
    if not words or words[0] in _ASKS or _AT_REST.intersection(words):
        return False
    return bool(((_WORK | _TRAVEL) - _NO_WORK_ALONE).intersection(words))


def tells_of_motion(name: str) -> bool:
    """Return whether a routine's name tells of motion."""
    words = set(_LETTERS.findall(name.lower()))
    return bool(words & (_WORK | _TRAVEL)) and not words & _AT_REST
