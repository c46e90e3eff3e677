"""An arm that the catalogue lacks: its model file comes from its own controller, and the driver takes it with that."""

import asyncio
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pydantic import ValidationError

from cellcal.calibration.arm.kinematics import MODEL_TOLERANCE_M, load_model
from cellcal.calibration.arm.model_references import fixed_reference
from cellcal.calibration.arm.ur_factory import factory_model
from cellcal.calibration.errors import CalibrationError
from cellcal.drivers.errors import WrongDeviceError
from cellcal.drivers.universal_robots import factory_calibration
from cellcal.drivers.universal_robots.config import UniversalRobotConfig
from cellcal.drivers.universal_robots.factory_calibration import (
    ControllerArm,
    FactoryKinematics,
    read_controller_arm,
)
from cellcal.procedures.steps.mastering import model_error_m
from cellcal.service.cli.app import run_command_line
from cellcal.service.engineering.parameters.ur_model_file import ur_model_text
from cellcal.service.exit_codes import ExitCode
from tests.machine_speed import stretched_s
from tests.wire.fake_ur import ROBOT_API_PORT, fake_ur
from tests.wire.test_universal_robots_driver import FAST, config_of

pytestmark = pytest.mark.timeout(stretched_s(120.0))

DEADLINE_S = stretched_s(10.0)
LACKING = ["ur7e", "ur8long", "ur12e", "ur15", "ur18"]
LENGTHS = {"ur7e": "ur5e", "ur8long": "ur20", "ur12e": "ur10e", "ur15": "ur30", "ur18": "ur3e"}


def settings_of(arm: str) -> dict[str, Any]:
    return {"software": "10.12.1", "arm": LENGTHS[arm]}


async def write_file(address: str, arm: str, path: Path) -> int:
    words = ["ur-model", address, "--arm", arm, "--out", str(path), "--timeout", str(DEADLINE_S)]
    return await asyncio.to_thread(run_command_line, words)


@pytest.mark.parametrize("arm", LACKING)
def test_an_arm_without_public_kinematics_says_where_they_come_from(arm: str) -> None:
    with pytest.raises(ValidationError, match=f"cellcal ur-model 10.0.0.7 --arm {arm}"):
        UniversalRobotConfig(
            driver="universal_robots", name="ur", address="10.0.0.7", model=arm, serial="20225500042"
        )


@pytest.mark.parametrize("arm", LACKING)
async def test_the_file_of_its_controller_carries_it_through_connect_check_and_a_move(
    arm: str, tmp_path: Path
) -> None:
    path = tmp_path / f"{arm}.toml"
    async with fake_ur(model=arm, settings=settings_of(arm)) as fake:
        assert await write_file(fake.server.address, arm, path) == 0
        model = load_model(str(path))
        truth = load_model(LENGTHS[arm])
        joints = np.random.default_rng(1).uniform(-3.0, 3.0, (20, 6))
        assert model.base_flange(joints) == pytest.approx(truth.base_flange(joints), abs=1e-8)
        assert model.upper_rad == pytest.approx(np.full(6, 2.0 * np.pi), abs=1e-6)
        config = config_of(
            fake,
            model=fixed_reference(path.name, tmp_path),
            arm_type=arm,
            robot_api_port=ROBOT_API_PORT,
        )
        async with config.open() as robot:
            assert (await robot.identify()).model == arm
            reading, pose = await robot.read_joints(), await robot.flange_pose()
            assert model_error_m(model, reading.joints_rad, pose) < MODEL_TOLERANCE_M
            factory = factory_model(model, (await robot.factory_kinematics()).to_table())
            at_flange = factory.base_flange(np.array([reading.joints_rad]))[0]
            assert pose.to_matrix() == pytest.approx(at_flange, abs=1e-9)
            target = (reading.joints_rad[0] + 0.05, *reading.joints_rad[1:])
            await robot.move_joints(target, speed_rad_s=FAST)
            assert (await robot.read_joints()).joints_rad == pytest.approx(target, abs=1e-3)


