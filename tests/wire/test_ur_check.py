"""What `cellcal check` says of Universal Robots of every generation: who answers, what is open, what stands behind it."""

import json
from pathlib import Path

import pytest

from cellcal.service.cli.app import run_command_line
from tests.machine_speed import stretched_s
from tests.wire.fake_devices_process import run_fakes

pytestmark = pytest.mark.timeout(stretched_s(120.0))

CELL = """\
[cell]
name = "three generations"
data_dir = "{folder}"

[[robot]]
name = "new"
driver = "universal_robots"
address = "{address}"
robot_api_port = 8089
model = "ur10e"
serial = "20235500043"
deadline_s = 2.0
calibration = ""

[[robot]]
name = "old"
driver = "universal_robots"
address = "{second_address}"
model = "ur5"
serial = "20123000001"
deadline_s = 2.0

[fake]
seed = 1
time_factor = {time_factor}
control_port = 0

[fake.robots.new]
software = "10.12.1.0"
"""


def test_the_check_says_what_could_not_be_told_apart(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with run_fakes(tmp_path, CELL) as (path, _):
        assert run_command_line(["check", str(path), "--json"]) == 0
        found = {device["name"]: device for device in json.loads(capsys.readouterr().out)["devices"]}
        new, old = found["new"]["message"], found["old"]["message"]
        assert "Universal Robots ur10e, serial 20235500043, 10.12.1.0." in new
        assert "does not tell a ur10e from a ur12e: compare the label on the arm." in new
        assert "does not tell a serial number" in new
        assert old == "Universal Robots ur5, serial 20123000001, 3.15.8.106339."
        assert {row["ability"] for row in found["old"]["evidence"]} >= {"move"}
        assert "move, stop" not in {row["ability"] for row in found["old"]["evidence"]}
        calibration = new.partition('calibration = "')[2].partition('"')[0]
        path.write_text(path.read_text().replace('calibration = ""', f'calibration = "{calibration}"'))
        assert run_command_line(["check", str(path), "--json"]) == 0
        (new_again,) = [d for d in json.loads(capsys.readouterr().out)["devices"] if d["name"] == "new"]
        assert "serial number" not in new_again["message"]
        path.write_text(path.read_text().replace(calibration, "calib_1"))
        assert run_command_line(["check", str(path), "--json"]) != 0
        (stranger,) = [d for d in json.loads(capsys.readouterr().out)["devices"] if d["name"] == "new"]
        assert calibration in stranger["message"]
        assert stranger["remedy"]
