"""Who may do what: four roles, and the right that each order needs."""

from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum
from types import MappingProxyType
from typing import Any

from cellcal.service.cell_process.messages import AnswerPrompt, HoldOrder, Order, SignOff, StartRun, StopRun


class Role(StrEnum):
    """A person's role at this cell. An administrator runs no procedure: the two are kept apart.

    Engineers and administrators make programs and identify robots from files: nothing is written to a robot.
    An identification is saved by those who may write master data.
    """

    VIEWER = "viewer"
    TECHNICIAN = "technician"
    ENGINEER = "engineer"
    ADMIN = "admin"


class Right(StrEnum):
    """A right that a role may have."""

    SEE = "look on"
    STOP = "ask for a stop"
    RUN = "run procedures"
    CHANGE_LIMITS = "change limits or go on against a verdict"
    WRITE_ALONE = "let master data be written alone"
    MAKE_PROGRAMS = "make robot programs"
    IDENTIFY = "identify robots from measurements"
    DELIVER_PROGRAMS = "deliver programs to a controller"


_RIGHTS_OF_ALL = frozenset({Right.SEE, Right.STOP})
RIGHTS: Mapping[Role, frozenset[Right]] = MappingProxyType(
    {
        Role.VIEWER: _RIGHTS_OF_ALL,
        Role.TECHNICIAN: _RIGHTS_OF_ALL | {Right.RUN},
        Role.ENGINEER: _RIGHTS_OF_ALL
        | {Right.RUN, Right.CHANGE_LIMITS, Right.WRITE_ALONE, Right.MAKE_PROGRAMS, Right.IDENTIFY}
        | {Right.DELIVER_PROGRAMS},
        Role.ADMIN: _RIGHTS_OF_ALL | {Right.MAKE_PROGRAMS, Right.IDENTIFY},
    }
)

# What a yes to a procedure's question brings. A test holds these tables against the procedures' own texts.
WRITES = frozenset({"accept_mastering", "accept_zeros", "accept_tool", "accept_frame", "accept_offset"})
KEEPS = frozenset({"accept_alignment", "accept_bases", "accept_parameters", "accept_part"})
MOVES = frozenset({"accept_plan", "approve_move", "may_move", "may_move_faster", "may_still_move"})
_WRITING_PREFIXES = ("accept", "approve", "may_", "write", "sign")
LIMIT_SETTINGS = frozenset({"limits", "write_anyway"})


@dataclass(frozen=True, slots=True)
class OrderNeed:
    """The needs of an order: a right; the PIN just entered; for writing, the right to do it alone or two people."""

    right: Right
    fresh_pin: bool = False
    writes: bool = False


def need_of(order: Order, prompt: Mapping[str, Any] | None) -> OrderNeed:
    """Return what an order takes.

    Parameters
    ----------
    order
        As it came in.
    prompt
        The question that the order answers, None where there is none.
    """
    if isinstance(order, StopRun) or (isinstance(order, HoldOrder) and not order.held):
        return OrderNeed(Right.STOP)
    if isinstance(order, StartRun) and LIMIT_SETTINGS & {
        key for key, value in order.settings.items() if value
    }:
        return OrderNeed(Right.CHANGE_LIMITS)
    if isinstance(order, SignOff):
        return OrderNeed(Right.RUN, fresh_pin=True)
    if isinstance(order, AnswerPrompt) and prompt is not None:
        return _need_of_yes(str(prompt["key"]))
    return OrderNeed(Right.RUN)


def _need_of_yes(key: str) -> OrderNeed:
    if key in MOVES | KEEPS:
        return OrderNeed(Right.RUN, fresh_pin=True)
    writes = key in WRITES or key.startswith(_WRITING_PREFIXES)  # one that these tables do not know may write
    return OrderNeed(Right.RUN, fresh_pin=writes, writes=writes)
