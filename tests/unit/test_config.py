"""cell.toml: every fault at once, with the key, and the nearest valid one."""

from pathlib import Path

import pytest

from service.config import ConfigError, read_cell_file
from service.demo.fake_cell import write_cell_file


@pytest.fixture
def good(tmp_path: Path) -> Path:
    return write_cell_file(tmp_path, "127.0.0.9", seed=3, time_factor=50.0)


def faults_of(path: Path) -> dict[str, str]:
    with pytest.raises(ConfigError) as caught:
        read_cell_file(path)
    return dict(caught.value.faults)


def test_the_demo_cell_file_is_valid_and_gives_si(good: Path) -> None:
    config = read_cell_file(good)
    assert [robot.name for robot in config.robots] == ["fanuc", "ur"]
    gauge = config.gauge_for("fanuc")
    assert gauge is not None
    assert gauge.setup.anchor_in_base_m == pytest.approx((0.9, -0.7, -0.45))
    assert config.gauge_for("ur") is None
    assert len(config.sha256) == 64


def test_a_misspelt_key_names_the_nearest_valid_one(good: Path) -> None:
    good.write_text(good.read_text().replace("speed_limit_rad_s", "speed_limt_rad_s"))
    faults = faults_of(good)
    told = [key for key, sentence in faults.items() if "did you mean 'speed_limit_rad_s'?" in sentence]
    assert len(told) == 2  # both robots, in one go


def test_all_faults_are_reported_at_once(good: Path) -> None:
    text = good.read_text().replace("node_id = 7", "node_id = 700").replace("period_s = 0.2", "period_s = -1")
    good.write_text(text.replace('robot = "fanuc"', 'robot = "fanucc"') + "\n[wach]\nperiod_s = 1\n")
    faults = faults_of(good)
    assert any("node_id" in key for key in faults)
    assert any("period_s" in key for key in faults)
    assert "did you mean 'watch'?" in faults["wach"]


@pytest.mark.parametrize("number", ["nan", "inf", "-inf", "0.0", "true", '"0.5"'])
def test_no_nonsense_becomes_a_speed_limit(good: Path, number: str) -> None:
    good.write_text(good.read_text().replace("speed_limit_rad_s = 0.5", f"speed_limit_rad_s = {number}"))
    assert any("speed_limit_rad_s" in key for key in faults_of(good))


def test_a_gauge_on_a_robot_that_is_not_there_is_refused(good: Path) -> None:
    good.write_text(good.read_text().replace('robot = "fanuc"', 'robot = "other"'))
    assert "which is not in this file" in faults_of(good)["gauge wire"]


def test_two_devices_of_one_name_are_refused(good: Path) -> None:
    good.write_text(good.read_text().replace('name = "ur"', 'name = "fanuc"'))
    assert "two devices" in faults_of(good)["name"]


@pytest.mark.parametrize(
    ("content", "says"),
    [
        (b"[cell", "not valid TOML"),
        (b"\xff\xfe\x00", "cannot be read"),
        (b"", "at least one"),
        (b'robot = "x"', "written as [[robot]]"),
    ],
)
def test_a_file_that_is_no_cell_says_why(tmp_path: Path, content: bytes, says: str) -> None:
    path = tmp_path / "cell.toml"
    path.write_bytes(content)
    assert any(says in sentence for sentence in faults_of(path).values())


def test_a_missing_file_says_so(tmp_path: Path) -> None:
    assert faults_of(tmp_path / "none.toml") == {"file": "there is no such file"}


def test_an_unknown_driver_is_a_sentence(good: Path) -> None:
    good.write_text(good.read_text().replace('driver = "modbus_robot"', 'driver = "modbus_robt"'))
    faults = faults_of(good)
    assert any("modbus_robot" in sentence for sentence in faults.values())
