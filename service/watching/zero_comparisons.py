"""Both comparisons of a robot whose mastering is read and not written: its record, and losses that were seen."""

from dataclasses import dataclass
from typing import Any

from cellcal.drivers.interfaces import Condition
from cellcal.service.watching.loss_modes import Suspicion
from cellcal.service.watching.mastering_comparison import MasteringComparison
from cellcal.service.watching.position_comparison import PositionComparison


@dataclass(frozen=True, slots=True)
class ZeroComparisons:
    """ZeroComparison. What the mastering says comes first; what was seen before is looked for all the same."""

    mastering: MasteringComparison
    position: PositionComparison

    def force_check(self) -> None:
        """Look at the next opportunity."""
        self.mastering.force_check()
        self.position.force_check()

    def note_loss(self, robot: str, condition: Condition) -> None:
        """Keep that a lost position was seen."""
        self.position.note_loss(robot, condition)

    async def find_trouble(self, robot: Any) -> tuple[str, Suspicion] | None:
        """Return in words what is wrong, and what is suspected; None: nothing."""
        remembered = await self.position.find_trouble(robot)
        return await self.mastering.find_trouble(robot) or remembered
