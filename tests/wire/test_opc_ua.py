"""What the OPC UA driver reads of its simulator beyond the contract, and the simulator as a plain client sees it."""

import asyncio
import math
from typing import Any

import pytest
from asyncua import Client, ua

from cellcal.drivers.errors import DeviceError, MotionStoppedError, RefusedError, WireProtocolError
from cellcal.drivers.interfaces import Readiness
from cellcal.drivers.opc_ua import value_times
from cellcal.drivers.opc_ua.server_access import ServerAccess
from cellcal.drivers.opc_ua.server_link import ServerLink
from tests.machine_speed import stretched_s
from tests.wire.opc_ua_server import (
    POSITION,
    SERIAL,
    believed,
    config_of,
    failure_of,
    fake_server,
    reads_again,
    until_standing,
)

pytestmark = pytest.mark.timeout(stretched_s(60.0))


# what is read


@pytest.mark.parametrize("unit", ["deg", "rad"])
@pytest.mark.parametrize("has_vendor_types", [True, False])
async def test_joints_come_in_order_and_in_radians(unit: str, has_vendor_types: bool) -> None:
    settings = {"units": [unit] * 6, "has_vendor_types": has_vendor_types}
    async with fake_server(settings) as fake, config_of(fake).open() as robot:
        assert (await robot.read_joints()).joints_rad == pytest.approx(believed(fake), abs=1e-12)


async def test_a_sliding_axis_is_read_in_metres() -> None:
    settings = {"units": ["deg", "deg", "mm", "deg", "deg", "deg"]}
    async with fake_server(settings) as fake, config_of(fake).open() as robot:
        assert (await robot.read_joints()).joints_rad == pytest.approx(believed(fake), abs=1e-12)


async def test_name_plate_mode_override_and_software_are_read() -> None:
    async with fake_server() as fake, config_of(fake).open() as robot:
        found = await robot.identify()
        assert (found.vendor, found.model) == ("Example Robotics", "ER-16 ER-16/2.0")
        assert (found.serial, found.firmware) == (SERIAL, "MotionWare 2.7.1")
        await fake.inject_fault("mode", {"mode": "external"})
        await fake.inject_fault("override", {"percent": 12.5})
        assert await robot.controller_mode() == "AUTOMATIC_EXTERNAL"
        assert await robot.speed_override() == 0.125