async def test_another_arm_gets_no_file(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "arm.toml"
    async with fake_ur(model="ur15", settings=settings_of("ur15")) as fake:
        assert await write_file(fake.server.address, "ur18", path) != 0
        assert "type code 9" in " ".join(capsys.readouterr().err.split())
        assert await write_file(fake.server.address, "ur99", path) == ExitCode.USAGE
        assert not path.exists()
        path.write_text("mine")
        assert await write_file(fake.server.address, "ur15", path) == ExitCode.USAGE
        assert path.read_text() == "mine"


async def test_a_factory_table_of_another_drawing_gets_no_file() -> None:
    async with (
        fake_ur(model="ur15", settings=settings_of("ur15")) as one,
        fake_ur(model="ur15", settings={"arm": "ur20", "software": "10.12.1"}) as other,
    ):
        ours, theirs = [
            await read_controller_arm("ur", fake.server.address, deadline_s=DEADLINE_S)
            for fake in (one, other)
        ]
    mixed = type(ours)(
        ours.type_code, ours.nominal, ours.lower_rad, ours.upper_rad, ours.max_speed_rad_s, theirs.factory
    )
    assert ur_model_text(ours, "ur15", "here")
    with pytest.raises(CalibrationError, match="does not belong"):
        ur_model_text(mixed, "ur15", "here")


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        ({"lower_rad": (-360.0,) * 6, "upper_rad": (360.0,) * 6}, "limits of -20626 to 20626 deg of joint 1"),
        (
            {"lower_rad": (2.0, *(-2.0,) * 5), "upper_rad": (1.0, *(2.0,) * 5)},
            "limits of 114.59 to 57.296 deg of joint 1",
        ),
        ({"max_speed_rad_s": (2.0, 2.0, 0.0, 2.0, 2.0, 2.0)}, "a speed of 0 deg/s of joint 3"),
        ({"max_speed_rad_s": (180.0,) * 6}, "a speed of 10313 deg/s"),
    ],
)
async def test_limits_and_speeds_of_no_arm_get_no_file(changes: dict[str, Any], says: str) -> None:
    arm = load_model("ur5e")
    assert arm.dh is not None
    columns: list[Any] = [tuple(column) for column in arm.dh.to_rows()[:, [0, 2, 1, 3]].T]
    theta, a, d, alpha = columns
    zeros = FactoryKinematics(theta, a, d, alpha, (0,) * 6, 2)
    told = ControllerArm(9, arm.dh, (-6.28,) * 6, (6.28,) * 6, (3.0,) * 6, zeros)
    assert ur_model_text(
        replace(told, lower_rad=(*(-6.28,) * 5, -360.0)), "ur15", "here"
    )  # the last may be endless
    with pytest.raises(CalibrationError, match=says):
        ur_model_text(replace(told, **changes), "ur15", "here")


async def test_a_calibration_that_is_not_linearised_is_said(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    async with fake_ur(model="ur15", settings=settings_of("ur15")) as fake:
        told = await read_controller_arm("ur", fake.server.address, deadline_s=DEADLINE_S)

    async def read_unmeasured(*_: object, **__: object) -> ControllerArm:
        return replace(told, factory=replace(told.factory, status=0))

    monkeypatch.setattr(factory_calibration, "read_controller_arm", read_unmeasured)
    assert await write_file("10.0.0.7", "ur15", tmp_path / "arm.toml") == 0
    text = " ".join(capsys.readouterr().err.split())
    assert "not linearised (status 0)" in text
    assert 'calibration = "' not in text


async def test_a_file_does_not_make_a_stranger_the_robot(tmp_path: Path) -> None:
    path = tmp_path / "ur15.toml"
    async with fake_ur(model="ur15", settings=settings_of("ur15")) as fake:
        assert await write_file(fake.server.address, "ur15", path) == 0
    async with fake_ur(model="ur18", settings=settings_of("ur18")) as fake:
        config = config_of(fake, model=str(path), arm_type="ur15", robot_api_port=ROBOT_API_PORT)
        with pytest.raises(WrongDeviceError, match="answers a ur18"):
            async with config.open():
                pytest.fail("a stranger was let in")


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        ({"model": "arms/mine.toml"}, "arm_type names the arm"),
        ({"model": "arms/mine.toml", "arm_type": "ur99"}, "arm_type names the arm"),
        ({"model": "ur10e", "arm_type": "ur12e"}, "model says ur10e and arm_type says ur12e"),
        ({"model": "kuka_kr10r1420"}, "does not know a 'kuka_kr10r1420'"),
        ({"model": "ur10e", "calibration": "calib_x"}, "calibration"),
        ({"model": "ur10e", "robot_api_port": 0}, "robot_api_port"),
    ],
)
def test_an_entry_that_names_no_arm_is_refused(changes: dict[str, Any], says: str) -> None:
    entry = {"driver": "universal_robots", "name": "ur", "address": "10.0.0.7", "serial": "1", **changes}
    with pytest.raises(ValidationError, match=says):
        UniversalRobotConfig(**entry)


@pytest.mark.parametrize("mounting", ["", "@wall"])
def test_a_mounting_does_not_change_the_arm(mounting: str) -> None:
    config = UniversalRobotConfig(
        driver="universal_robots", name="ur", address="10.0.0.7", serial="1", model=f"ur10{mounting}"
    )
    assert config.arm == "ur10"
    assert not config.capabilities.moves_joints
