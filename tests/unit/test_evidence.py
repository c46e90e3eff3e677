"""What stands behind each ability is written down for every kind of controller, and agrees with the drivers."""

from pathlib import Path

import pytest

from cellcal.drivers.modbus_robot import robot as modbus_robot
from cellcal.drivers.modbus_robot.profile import load_profile, profile_names
from cellcal.drivers.registry import RobotConfig
from cellcal.drivers.universal_robots import robot_connection
from cellcal.drivers.wire.evidence import NOT_CONFIRMED, driver_evidence
from cellcal.service.cli.app import run_command_line
from deploy.evidence_table import PAGE, evidence_table
from tests.driver_configs import models_of
from tests.wire.fake_devices_process import run_fakes
from tests.wire.tp_cell import TP_CELL

VERIFIED = {"modbus_robot": modbus_robot.VERIFIED_ON, "universal_robots": robot_connection.VERIFIED_ON}
BRANDS = sorted({model.__module__.split(".")[2] for model in models_of(RobotConfig)})
PROFILES = {
    "modbus_robot": profile_names(),
    "universal_robots": ("polyscope", "cb3"),
    "fanuc": ("", "fanuc_rmi"),
}
KINDS = [(brand, profile) for brand in BRANDS for profile in PROFILES.get(brand, ("",))]


@pytest.mark.parametrize(("driver", "profile"), KINDS)
def test_every_kind_of_controller_says_what_stands_behind_it(driver: str, profile: str) -> None:
    rows = driver_evidence(driver, profile)
    assert rows
    for row in rows:
        assert all((row.ability, row.document, row.client, row.robot))
        if not VERIFIED.get(driver, ()):
            assert row.robot == NOT_CONFIRMED  # the driver itself says that it has run on no robot


def test_the_set_up_page_shows_the_same() -> None:
    assert PAGE.read_text(encoding="utf-8").endswith("\n" + evidence_table()), "make types writes it"


def test_what_is_not_offered_says_so() -> None:
    abilities = load_profile("fanuc_tp").abilities
    assert not abilities.jogs_single_axes
    assert not abilities.writes_mastering
    texts = {row.ability: row.document for row in driver_evidence("modbus_robot", "fanuc_tp")}
    assert texts["write mastering"] == texts["move an axis without mastering"] == "none: not offered"


def test_the_first_screen_of_check_shows_it(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with run_fakes(tmp_path, TP_CELL) as (path, _):
        assert run_command_line(["check", str(path)]) == 0
    text = " ".join(capsys.readouterr().err.split())
    assert "fanuc: 0 of 9 abilities are confirmed on a robot." in text
    assert "confirmed by an" in text
