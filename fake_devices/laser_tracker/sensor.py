"""The tracker's head and what it looks at: the truth, and how well light tells it.

Imitates
    An absolute laser tracker with a camera for probes, on a tripod near a robot.
Source
    Data sheets of Leica AT901/AT960: 15 um + 6 um/m across the beam, an interferometer's 15 um along it, 0.01 deg
    for a probe's turn at twice its standard deviation. Refractive index of air: 0.95e-6 a kelvin (Edlen).
Modelled
    Where the tripod stands (drawn at random, not published), where reflector and probe really sit on the flange,
    noise of every measurement, a moved tripod, a broken beam, air that drifts and the error of lengths by a
    wrong temperature; six fixed nests for the reflector, to which a person leads the beam.
Not modelled
    Line of sight through the robot's own body, acceptance angle of the reflector, two faces, drift of the encoders.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from cellcal.fake_devices.arm import SimulatedArm
from cellcal.fake_devices.kinematics import Array, invert_pose, matrix_from_xyzwpr, transform_point
from cellcal.fake_devices.world import World

ALONG_M, ACROSS_M, ACROSS_PER_M, TURN_RAD = 15e-6, 15e-6, 6e-6, 4e-5
INDEX_PER_K = 0.95e-6
NEST_SIGMA_M = 1e-5
_NESTS = 6


@dataclass(frozen=True)
class StationaryMeasurement:
    """One stationary measurement in the tracker's frame, SI."""

    place_m: Array  # (3,)
    turn: Array  # (3, 3)
    scatter_m: Array  # (3,)
    covariance_m2: Array  # (3, 3), a priori


