"""General purpose registers and the right to write them.

Imitates
    The input and output registers of the controller: global, they keep their last value when a client leaves.
Source
    The maker's RTDE guide.
Modelled
    One owner per input variable (IN_USE for all others), released when its connection closes.
Not modelled
    The delay with which a real controller releases the variables of a client that vanished.
"""

from collections.abc import Mapping
from typing import Any

from cellcal.fake_devices.universal_robots.rtde_fields import INPUT_TYPES, OUTPUT_TYPES, zero_value


class GeneralRegisters:
    """Input and output registers with their owners."""

    def __init__(self) -> None:
        self.inputs: dict[str, Any] = {name: zero_value(kind) for name, kind in INPUT_TYPES.items()}
        self.outputs: dict[str, Any] = {
            name: zero_value(kind) for name, kind in OUTPUT_TYPES.items() if name.startswith("output_")
        }
        self.written_at_s: dict[str, float] = {}
        self.foreign_owner = False
        self._owners: dict[str, object] = {}

    def claim_names(self, names: list[str], owner: object) -> list[str]:
        """Return those that belong to another client; take all when there are none."""
        taken = [name for name in names if self.foreign_owner or self._owners.get(name, owner) is not owner]
        if not taken:
            self._owners.update(dict.fromkeys(names, owner))
        return taken

    def release_names(self, owner: object) -> None:
        """Free everything that ``owner`` has claimed; the values stay."""
        self._owners = {name: who for name, who in self._owners.items() if who is not owner}

    def write_inputs(self, values: Mapping[str, Any], now_s: float) -> None:
        """Take over one data package."""
        self.inputs.update(values)
        for name in values:
            self.written_at_s[name] = now_s

    def input_integer(self, index: int) -> int:
        """Return an input integer register."""
        return int(self.inputs[f"input_int_register_{index}"])

    def input_doubles(self, first: int, count: int) -> tuple[float, ...]:
        """Return consecutive input double registers."""
        return tuple(float(self.inputs[f"input_double_register_{first + i}"]) for i in range(count))

    def set_integer(self, index: int, value: int) -> None:
        """Set an output integer register."""
        self.outputs[f"output_int_register_{index}"] = value

    def set_doubles(self, first: int, values: tuple[float, ...]) -> None:
        """Set consecutive output double registers."""
        for i, value in enumerate(values):
            self.outputs[f"output_double_register_{first + i}"] = value
