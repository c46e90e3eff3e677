"""The laser tracker of a cell: head, server and socket put together, and what can happen to them.

Imitates
    An AT901 on a tripod beside a robot.
Source
    See the modules of this package.
Modelled
    The happenings of ``LaserTracker.fault_names``.
Not modelled
    More than one target at a time.
"""

import math
from collections.abc import Callable, Mapping
from typing import Any

from cellcal.fake_devices.device import FaultRefusedError, JsonObject
from cellcal.fake_devices.laser_tracker import layout as at
from cellcal.fake_devices.laser_tracker.controller import Controller
from cellcal.fake_devices.laser_tracker.sensor import Sensor
from cellcal.fake_devices.laser_tracker.server import KINDS, Server
from cellcal.fake_devices.link_faults import LinkFaults
from cellcal.fake_devices.world import World

Given = dict[str, Any]


class LaserTracker:
    """One tracker on one loopback address."""

    def __init__(self, world: World, table: Mapping[str, Any]) -> None:
        self._name = str(table["name"])
        self.sensor = Sensor(world, table)
        self._faults = LinkFaults(KINDS, world.clock.real)
        self.server = Server(
            str(table.get("address", "127.0.0.1")), int(table.get("port", 700)), self._faults
        )
        self.controller = Controller(
            self.sensor, world.clock, int(table.get("serial", 1)), bool(table.get("measures_poses", False))
        )
        self.controller.broadcast = self.server.broadcast
        self.server.on_packet = self.controller.receive
        self._happen: dict[str, Callable[[Given], None]] = {
            "beam_break": lambda given: self.controller.beam_breaks(bool(given.pop("findable", True))),
            "beam_return": lambda _given: self.controller.beam_returns(),
            "tripod_pushed": self._pushed,
            "set_up_again": lambda _given: self.sensor.set_up_again(),
            "reflector_to_nest": lambda given: self.sensor.put_reflector(int(given.pop("nest", 1))),
            "reflector_to_flange": lambda _given: self.sensor.put_reflector(None),
            "units": lambda given: self._other(given, "units", tuple(given.pop("units", (1, 1, 0, 1, 0)))),
            "axes": lambda given: self._other(given, "axes", int(given.pop("axes", 6))),
            "settings": self._settings,
            "reflector": lambda given: self._other(given, "reflector", int(given.pop("id", 3))),
            "station": self._station,
            "compensation": lambda given: self._other(given, "compensation", int(given.pop("id", 12))),
            "air": self._air,
            "entered_temperature": self._entered,
            "spoil": self._spoil,
            "refuse_command": self._refuse_command,
            "event": lambda given: self.server.broadcast(at.status_change(int(given.pop("code")))),
            "not_initialised": lambda _given: setattr(self.controller, "initialised", False),
            "power_cycle": self._power_cycle,
            "reset": lambda _given: self.server.drop_clients(),
        }  # fmt: skip

    @property
    def name(self) -> str:
        """Name in the cell file."""
        return self._name

    async def start(self) -> None:
        await self.server.open()

    async def stop(self) -> None:
        await self.controller.end()
        await self.server.close()

    # faults

    def fault_names(self) -> frozenset[str]:
        return self._faults.kinds | frozenset(self._happen)

    async def fault(self, name: str, parameters: Mapping[str, Any]) -> JsonObject:
        if name in self._happen:
            given = dict(parameters)
            self._happen[name](given)
            if given:
                raise FaultRefusedError(f"{name} does not know {', '.join(sorted(given))}")
        else:
            self._faults.set(name, parameters)
            if name == "refuse":
                self.server.drop_clients()
        return {}

    def clear(self) -> None:
        self._faults.clear()
        self.controller.refusals.clear()
        self.controller.setup.spoil.clear()

    def _other(self, given: Given, name: str, value: object) -> None:
        self.controller.other_program(name, value, bool(given.pop("silently", False)))

    def _settings(self, given: Given) -> None:
        """Another program turns the orientation and the try mode on, unless told what."""
        self._other(given, "settings", tuple(given.pop("settings", (2, 1, 1, 0, 1, 0, 1, 0, 0))))

    def _spoil(self, given: Given) -> None:
        """Put something else for one of the result's numbers, counted as the header counts its doubles."""
        self.controller.setup.spoil[int(given.pop("value", 0))] = float(given.pop("to", math.nan))

    def _refuse_command(self, given: Given) -> None:
        self.controller.refusals[int(given.pop("command"))] = int(given.pop("status"))

    def _station(self, given: Given) -> None:
        values = tuple(float(v) for v in given.pop("orientation", (1.0, 2.0, 0.0, 0.0, 0.0, 0.1)))
        self._other(given, "orientation", values)

    def _pushed(self, given: Given) -> None:
        """Somebody runs into the tripod; a level sensor, where there is one, tells of it."""
        self.sensor.push(float(given.pop("m", 0.02)))
        if not given.pop("silently", False):
            self.server.broadcast(at.status_change(at.SSC_TILT))

    def _air(self, given: Given) -> None:
        self.sensor.set_air(
            float(given.pop("temperature_c", 20.0)),
            float(given.pop("pressure_hpa", 1013.25)),
            float(given.pop("humidity_percent", 45.0)),
            float(given.pop("drift_c_per_hour", 0.0)),
        )

    def _entered(self, given: Given) -> None:
        entered = given.pop("temperature_c", None)
        self.sensor.entered_c = None if entered is None else float(entered)

    def _power_cycle(self, _given: Given) -> None:
        self.controller.restart()
        self.server.drop_clients()

    # truth

    def truth(self) -> JsonObject:
        sensor = self.sensor
        place = sensor.tracker_probe()
        return {
            "robot": sensor.robot,
            "base_tracker": sensor.base_tracker.tolist(),
            "target_in_flange_m": sensor.target_in_flange_m.tolist(),
            "flange_probe": sensor.flange_probe.tolist(),
            "target_in_base_m": sensor.target_in_base_m().tolist(),
            "target_m": place[:3, 3].tolist(),
            "tracker_probe": place.tolist(),
            "covariance_m2": sensor.covariance_m2(place[:3, 3]).tolist(),
            "locked": sensor.locked,
            "moved": sensor.moved,
            "temperature_c": sensor.true_temperature_c(),
            "initialised": self.controller.initialised,
            "units": list(self.controller.setup.units),
            "axes": self.controller.setup.axes,
            "mode": self.controller.setup.mode,
            "settings": list(self.controller.setup.settings),
            "busy": self.controller.busy,
            "measurements": self.controller.measurements,
            "connections": self.server.connections,
            "port": self.server.port,
        }


def create(world: World, table: Mapping[str, Any]) -> LaserTracker:
    """Build the tracker that a cell file names."""
    return LaserTracker(world, table)
