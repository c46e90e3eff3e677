"""From a result of the wire to a reading, or to a refusal that says why the numbers are not to be used."""

import math
from dataclasses import dataclass

import numpy as np

from cellcal.calibration.geometry import Pose
from cellcal.calibration.message import make_message
from cellcal.drivers.errors import RefusedError, WireProtocolError
from cellcal.drivers.interfaces import Air, PointReading, PoseReading
from cellcal.drivers.laser_tracker.link import status_meaning
from cellcal.drivers.laser_tracker.packets import MeasurementMode, PacketKind, StationaryResult, Triple

_AIR = ((-20.0, 60.0), (500.0, 1200.0), (0.0, 100.0))  # degree Celsius, millibar, per cent
_PA_PER_MILLIBAR = 100.0
_VALID, _WRONG, _FROZEN, _TOO_FAR = 0x01, 0x02, 0x20, 0x40  # bits of a probe's rotation status
_ROUNDING = 1e-9
_AGAIN = "Let the arm come to rest, clear the line of sight, then measure again."


@dataclass(frozen=True, slots=True)
class TrackerLimits:
    """The known limits of this tracker, and the deviations assumed for it."""

    range_m: float
    sigma_m: float
    sigma_per_m: float
    sigma_rad: float
    steady_m: float


class ResultChecker:
    """Turns results into readings of one device."""

    def __init__(self, device: str, limits: TrackerLimits) -> None:
        self._device, self._limits = device, limits

    def point_reading(self, found: StationaryResult, taken_at_s: float, station: int) -> PointReading:
        """Return a point [m], refusing what is not one."""
        self._check_result(found, MeasurementMode.POINT, (PacketKind.POINT, PacketKind.POINT_WITH_COVARIANCE))
        sigma_m = self._sigma_m(found)
        self._check_covariance(found, sigma_m)
        return PointReading(
            found.value, sigma_m, taken_at_s, station, self._check_air(found), found.covariance, found.raw
        )

    def pose_reading(self, found: StationaryResult, taken_at_s: float, station: int) -> PoseReading:
        """Return a pose, refusing one whose turn the tracker does not vouch for."""
        self._check_result(found, MeasurementMode.PROBE, (PacketKind.PROBE,))
        bits = found.rotation_status
        if not bits & _VALID or bits & (_WRONG | _FROZEN | _TOO_FAR):
            raise self._refused_error(
                make_message("the turn of the probe is not valid (status {bits:#x})", bits=bits), _AGAIN
            )
        if found.tip_status:
            raise self._refused_error(
                "the probe has another tip than expected", "Mount one tip, and choose it."
            )
        length = math.hypot(*found.quaternion)
        if not abs(length - 1.0) < 1e-3:
            raise self._damaged_result_error("a quaternion that is not of unit length", found)
        w, x, y, z = (value / length for value in found.quaternion)
        scatter_pairs = zip(found.turn_scatter, found.turn_expected, strict=True)
        a, b, c = (max(pair) or self._limits.sigma_rad for pair in scatter_pairs)
        pose = Pose(found.value, (w, x, y, z))
        sigma_m = self._sigma_m(found)
        return PoseReading(pose, sigma_m, (a, b, c), taken_at_s, station, self._check_air(found), found.raw)

    def _check_result(
        self, found: StationaryResult, mode: MeasurementMode, kinds: tuple[PacketKind, ...]
    ) -> None:
        if found.status:
            entry = status_meaning(found.status)
            raise self._refused_error(
                make_message("the result has the status {status}", status=entry.text),
                entry.remedy,
                found.status,
            )
        if found.kind not in kinds or found.mode != mode:
            raise self._refused_error("the result belongs to another measurement mode", _AGAIN)
        if found.is_try:
            raise self._refused_error("the tracker measures in its try mode", "Switch the try mode off.")
        numbers = (*found.value, *found.covariance, *found.quaternion, *found.air)
        spreads = (*found.scatter, *found.expected, *found.turn_scatter, *found.turn_expected)
        if not all(map(math.isfinite, (*numbers, *spreads))) or min(spreads) < 0.0:
            raise self._damaged_result_error("numbers that are not finite, or a negative deviation", found)
        self._check_place(found)

    def _check_place(self, found: StationaryResult) -> None:
        distance_m, limit_m = math.hypot(*found.value), self._limits.range_m
        if not 0.0 < distance_m <= limit_m:
            raise self._refused_error(
                make_message(
                    "the point is {distance_m:.3f} m away, the range is {limit_m:g} m",
                    distance_m=distance_m,
                    limit_m=limit_m,
                ),
                "Check range_m in cell.toml and the line of sight; this may be a reflection.",
            )
        if max(found.scatter) > self._limits.steady_m:
            moved_mm = max(found.scatter) * 1e3
            raise self._refused_error(
                make_message(
                    "the target moved by {moved_mm:.2f} mm while it was measured", moved_mm=moved_mm
                ),
                _AGAIN,
            )

    def _check_covariance(self, found: StationaryResult, sigma_m: Triple) -> None:
        """Refuse covariances that no three coordinates can have."""
        xy, xz, yz = found.covariance
        x, y, z = (sigma**2 for sigma in sigma_m)
        eigenvalues = np.linalg.eigvalsh(np.array([[x, xy, xz], [xy, y, yz], [xz, yz, z]]))
        if eigenvalues[0] < -_ROUNDING * eigenvalues[2]:
            raise self._damaged_result_error("a covariance that cannot be", found)

    def _sigma_m(self, found: StationaryResult) -> Triple:
        """Take the larger of what was seen and what is expected; without either, what cell.toml says."""
        stated_m = self._limits.sigma_m
        if not any(found.expected):
            stated_m += self._limits.sigma_per_m * math.hypot(*found.value)
        x, y, z = (max(*pair, stated_m) for pair in zip(found.scatter, found.expected, strict=True))
        return x, y, z

    def _check_air(self, found: StationaryResult) -> Air:
        if not all(low <= value <= high for value, (low, high) in zip(found.air, _AIR, strict=True)):
            t, p, h = found.air
            raise self._refused_error(
                make_message(
                    "it reckons with impossible air ({celsius:.1f} °C, {mbar:.0f} mbar, {humidity:.0f} %): "
                    "its lengths are wrong",
                    celsius=t,
                    mbar=p,
                    humidity=h,
                ),
                "Connect its weather station, or enter the air by hand on the tracker.",
            )
        temperature, pressure, humidity = found.air
        return Air(temperature, pressure * _PA_PER_MILLIBAR, humidity)

    def _refused_error(self, message: str, remedy: str, status: int = 0) -> RefusedError:
        return RefusedError(
            self._device, make_message("{message}.", message=message), remedy=remedy, vendor_code=status
        )

    def _damaged_result_error(self, found: str, result: StationaryResult) -> WireProtocolError:
        return WireProtocolError(
            self._device,
            make_message("the result has {found}.", found=found),
            remedy="The reading was not used.",
            frame=result.raw,
        )
