"""From what the sensor saw to the numbers of a result, in the units and axes that are set.

Imitates
    The emScon server's conversion of measurements.
Source
    ES_C_API_Def.h: length, angle, temperature and pressure units, coordinate system types; quaternion (q0 is w) as
    the maker's sample code turns it into a matrix.
Modelled
    All length, angle, temperature units; hPa, kPa and the older pressure units; right- and left-handed, cylindrical
    and spherical coordinates; station orientation and transformation with scale.
Not modelled
    Deviations in spherical and cylindrical coordinates (given as in Cartesian ones).
"""

import math
from dataclasses import dataclass, field

import numpy as np

from cellcal.fake_devices.kinematics import Array, invert_pose, matrix_from_xyzwpr
from cellcal.fake_devices.laser_tracker import layout
from cellcal.fake_devices.laser_tracker.sensor import TURN_RAD, StationaryMeasurement

_LENGTHS = (1.0, 1e3, 1e6, 1.0 / 0.3048, 1.0 / 0.9144, 1.0 / 0.0254)  # per metre
_ANGLES = (1.0, 180.0 / math.pi, 200.0 / math.pi)
_PRESSURES = (1.0, 1.0, 0.1, 0.750062, 0.0145038, 0.401463, 0.02953)  # per mbar
_PROBE_WORDS = (0, 0x01 | 0x3 << 13, 1, 1, 0, 1, 0)  # trigger, turn valid and well seen, probe, field, tip OK


@dataclass
class EmsconSettings:
    """The settings that a client can change, as the server starts with them."""

    units: tuple[int, ...] = (1, 1, 0, 1, 0)  # millimetre, degree, Celsius, hPa, per cent
    axes: int = 6  # spherical, clockwise
    mode: int = 0
    settings: tuple[int, ...] = (2, 1, 1, 0, 0, 0, 0, 0, 0)
    orientation: tuple[float, ...] = (0.0,) * 6
    transformation: tuple[float, ...] = (0.0,) * 6 + (1.0,)
    statistics: tuple[int, ...] = (0, 0)
    stationary: tuple[int, ...] = (500, 1)
    reflector: int = 2
    compensation: int = 11
    corrupt: dict[int, float] = field(default_factory=dict)  # value index -> value, for faults

    def length_factor(self) -> float:
        """Return units of length per metre."""
        return _LENGTHS[self.units[0]]

    def angle_factor(self) -> float:
        """Return units of angle per radian."""
        return _ANGLES[self.units[1]]

    def air_values(self, air: tuple[float, float, float]) -> tuple[float, float, float]:
        """Return temperature, pressure, humidity in the units that are set."""
        celsius, hpa, percent = air
        return (celsius * 1.8 + 32.0 if self.units[2] else celsius, hpa * _PRESSURES[self.units[3]], percent)


def result_packet(
    setup: EmsconSettings, measurement: StationaryMeasurement, air: tuple[float, float, float]
) -> bytes:
    """Return the packet for a measurement in the mode that is set."""
    frame = _result_frame(setup)
    turn, place = frame[:3, :3], frame[:3, :3] @ measurement.place_m + frame[:3, 3]
    if setup.settings[1]:
        place = place * setup.transformation[6]
    covariance = turn @ measurement.covariance_m2 @ turn.T
    scatter = np.abs(turn) @ measurement.scatter_m
    per_m, weather = setup.length_factor(), setup.air_values(air)
    value = _result_coordinates(setup, place)
    expected = np.sqrt(np.diag(covariance)) * per_m
    mixed = np.array([covariance[0, 1], covariance[0, 2], covariance[1, 2]]) * per_m**2
    spread = [*(scatter * per_m), float(np.linalg.norm(scatter)) * per_m]
    expected_values = [*expected, float(np.linalg.norm(expected))]
    is_try = setup.settings[6]
    if setup.mode == layout.MM_6D_STATIONARY:
        values = [
            *value,
            *spread,
            0.0,
            0.0,
            0.0,
            *expected_values,
            *mixed,
            *_rotation_numbers(setup, turn @ measurement.turn),
            *weather,
        ]
        return layout.probe_result(is_try, _PROBE_WORDS, _corrupt_values(setup, values))
    if setup.statistics[0]:
        values = [*value, *spread, *(0.0,) * 6, *expected_values, *mixed, *weather]
        return layout.single_result_2(setup.mode, is_try, _corrupt_values(setup, values))
    return layout.single_result(
        setup.mode, is_try, _corrupt_values(setup, [*value, *spread, *(0.0,) * 3, *expected_values, *weather])
    )


