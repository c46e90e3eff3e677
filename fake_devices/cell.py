"""A fake cell: the devices that a cell file names, in one world, with one control port.

Imitates
    A robot cell with its cabinet doors open.
Source
    The tables [[robot]], [[gauge]], [[tracker]], [[probe]] and [fake] of a cell file; [fake.robots.NAME] holds
    what a simulated robot is besides.
Modelled
    Every driver that has a fake: ``create_device`` in ``<driver>/device.py`` or ``<driver>.py`` of this folder.
Not modelled
    Devices that are not in the file.
"""

import tomllib
from collections.abc import Callable, Mapping
from importlib import import_module
from pathlib import Path
from types import MappingProxyType
from typing import Any, cast

from cellcal.fake_devices.arm_models import ArmModel
from cellcal.fake_devices.described_arms import read_described_arms
from cellcal.fake_devices.device import FakeDevice
from cellcal.fake_devices.world import World

Factory = Callable[[World, Mapping[str, Any]], FakeDevice]


WITHOUT_WIRE = frozenset({"file_import"})  # a person or a file: nothing to play


def find_factory(driver: str) -> Factory:
    """Return what builds the fake of a driver, found by the driver's name; ValueError where there is none.

    Only what a cell names is imported: some fakes load large libraries.
    """
    folder = Path(__file__).parent
    in_package, alone = folder / driver / "device.py", folder / f"{driver}.py"
    if driver.isidentifier() and (in_package.is_file() or alone.is_file()):
        module = f"{driver}.device" if in_package.is_file() else driver
        factory = vars(import_module(f"cellcal.fake_devices.{module}")).get("create_device")
        if factory is not None:
            return cast("Factory", factory)
    raise ValueError(f"there is no fake for the driver {driver!r}")


def _possible_factor(factor: float) -> float:
    if not 1.0 <= factor <= 100.0:
        raise ValueError(f"watchdog_factor {factor} is outside 1 to 100")
    return factor


class FakeCell:
    """All fake devices of one file; an async context."""

    def __init__(
        self, document: Mapping[str, Any], described: Mapping[str, ArmModel] = MappingProxyType({})
    ) -> None:
        fake = document.get("fake", {})
        hidden = bool(fake.get("hidden", True))  # false: a world as its drawings say, for tests of arithmetic
        self.world = World(int(fake.get("seed", 1)), float(fake.get("time_factor", 1.0)), hidden=hidden)
        self.world.described = described
        self.world.watchdog_factor = _possible_factor(float(fake.get("watchdog_factor", 1.0)))
        self.world.add_fixtures(fake)
        self.control_port = int(fake.get("control_port", 0))
        settings = fake.get("robots", {})
        self.robots = self._build_devices(
            [
                {**table, "settings": settings[table["name"]]} if table.get("name") in settings else table
                for table in document.get("robot", [])
            ]
        )
        self.gauges = self._build_devices(document.get("gauge", []))
        self.trackers = self._build_devices(document.get("tracker", []))
        self.probes = self._build_devices(document.get("probe", []))

    @classmethod
    def from_file(cls, path: Path, arms: Path | None = None) -> "FakeCell":
        """Read a cell file, and the arms that are described beside it."""
        with path.open("rb") as file:
            return cls(tomllib.load(file), {} if arms is None else read_described_arms(arms))

    @property
    def all_devices(self) -> list[FakeDevice]:
        """Robots first, because gauges, targets and probes hang on them."""
        return [*self.robots, *self.gauges, *self.trackers, *self.probes]

    def _build_devices(self, tables: list[Mapping[str, Any]]) -> list[FakeDevice]:
        tables = [table for table in tables if table["driver"] not in WITHOUT_WIRE]
        factories = [find_factory(str(table["driver"])) for table in tables]
        return [
            create_device(self.world, table) for create_device, table in zip(factories, tables, strict=True)
        ]

    async def __aenter__(self) -> "FakeCell":
        started: list[FakeDevice] = []
        try:
            for device in self.all_devices:
                await device.start()
                started.append(device)
        except OSError:
            for device in reversed(started):
                await device.stop()
            raise
        return self

    async def __aexit__(self, *_exc: object) -> None:
        for device in reversed(self.all_devices):
            await device.stop()
