"""cell.toml, read once into frozen models. Nothing else in the product reads configuration.

Millimetres and degrees appear in the file only, spelled ``_mm`` and ``_deg``; the models give SI.
Every fault of a file is reported at once, each with its key path and, for an unknown key, the nearest
valid one.
"""

import hashlib
import json
import os
import re
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from pydantic import Field, TypeAdapter, ValidationError, field_validator

from cellcal.calibration.arm.model_references import fixed_reference, load_model
from cellcal.calibration.documents import DocumentError
from cellcal.calibration.documents.plain_files import read_plain_text
from cellcal.calibration.documents.toml_text import parse_toml
from cellcal.calibration.errors import CalibrationError, CellError
from cellcal.calibration.message import make_message
from cellcal.drivers.registry import GaugeConfig, ProbeConfig, RobotConfig, TrackerConfig
from cellcal.service.configuration.device_keys import CHOICES, keys_of, suggest_key, wrong_choice
from cellcal.service.configuration.instrument_tables import (
    GaugeEntry,
    GaugeSetupTable,
    InstrumentEntry,
    ProbeEntry,
    ProbeSetupTable,
    StrictTable,
    TrackerEntry,
    TrackerSetupTable,
)
from cellcal.service.configuration.motion_config import MOTION_KEYS, RobotMotion, read_motion
from cellcal.service.configuration.report_tables import MetricsTable, ReportTables, WebhookTable
from cellcal.service.configuration.site_config import SiteTable
from cellcal.service.configuration.usual_settings import USUAL_KEY, Usual, read_usual


class ConfigError(CellError):
    """The cell file is wrong; ``faults`` are (key path, sentence), all of them at once."""

    code = "config"

    def __init__(self, path: Path, faults: list[tuple[str, str]]) -> None:
        lines = "\n".join(f"  {key}: {sentence}" for key, sentence in faults)
        super().__init__(f"{path} cannot be used:\n{lines}", remedy="\nCorrect the file and try again.")
        self.path, self.faults = path, faults


class CellTable(StrictTable):
    """[cell]: who we are and where our data live; a relative folder is meant from the cell file's own."""

    name: str = Field(min_length=1, max_length=64)
    data_dir: Path

    @field_validator("data_dir")
    @classmethod
    def _expand_path(cls, path: Path) -> Path:
        return path.expanduser()


class WatchTable(StrictTable):
    """[watch]: how the service follows the devices, and what it may start by itself."""

    period_s: float = Field(default=0.5, gt=0, le=60)
    recover_alone: bool = False  # only where an admin has decided so, and the robot's motion is "commanded"
    drift_check_days: int | None = Field(default=None, ge=1, le=3650)  # from one drift check to the next
    cell_closed: bool = (
        False  # an administrator confirms that no person can be in the cell while the watch runs
    )
    records_complete: bool = False  # and that no newer mastering record is kept elsewhere than in the journal
    wire_stays_hooked: bool = False  # and that the draw-wire hangs on the flange, free, between runs


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
    trackers: tuple[TrackerEntry, ...] = ()
    probes: tuple[ProbeEntry, ...] = ()
    motions: Mapping[str, RobotMotion] = field(default_factory=dict)  # by the robot's name
    site: SiteTable | None = None
    reports: ReportTables = field(default_factory=ReportTables)
    usual: Mapping[str, Usual] = field(default_factory=dict)  # settings, by the robot's name

    @property
    def sha256(self) -> str:
        """Hash of the file's text; stored with every run."""
        return hashlib.sha256(self.text.encode()).hexdigest()

    def robot_named(self, name: str | None = None) -> RobotConfig:
        """Return the robot of that name; the only or first one when no name is given."""
        for robot in self.robots:
            if name in (None, robot.name):
                return robot
        names = ", ".join(robot.name for robot in self.robots)
        raise ConfigError(self.path, [("robot", f"there is no robot {name!r}; this cell has {names}")])

    def motion_of(self, robot: str) -> RobotMotion:
        """Return who moves that robot; a person, where the file does not say."""
        return self.motions.get(robot, RobotMotion())

    def gauge_for(self, robot: str) -> GaugeEntry | None:
        """Return the gauge that is hooked to that robot, if any."""
        return next((entry for entry in self.gauges if entry.setup.robot == robot), None)

    def tracker_for(self, robot: str) -> TrackerEntry | None:
        """Return the tracker whose target that robot carries, if any."""
        return next((entry for entry in self.trackers if entry.setup.robot == robot), None)

    def probes_for(self, robot: str) -> tuple[ProbeEntry, ...]:
        """Return the touch probe and the dial gauge that the robot carries, as far as there are any."""
        return tuple(entry for entry in self.probes if entry.setup.robot == robot)

    @property
    def instrument_entries(self) -> tuple[InstrumentEntry, ...]:
        """Everything that measures in this cell."""
        return (*self.gauges, *self.trackers, *self.probes)

    def instruments_for(self, robot: str) -> dict[str, InstrumentEntry]:
        """Return what measures at that robot, by its role."""
        found: dict[str, InstrumentEntry] = {entry.role: entry for entry in self.probes_for(robot)}
        one_of_a_kind = (("gauge", self.gauge_for(robot)), ("tracker", self.tracker_for(robot)))
        return {role: entry for role, entry in one_of_a_kind if entry is not None} | found


