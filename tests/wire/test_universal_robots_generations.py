"""The UR driver against controllers of every generation: who answers, CB3, and PolyScope X without a dashboard."""

import os
import signal
from typing import Any

import numpy as np
import pytest

from cellcal.calibration.arm.kinematics import RobotModel
from cellcal.drivers.errors import (
    DeviceError,
    RefusedError,
    UnreachableError,
    WireProtocolError,
    WrongDeviceError,
)
from cellcal.drivers.interfaces import DoubtsIdentity, Readiness
from cellcal.fake_devices.universal_robots.device import FakeUniversalRobot
from tests.machine_speed import stretched_s
from tests.wire.driver_cases import until_ready
from tests.wire.fake_ur import ROBOT_API_PORT, fake_ur
from tests.wire.test_universal_robots_driver import (
    AWAY,
    FAST,
    child_of,
    config_of,
    failure_of,
    long_move,
    wait_until,
    works_again,
)

pytestmark = pytest.mark.timeout(stretched_s(120.0))

X, EARLY_X = {"software": "10.12.1.0"}, {"software": "10.11.0.0"}


def x_config(fake: FakeUniversalRobot, **changes: Any) -> Any:
    return config_of(fake, robot_api_port=ROBOT_API_PORT, **changes)


# who answers


@pytest.mark.parametrize(
    ("model", "settings", "told_apart"),
    [
        ("ur3e", {}, True),
        ("ur5e", {}, True),
        ("ur5e", {"software": "5.25.0"}, False),
        ("ur10e", {"software": "5.25.0"}, False),
        ("ur16e", {"software": "5.25.0"}, True),
        ("ur20", {"software": "5.14.0"}, True),
        ("ur30", {"software": "5.15.0"}, True),
        ("ur3", {}, True),
        ("ur5", {}, True),
        ("ur10", {}, True),
    ],
)
async def test_an_arm_is_the_one_of_the_cell_file_and_what_is_open_is_said(
    model: str, settings: dict[str, Any], told_apart: bool
) -> None:
    async with fake_ur(model=model, settings=settings) as fake, config_of(fake, model=model).open() as robot:
        assert (await robot.identify()).model == model
        assert isinstance(robot, DoubtsIdentity)
        assert ((await robot.identity_doubts()) == "") is told_apart


@pytest.mark.parametrize(
    ("settings", "says"),
    [
        ({"software": "5.25.0", "dashboard_model": "UR7"}, "answers a ur7e"),
        ({"software": "5.25.0", "type_code": 2}, "fit no arm"),
        ({"software": "5.25.0", "type_code": 9, "dashboard_model": "UR15"}, "answers a ur15"),
        ({"software": "5.25.0", "type_code": 6, "dashboard_model": "UR8LONG"}, "answers a ur8long"),
        ({"software": "5.25.0", "type_code": 5, "dashboard_model": "UR18"}, "answers a ur18"),
        ({"software": "10.12.0", "type_code": 2}, "answers a ur10e / ur12e"),
        ({"software": "3.15.0"}, "answers a ur5 "),
    ],
)
async def test_an_arm_that_is_surely_another_one_is_refused(settings: dict[str, Any], says: str) -> None:
    async with fake_ur(model="ur5e", settings=settings) as fake:
        with pytest.raises(WrongDeviceError, match=says) as refused:
            async with x_config(fake, model="ur5e").open():
                pytest.fail("a stranger was let in")
        assert "label" in refused.value.remedy


@pytest.mark.parametrize("software", ["3.11.0", "5.5.0", "10.10.0", "11.0.0"])
async def test_other_software_is_refused(software: str) -> None:
    async with fake_ur(settings={"software": software}) as fake:
        with pytest.raises(RefusedError, match="does not know") as refused:
            async with x_config(fake).open():
                pytest.fail("unknown software was let in")
        assert "PolyScope X to 10.11" in refused.value.remedy


async def test_an_arm_of_another_factory_calibration_is_refused() -> None:
    async with fake_ur(settings=X) as fake:
        async with x_config(fake).open() as robot:
            name = (await robot.factory_kinematics()).name
            assert name in await robot.identity_doubts()
        async with x_config(fake, calibration=name, model="ur10e").open() as robot:
            assert name not in await robot.identity_doubts()
        with pytest.raises(WrongDeviceError, match="calib_1234"):
            async with x_config(fake, calibration="calib_1234").open():
                pytest.fail("a stranger was let in")


async def test_polyscope_x_from_10_14_on_proves_serial_number_and_model() -> None:
    newer = {"software": "10.14.0.0"}
    async with fake_ur(model="ur5e", settings=newer) as fake:
        async with x_config(fake, model="ur5e").open() as robot:
            doubts = await robot.identity_doubts()
            assert "serial" not in doubts
            assert "ur7e" in doubts  # the name UR5 may be that of a UR7e
        with pytest.raises(WrongDeviceError, match="20225500042"):
            async with x_config(fake, model="ur5e", serial="20235511111").open():
                pytest.fail("a stranger was let in")
    async with fake_ur(model="ur5e", settings=newer | {"dashboard_model": "UR7"}) as fake:
        with pytest.raises(WrongDeviceError, match="answers a ur7e"):
            async with x_config(fake, model="ur5e").open():
                pytest.fail("a stranger was let in")


async def test_a_port_30001_that_is_blocked_says_so() -> None:
    async with fake_ur() as fake:
        fake.server.ports[30001].silent = True
        with pytest.raises(UnreachableError, match="primary interface") as refused:
            async with config_of(fake).open():
                pytest.fail("an arm of unknown type was let in")
        assert "30001" in refused.value.remedy


# CB3


