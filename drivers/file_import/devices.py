"""An instrument whose wire is closed, as a gauge or a tracker: its readings are typed, or taken from a file."""

import math
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass

import numpy as np

from cellcal.calibration.errors import CalibrationError
from cellcal.calibration.geometry import Array, Pose, homogeneous_matrix
from cellcal.calibration.message import make_message
from cellcal.calibration.orientation import CONVENTIONS, rotation_from
from cellcal.drivers.errors import BusyError, DeviceError, RefusedError
from cellcal.drivers.file_import.number_text import TextRow, metres_per
from cellcal.drivers.file_import.rows import RowSource
from cellcal.drivers.interfaces import (
    Condition,
    GaugeCapabilities,
    Identity,
    LengthReading,
    PointReading,
    PoseReading,
    Readiness,
    TrackerCapabilities,
)

_STEP_M = 1e-9  # rounding of a number in a text file
_AGAIN = "Read the instrument again; if its unit is another, correct the cell file."


@dataclass(frozen=True, slots=True)
class InstrumentOptions:
    """The cell file's options of the instrument."""

    name: str
    identity: Identity
    unit: str
    range_m: float
    sigma_m: float
    typed: bool = False  # by a person, when a run asks for it


@dataclass(frozen=True, slots=True)
class FrameOptions:
    """The cell file's options of an instrument that measures places."""

    station: int
    orientation: str  # a name of cellcal.calibration.orientation; empty for points only
    radians_per_angle: float
    sigma_rad: float


class _Instrument:
    """The parts that all readings from a file or a person have in common."""

    def __init__(self, rows: RowSource, options: InstrumentOptions) -> None:
        self._rows, self._options = rows, options
        self._busy = False

    @property
    def name(self) -> str:
        return self._options.name

    def close(self) -> None:
        """Let go of the file."""
        self._rows.close()

    async def identify(self) -> Identity:
        """Return what the cell file says: nothing can be asked."""
        return self._options.identity

    async def read_condition(self) -> Condition:
        if self._busy:
            return Condition(Readiness.READY, "It waits for a reading.")
        try:
            await self._rows.check_source()
        except RefusedError as error:
            return Condition(Readiness.NOT_READY, error.message, error.remedy)
        except DeviceError as error:
            return Condition(Readiness.UNREACHABLE, error.message, error.remedy)
        return Condition(Readiness.READY)

    async def _next_row(self) -> TextRow:
        with self._exclusive_use():
            return await self._rows.next_row()

    @contextmanager
    def _exclusive_use(self) -> Iterator[None]:
        if self._busy:
            raise BusyError(self.name, "a reading is asked for while another one is awaited.")
        self._busy = True
        try:
            yield
        finally:
            self._busy = False

    def _refused_error(self, row: TextRow, message: str) -> RefusedError:
        where = make_message("line {line}: ", line=row.line) if row.line else ""
        return RefusedError(
            self.name,
            make_message("{where}{message} ({text}).", where=where, message=message, text=row.text[:60]),
            remedy=_AGAIN,
        )


class FileGauge(_Instrument):
    """DistanceGauge from a person or a file."""

    @property
    def capabilities(self) -> GaugeCapabilities:
        options = self._options
        return GaugeCapabilities(
            options.range_m, _STEP_M, options.sigma_m, answers_alone=False, typed=options.typed
        )

    async def read_distance(self) -> LengthReading:
        row = await self._next_row()
        raw = round(row.values[0] * metres_per(self._options.unit) / _STEP_M)
        value_m = raw * _STEP_M
        if not 0.0 <= value_m <= self._options.range_m:
            raise self._refused_error(
                row,
                make_message(
                    "{value:.3f} mm is outside 0 to {most:g} mm",
                    value=value_m * 1e3,
                    most=self._options.range_m * 1e3,
                ),
            )
        return LengthReading(value_m, self._options.sigma_m, time.monotonic(), raw)


class FileTracker(_Instrument):
    """Tracker from a person or a file."""

    def __init__(self, rows: RowSource, options: InstrumentOptions, frame: FrameOptions) -> None:
        super().__init__(rows, options)
        self._frame = frame

    @property
    def capabilities(self) -> TrackerCapabilities:
        options, frame = self._options, self._frame
        return TrackerCapabilities(
            bool(frame.orientation),
            options.range_m,
            options.sigma_m,
            sigma_rad=frame.sigma_rad,
            typed=options.typed,
        )

    async def measure_point(self) -> PointReading:
        row = await self._next_row()
        sigma = self._options.sigma_m
        place = self._place_m(row)
        return PointReading(place, (sigma, sigma, sigma), time.monotonic(), self._frame.station, raw=row.text)

    async def measure_pose(self) -> PoseReading:
        if not self._frame.orientation:
            raise RefusedError(
                self.name,
                "it gives points only.",
                remedy="Name the convention of its angles as `orientation` in cell.toml.",
            )
        row = await self._next_row()
        place = self._place_m(row)
        try:
            rotation = rotation_from(self._frame.orientation, self._turn_numbers(row))
        except CalibrationError as error:
            raise self._refused_error(row, error.message) from error
        sigma, turn = self._options.sigma_m, self._frame.sigma_rad
        return PoseReading(
            Pose.from_matrix(homogeneous_matrix(rotation, np.array(place))),
            (sigma, sigma, sigma),
            (turn, turn, turn),
            time.monotonic(),
            self._frame.station,
            raw=row.text,
        )

    def _place_m(self, row: TextRow) -> tuple[float, float, float]:
        per_unit = metres_per(self._options.unit)
        x, y, z = (value * per_unit for value in row.values[:3])
        distance_m = math.hypot(x, y, z)
        if distance_m > self._options.range_m:
            raise self._refused_error(
                row,
                make_message(
                    "the point is {distance_m:.3f} m away, the range is {limit_m:g} m",
                    distance_m=distance_m,
                    limit_m=self._options.range_m,
                ),
            )
        return x, y, z

    def _turn_numbers(self, row: TextRow) -> Array:
        """Return the numbers of the turn in radians; a quaternion has none."""
        numbers = np.array(row.values[3:])
        is_quaternion = CONVENTIONS[self._frame.orientation].formula == "quaternion"
        return numbers if is_quaternion else numbers * self._frame.radians_per_angle
