"""cell.toml: every fault at once, with the key, and the nearest valid one."""

import re
from pathlib import Path

import pytest

from cellcal.procedures.catalogue import UnknownProcedureError, definition_named
from cellcal.service.configuration.cell_file import ConfigError, read_cell_file
from cellcal.service.demo.fake_cell import write_cell_file


@pytest.fixture
def good_cell_file(tmp_path: Path) -> Path:
    return write_cell_file(tmp_path, "127.0.0.9", seed=3, time_factor=50.0)


def faults_of(path: Path) -> dict[str, str]:
    with pytest.raises(ConfigError) as caught:
        read_cell_file(path)
    return dict(caught.value.faults)


def test_the_demo_cell_file_is_valid_and_gives_si(good_cell_file: Path) -> None:
    config = read_cell_file(good_cell_file)
    assert [robot.name for robot in config.robots] == ["fanuc", "ur"]
    gauge = config.gauge_for("fanuc")
    assert gauge is not None
    assert gauge.setup.anchor_in_base_m == pytest.approx((0.9, -0.7, -0.45))
    assert config.gauge_for("ur") is None
    assert len(config.sha256) == 64


def test_a_misspelt_key_names_the_nearest_valid_one(good_cell_file: Path) -> None:
    good_cell_file.write_text(good_cell_file.read_text().replace("speed_limit_rad_s", "speed_limt_rad_s"))
    faults = faults_of(good_cell_file)
    suggested_keys = [
        key for key, sentence in faults.items() if "did you mean 'speed_limit_rad_s'?" in sentence
    ]
    assert len(suggested_keys) == 2  # both robots, in one go


def test_all_faults_are_reported_at_once(good_cell_file: Path) -> None:
    text = (
        good_cell_file.read_text()
        .replace("node_id = 7", "node_id = 700")
        .replace("period_s = 0.2", "period_s = -1")
    )
    good_cell_file.write_text(
        text.replace('robot = "fanuc"', 'robot = "fanucc"') + "\n[wach]\nperiod_s = 1\n"
    )
    faults = faults_of(good_cell_file)
    assert any("node_id" in key for key in faults)
    assert any("period_s" in key for key in faults)
    assert "did you mean 'watch'?" in faults["wach"]


@pytest.mark.parametrize("number", ["nan", "inf", "-inf", "0.0", "true", '"0.5"'])
def test_no_nonsense_becomes_a_speed_limit(good_cell_file: Path, number: str) -> None:
    good_cell_file.write_text(
        good_cell_file.read_text().replace("speed_limit_rad_s = 0.5", f"speed_limit_rad_s = {number}")
    )
    assert any("speed_limit_rad_s" in key for key in faults_of(good_cell_file))


@pytest.mark.parametrize(
    ("key", "value"), [("range_m", "true"), ("range_m", '"1.3"'), ("sigma_m", "1e-300"), ("sigma_m", "nan")]
)
def test_no_nonsense_becomes_a_gauge(good_cell_file: Path, key: str, value: str) -> None:
    text, times = re.subn(rf"(?m)^{key} = .*$", f"{key} = {value}", good_cell_file.read_text(), count=1)
    assert times == 1
    good_cell_file.write_text(text)
    assert [path for path in faults_of(good_cell_file) if path.startswith("gauge[0]") and path.endswith(key)]


def test_a_gauge_on_a_robot_that_is_not_there_is_refused(good_cell_file: Path) -> None:
    good_cell_file.write_text(good_cell_file.read_text().replace('robot = "fanuc"', 'robot = "other"'))
    assert "which is not in this file" in faults_of(good_cell_file)["gauge wire"]


def test_two_devices_of_one_name_are_refused(good_cell_file: Path) -> None:
    good_cell_file.write_text(good_cell_file.read_text().replace('name = "ur"', 'name = "fanuc"'))
    assert "two devices" in faults_of(good_cell_file)["name"]


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


def test_an_unknown_driver_is_a_sentence(good_cell_file: Path) -> None:
    good_cell_file.write_text(
        good_cell_file.read_text().replace('driver = "modbus_robot"', 'driver = "modbus_robt"')
    )
    faults = faults_of(good_cell_file)
    assert any("modbus_robot" in sentence for sentence in faults.values())


PROBE = """
[[probe]]
name = "{name}"
driver = "touch_probe"
address = "127.0.0.9"
serial = "00:30:DE:01:02:03"
robot = "{robot}"
contact_input = 1
echo_output = 1
echo_input = {echo}
tip_in_flange_mm = [0.0, 0.0, 160.0]
tip_radius_mm = 1.5
sigma_mm = 0.003
overtravel_mm = 3.0
delay_ms = 6.0
delay_tolerance_ms = 3.0
"""