class TrackerSensor:
    """One tripod and one target on one robot's flange."""

    def __init__(self, world: World, table: Mapping[str, Any]) -> None:
        self._world = world
        self.name = str(table["name"])
        self.robot = str(table.get("robot", "")) or next(iter(world.arms), "")
        self._arm: SimulatedArm | None = world.arms.get(self.robot)
        rng = world.make_rng(self.name, "tracker")
        self._noise = world.make_rng(self.name, "noise")
        self._moves = world.make_rng(self.name, "moves")
        bearing, distance = rng.uniform(-0.7, 0.7), rng.uniform(2.5, 3.5)
        place_mm = 1e3 * np.array(
            [distance * np.cos(bearing), distance * np.sin(bearing), rng.uniform(0.2, 0.8)]
        )
        tilt = rng.normal(size=2) * 0.3
        self.base_tracker = matrix_from_xyzwpr([*place_mm, *tilt, rng.uniform(-180.0, 180.0)])
        target = np.array(table.get("target_in_flange_mm", (60.0, 50.0, 120.0))) * 1e-3
        sigma_m = float(table.get("target_sigma_mm", 2.0)) * 1e-3
        amount = 1.0 if world.hidden else 0.0
        self.target_in_flange_m = target + amount * np.clip(rng.normal(size=3), -2.0, 2.0) * sigma_m
        self.flange_probe = matrix_from_xyzwpr([0.0, 0.0, 0.0, *(amount * rng.uniform(-90.0, 90.0, 3))])
        self.flange_probe[:3, 3] = self.target_in_flange_m
        self.locked, self.hidden_target, self.moved = True, False, 0
        self.temperature_c, self.pressure_hpa, self.humidity_percent = 20.0, 1013.25, 45.0
        self.drift_c_per_hour = 0.0
        self.nest: int | None = None  # where a person has put the reflector instead of the flange
        self._nests_m = world.make_rng(self.name, "nests").uniform(
            (-0.5, -1.5, -0.4), (1.8, 1.5, 1.0), (_NESTS, 3)
        )
        self._seating = world.make_rng(self.name, "seating")
        self._seated_m = np.zeros(3)
        self._air_since_s = world.clock.now_s()
        self.entered_c: float | None = None  # by hand; without it the weather station tells

    # truth

    def tracker_probe(self) -> Array:
        """Return the probe seen from the tracker (4, 4); its origin is the reflector's centre."""
        if self.nest is not None:
            place = np.eye(4)
            place[:3, 3] = self._nests_m[self.nest] + self._seated_m
            return np.asarray(invert_pose(self.base_tracker) @ place)
        flange = np.eye(4) if self._arm is None else self._arm.base_flange()
        return np.asarray(invert_pose(self.base_tracker) @ flange @ self.flange_probe)

    def target_in_base_m(self) -> Array:
        """Return where the target is in the robot's base frame now."""
        flange = np.eye(4) if self._arm is None else self._arm.base_flange()
        return transform_point(flange, self.target_in_flange_m)

    def true_temperature_c(self) -> float:
        """Return the air's temperature now."""
        hours = (self._world.clock.now_s() - self._air_since_s) / 3600.0
        return self.temperature_c + self.drift_c_per_hour * hours

    def read_air(self) -> tuple[float, float, float]:
        """Return what the tracker reckons with: degree Celsius, hPa, per cent."""
        known_c = self.true_temperature_c() if self.entered_c is None else self.entered_c
        return known_c, self.pressure_hpa, self.humidity_percent

    # measuring

    async def measure_target(self, seconds: float) -> StationaryMeasurement:
        """Look for a while at whatever the target does meanwhile."""
        places = []
        for _ in range(5):
            places.append(self.tracker_probe())
            await self._world.clock.sleep(seconds / 5.0)
        path = np.array([pose[:3, 3] for pose in places])
        place = path.mean(axis=0)
        covariance = self.covariance_m2(place)
        noise = self._noise.multivariate_normal(np.zeros(3), covariance, method="cholesky")
        scale = 1.0 - INDEX_PER_K * (self.true_temperature_c() - self.read_air()[0])
        turn = places[-1][:3, :3] @ _small_turn(self._noise.normal(size=3) * TURN_RAD)
        scatter = np.hypot(path.std(axis=0), 0.3 * np.sqrt(np.diag(covariance)))
        return StationaryMeasurement(place * scale + noise, turn, scatter, covariance)

    def covariance_m2(self, place_m: Array) -> Array:
        """Return the covariance (3, 3) of a point there: the beam knows lengths better than directions."""
        distance = float(np.linalg.norm(place_m))
        along = np.outer(place_m, place_m) / distance**2
        across = (ACROSS_M + ACROSS_PER_M * distance) ** 2
        return np.asarray(ALONG_M**2 * along + across * (np.eye(3) - along))

    # what happens to it

    def set_air(
        self, temperature_c: float, pressure_hpa: float, humidity_percent: float, drift: float
    ) -> None:
        """Change the weather in the hall."""
        self.temperature_c, self.pressure_hpa, self.humidity_percent = (
            temperature_c,
            pressure_hpa,
            humidity_percent,
        )
        self.drift_c_per_hour, self._air_since_s = drift, self._world.clock.now_s()

    def put_reflector(self, nest: int | None) -> None:
        """Put the reflector into a fixed nest, from 1, or back to the flange; it never sits quite the same."""
        if nest is not None and not 1 <= nest <= _NESTS:
            raise ValueError(f"there are nests 1 to {_NESTS}")
        self.nest = None if nest is None else nest - 1
        self._seated_m = self._seating.normal(size=3) * NEST_SIGMA_M

    def set_up_again(self) -> None:
        """Put the tripod somewhere else, as for another day's work; its frame is another one."""
        turn = matrix_from_xyzwpr(
            [*(self._moves.normal(size=3) * 300.0), 0.0, 0.0, self._moves.uniform(-40.0, 40.0)]
        )
        self.base_tracker = np.asarray(self.base_tracker @ turn)

    def push_tripod(self, metres: float) -> None:
        """Move the tripod by that much in a drawn direction, and turn it a little."""
        way = self._moves.normal(size=3)
        moved = np.eye(4)
        moved[:3, :3] = _small_turn(self._moves.normal(size=3) * metres)
        moved[:3, 3] = metres * way / np.linalg.norm(way)
        self.base_tracker = np.asarray(self.base_tracker @ moved)
        self.moved += 1


def _small_turn(vector: Array) -> Array:
    """Return the rotation (3, 3) about a vector by its length (Rodrigues)."""
    angle = float(np.linalg.norm(vector))
    if angle == 0.0:
        return np.eye(3)
    x, y, z = vector / angle
    k = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.asarray(np.eye(3) + np.sin(angle) * k + (1.0 - np.cos(angle)) * k @ k)
