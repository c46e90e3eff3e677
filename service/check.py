"""Reach every device of a cell and say what is missing, before anybody relies on it."""

import asyncio
from dataclasses import asdict, dataclass
from typing import Any

from drivers.errors import DeviceError
from drivers.interfaces import Device, Readiness, Robot
from service.cell import open_journal
from service.config import CellConfig
from service.store import Store

_FIRST_SCREEN = (
    "No mastering record of {robot} is stored. Take it now, while the robot is healthy: "
    "`cellcal run mastering_record --cell {path}`. Without it a lost turn cannot be restored exactly."
)


@dataclass(frozen=True, slots=True)
class DeviceReport:
    """What one device said."""

    name: str
    state: str
    message: str
    remedy: str = ""
    serial: str = ""
    keeps_mastering: bool = False

    @property
    def ready(self) -> bool:
        """Whether a procedure could use it now."""
        return self.state == Readiness.READY


@dataclass(frozen=True, slots=True)
class CellReport:
    """A whole cell."""

    cell: str
    devices: tuple[DeviceReport, ...]
    advice: tuple[str, ...]

    @property
    def all_reached(self) -> bool:
        """Whether every device answered as the one that the file names."""
        return all(device.state != Readiness.UNREACHABLE for device in self.devices)

    def as_object(self) -> dict[str, Any]:
        """Return the report for ``--json``."""
        return {**asdict(self), "all_reached": self.all_reached}


async def check_cell(config: CellConfig) -> CellReport:
    """Reach all devices at once; an unreachable one is a line of the report, not an end."""
    entries = [*config.robots, *(entry.device for entry in config.gauges)]
    devices = await asyncio.gather(*(_check_device(entry) for entry in entries))
    with open_journal(config) as journal:
        store = Store(journal)
        advice = tuple(
            _FIRST_SCREEN.format(robot=device.name, path=config.path)
            for device in devices
            if device.keeps_mastering and store.mastering_record(device.serial) is None
        )
    return CellReport(config.cell.name, tuple(devices), advice)


async def _check_device(config: Any) -> DeviceReport:
    try:
        async with config.open() as device:
            return await _ask(device)
    except DeviceError as error:
        return DeviceReport(config.name, Readiness.UNREACHABLE, error.message, error.remedy)


async def _ask(device: Device | Robot) -> DeviceReport:
    identity = await device.identify()
    condition = await device.condition()
    who = f"{identity.vendor} {identity.model}, serial {identity.serial}, {identity.firmware}"
    capabilities = getattr(device, "capabilities", None)
    return DeviceReport(
        name=device.name,
        state=condition.readiness,
        message=f"{who}. {condition.message}".strip(),
        remedy=condition.remedy,
        serial=identity.serial,
        keeps_mastering=getattr(capabilities, "writes_mastering", False),
    )