def read_cell_file(path: str | os.PathLike[str]) -> CellConfig:
    """Read and validate a cell file; raise ConfigError with every fault at once."""
    path = Path(path)
    text = _text_of(path)
    try:
        document = parse_toml(text)
    except DocumentError as error:
        raise ConfigError(path, [(error.key or "file", error.why.removeprefix("it "))]) from error
    return _CellFileReader(path, text).read_config(document)


def _text_of(path: Path) -> str:
    try:
        return read_plain_text(path, _MOST_BYTES)
    except FileNotFoundError:
        raise ConfigError(path, [("file", "there is no such file")]) from None
    except IsADirectoryError:
        raise ConfigError(path, [("file", "is a folder; name the cell file in it")]) from None
    except (OSError, ValueError) as error:
        raise ConfigError(path, [("file", f"cannot be read: {error}")]) from error


def _to_json(table: Any) -> str:
    """Return a table as JSON: of that, strict reading takes lists and dates, but no ``true`` as a number."""
    return json.dumps(table, default=str)


_NAME = re.compile(r"\w[\w .-]*")
_MOST_BYTES = 1_000_000
_TABLES = ("cell", "robot", "gauge", "tracker", "probe", "watch", "site", "metrics", "webhook", "fake")


class _CellFileReader:
    """Collects every fault before it gives up."""

    def __init__(self, path: Path, text: str) -> None:
        self.path, self.text = path, text
        self.faults: list[tuple[str, str]] = []

    def read_config(self, document: dict[str, Any]) -> CellConfig:
        for key in document:
            if key not in _TABLES:
                self.faults.append((key, f"unknown table; {suggest_key(key, _TABLES)}"))
        cell = self._validate_model(CellTable, document.get("cell", {}), "cell")
        tables = self._table_list(document, "robot")
        robots = [self._read_robot(table, f"robot[{i}]") for i, table in enumerate(tables)]
        motions = {
            str(table.get("name")): read_motion(table, f"robot[{i}]", self.faults)
            for i, table in enumerate(tables)
        }
        usual = {
            str(table.get("name")): read_usual(table, f"robot[{i}]", self.faults)
            for i, table in enumerate(tables)
        }
        gauges = self._read_placed(document, "gauge", GaugeConfig, GaugeEntry, GaugeSetupTable)
        trackers = self._read_placed(document, "tracker", TrackerConfig, TrackerEntry, TrackerSetupTable)
        probes = self._read_placed(document, "probe", ProbeConfig, ProbeEntry, ProbeSetupTable)
        watch = self._validate_model(WatchTable, document.get("watch", {}), "watch")
        site = self._validate_optional(SiteTable, document, "site")
        reports = ReportTables(
            self._validate_optional(MetricsTable, document, "metrics"),
            self._validate_optional(WebhookTable, document, "webhook"),
        )
        self._check_models(robots)
        if not robots and "robot" not in dict(self.faults):
            self.faults.append(("robot", "a cell needs at least one [[robot]]"))
        if not self.faults:
            entries = [
                (kind, entry)
                for kind, found in (("gauge", gauges), ("tracker", trackers), ("probe", probes))
                for entry in found
            ]
            names = [r.name for r in robots] + [entry.device.name for _, entry in entries]
            self._check_names(names, entries, {r.name for r in robots})
        if self.faults:
            raise ConfigError(self.path, self.faults)
        cell = cell.model_copy(update={"data_dir": self.path.parent / cell.data_dir})
        return CellConfig(
            self.path,
            self.text,
            cell,
            tuple(robots),
            tuple(gauges),
            watch,
            document.get("fake", {}),
            tuple(trackers),
            tuple(probes),
            motions,
            None if site is None else site.seen_from(self.path),
            reports.seen_from(self.path),
            usual,
        )

    def _read_robot(self, table: dict[str, Any], where: str) -> Any:
        ours = (*MOTION_KEYS, USUAL_KEY)
        device = {key: value for key, value in table.items() if key not in ours}
        if isinstance(model := device.get("model"), str):
            with suppress(CalibrationError):  # `_check_models` says what is wrong with it
                device["model"] = fixed_reference(model, self.path.absolute().parent)
        return self._validate_device(RobotConfig, device, where, ours)

    def _check_models(self, robots: list[Any]) -> None:
        for i, robot in enumerate(robots):
            if robot is None:
                continue
            try:
                model = load_model(fixed_reference(robot.model, self.path.absolute().parent))
            except CalibrationError as refused:
                none = f"there is no robot model {robot.model!r}"
                why = (
                    ""
                    if refused.message.startswith(none)
                    else make_message(": {refused_message}", refused_message=refused.message.rstrip("."))
                )
                self.faults.append((f"robot[{i}].model", f"{none}{why}; {refused.remedy}"))
                continue
            if model.axis_count != robot.capabilities.axes:
                other = make_message(
                    "{model} has {axes} axes, and {shown} are read of this controller",
                    model=robot.model,
                    axes=model.axis_count,
                    shown=robot.capabilities.axes,
                )
                self.faults.append((f"robot[{i}].model", other))

    def _table_list(self, document: dict[str, Any], key: str) -> list[Any]:
        tables = document.get(key, [])
        if isinstance(tables, list) and all(isinstance(table, dict) for table in tables):
            return tables
        self.faults.append((key, f"is written as [[{key}]], once for each"))
        return []

    def _read_placed(
        self, document: dict[str, Any], key: str, union: Any, entry: type[Any], setup: type[Any]
    ) -> list[Any]:
        """Read tables that hold a device and where it stands: the keys tell which is which."""
        found = []
        for i, table in enumerate(self._table_list(document, key)):
            where, placing = f"{key}[{i}]", tuple(setup.model_fields)
            device = {name: value for name, value in table.items() if name not in placing}
            place = {name: value for name, value in table.items() if name in placing}
            found.append(
                entry(
                    self._validate_device(union, device, where, placing),
                    self._validate_model(setup, place, where),
                )
            )
        return found

    def _check_names(self, names: list[str], entries: list[tuple[str, Any]], robots: set[str]) -> None:
        for name in names:
            if not _NAME.fullmatch(name):  # it becomes part of file names
                self.faults.append(("name", f"{name!r} is no name; letters, digits, '-', '_', '.', ' '"))
        for name in sorted({name for name in names if names.count(name) > 1}):
            self.faults.append(("name", f"two devices are called {name!r}"))
        worn = [(entry.setup.robot, entry.device.driver) for kind, entry in entries if kind == "probe"]
        for robot, driver in sorted({pair for pair in worn if worn.count(pair) > 1}):
            self.faults.append(("probe", f"two probes with the driver {driver} on the robot {robot!r}"))
        for kind, entry in entries:
            if entry.setup.robot not in robots:
                sentence = f"names the robot {entry.setup.robot!r}, which is not in this file"
                self.faults.append((f"{kind} {entry.device.name}", sentence))

    def _validate_model(self, model: type[Any], table: Any, where: str) -> Any:
        build = TypeAdapter(model).validate_json
        return self._collect_faults(
            lambda: build(_to_json(table), strict=True), where, tuple(model.model_fields)
        )

    def _validate_optional(self, model: type[Any], document: dict[str, Any], key: str) -> Any:
        return self._validate_model(model, document[key], key) if key in document else None

    def _validate_device(
        self, union: Any, table: dict[str, Any], where: str, placing: tuple[str, ...] = ()
    ) -> Any:
        build = TypeAdapter(union).validate_json
        tags = tuple(table.get(key) for key in CHOICES)
        return self._collect_faults(
            lambda: build(_to_json(table), strict=True),
            where,
            (*keys_of(union, table), *placing),
            tags,
            union,
        )

    def _collect_faults(
        self, build: Any, where: str, valid: tuple[str, ...], tags: tuple[Any, ...] = (), union: Any = None
    ) -> Any:
        try:
            return build()
        except ValidationError as error:
            for fault in error.errors():
                path = ".".join(str(part) for part in fault["loc"] if part not in tags)
                key = str(fault["loc"][-1]) if fault["loc"] else ""
                sentence = fault["msg"]
                if fault["type"] == "extra_forbidden":
                    sentence = f"unknown key; {suggest_key(key, valid)}"
                elif fault["type"].startswith("union_tag"):
                    sentence = wrong_choice(union, fault["ctx"])
                self.faults.append((f"{where}.{path}" if path else where, sentence))
            return None