def _result_frame(setup: EmsconSettings) -> Array:
    """Return the tracker seen from the frame that results are given in."""
    frame = np.eye(4)
    if setup.settings[2]:
        frame = _pose_matrix(setup, setup.orientation)
    if setup.settings[1]:
        frame = invert_pose(_pose_matrix(setup, setup.transformation[:6])) @ frame
    return frame


def _pose_matrix(setup: EmsconSettings, six: tuple[float, ...]) -> Array:
    per_m, per_rad = setup.length_factor(), setup.angle_factor()
    return matrix_from_xyzwpr(
        [*(v / per_m * 1e3 for v in six[:3]), *(math.degrees(v / per_rad) for v in six[3:])]
    )


def _result_coordinates(setup: EmsconSettings, place: Array) -> list[float]:
    x, y, z = (float(v) for v in place)
    per_m, per_rad = setup.length_factor(), setup.angle_factor()
    if setup.axes < 4:
        signs = (
            (1.0, 1.0, 1.0)
            if setup.axes == 0
            else tuple(-1.0 if i == setup.axes - 1 else 1.0 for i in range(3))
        )
        return [s * v * per_m for s, v in zip(signs, (x, y, z), strict=True)]
    around = math.atan2(y, x) * (-1.0 if setup.axes in (4, 6) else 1.0)
    if setup.axes < 6:
        return [math.hypot(x, y) * per_m, around * per_rad, z * per_m]
    distance = math.hypot(x, y, z)
    return [around * per_rad, math.acos(z / distance) * per_rad, distance * per_m]


def _rotation_numbers(setup: EmsconSettings, rotation: Array) -> list[float]:
    """Return quaternion, rotation angles, and their deviations as a probe's result has them: 21 numbers."""
    per_rad = setup.angle_factor()
    angles = [
        math.atan2(rotation[2, 1], rotation[2, 2]),
        math.asin(min(1.0, max(-1.0, -float(rotation[2, 0])))),
        math.atan2(rotation[1, 0], rotation[0, 0]),
    ]
    each, total = TURN_RAD * per_rad, TURN_RAD * per_rad * math.sqrt(3.0)
    deviations = [0.3 * each, 0.3 * each, 0.3 * each, 0.3 * total, 0.0, 0.0, 0.0]
    expected_values = [each, each, each, total, 0.0, 0.0, 0.0]
    return [*_quaternion_of(rotation), *(v * per_rad for v in angles), *deviations, *expected_values]


def _quaternion_of(rotation: Array) -> list[float]:
    """Return (w, x, y, z) as the eigenvector of the largest eigenvalue of Bar-Itzhack's matrix (2000)."""
    r = rotation
    k = np.array(
        [
            [r[0, 0] + r[1, 1] + r[2, 2], r[2, 1] - r[1, 2], r[0, 2] - r[2, 0], r[1, 0] - r[0, 1]],
            [r[2, 1] - r[1, 2], r[0, 0] - r[1, 1] - r[2, 2], r[0, 1] + r[1, 0], r[0, 2] + r[2, 0]],
            [r[0, 2] - r[2, 0], r[0, 1] + r[1, 0], r[1, 1] - r[0, 0] - r[2, 2], r[1, 2] + r[2, 1]],
            [r[1, 0] - r[0, 1], r[0, 2] + r[2, 0], r[1, 2] + r[2, 1], r[2, 2] - r[0, 0] - r[1, 1]],
        ]
    )
    vector = np.linalg.eigh(k)[1][:, -1]
    return [float(v) for v in vector * (1.0 if vector[0] >= 0 else -1.0)]


def _corrupt_values(setup: EmsconSettings, values: list[float]) -> list[float]:
    for index, value in setup.corrupt.items():
        values[index] = value
    return values