async def test_positions_that_are_frozen_with_a_good_status_are_no_reading(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(value_times, "OLDEST_S", 0.0)
    async with fake_server() as fake, config_of(fake).open() as robot:
        assert await robot.identity_doubts() == ""
        await robot.read_joints()
        await robot.read_joints()  # the time goes on while the arm stands
        await fake.inject_fault("frozen_value", {"node": POSITION})
        await robot.read_condition()
        await fake.inject_fault("jog_by_hand", {"axis": "J3", "rad": 0.4})
        failure = await failure_of(robot.read_joints())
        assert "stood still" in str(failure)
        assert (await robot.read_condition()).readiness is Readiness.NOT_READY


async def test_a_motion_of_others_is_seen_until_the_arm_stands() -> None:
    async with fake_server() as fake, config_of(fake).open() as robot:
        assert not (await robot.read_joints()).moving
        await fake.inject_fault("jog_by_hand", {"axis": "J2", "rad": 0.4, "speed_rad_s": 2.0})
        seen = False
        async with asyncio.timeout(stretched_s(20.0)):
            while not seen:
                seen = (await robot.read_joints()).moving
        await until_standing(robot)
        assert not fake.true_state()["moving"]
        assert (await robot.read_joints()).joints_rad == pytest.approx(believed(fake), abs=1e-9)


async def test_stop_waits_for_standstill_and_says_so_where_there_is_none() -> None:
    async with fake_server() as fake, config_of(fake, deadline_s=stretched_s(1.0)).open() as robot:
        await robot.stop()
        await fake.inject_fault("jog_by_hand", {"axis": "J1", "rad": 2.0, "speed_rad_s": 0.02})
        async with asyncio.timeout(stretched_s(20.0)):
            while not (await robot.read_joints()).moving:
                pass
        failure = await failure_of(robot.stop())
        assert isinstance(failure, MotionStoppedError)
        assert "emergency stop" in failure.remedy
        assert fake.true_state()["moving"]


class AnsweredMeanwhileError(asyncio.CancelledError):
    """As the library raises where an answer comes in the moment of a cancellation."""


async def test_an_answer_in_the_moment_of_a_deadline_is_a_missed_deadline() -> None:
    async def answer_late() -> None:
        try:
            await asyncio.Event().wait()
        except asyncio.CancelledError as cancelled:
            raise AnsweredMeanwhileError from cancelled

    link = ServerLink("robot", "opc.tcp://127.0.0.1:4840", ServerAccess(), deadline_s=1.0)
    with pytest.raises(TimeoutError):
        async with asyncio.timeout(0.0):
            await link._ask_server(answer_late, "joints")


@pytest.mark.parametrize(
    ("event", "words"), [("emergency_stop", "emergency"), ("protective_stop", "protective")]
)
async def test_stops_are_conditions(event: str, words: str) -> None:
    async with fake_server() as fake, config_of(fake).open() as robot:
        await fake.inject_fault(event, {})
        condition = await robot.read_condition()
        assert condition.readiness is Readiness.STOPPED
        assert words in condition.message
        assert condition.remedy
        await fake.inject_fault("mend", {})
        assert (await robot.read_condition()).readiness is Readiness.READY


# values that are none


@pytest.mark.parametrize(
    ("fault", "parameters", "kind", "says"),
    [
        ("bad_status", {"code": "BadSensorFailure"}, RefusedError, "BadSensorFailure"),
        ("bad_status", {"code": "UncertainLastUsableValue"}, RefusedError, "UncertainLastUsableValue"),
        ("bad_status", {"code": "GoodLocalOverride"}, RefusedError, "GoodLocalOverride"),
        ("not_a_number", {}, WireProtocolError, "nan"),
        ("not_a_number", {"value": "-inf"}, WireProtocolError, "inf"),
        ("wrong_type", {}, WireProtocolError, "String"),
        ("no_value", {}, WireProtocolError, "Null"),
    ],
)
async def test_a_position_that_is_none_is_refused_and_the_next_good_one_read(
    fault: str, parameters: dict[str, Any], kind: type[DeviceError], says: str
) -> None:
    async with fake_server() as fake, config_of(fake).open() as robot:
        await fake.inject_fault(fault, {"node": POSITION, **parameters})
        failure = await failure_of(robot.read_joints())
        assert isinstance(failure, kind)
        assert says in str(failure)
        assert "Axis_3" in str(failure)
        assert (await robot.read_condition()).readiness is Readiness.NOT_READY
        fake.clear_faults()
        assert (await robot.read_joints()).joints_rad == pytest.approx(believed(fake), abs=1e-9)


@pytest.mark.parametrize(
    ("node", "fault", "call"),
    [
        ("EmergencyStop", "bad_status", "read_condition"),
        ("EmergencyStop", "wrong_type", "read_condition"),
        ("ProtectiveStop", "no_value", "read_condition"),
        ("OperationalMode", "wrong_type", "controller_mode"),
        ("SpeedOverride", "not_a_number", "speed_override"),
        ("SerialNumber", "bad_status", "identify"),
        ("MotionProfile", "wrong_type", "read_joints"),
        ("EngineeringUnits", "no_value", "read_joints"),
    ],
)
async def test_other_values_that_are_none_are_refused(node: str, fault: str, call: str) -> None:
    async with fake_server() as fake, config_of(fake).open() as robot:
        await fake.inject_fault(fault, {"node": node})
        if call == "read_condition":
            condition = await robot.read_condition()
            assert condition.readiness is Readiness.NOT_READY
            assert node in condition.message
            assert condition.remedy
        else:
            assert node in str(await failure_of(getattr(robot, call)()))


@pytest.mark.parametrize(
    ("node", "value", "call", "says"),
    [
        ("OperationalMode", 9, "controller_mode", "9"),
        ("SpeedOverride", 130.0, "speed_override", "130"),
        ("MotionProfile", 3, "read_joints", "do not fit"),
        ("MotionProfile", 0, "read_joints", "do not fit"),
        ("State", 1, "read_joints", "state 1"),
    ],
)
async def test_values_outside_what_the_document_allows_are_refused(
    node: str, value: float, call: str, says: str
) -> None:
    async with fake_server() as fake, config_of(fake).open() as robot:
        await fake.inject_fault("other_value", {"node": node, "value": value})
        assert says in str(await failure_of(getattr(robot, call)()))


async def test_an_axis_that_changes_its_unit_is_read_in_the_new_one() -> None:
    async with fake_server() as fake, config_of(fake).open() as robot:
        before = (await robot.read_joints()).joints_rad
        await fake.inject_fault("restart", {"units": ["rad"] * 6})
        await reads_again(robot, fake)
        assert (await robot.read_joints()).joints_rad == pytest.approx(before, abs=1e-9)


async def test_an_unknown_unit_is_refused() -> None:
    async with fake_server({"units": ["deg"] * 5 + ["inch"]}) as fake, config_of(fake).open() as robot:
        failure = await failure_of(robot.read_joints())
        assert "Axis_6" in str(failure)
        assert "in 4804168" in str(failure)


# the simulator, as a plain client sees it


async def test_a_plain_client_browses_to_every_axis() -> None:
    async with fake_server() as fake, Client(f"opc.tcp://{fake.address}:4840/") as client:
        uris = await client.get_namespace_array()
        robotics, devices = (
            uris.index("http://opcfoundation.org/UA/Robotics/"),
            uris.index("http://opcfoundation.org/UA/DI/"),
        )
        at = await client.nodes.objects.get_child(f"{devices}:DeviceSet")
        systems = [
            child for child in await at.get_children()
            if await child.read_type_definition() == ua.NodeId(1002, robotics)
        ]  # fmt: skip
        arm = (await (await systems[0].get_child(f"{robotics}:MotionDevices")).get_children())[0]
        axes = await (await arm.get_child(f"{robotics}:Axes")).get_children()
        found = {}
        for axis in axes:
            position = await axis.get_child([f"{devices}:ParameterSet", f"{robotics}:ActualPosition"])
            units = await (await position.get_child("0:EngineeringUnits")).read_value()
            assert (units.UnitId, units.DisplayName.Text) == (17476, "deg")
            found[(await axis.read_browse_name()).Name] = math.radians(await position.read_value())
        assert [found[f"Axis_{k}"] for k in range(1, 7)] == pytest.approx(believed(fake), abs=1e-9)
        serial = await arm.get_child(f"{devices}:SerialNumber")
        assert await serial.read_value() == SERIAL
        with pytest.raises(ua.UaStatusCodeError):
            await serial.write_value("another one")
