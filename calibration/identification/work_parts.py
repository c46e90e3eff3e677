"""How the independent parts of an identification are carried out: here one after the other, when asked for.

A command may hand over something that spreads them over processes. Parts are functions of a module with arguments
that can be sent, and depend on nothing else, so the result is the same wherever they are carried out.
"""

from collections.abc import Callable
from typing import Protocol, TypeVar

Result = TypeVar("Result")


class PartRunner(Protocol):
    """Carries out parts, and shows what is being done."""

    def submit(self, function: Callable[..., Result], /, *arguments: object) -> Callable[[], Result]:
        """Begin a part, or put it off; return what waits for its result, or raises what it raised."""

    def show_stage(self, text: str) -> None:
        """Show what the work on the whole is about from now on."""


class SerialRunner:
    """Carries out each part in this process when its result is asked for."""

    def submit(self, function: Callable[..., Result], /, *arguments: object) -> Callable[[], Result]:
        """Put a part off."""
        return lambda: function(*arguments)

    def show_stage(self, text: str) -> None:
        """Show nothing."""


SERIAL = SerialRunner()
