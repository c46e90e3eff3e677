"""The factory calibration that the fake tells, read and understood by the product."""

import math

import numpy as np
import pytest

from cellcal.calibration.arm.kinematics import load_model
from cellcal.calibration.arm.ur_factory import factory_model
from cellcal.drivers.universal_robots.config import UniversalRobotConfig
from cellcal.drivers.universal_robots.factory_calibration import FactoryKinematics
from cellcal.fake_devices.arm_models import MODELS
from cellcal.fake_devices.kinematics import flange_poses
from cellcal.fake_devices.universal_robots.device import FakeUniversalRobot
from tests.machine_speed import stretched_s
from tests.wire.fake_ur import fake_ur

SEEDS = range(10)
E_SERIES = sorted(name for name in MODELS if name.startswith("ur") and name.endswith("e"))
CB3 = sorted(name for name in MODELS if name in ("ur3", "ur5", "ur10"))
UR_SERIES = sorted(name for name in MODELS if name in ("ur20", "ur30"))
SOFTWARE = (
    dict.fromkeys(E_SERIES, "5.11.1") | dict.fromkeys(CB3, "3.15.8") | dict.fromkeys(UR_SERIES, "5.15.2")
)
DEADLINE_S = min(stretched_s(10.0), 60.0)  # what a cell file takes
NEAR_RAD = math.radians(1.0)


def test_every_universal_robot_that_can_be_played_is_among_them() -> None:
    assert {"ur3e", "ur5e", "ur10e", "ur16e"} <= set(E_SERIES)
    assert {"ur3", "ur5", "ur10"} <= set(CB3)
    assert {"ur20", "ur30"} <= set(UR_SERIES)


@pytest.mark.parametrize("model", SOFTWARE)
async def test_the_driver_reads_a_table_of_the_arm_that_the_controller_believes_in(model: str) -> None:
    for seed in SEEDS:
        async with fake_ur(model=model, seed=seed, settings={"software": SOFTWARE[model]}) as fake:
            config = UniversalRobotConfig(
                driver="universal_robots",
                name="ur",
                address=fake.server.address,
                model=model,
                serial="20225500042",
                deadline_s=DEADLINE_S,
            )
            async with config.open() as robot:
                assert_belongs(await robot.factory_kinematics(), fake, model, seed)


def assert_belongs(found: FactoryKinematics, fake: FakeUniversalRobot, model: str, seed: int) -> None:
    """Check that a table looks like a real controller's, is accepted, and is the believed arm."""
    nominal = load_model(model)
    assert nominal.dh is not None
    assert found.alpha_rad == pytest.approx(tuple(nominal.dh.alpha_rad), abs=NEAR_RAD)
    far = (found.theta_rad[0], sum(found.theta_rad[1:4]), *found.theta_rad[4:])
    assert [math.remainder(angle, 2.0 * math.pi) for angle in far] == pytest.approx([0.0] * 4, abs=NEAR_RAD)
    assert max(map(abs, found.d_m)) > 5.0  # distant common normals, as in real tables
    arm = factory_model(nominal, found.to_table())
    joints = np.random.default_rng(seed).uniform(-2.0 * math.pi, 2.0 * math.pi, (20, 6))
    believed = flange_poses(np.array(fake.true_state()["known_dh"]), joints)
    assert arm.base_flange(joints) == pytest.approx(believed, abs=1e-9)
