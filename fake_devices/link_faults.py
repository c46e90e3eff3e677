"""Faults of a cable, a switch or a link processor, by name and for a while.

Imitates
    Everything between two devices that can go wrong without either being at fault.
Source
    The fault table of the design (F01-F18, F21-F26): link lost, slow, late, doubled, foreign, cut, refused.
Modelled
    Each fault lasts ``duration_s`` real seconds, or ``count`` telegrams, or until cleared.
Not modelled
    Bit errors that a checksum of the link would have caught.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from cellcal.fake_devices.device import FaultRefusedError


@dataclass
class _ActiveFault:
    parameters: dict[str, Any]
    until_real_s: float
    telegrams_left: float


class LinkFaults:
    """The faults of one link that are on."""

    def __init__(self, kinds: Mapping[str, Mapping[str, Any]], real: Callable[[], float]) -> None:
        self._kinds = {kind: dict(defaults) for kind, defaults in kinds.items()}
        self._real = real
        self._active: dict[str, _ActiveFault] = {}

    @property
    def fault_kinds(self) -> frozenset[str]:
        """Names of all faults this link can show."""
        return frozenset(self._kinds)

    def switch_on(self, kind: str, parameters: Mapping[str, Any]) -> float:
        """Switch one on; return how many real seconds it will last (infinite unless told)."""
        if kind not in self._kinds:
            raise FaultRefusedError(
                f"no fault is called {kind!r}; there are {', '.join(sorted(self._kinds))}"
            )
        remaining = dict(parameters)
        duration_s = float(remaining.pop("duration_s", float("inf")))
        count = float(remaining.pop("count", float("inf")))
        merged = {**self._kinds[kind], **remaining}
        if unknown := set(remaining) - set(self._kinds[kind]):
            raise FaultRefusedError(f"{kind} does not know {', '.join(sorted(unknown))}")
        self._active[kind] = _ActiveFault(merged, self._real() + duration_s, count)
        return duration_s

    def active_parameters(self, kind: str) -> dict[str, Any] | None:
        """Return the parameters of a fault that is on."""
        active = self._active.get(kind)
        if active is None:
            return None
        if active.telegrams_left <= 0 or self._real() >= active.until_real_s:
            del self._active[kind]
            return None
        return active.parameters

    def use_once(self, kind: str) -> dict[str, Any] | None:
        """As ``active_parameters``, and count one telegram as spoiled."""
        parameters = self.active_parameters(kind)
        if parameters is not None:
            self._active[kind].telegrams_left -= 1
        return parameters

    def clear_all(self) -> None:
        """Take every fault away."""
        self._active.clear()
