"""Every example cell file is read, every driver has one, and each gives the configuration that it says."""

import re
from pathlib import Path
from typing import Any

import pytest

from cellcal.drivers.registry import GaugeConfig, ProbeConfig, RobotConfig, TrackerConfig
from cellcal.service.cli.app import run_command_line
from cellcal.service.configuration.cell_file import CellConfig, read_cell_file
from cellcal.service.runs.open_cell import offline_cell
from tests.driver_configs import models_of

EXAMPLES = sorted((Path(__file__).parents[2] / "deploy/example_cells").glob("*.toml"))


def configured_devices(config: CellConfig) -> list[Any]:
    placed = (*config.gauges, *config.trackers, *config.probes)
    return [*config.robots, *(entry.device for entry in placed)]


@pytest.mark.parametrize("path", EXAMPLES, ids=lambda path: path.stem)
def test_an_example_is_read_and_a_cell_is_made_of_it_on_paper(path: Path) -> None:
    config = read_cell_file(path)
    assert config.cell.data_dir.is_relative_to("/var/lib/cellcal")
    for robot in config.robots:
        cell = offline_cell(config, robot.name)
        assert cell.model.name == robot.model
        assert cell.limits.speed_rad_s == robot.speed_limit_rad_s
    for device in configured_devices(config):
        assert callable(device.open), device.name  # the model is the factory


def test_every_driver_has_an_example() -> None:
    shown = {type(device) for path in EXAMPLES for device in configured_devices(read_cell_file(path))}
    expected_names = set.union(
        *(models_of(union) for union in (RobotConfig, GaugeConfig, TrackerConfig, ProbeConfig))
    )
    assert len(expected_names) >= 8
    assert shown == expected_names


@pytest.mark.parametrize("path", EXAMPLES, ids=lambda path: path.stem)
def test_what_stands_in_comments_is_right_too(path: Path, tmp_path: Path) -> None:
    text = re.sub(
        r"^# (?=\[{1,2}[a-z._]+\]|[a-z_]+ = )", "", path.read_text(encoding="utf-8"), flags=re.MULTILINE
    )
    (tmp_path / path.name).write_text(text)
    config = read_cell_file(tmp_path / path.name)
    if path.stem == "fanuc_draw_wire":
        assert config.reports.metrics is not None
        assert config.reports.webhook is not None
        assert config.site is not None
        assert config.usual["fanuc"].keys() == {"six_point_tcp", "fixture_alignment"}
        assert config.gauges[0].setup.certificate is not None


def test_one_that_is_wrong_is_refused(tmp_path: Path) -> None:
    for path in EXAMPLES:
        broken = tmp_path / path.name
        broken.write_text(path.read_text(encoding="utf-8").replace('driver = "', 'driver = "x', 1))
        assert run_command_line(["check", str(broken)]) == 2


@pytest.mark.parametrize("path", EXAMPLES, ids=lambda path: path.stem)
def test_every_instrument_has_an_example_of_its_certificate(path: Path, tmp_path: Path) -> None:
    text = path.read_text(encoding="utf-8")
    described = re.sub(
        r"(?m)^# (?=\[\w+\.certificate\]|(?:number|laboratory|accreditation|issued|due|expanded_\w+) = )",
        "",
        text,
    )
    (tmp_path / path.name).write_text(described, encoding="utf-8")
    instruments = read_cell_file(tmp_path / path.name).instrument_entries
    missing = [entry.device.name for entry in instruments if entry.setup.certificate is None]
    assert not missing, missing
