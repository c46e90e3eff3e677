"""What `cellcal check` says of Universal Robots of every generation: who answers, what is open, what stands behind it."""

import json
from pathlib import Path

import pytest

from cellcal.procedures.catalogue import definition_named, missing_needs
from cellcal.service.cli.app import run_command_line
from cellcal.service.configuration.cell_file import read_cell_file
from cellcal.service.runs.open_cell import offline_cell
from tests.cell_tables import cell_head, fake_table, fill_in, write_table
from tests.machine_speed import stretched_s
from tests.wire.fake_devices_process import TIME_FACTOR, run_fakes

pytestmark = pytest.mark.timeout(stretched_s(120.0))

CELL = "".join(
    (
        cell_head("three generations"),
        write_table(
            "robot",
            name="new",
            driver="universal_robots",
            address="{address}",
            robot_api_port=8089,
            model="ur10e",
            serial="20235500043",
            deadline_s=2.0,
            calibration="",
        ),
        write_table(
            "robot",
            name="old",
            driver="universal_robots",
            address="{second_address}",
            model="ur5",
            serial="20123000001",
            deadline_s=2.0,
        ),
        fake_table(time_factor=TIME_FACTOR),
        write_table("fake.robots.new", software="10.12.1.0"),
    )
)


def test_the_check_says_what_could_not_be_distinguished(
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


@pytest.mark.parametrize(("motion", "offered"), [("observe", True), ("program", True), ("commanded", False)])
def test_a_robot_that_is_only_read_is_moved_by_a_person_or_not_at_all(
    tmp_path: Path, motion: str, offered: bool
) -> None:
    text = fill_in(CELL, folder=str(tmp_path), address="10.0.0.7", second_address="10.0.0.8")
    path = tmp_path / "cell.toml"
    path.write_text(text.replace('model = "ur5"', f'model = "ur5"\nmotion = "{motion}"'))
    cell = offline_cell(read_cell_file(path), "old")
    lacks = missing_needs(definition_named("drift_check"), cell)
    assert ("a robot that moves on command" not in lacks) is offered
