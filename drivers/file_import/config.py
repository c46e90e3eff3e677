"""[[gauge]] and [[tracker]] driver = "file_import" in cell.toml. The models are the factories."""

import math
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Literal

from pydantic import BaseModel, ConfigDict, Field, field_validator, model_validator

from cellcal.calibration.message import make_message
from cellcal.calibration.orientation import CONVENTIONS
from cellcal.drivers.file_import.devices import FileGauge, FileTracker, FrameOptions, InstrumentOptions
from cellcal.drivers.file_import.number_text import ColumnLayout
from cellcal.drivers.file_import.rows import FileOptions, GrowingFile, RowSource, TypedRows, WholeFile
from cellcal.drivers.interfaces import Identity, Operator, TrackerCapabilities

_SEPARATORS = {"": "", ";": ";", ",": ",", "tab": "\t", "blank": " "}


class _InstrumentConfig(BaseModel):
    """An instrument that is read by a person or by its own program."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    driver: Literal["file_import"]
    name: str = Field(min_length=1, max_length=64)
    instrument: str = Field(default="an instrument", min_length=1, max_length=64)
    serial: str = Field(min_length=1, max_length=64)
    source: Literal["typed", "growing_file", "whole_file"]
    path: Path | None = None
    columns: tuple[int | str, ...] = ()
    separator: Literal["", ";", ",", "tab", "blank"] = ""
    heading_lines: int = Field(default=0, ge=0, le=1000)
    unit: Literal["m", "mm", "um", "in"]
    sigma_m: float = Field(ge=1e-7, le=0.1)
    range_m: float = Field(gt=0, le=500)
    wait_s: float = Field(default=300.0, gt=0, le=86_400)
    deadline_s: float = Field(default=5.0, gt=0, le=60)
    first_row: int | None = Field(default=None, ge=1)

    @field_validator("path")
    @classmethod
    def _check_path(cls, path: Path | None) -> Path | None:
        if path is None:
            return None
        if not path.expanduser().is_absolute():
            raise ValueError("write the whole path, from the root on")
        return path.expanduser()

    @model_validator(mode="after")
    def _file_is_described(self) -> "_InstrumentConfig":
        if self.source == "typed":
            return self
        if self.path is None:
            raise ValueError(f"source = {self.source!r} needs a path")
        if len(self.columns) != self.number_count:
            raise ValueError(f"columns must name {self.number_count} columns, it names {len(self.columns)}")
        if any(isinstance(column, int) and column < 1 for column in self.columns):
            raise ValueError("columns are counted from 1")
        return self

    @property
    def number_count(self) -> int:
        """The number of numbers in a reading."""
        return 1

    def _make_rows(self, operator: Operator | None, question: str) -> RowSource:
        if self.source == "typed":
            return TypedRows(self.name, operator, question, self.unit, self.number_count)
        assert self.path is not None
        layout = ColumnLayout(self.columns, self.unit, _SEPARATORS[self.separator], self.heading_lines)
        options = FileOptions(self.path, layout, self.wait_s, self.deadline_s, self.first_row)
        if self.source == "growing_file":
            return GrowingFile(self.name, options)
        return WholeFile(self.name, options, operator)

    def _instrument_options(self) -> InstrumentOptions:
        identity = Identity("as cell.toml says", self.instrument, self.serial, f"read as {self.source}")
        return InstrumentOptions(
            self.name, identity, self.unit, self.range_m, self.sigma_m, typed=self.source == "typed"
        )


class FileGaugeConfig(_InstrumentConfig):
    """A length gauge without a wire of its own."""

    @asynccontextmanager
    async def open(self, operator: Operator | None = None) -> AsyncIterator[FileGauge]:
        """Open it; ``operator`` is who is asked for readings, or for the first row of a file."""
        question = make_message(
            "Read {instrument} and type its length in {unit}.", instrument=self.instrument, unit=self.unit
        )
        gauge = FileGauge(self._make_rows(operator, question), self._instrument_options())
        try:
            yield gauge
        finally:
            gauge.close()


class FileTrackerConfig(_InstrumentConfig):
    """An instrument for points or poses without a wire of its own."""

    station: int = Field(default=1, ge=1)
    orientation: str = ""
    angle_unit: Literal["deg", "rad"] = "deg"
    sigma_rad: float = Field(default=1e-4, ge=1e-7, le=0.1)

    @field_validator("orientation")
    @classmethod
    def _check_orientation(cls, name: str) -> str:
        if name and name not in CONVENTIONS:
            raise ValueError(f"no orientation is called {name!r}; there are {', '.join(CONVENTIONS)}")
        return name

    @property
    def number_count(self) -> int:
        """The number of numbers in a reading: three, and those of the turn."""
        return 3 + (len(CONVENTIONS[self.orientation].fields) if self.orientation else 0)

    @property
    def capabilities(self) -> TrackerCapabilities:
        """The instrument's capabilities, known before it is reached."""
        return TrackerCapabilities(
            bool(self.orientation),
            self.range_m,
            self.sigma_m,
            sigma_rad=self.sigma_rad,
            typed=self.source == "typed",
        )

    @asynccontextmanager
    async def open(self, operator: Operator | None = None) -> AsyncIterator[FileTracker]:
        """Open it; ``operator`` is who is asked for readings, or for the first row of a file."""
        radians = math.pi / 180.0 if self.angle_unit == "deg" else 1.0
        frame = FrameOptions(self.station, self.orientation, radians, self.sigma_rad)
        tracker = FileTracker(
            self._make_rows(operator, self._question_text()), self._instrument_options(), frame
        )
        try:
            yield tracker
        finally:
            tracker.close()

    def _question_text(self) -> str:
        if not self.orientation:
            return make_message(
                "Measure with {instrument} and type x y z in {unit}, with blanks between.",
                instrument=self.instrument,
                unit=self.unit,
            )
        return make_message(
            "Measure with {instrument} and type x y z in {unit} {fields} in {angle_unit}, as {orientation} has them, "
            "with blanks between.",
            instrument=self.instrument,
            unit=self.unit,
            fields=" ".join(CONVENTIONS[self.orientation].fields),
            angle_unit=self.angle_unit,
            orientation=self.orientation,
        )