async def test_a_cb3_is_read_and_never_moved() -> None:
    async with fake_ur(model="ur10") as fake, config_of(fake, model="ur10").open() as robot:
        assert not robot.capabilities.moves_joints
        believed = fake.true_state()["controller_joints_rad"]
        assert (await robot.read_joints()).joints_rad == pytest.approx(believed, abs=1e-9)
        assert (await robot.read_condition()).readiness is Readiness.READY
        model = RobotModel.from_dh((await robot.factory_kinematics()).to_table(), name="as measured")
        at_flange = model.base_flange(np.array([believed]))[0]
        assert (await robot.flange_pose()).to_matrix() == pytest.approx(at_flange, abs=1e-9)
        assert (await robot.active_frames()).payload_kg == 0.0
        failure = await failure_of(robot.move_joints(AWAY, speed_rad_s=FAST))
        assert isinstance(failure, RefusedError)
        assert "only read" in str(failure)
        assert "by hand" in failure.remedy
        assert fake.true_state()["connections"]["30003"] == 0
        await fake.inject_fault("protective_stop", {})
        assert (await until_ready(robot, Readiness.STOPPED)).remedy


async def test_a_program_that_moves_a_cb3_can_be_stopped() -> None:
    async with fake_ur(model="ur10") as fake, config_of(fake, model="ur10").open() as robot:
        await fake.inject_fault("other_client_moves", {"axis": "J1", "rad": 2.0, "speed": 0.2})
        await wait_until(lambda: fake.true_state()["moving"])
        await robot.stop()
        assert not fake.true_state()["moving"]
        assert fake.true_state()["program"] is None


# PolyScope X


@pytest.mark.parametrize("cut", ["api_refuses", ""])
async def test_stop_reaches_an_arm_on_x_while_the_child_hangs(cut: str) -> None:
    async with fake_ur(settings=X) as fake, x_config(fake).open() as robot, long_move(robot, fake) as move:
        if cut:  # the program ends by its own watchdog all the same
            await fake.inject_fault(cut, {})
        os.kill(child_of(robot), signal.SIGSTOP)
        await robot.stop()
        assert not fake.true_state()["moving"]
        assert fake.true_state()["runtime"] == "STOPPED"
        await failure_of(move)


async def test_a_foreign_program_that_x_refuses_to_stop_is_an_error() -> None:
    async with fake_ur(settings=X) as fake, x_config(fake).open() as robot:
        await fake.inject_fault("other_client_moves", {"axis": "J1", "rad": 2.0, "speed": 0.01})
        await fake.inject_fault("api_refuses", {})
        failure = await failure_of(robot.stop())
        assert "status 500" in str(failure)
        assert "pendant" in failure.remedy
        fake.clear_faults()
        await robot.stop()
        assert fake.true_state()["program"] is None


@pytest.mark.parametrize(("fault", "says"), [("local_mode", "Local"), ("manual_mode", "manual")])
async def test_an_arm_on_x_is_not_moved_unless_a_person_has_handed_it_over(fault: str, says: str) -> None:
    async with fake_ur(settings=X) as fake, x_config(fake).open() as robot:
        assert await robot.controller_mode() == "remote control, automatic"
        await works_again(robot, fake)
        await fake.inject_fault(fault, {})
        before = fake.true_state()["controller_joints_rad"]
        failure = await failure_of(robot.move_joints(AWAY, speed_rad_s=FAST))
        assert isinstance(failure, RefusedError)
        assert says in str(failure)
        assert fake.true_state()["controller_joints_rad"] == pytest.approx(before)


async def test_the_first_robot_api_tells_no_mode_so_the_arm_is_only_read() -> None:
    async with fake_ur(settings=EARLY_X) as fake, x_config(fake).open() as robot:
        assert (await robot.read_joints()).joints_rad
        assert (await robot.read_condition()).readiness is Readiness.NOT_READY
        for work in (robot.move_joints(AWAY, speed_rad_s=FAST), robot.controller_mode()):
            failure = await failure_of(work)
            assert isinstance(failure, RefusedError)
            assert "10.12" in failure.remedy
        assert fake.true_state()["program"] is None


async def test_redirects_are_followed() -> None:
    async with fake_ur(settings=X) as fake, x_config(fake).open() as robot:
        await fake.inject_fault("api_moved", {})
        assert await robot.controller_mode() == "remote control, automatic"
        await fake.inject_fault("other_client_moves", {"axis": "J1", "rad": 2.0, "speed": 0.2})
        await robot.stop()
        assert fake.true_state()["program"] is None


@pytest.mark.parametrize(
    "text",
    [
        "not JSON",
        "",
        "[]",
        '{"mode": 3}',
        '{"mode": ""}',
        '{"mode": "SERVICE"}',
        "\ud800".encode("utf-8", "surrogatepass").decode("latin-1"),
    ],
)
async def test_an_answer_that_is_none_is_no_permission(text: str) -> None:
    async with fake_ur(settings=X) as fake, x_config(fake).open() as robot:
        await fake.inject_fault("api_nonsense", {"text": text})
        failure = await failure_of(robot.move_joints(AWAY, speed_rad_s=FAST))
        assert isinstance(failure, WireProtocolError)
        assert fake.true_state()["program"] is None


@pytest.mark.parametrize("fault", ["silent", "closed"])
async def test_a_robot_api_that_does_not_answer_is_reported(fault: str) -> None:
    async with fake_ur(settings=X) as fake:
        port = fake.server.ports[ROBOT_API_PORT]
        port.silent = True
        if fault == "closed":
            await port.close()
        with pytest.raises(DeviceError, match="Robot API") as refused:
            async with x_config(fake).open():
                pytest.fail("a controller without its second path to the arm was let in")
        assert "Robot API" in refused.value.remedy
