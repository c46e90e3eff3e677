"""A cell's instruments as a run and a screen share them, and who is told of each reading that a run takes."""

import asyncio
from collections.abc import Awaitable, Callable
from dataclasses import replace
from functools import partial
from typing import Any, TypeVar, cast

from cellcal.procedures.cell import Cell
from cellcal.procedures.procedure_definition import ProcedureDefinition
from cellcal.procedures.run_history import RunHistory

T = TypeVar("T")
Tell = Callable[[str, Any], None]  # a role and its reading; None: a run asks for one just now


class SharedInstrument:
    """An instrument that a run reads and a screen looks at; neither ever comes between a question and its answer.

    A run waits at most for one poll in progress; during its own requests there is no polling.
    """

    def __init__(self, device: Any, tell: Callable[[Any], None]) -> None:
        self._device, self._tell = device, tell
        self._asking = 0
        self._looking = asyncio.Lock()

    def __getattr__(self, name: str) -> Any:
        return getattr(self._device, name)

    @property
    def is_queried(self) -> bool:
        """Whether a run asks it just now."""
        return self._asking > 0

    async def read_for_screen(self, question: Callable[[Any], Awaitable[T]]) -> T | None:
        """Ask for a screen; None while a run asks."""
        if self.is_queried or self._looking.locked():
            return None
        async with self._looking:
            return await question(self._device)

    async def identify(self) -> Any:
        return await self._query_device(self._device.identify)

    async def read_condition(self) -> Any:
        return await self._query_device(self._device.read_condition)

    async def read_distance(self) -> Any:
        return await self._read_and_report(self._device.read_distance)

    async def measure_point(self) -> Any:
        return await self._read_and_report(self._device.measure_point)

    async def measure_pose(self) -> Any:
        return await self._read_and_report(self._device.measure_pose)

    async def read_contact(self) -> Any:
        return await self._read_and_report(self._device.read_contact)

    async def wait_for_touch(self) -> Any:
        return await self._read_and_report(self._device.wait_for_touch)

    async def _read_and_report(self, question: Callable[[], Awaitable[T]]) -> T:
        self._tell(None)
        reading = await self._query_device(question)
        self._tell(reading)
        return reading

    async def _query_device(self, question: Callable[[], Awaitable[T]]) -> T:
        self._asking += 1
        try:
            async with self._looking:  # a look that is under way ends first; no other begins
                pass
            return await question()
        finally:
            self._asking -= 1


def share_instruments(cell: Cell, tell: Tell) -> Cell:
    """Return the cell with every instrument shared; ``tell`` receives what a run reads of them."""

    def share_role(role: str) -> Any:
        device = cell.measuring_devices.get(role)
        return None if device is None else SharedInstrument(device, partial(tell, role))

    return replace(
        cell,
        gauge=share_role("gauge"),
        tracker=share_role("tracker"),
        probe=share_role("probe"),
        dial=share_role("dial"),
    )


def shared_instruments(cell: Cell) -> dict[str, SharedInstrument]:
    """Return the instruments of a shared cell by their roles."""
    return cast(dict[str, SharedInstrument], cell.measuring_devices)


def instruments_behind(
    entry: ProcedureDefinition, ways: tuple[object, ...], past: RunHistory
) -> tuple[str, ...]:
    """Return the roles of the instruments whose readings are behind a run's result.

    Journals from before findings named them tell only by the card that a gauge was read; ``ways`` are the method
    and the evidence of the run's settings.
    """
    gauge = ("gauge",) if entry.reads_gauge(*ways) else ()
    return tuple(sorted({*past.instrument_roles, *gauge}))
