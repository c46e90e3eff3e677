"""cell.toml, read once into frozen models. Nothing else in the product reads configuration.

Millimetres and degrees appear in the file only, spelled ``_mm`` and ``_deg``; the models give SI.
Every fault of a file is reported at once, each with its key path and, for an unknown key, the nearest
valid one.
"""

import difflib
import hashlib
import os
import re
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pydantic import BaseModel, ConfigDict, Field, TypeAdapter, ValidationError, field_validator

from calibration.errors import CellError
from calibration.robot_models import model_names
from drivers.registry import GaugeConfig, RobotConfig

Triple = tuple[float, float, float]


class ConfigError(CellError):
    """The cell file is wrong; ``faults`` are (key path, sentence), all of them at once."""

    code = "config"

    def __init__(self, path: Path, faults: list[tuple[str, str]]) -> None:
        lines = "\n".join(f"  {key}: {sentence}" for key, sentence in faults)
        super().__init__(f"{path} cannot be used:\n{lines}", remedy="\nCorrect the file and try again.")
        self.path = path
        self.faults = faults


class _Table(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


class CellTable(_Table):
    """[cell]: who we are and where our data live; a relative folder is meant from the cell file's own."""

    name: str = Field(min_length=1, max_length=64)
    data_dir: Path

    @field_validator("data_dir")
    @classmethod
    def _expand(cls, path: Path) -> Path:
        return path.expanduser()


class GaugeSetup(_Table):
    """Where a length gauge stands, as far as a tape measure tells. The truth is fitted."""

    robot: str
    anchor_in_base_mm: Triple
    hook_in_flange_mm: Triple
    anchor_sigma_mm: float = Field(default=10.0, gt=0)
    hook_sigma_mm: float = Field(default=2.0, gt=0)

    @property
    def anchor_in_base_m(self) -> Triple:
        """Exit point of the wire in the robot's base frame [m]."""
        return _metres(self.anchor_in_base_mm)

    @property
    def hook_in_flange_m(self) -> Triple:
        """Hook of the wire in the robot's flange frame [m]."""
        return _metres(self.hook_in_flange_mm)


class WatchTable(_Table):
    """[watch]: how the service follows the devices, and what it may start by itself."""

    period_s: float = Field(default=0.5, gt=0, le=60)
    recover_alone: bool = False  # only where the cell is closed and an admin has decided so


@dataclass(frozen=True)
class GaugeEntry:
    """One length gauge: how to reach it, and where it stands."""

    device: GaugeConfig
    setup: GaugeSetup


@dataclass(frozen=True)
class CellConfig:
    """A whole cell file."""

    path: Path
    text: str
    cell: CellTable
    robots: tuple[RobotConfig, ...]
    gauges: tuple[GaugeEntry, ...]
    watch: WatchTable
    fake: Mapping[str, Any]

    @property
    def sha256(self) -> str:
        """Hash of the file's text; stored with every run."""
        return hashlib.sha256(self.text.encode()).hexdigest()

    def robot(self, name: str | None = None) -> RobotConfig:
        """Return the robot of that name; the only or first one when no name is given."""
        for robot in self.robots:
            if name in (None, robot.name):
                return robot
        names = ", ".join(robot.name for robot in self.robots)
        raise ConfigError(self.path, [("robot", f"there is no robot {name!r}; this cell has {names}")])

    def gauge_for(self, robot: str) -> GaugeEntry | None:
        """Return the gauge that is hooked to that robot, if any."""
        return next((entry for entry in self.gauges if entry.setup.robot == robot), None)


def read_cell_file(path: str | os.PathLike[str]) -> CellConfig:
    """Read and validate a cell file; raise ConfigError with every fault at once."""
    path = Path(path)
    text = _text_of(path)
    try:
        document = tomllib.loads(text)
    except (tomllib.TOMLDecodeError, RecursionError) as error:
        raise ConfigError(path, [("file", f"is not valid TOML: {error}")]) from error
    return _Reader(path, text).read(document)


def _text_of(path: Path) -> str:
    try:
        with path.open("rb") as file:
            raw = file.read(_MOST_BYTES + 1)
        if len(raw) > _MOST_BYTES:
            raise ConfigError(path, [("file", f"is larger than {_MOST_BYTES // 1000} kB: no cell file is")])
        return raw.decode("utf-8")
    except FileNotFoundError:
        raise ConfigError(path, [("file", "there is no such file")]) from None
    except IsADirectoryError:
        raise ConfigError(path, [("file", "is a folder; name the cell file in it")]) from None
    except UnicodeDecodeError as error:
        raise ConfigError(
            path, [("file", f"cannot be read: it is not text in UTF-8 (byte {error.start})")]
        ) from error
    except (OSError, ValueError) as error:
        raise ConfigError(path, [("file", f"cannot be read: {error}")]) from error


_NAME = re.compile(r"\w[\w .-]*")
_MOST_BYTES = 1_000_000
_TABLES = ("cell", "robot", "gauge", "watch", "fake")
_SETUP_KEYS = frozenset(GaugeSetup.model_fields)


class _Reader:
    """Collects every fault before it gives up."""

    def __init__(self, path: Path, text: str) -> None:
        self.path, self.text = path, text
        self.faults: list[tuple[str, str]] = []

    def read(self, document: dict[str, Any]) -> CellConfig:
        for key in document:
            if key not in _TABLES:
                self.faults.append((key, f"unknown table; {_nearest(key, _TABLES)}"))
        cell = self._model(CellTable, document.get("cell", {}), "cell")
        robots = [
            self._device(RobotConfig, table, f"robot[{i}]")
            for i, table in enumerate(self._tables(document, "robot"))
        ]
        gauges = [
            self._gauge(table, f"gauge[{i}]") for i, table in enumerate(self._tables(document, "gauge"))
        ]
        watch = self._model(WatchTable, document.get("watch", {}), "watch")
        self._models(robots)
        if not robots and "robot" not in dict(self.faults):
            self.faults.append(("robot", "a cell needs at least one [[robot]]"))
        if not self.faults:
            self._names(
                [r.name for r in robots] + [g.device.name for g in gauges], gauges, {r.name for r in robots}
            )
        if self.faults:
            raise ConfigError(self.path, self.faults)
        cell = cell.model_copy(update={"data_dir": self.path.parent / cell.data_dir})
        return CellConfig(
            self.path, self.text, cell, tuple(robots), tuple(gauges), watch, document.get("fake", {})
        )

    def _models(self, robots: list[Any]) -> None:
        for i, robot in enumerate(robots):
            if robot is not None and robot.model not in model_names():
                sentence = f"there is no robot model {robot.model!r}; {_nearest(robot.model, model_names())}"
                self.faults.append((f"robot[{i}].model", sentence))

    def _tables(self, document: dict[str, Any], key: str) -> list[Any]:
        tables = document.get(key, [])
        if isinstance(tables, list) and all(isinstance(table, dict) for table in tables):
            return tables
        self.faults.append((key, f"is written as [[{key}]], once for each"))
        return []

    def _gauge(self, table: dict[str, Any], where: str) -> GaugeEntry:
        setup = {key: value for key, value in table.items() if key in _SETUP_KEYS}
        device = {key: value for key, value in table.items() if key not in _SETUP_KEYS}
        return GaugeEntry(self._device(GaugeConfig, device, where), self._model(GaugeSetup, setup, where))

    def _names(self, names: list[str], gauges: list[GaugeEntry], robots: set[str]) -> None:
        for name in names:
            if not _NAME.fullmatch(name):  # it becomes part of file names
                self.faults.append(("name", f"{name!r} is no name; letters, digits, '-', '_', '.', ' '"))
        for name in sorted({name for name in names if names.count(name) > 1}):
            self.faults.append(("name", f"two devices are called {name!r}"))
        for entry in gauges:
            if entry.setup.robot not in robots:
                sentence = f"names the robot {entry.setup.robot!r}, which is not in this file"
                self.faults.append((f"gauge {entry.device.name}", sentence))

    def _model(self, model: type[Any], table: Any, where: str) -> Any:
        return self._validate(lambda: model.model_validate(table), where, tuple(model.model_fields))

    def _device(self, union: Any, table: dict[str, Any], where: str) -> Any:
        valid = _keys_of(union, table.get("driver"))
        driver = table.get("driver")
        return self._validate(lambda: TypeAdapter(union).validate_python(table), where, valid, driver)

    def _validate(self, build: Any, where: str, valid: tuple[str, ...], tag: Any = None) -> Any:
        try:
            return build()
        except ValidationError as error:
            for fault in error.errors():
                path = ".".join(str(part) for part in fault["loc"] if part != tag)
                key = str(fault["loc"][-1]) if fault["loc"] else ""
                sentence = fault["msg"]
                if fault["type"] == "extra_forbidden":
                    sentence = f"unknown key; {_nearest(key, valid)}"
                elif fault["type"].startswith("union_tag"):
                    told = "names no driver" if tag is None else f"there is no driver {tag!r}"
                    sentence = f"{told}; there are {', '.join(_drivers())}"
                self.faults.append((f"{where}.{path}" if path else where, sentence))
            return None


def _drivers() -> list[str]:
    models = getattr(RobotConfig, "__origin__", RobotConfig).__args__
    return [str(name) for model in models for name in model.model_fields["driver"].annotation.__args__]


def _keys_of(union: Any, driver: Any) -> tuple[str, ...]:
    """Return the valid keys of the device model that this ``driver`` names."""
    models = getattr(getattr(union, "__origin__", union), "__args__", (union,))
    for model in models:
        field = model.model_fields.get("driver")
        if field is not None and driver in getattr(field.annotation, "__args__", ()):
            return (*model.model_fields, *_SETUP_KEYS)
    return ("driver",)


def _nearest(key: str, valid: tuple[str, ...]) -> str:
    close = difflib.get_close_matches(key, valid, n=1, cutoff=0.5)
    return f"did you mean {close[0]!r}?" if close else f"valid here: {', '.join(sorted(valid))}"


def _metres(millimetres: Triple) -> Triple:
    x, y, z = millimetres
    return (x * 1e-3, y * 1e-3, z * 1e-3)
