"""What the host and the control port need of every fake device.

Imitates
    Nothing: the handle by which a process holds a device.
Source
    Ours.
Modelled
    Start, stop, faults by name, truth.
Not modelled
    Devices that share a socket.

A fake offers ``create_device(world, table) -> FakeDevice`` in ``fake_devices/<driver>/device.py`` or
``fake_devices/<driver>.py``; ``table`` is the device's table of the cell file. Only a device's server knows
sockets; it opens them in ``start``.
"""

from collections.abc import Callable, Mapping
from typing import Any, Protocol, TypeVar

JsonObject = dict[str, Any]
_Answer = TypeVar("_Answer")


class FaultRefusedError(ValueError):
    """The fault cannot be set: unknown name or parameter. The control port answers with the text."""


class FakeDevice(Protocol):
    """One device of the cell, listening."""

    @property
    def name(self) -> str: ...
    async def start(self) -> None:
        """Bind the sockets; raise OSError when an address is taken."""
        ...

    async def stop(self) -> None:
        """Close every socket and end every task."""
        ...

    def fault_names(self) -> frozenset[str]:
        """Return the faults that this device can show."""
        ...

    async def inject_fault(self, name: str, parameters: Mapping[str, Any]) -> JsonObject:
        """Let one fault happen; the control port sends what is returned. Refuse invalid parameters."""
        ...

    def clear_faults(self) -> None:
        """Take all link faults away; the world stays as it is."""
        ...

    def true_state(self) -> JsonObject:
        """Return what no procedure may know, ready for JSON."""
        ...


def run_fault_action(
    action: Callable[[dict[str, Any]], _Answer], name: str, parameters: Mapping[str, Any]
) -> _Answer:
    """Run what a fault does; it takes the parameters that it knows out of the table, and the rest is refused."""
    remaining = dict(parameters)
    answer = action(remaining)
    if remaining:
        raise FaultRefusedError(f"{name} does not know {', '.join(sorted(remaining))}")
    return answer
