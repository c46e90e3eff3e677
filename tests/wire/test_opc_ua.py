"""The OPC UA driver against its simulator beyond the contract, and the simulator as a plain client sees it."""

import asyncio
import math
import random
import struct
from collections.abc import AsyncIterator, Mapping
from contextlib import asynccontextmanager, suppress
from pathlib import Path
from typing import Any

import pytest
from asyncua import Client, ua
from asyncua.common.utils import Buffer
from asyncua.crypto import cert_gen
from cryptography import x509
from cryptography.hazmat.primitives.serialization import Encoding

from cellcal.drivers.errors import (
    DeviceError,
    MotionStoppedError,
    RefusedError,
    UnreachableError,
    WireProtocolError,
    WrongDeviceError,
)
from cellcal.drivers.interfaces import Readiness
from cellcal.drivers.opc_ua import server_link
from cellcal.drivers.opc_ua.axis_units import order_axes, unit_of_axis
from cellcal.drivers.opc_ua.config import OpcUaConfig
from cellcal.drivers.opc_ua.safety_state import SafetyState, condition_of, mode_name
from cellcal.drivers.opc_ua.standstill import StandstillWatch
from cellcal.fake_devices.opc_ua.device import FakeOpcUaRobot, create_opc_ua_robot
from cellcal.fake_devices.world import World
from tests.machine_speed import stretched_s

pytestmark = pytest.mark.timeout(stretched_s(60.0))

SERIAL = "ER-230817"
POSITION = "Axis_3/ParameterSet/ActualPosition"
CEFACT = "http://www.opcfoundation.org/UA/units/un/cefact"


@asynccontextmanager
async def fake_server(settings: Mapping[str, Any] | None = None) -> AsyncIterator[FakeOpcUaRobot]:
    """Start a robot with an OPC UA server on a loopback address of its own."""
    rng = random.SystemRandom()
    for _ in range(20):
        address = f"127.{rng.randint(1, 250)}.{rng.randint(0, 250)}.{rng.randint(1, 250)}"
        table = {"name": "any_maker", "model": "fanuc_m6ib", "serial": SERIAL, "address": address}
        fake = create_opc_ua_robot(World(3), {**table, "settings": settings or {}})
        try:
            await fake.start()
        except OSError:
            continue
        fake.address = address  # type: ignore[attr-defined]
        try:
            yield fake
        finally:
            await fake.stop()
        return
    raise AssertionError("no free loopback address")


def config_of(fake: Any, **changes: Any) -> OpcUaConfig:
    """Return the entry of a cell file that reaches this fake."""
    entry = {
        "driver": "opc_ua", "name": "any_maker", "model": "fanuc_m6ib", "serial": SERIAL, "address": fake.address,
        "deadline_s": stretched_s(2.0), "still_s": 0.1,
    }  # fmt: skip
    return OpcUaConfig.model_validate({**entry, **changes})


def believed(fake: FakeOpcUaRobot) -> list[float]:
    return list(fake.true_state()["controller_joints_rad"])


async def failure_of(call: Any) -> DeviceError:
    """Return the error of a call, which names the device and says what to do."""
    with pytest.raises(DeviceError) as failure:
        await call
    assert "any_maker" in str(failure.value)
    assert failure.value.remedy
    return failure.value


async def failure_of_opening(config: OpcUaConfig) -> DeviceError:
    async def opened() -> None:
        async with config.open():
            pytest.fail("it was let in")

    return await failure_of(opened())


async def reads_again(robot: Any, fake: FakeOpcUaRobot) -> None:
    """Read until the link is back, and compare with the truth."""
    async with asyncio.timeout(stretched_s(20.0)):
        while True:
            with suppress(UnreachableError):
                assert (await robot.read_joints()).joints_rad == pytest.approx(believed(fake), abs=1e-9)
                return
            await asyncio.sleep(0.01)


async def until_standing(robot: Any) -> None:
    async with asyncio.timeout(stretched_s(20.0)):
        while (await robot.read_joints()).moving:
            await asyncio.sleep(0.01)


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
    async with fake_server() as fake, config_of(fake, deadline_s=0.5).open() as robot:
        await robot.stop()
        fake.controller.arm.start_speed([0.05, 0, 0, 0, 0, 0], 10.0)
        failure = await failure_of(robot.stop())
        assert isinstance(failure, MotionStoppedError)
        assert "emergency stop" in failure.remedy
        assert fake.true_state()["moving"]


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


# servers that encrypt


