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

from cellcal.fake_devices.device import JsonObject, run_fault_action
from cellcal.fake_devices.laser_tracker import layout as at
from cellcal.fake_devices.laser_tracker.controller import TrackerController
from cellcal.fake_devices.laser_tracker.sensor import TrackerSensor
from cellcal.fake_devices.laser_tracker.server import KINDS, TrackerServer
from cellcal.fake_devices.link_faults import LinkFaults
from cellcal.fake_devices.world import World

Parameters = dict[str, Any]


class FakeLaserTracker:
    """One tracker on one loopback address."""

    def __init__(self, world: World, table: Mapping[str, Any]) -> None:
        self._name = str(table["name"])
        self.sensor = TrackerSensor(world, table)
        self._faults = LinkFaults(KINDS, world.clock.real_now_s)
        self.server = TrackerServer(
            str(table.get("address", "127.0.0.1")), int(table.get("port", 700)), self._faults
        )
        self.controller = TrackerController(
            self.sensor, world.clock, int(table.get("serial", 1)), bool(table.get("measures_poses", False))
        )
        self.controller.broadcast = self.server.broadcast
        self.server.on_packet = self.controller.receive_packet
        self._fault_actions: dict[str, Callable[[Parameters], None]] = {
            "beam_break": lambda parameters: self.controller.beam_breaks(bool(parameters.pop("findable", True))),
            "beam_return": lambda _parameters: self.controller.beam_returns(),
            "tripod_pushed": self._push_tripod,
            "set_up_again": lambda _parameters: self.sensor.set_up_again(),
            "reflector_to_nest": lambda parameters: self.sensor.put_reflector(int(parameters.pop("nest", 1))),
            "reflector_to_flange": lambda _parameters: self.sensor.put_reflector(None),
            "units": lambda parameters: self._set_by_other(
                parameters, "units", tuple(parameters.pop("units", (1, 1, 0, 1, 0)))
            ),
            "axes": lambda parameters: self._set_by_other(parameters, "axes", int(parameters.pop("axes", 6))),
            "settings": self._change_settings,
            "reflector": lambda parameters: self._set_by_other(parameters, "reflector", int(parameters.pop("id", 3))),
            "station": self._change_station,
            "compensation": lambda parameters: self._set_by_other(
                parameters, "compensation", int(parameters.pop("id", 12))
            ),
            "air": self._change_air,
            "entered_temperature": self._enter_temperature,
            "spoil": self._corrupt_result,
            "refuse_command": self._refuse_command,
            "event": lambda parameters: self.server.broadcast(at.status_change(int(parameters.pop("code")))),
            "not_initialised": lambda _parameters: setattr(self.controller, "initialised", False),
            "power_cycle": self._power_cycle,
            "reset": lambda _parameters: self.server.cut_connections(),
        }  # fmt: skip

    @property
    def name(self) -> str:
        """Name in the cell file."""
        return self._name

    async def start(self) -> None:
        await self.server.open()

    async def stop(self) -> None:
        await self.controller.end_work()
        await self.server.wait_closed()

    # faults

    def fault_names(self) -> frozenset[str]:
        return self._faults.fault_kinds | frozenset(self._fault_actions)

    async def inject_fault(self, name: str, parameters: Mapping[str, Any]) -> JsonObject:
        if name in self._fault_actions:
            run_fault_action(self._fault_actions[name], name, parameters)
        else:
            self._faults.switch_on(name, parameters)
            if name == "refuse":
                self.server.cut_connections()
        return {}

    def clear_faults(self) -> None:
        self._faults.clear_all()
        self.controller.refusals.clear()
        self.controller.setup.corrupt.clear()

    def _set_by_other(self, parameters: Parameters, name: str, value: object) -> None:
        self.controller.other_program(name, value, bool(parameters.pop("silently", False)))

    def _change_settings(self, parameters: Parameters) -> None:
        """Another program turns the orientation and the try mode on, unless told what."""
        self._set_by_other(
            parameters, "settings", tuple(parameters.pop("settings", (2, 1, 1, 0, 1, 0, 1, 0, 0)))
        )

    def _corrupt_result(self, parameters: Parameters) -> None:
        """Put something else for one of the result's numbers, counted as the header counts its doubles."""
        self.controller.setup.corrupt[int(parameters.pop("value", 0))] = float(parameters.pop("to", math.nan))

    def _refuse_command(self, parameters: Parameters) -> None:
        self.controller.refusals[int(parameters.pop("command"))] = int(parameters.pop("status"))

    def _change_station(self, parameters: Parameters) -> None:
        values = tuple(float(v) for v in parameters.pop("orientation", (1.0, 2.0, 0.0, 0.0, 0.0, 0.1)))
        self._set_by_other(parameters, "orientation", values)

    def _push_tripod(self, parameters: Parameters) -> None:
        """Knock the tripod; a level sensor, where there is one, reports it."""
        self.sensor.push_tripod(float(parameters.pop("m", 0.02)))
        if not parameters.pop("silently", False):
            self.server.broadcast(at.status_change(at.SSC_TILT))

    def _change_air(self, parameters: Parameters) -> None:
        self.sensor.set_air(
            float(parameters.pop("temperature_c", 20.0)),
            float(parameters.pop("pressure_hpa", 1013.25)),
            float(parameters.pop("humidity_percent", 45.0)),
            float(parameters.pop("drift_c_per_hour", 0.0)),
        )

    def _enter_temperature(self, parameters: Parameters) -> None:
        entered = parameters.pop("temperature_c", None)
        self.sensor.entered_c = None if entered is None else float(entered)

    def _power_cycle(self, _parameters: Parameters) -> None:
        self.controller.restart_server()
        self.server.cut_connections()

    # truth

    def true_state(self) -> JsonObject:
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
            "busy": self.controller.is_busy,
            "measurements": self.controller.measurements,
            "connections": self.server.client_count,
            "port": self.server.port,
        }


def create_device(world: World, table: Mapping[str, Any]) -> FakeLaserTracker:
    """Build the tracker that a cell file names."""
    return FakeLaserTracker(world, table)