def test_a_probe_is_found_with_its_robot(good_cell_file: Path) -> None:
    good_cell_file.write_text(good_cell_file.read_text() + PROBE.format(name="probe", robot="fanuc", echo=2))
    (entry,) = read_cell_file(good_cell_file).probes_for("fanuc")
    assert entry.device.name == "probe"
    assert read_cell_file(good_cell_file).probes_for("ur") == ()


@pytest.mark.parametrize(
    ("tables", "sentence"),
    [
        (PROBE.format(name="probe", robot="other", echo=2), "which is not in this file"),
        (PROBE.format(name="probe", robot="fanuc", echo=1), "cannot be one input"),
        (
            PROBE.format(name="a", robot="ur", echo=2) + PROBE.format(name="b", robot="ur", echo=2),
            "two probes",
        ),
        (PROBE.format(name="p", robot="ur", echo=2).replace("echo_input", "#"), "go together"),
        (PROBE.format(name="p", robot="ur", echo=2).replace("00:30:DE", "WAGO"), "MAC-ID"),
        (PROBE.format(name="p", robot="ur", echo=2) + "axis_in_flange = [0.0, 0.0, 2.0]\n", "length 1"),
    ],
)
def test_a_probe_that_cannot_be_so_is_refused(good_cell_file: Path, tables: str, sentence: str) -> None:
    good_cell_file.write_text(good_cell_file.read_text() + tables)
    assert any(sentence in fault_text for fault_text in faults_of(good_cell_file).values())


def test_a_draw_wire_is_on_the_bus_that_its_interface_names(good_cell_file: Path) -> None:
    text = good_cell_file.read_text()
    start = text.index("[[gauge]]")
    gauge = """[[gauge]]
name = "wire"
driver = "draw_wire"
interface = "modbus"
host = "127.0.0.9"
serial = 815
step_um = 38.452
range_m = 3.0
sigma_m = 0.0002
robot = "fanuc"
anchor_in_base_mm = [900.0, -700.0, -450.0]
hook_in_flange_mm = [60.0, 50.0, 120.0]
"""
    good_cell_file.write_text(text[:start] + gauge)
    found = read_cell_file(good_cell_file).gauge_for("fanuc")
    assert found is not None
    assert found.device.interface == "modbus"
    good_cell_file.write_text(text[:start] + gauge.replace('"modbus"', '"profibus"'))
    assert "there is no interface 'profibus'; there are socketcand" in faults_of(good_cell_file)["gauge[0]"]
    good_cell_file.write_text(text[:start] + gauge.replace("step_um", "step_mm"))
    assert "did you mean 'step_um'?" in faults_of(good_cell_file)["gauge[0].step_mm"]


def test_an_anchor_in_metres_is_refused(good_cell_file: Path) -> None:
    text = good_cell_file.read_text()
    assert "anchor_in_base_mm = [900.0, -700.0, -450.0]" in text
    good_cell_file.write_text(text.replace("[900.0, -700.0, -450.0]", "[0.9, -0.7, -0.45]", 1))
    faults = " ".join(faults_of(good_cell_file).values())
    assert "metres written where millimetres belong?" in faults


def test_a_robot_on_a_wall_is_a_model_with_its_mounting(good_cell_file: Path) -> None:
    text = good_cell_file.read_text()
    model = next(robot.model for robot in read_cell_file(good_cell_file).robots if robot.name == "ur")
    good_cell_file.write_text(text.replace(f'model = "{model}"', f'model = "{model}@wall"'))
    assert read_cell_file(good_cell_file).robot_named("ur").model == f"{model}@wall"
    good_cell_file.write_text(text.replace(f'model = "{model}"', f'model = "{model}@shelf"'))
    assert any("no robot model" in sentence for sentence in faults_of(good_cell_file).values())


def test_a_model_with_another_number_of_axes_is_refused(good_cell_file: Path) -> None:
    text = good_cell_file.read_text().replace('"fanuc_m6ib"', '"kuka_lbr_iiwa7_r800"')
    good_cell_file.write_text(text)
    found = faults_of(good_cell_file)["robot[0].model"]
    assert found == "kuka_lbr_iiwa7_r800 has 7 axes, and 6 are read of this controller"


def test_a_table_that_is_like_none_is_answered_with_all_that_are_valid(good_cell_file: Path) -> None:
    good_cell_file.write_text(good_cell_file.read_text() + "\n[foo]\na = 1\n")
    assert "valid here: cell," in faults_of(good_cell_file)["foo"]


def test_a_cell_file_in_place_of_a_procedure_is_answered_with_its_option() -> None:
    with pytest.raises(UnknownProcedureError) as refused:
        definition_named("cells/my cell.toml")
    assert '`--cell "cells/my cell.toml"`' in refused.value.remedy
    with pytest.raises(UnknownProcedureError) as refused:
        definition_named("zzz")
    assert "drift_check" in refused.value.remedy