def write_pair(folder: Path, name: str) -> dict[str, str]:
    """Write a certificate of its own and the key to it; return both paths."""
    key = cert_gen.generate_private_key()
    certificate = cert_gen.generate_self_signed_app_certificate(
        key, name, {}, [x509.UniformResourceIdentifier(f"urn:test:{name}")], extended=[]
    )
    paths = {"certificate": str(folder / f"{name}.der"), "private_key": str(folder / f"{name}.pem")}
    Path(paths["certificate"]).write_bytes(certificate.public_bytes(Encoding.DER))
    Path(paths["private_key"]).write_bytes(cert_gen.dump_private_key_as_pem(key))
    return paths


@pytest.fixture(scope="module")
def pairs(tmp_path_factory: pytest.TempPathFactory) -> dict[str, dict[str, str]]:
    """Certificates of a server, of another server, and of us."""
    folder = tmp_path_factory.mktemp("certificates")
    return {name: write_pair(folder, name) for name in ("server", "other", "ours")}


async def test_a_server_that_encrypts_is_read_with_certificates_and_password(
    pairs: dict[str, dict[str, str]],
) -> None:
    ours = {**pairs["ours"], "server_certificate": pairs["server"]["certificate"]}
    async with fake_server({**pairs["server"], "users": {"reader": "s3cret"}}) as fake:
        config = config_of(fake, **ours, user="reader", password="s3cret")
        async with config.open() as robot:
            assert (await robot.read_joints()).joints_rad == pytest.approx(believed(fake), abs=1e-9)
            await fake.inject_fault("restart", {"shuffled": True})
            await failure_of(robot.read_joints())
            await reads_again(robot, fake)
        for changes in ({"password": "guess"}, {"user": "other"}, {"user": "", "password": ""}):
            failure = await failure_of_opening(config.model_copy(update=changes))
            assert isinstance(failure, RefusedError)
            assert "certificates" in failure.remedy
        assert isinstance(await failure_of_opening(config_of(fake)), RefusedError)  # without encryption


@pytest.mark.parametrize("encrypts", [True, False])
async def test_a_channel_is_renewed_before_its_life_ends(
    pairs: dict[str, dict[str, str]], encrypts: bool
) -> None:
    ours = {**pairs["ours"], "server_certificate": pairs["server"]["certificate"]}
    settings, changes = (pairs["server"], ours) if encrypts else ({}, {})
    async with fake_server(settings) as fake, config_of(fake, **changes).open() as robot:
        session = robot._link.session_number
        for _ in range(3):
            robot._link._renew_at_s = 0.0
            assert (await robot.read_joints()).joints_rad == pytest.approx(believed(fake), abs=1e-9)
            assert robot._link._renew_at_s > 0.0
        assert robot._link.session_number == session


async def test_a_server_with_another_certificate_is_not_talked_to(pairs: dict[str, dict[str, str]]) -> None:
    ours = {**pairs["ours"], "server_certificate": pairs["other"]["certificate"]}
    async with fake_server(pairs["server"]) as fake:
        assert "server_certificate" in (await failure_of_opening(config_of(fake, **ours))).remedy
    async with fake_server() as fake:  # one that does not encrypt at all
        await failure_of_opening(config_of(fake, **ours))


async def test_certificates_that_cannot_be_read_are_named(
    pairs: dict[str, dict[str, str]], tmp_path: Path
) -> None:
    broken = tmp_path / "broken.der"
    broken.write_bytes(b"no certificate")
    async with fake_server(pairs["server"]) as fake:
        for wrong in (str(broken), str(tmp_path / "missing.der")):
            files = {
                **pairs["ours"],
                "server_certificate": pairs["server"]["certificate"],
                "certificate": wrong,
            }
            failure = await failure_of_opening(config_of(fake, **files))
            assert isinstance(failure, RefusedError)
            assert "certificate" in failure.remedy


# rules without a wire


def stated_unit(number: int, shown: str, uri: str = CEFACT) -> ua.EUInformation:
    return ua.EUInformation(uri, number, ua.LocalizedText(shown), ua.LocalizedText(""))


@pytest.mark.parametrize(
    ("number", "shown", "profile", "to_si"),
    [
        (17476, "°", 1, math.radians(1.0)),
        (17476, "", 2, math.radians(1.0)),
        (4405297, "rad", 1, 1.0),
        (5066068, "mm", 3, 1e-3),
        (-1, "deg", 1, math.radians(1.0)),
        (0, "Radian", 1, 1.0),
    ],
)
def test_known_units(number: int, shown: str, profile: int, to_si: float) -> None:
    assert unit_of_axis("r", "A1", stated_unit(number, shown), profile).to_si == pytest.approx(to_si)


