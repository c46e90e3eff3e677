"""What differs between Robot Web Services 1 (RobotWare 6) and 2 (RobotWare 7): media types, paths, answers.

Sources: ABB 3HAC050973-001 rev M for the first; for the second ABB's OmniCore App SDK 1.5.0 (MIT) and the paths that
public clients cite from ABB 3HAC073675-001.
"""

from abc import ABC, abstractmethod
from collections.abc import Mapping
from typing import Any, ClassVar

Reply = Mapping[str, Any]
_TASK = "RAPID/T_ROB1"
_FORM = "application/x-www-form-urlencoded"


class Dialect(ABC):
    """One generation of Robot Web Services."""

    generation: ClassVar[int]
    needs_mastership: ClassVar[bool]  # for a write to RAPID data
    pause_s: ClassVar[float]  # between the starts of two requests
    accept: ClassVar[str]
    form_type: ClassVar[str]
    file_type: ClassVar[str]
    motors_path: ClassVar[str]
    query: ClassVar[Mapping[str, str]]  # of every request

    @abstractmethod
    def symbol_path(self, name: str) -> str:
        """Return where the value of a RAPID symbol of the motion task is read."""

    @abstractmethod
    def action_target(self, path: str, action: str) -> tuple[str, Mapping[str, str]]:
        """Return path and query of an action on a resource; "" is a plain write."""

    @abstractmethod
    def symbol_action(self) -> str:
        """Return the action that writes a symbol."""

    @abstractmethod
    def states_in(self, reply: Reply) -> list[Mapping[str, Any]] | None:
        """Return the states of an answer, or its list; None where it has neither."""


class FirstDialect(Dialect):
    """Robot Web Services 1: plain JSON on request, actions in the query."""

    generation, needs_mastership, pause_s = 1, False, 0.0
    accept, form_type, file_type = "application/json", _FORM, "application/octet-stream"
    motors_path = "/rw/panel/ctrlstate"
    query: ClassVar[Mapping[str, str]] = {"json": "1"}

    def symbol_path(self, name: str) -> str:
        return f"/rw/rapid/symbol/data/{_TASK}/{name}"

    def action_target(self, path: str, action: str) -> tuple[str, Mapping[str, str]]:
        return path, {"action": action} if action else {}

    def symbol_action(self) -> str:
        return "set"

    def states_in(self, reply: Reply) -> list[Mapping[str, Any]] | None:
        return _tables_in(reply, "_embedded", "_state")


class SecondDialect(Dialect):
    """Robot Web Services 2: versioned media types, actions as a part of the path, mastership for every write."""

    generation, needs_mastership = 2, True
    pause_s = 0.055  # omnicorectl, run on RobotWare 8.1 by its author, keeps to this pace
    accept, form_type = "application/hal+json;v=2.0", f"{_FORM};v=2.0"
    file_type = "application/octet-stream;v=2.0"
    motors_path = "/rw/panel/ctrl-state"
    query: ClassVar[Mapping[str, str]] = {}

    def symbol_path(self, name: str) -> str:
        return f"/rw/rapid/symbol/{_TASK}/{name}/data"

    def action_target(self, path: str, action: str) -> tuple[str, Mapping[str, str]]:
        return (f"{path}/{action}" if action else path), {}

    def symbol_action(self) -> str:
        return ""

    def states_in(self, reply: Reply) -> list[Mapping[str, Any]] | None:
        states = reply.get("state")
        if isinstance(states, list) and all(isinstance(one, dict) for one in states):
            return states
        return _tables_in(reply, "_embedded", "resources")


def _tables_in(reply: Reply, outer: str, inner: str) -> list[Mapping[str, Any]] | None:
    embedded = reply.get(outer)
    found = embedded.get(inner) if isinstance(embedded, dict) else None
    if not isinstance(found, list) or not all(isinstance(one, dict) for one in found):
        return None
    return found
