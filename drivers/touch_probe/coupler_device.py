"""What every instrument on a coupler does alike: connect, hang up, say who answers and whether it is ready."""

from cellcal.drivers.interfaces import Condition, Identity
from cellcal.drivers.touch_probe.coupler import Coupler
from cellcal.drivers.wire.deadline import answer_deadline


class CouplerDevice:
    """A device that is wired to one coupler, which answers for it."""

    def __init__(self, coupler: Coupler, deadline_s: float) -> None:
        self._coupler, self._deadline_s = coupler, deadline_s

    @property
    def name(self) -> str:
        return self._coupler.name

    async def connect(self) -> None:
        """Connect and check who answers."""
        async with answer_deadline(self.name, self._deadline_s, "connecting"):
            await self._coupler.connect()

    async def close(self) -> None:
        """Hang up."""
        await self._coupler.link.close()

    async def identify(self) -> Identity:
        async with answer_deadline(self.name, self._deadline_s, "asking who it is"):
            return await self._coupler.identify()

    async def read_condition(self) -> Condition:
        return await self._coupler.read_condition()