@pytest.mark.parametrize(
    ("stated", "profile"),
    [
        (stated_unit(17476, "rad"), 1),  # contradicts itself
        (stated_unit(4405297, "deg"), 1),
        (stated_unit(-1, ""), 1),
        (stated_unit(17476, "deg", "urn:other-units"), 1),
        (stated_unit(17476, "deg"), 3),
        (stated_unit(5066068, "mm"), 1),
        (stated_unit(17476, "deg"), 0),
        (stated_unit(17476, "deg"), 4),
        (None, 1),
        ("deg", 1),
    ],
)
def test_units_that_are_unknown_or_do_not_fit_are_refused(stated: object, profile: int) -> None:
    with pytest.raises(RefusedError) as refusal:
        unit_of_axis("r", "A1", stated, profile)
    assert "A1" in str(refusal.value)


def test_numbered_axes_are_ordered_by_their_numbers() -> None:
    found = ["Axis 2", "Axis 10", "Axis 9", "Axis 3"]
    with pytest.raises(RefusedError):
        order_axes("r", found, (), 4)
    assert order_axes("r", ["J3", "J1", "J2"], (), 3) == ["J1", "J2", "J3"]
    assert order_axes("r", [f"A{k}" for k in (7, 9, 8, 10)], (), 4) == ["A7", "A8", "A9", "A10"]
    for wrong in (
        ["A1", "A2", "E3"],
        ["A1", "A2"],
        ["A1", "A2", "A3", "A4"],
        ["A1", "A1", "A2"],
        ["A", "B", "C"],
        [],
    ):
        with pytest.raises(RefusedError):
            order_axes("r", wrong, (), 3)
    assert order_axes("r", ["T", "E1", "S"], ("S", "T"), 2) == ["S", "T"]


def test_an_arm_stands_when_no_reading_of_the_last_moment_differs() -> None:
    watch = StandstillWatch(1.0)
    assert watch.is_moving() is None
    watch.add_reading(0.0, (0.0, 0.0))
    watch.add_reading(0.5, (0.0, 0.0))
    assert watch.is_moving() is None
    watch.add_reading(1.0, (0.0, 0.0001))
    assert watch.is_moving() is False
    watch.add_reading(1.1, (0.0, 0.01))
    assert watch.is_moving() is True
    watch.add_reading(1.9, (0.0, 0.01))
    assert watch.is_moving() is True
    watch.add_reading(2.2, (0.0, 0.01))
    assert watch.is_moving() is False
    watch.add_reading(30.0, (0.0, 0.01))  # what is older does not count
    assert watch.is_moving() is None
    watch.forget()
    assert watch.is_moving() is None


def test_one_stop_of_several_safety_states_stops_the_robot() -> None:
    healthy, stopped = SafetyState(3, False, False), SafetyState(1, True, False)
    assert condition_of([healthy, stopped]).readiness is Readiness.STOPPED
    assert condition_of([]).readiness is Readiness.NOT_READY
    assert mode_name("r", [healthy, stopped, healthy]) == "AUTOMATIC, MANUAL_REDUCED_SPEED"


@pytest.mark.parametrize(
    "changes",
    [
        {"still_s": 2.0, "deadline_s": 2.0},
        {"axes": ["A1", "A1"]},
        {"path": "no slash"},
        {"port": 0},
        {"certificate": "ours.der"},
        {"user": "reader"},
        {"password": "s3cret"},
    ],
)
def test_entries_that_cannot_work_are_refused(changes: dict[str, Any]) -> None:
    entry = {"driver": "opc_ua", "name": "r", "address": "10.0.0.1", "model": "ur10e", "serial": "1"}
    with pytest.raises(ValueError, match=next(iter(changes))):
        OpcUaConfig.model_validate({**entry, **changes})


def test_an_array_of_nothing_with_a_damaged_length_is_refused_at_once() -> None:
    octets = bytes([0x80]) + struct.pack(
        "<i", 2**31 - 1
    )  # as many elements as fit, none of which takes an octet
    with pytest.raises(ValueError, match="empty values"):
        server_link.ua_binary.variant_from_binary(Buffer(octets))


# the simulator, as a plain client sees it


async def test_a_plain_client_browses_to_every_axis() -> None:
    async with fake_server() as fake, Client(f"opc.tcp://{fake.address}:4840/") as client:  # type: ignore[attr-defined]
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
