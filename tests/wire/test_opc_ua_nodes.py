"""Which nodes of an OPC UA server are the robot: several devices, missing nodes, restarts, reordered namespaces."""

import pytest

from cellcal.drivers.errors import RefusedError, UnreachableError, WrongDeviceError
from cellcal.drivers.interfaces import Readiness
from tests.machine_speed import stretched_s
from tests.wire.opc_ua_server import (
    POSITION,
    SERIAL,
    believed,
    config_of,
    failure_of,
    failure_of_opening,
    fake_server,
    reads_again,
)

pytestmark = pytest.mark.timeout(stretched_s(60.0))


# which nodes


async def test_several_motion_devices_need_a_name() -> None:
    async with fake_server({"devices": ["Arm", "Positioner"]}) as fake:
        failure = await failure_of_opening(config_of(fake))
        assert "System/Arm, System/Positioner" in str(failure)
        assert "motion_device" in failure.remedy
        for name in ("Arm", "System/Arm"):
            async with config_of(fake, motion_device=name).open() as robot:
                assert (await robot.read_joints()).joints_rad == pytest.approx(believed(fake), abs=1e-9)
        other = config_of(fake, motion_device="Positioner", serial=f"{SERIAL}-Positioner")
        async with other.open() as robot:
            assert (await robot.read_joints()).joints_rad == (0.0,) * 6
        assert "Gantry" in str(await failure_of_opening(config_of(fake, motion_device="Gantry")))


@pytest.mark.parametrize(
    "absent", ["Axis_3", POSITION, f"{POSITION}/EngineeringUnits", "Axis_3/MotionProfile", "Axes", "SerialNumber",
               "MotionDevices"],
)  # fmt: skip
async def test_a_robot_that_cannot_be_read_is_not_opened(absent: str) -> None:
    async with fake_server({"absent": [absent]}) as fake:
        assert isinstance(await failure_of_opening(config_of(fake)), RefusedError)


@pytest.mark.parametrize(
    ("absent", "call"), [("SpeedOverride", "speed_override"), ("SafetyStates", "controller_mode")]
)
async def test_what_a_server_does_not_show_is_an_error_and_the_rest_is_read(absent: str, call: str) -> None:
    async with fake_server({"absent": [absent]}) as fake, config_of(fake).open() as robot:
        assert (await robot.read_joints()).joints_rad == pytest.approx(believed(fake), abs=1e-9)
        assert absent in str(await failure_of(getattr(robot, call)()))


@pytest.mark.parametrize("absent", ["SafetyStates", "EmergencyStop", "ProtectiveStop"])
async def test_a_robot_whose_stops_are_not_shown_is_not_ready(absent: str) -> None:
    async with fake_server({"absent": [absent]}) as fake, config_of(fake).open() as robot:
        condition = await robot.read_condition()
        assert condition.readiness is Readiness.NOT_READY
        assert "emergency stop" in condition.message


async def test_software_that_is_not_shown_is_left_empty() -> None:
    async with fake_server({"absent": ["Software"]}) as fake, config_of(fake).open() as robot:
        assert (await robot.identify()).firmware == ""


async def test_a_placeholder_that_a_server_took_over_from_a_type_is_no_device() -> None:
    settings = {"devices": ["Arm", "<MotionDeviceIdentifier>"]}
    async with fake_server(settings) as fake, config_of(fake).open() as robot:
        assert (await robot.read_joints()).joints_rad == pytest.approx(believed(fake), abs=1e-9)


async def test_axes_without_an_order_need_names_in_the_cell_file() -> None:
    names = ["S", "L", "U", "R", "B", "T"]
    async with fake_server({"axis_names": names}) as fake:
        failure = await failure_of_opening(config_of(fake))
        assert "axes = [" in failure.remedy
        async with config_of(fake, axes=names).open() as robot:
            assert (await robot.read_joints()).joints_rad == pytest.approx(believed(fake), abs=1e-9)
        failure = await failure_of_opening(config_of(fake, axes=[*names[:5], "E1"]))
        assert "axes of the cell file" in str(failure)


async def test_a_server_without_the_specification_says_what_is_missing() -> None:
    async with fake_server() as fake, config_of(fake).open() as robot:
        plain = ["http://opcfoundation.org/UA/", "urn:example-robotics:server"]
        await fake.inject_fault("other_value", {"node": "NamespaceArray", "value": plain})
        failure = await failure_of(robot.read_joints())
        assert "http://opcfoundation.org/UA/DI/" in str(failure)
        assert "OPC 40010-1" in failure.remedy


# servers that come and go


async def test_a_restart_with_other_namespaces_is_an_error_and_then_read_right() -> None:
    async with fake_server() as fake, config_of(fake).open() as robot:
        for _ in range(3):
            before = fake.layout.namespaces
            await fake.inject_fault("restart", {"shuffled": True})
            assert fake.layout.namespaces != before
            failure = await failure_of(robot.read_joints())
            assert isinstance(failure, UnreachableError)
            await reads_again(robot, fake)


async def test_namespaces_that_change_their_order_in_a_session_are_followed() -> None:
    async with fake_server() as fake, config_of(fake).open() as robot:
        await robot.read_joints()
        await fake.inject_fault("shuffle_namespaces", {})
        assert (await robot.read_joints()).joints_rad == pytest.approx(believed(fake), abs=1e-9)
        assert await robot.speed_override() == 1.0


async def test_another_robot_behind_the_address_is_refused_also_after_a_restart() -> None:
    async with fake_server() as fake, config_of(fake).open() as robot:
        await fake.inject_fault("other_robot", {"serial": "X-000000"})
        await failure_of(robot.read_joints())  # the session is gone
        assert isinstance(await failure_of(robot.read_joints()), WrongDeviceError)
        assert (await robot.read_condition()).readiness is Readiness.UNREACHABLE


async def test_an_answer_in_pieces_is_put_together() -> None:
    async with fake_server() as fake, config_of(fake).open() as robot:
        await fake.inject_fault("half", {})
        assert (await robot.read_joints()).joints_rad == pytest.approx(believed(fake), abs=1e-9)
