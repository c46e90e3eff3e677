"""An address at which no such controller answers: the cause is the system's own, for IPv6 and host names too."""

import asyncio
import contextlib
import socket
from collections.abc import AsyncIterator

import pytest

from cellcal.drivers.abb.robot_web_services.generation import ServiceAddress, find_service
from cellcal.drivers.errors import DeviceError, UnreachableError
from cellcal.drivers.opc_ua.config import OpcUaConfig
from cellcal.drivers.universal_robots.config import UniversalRobotConfig
from cellcal.drivers.wire.link_errors import find_reason
from cellcal.drivers.wire.modbus import ModbusLink
from cellcal.fake_devices.listening_port import ListeningPort
from tests.wire.fake_devices_process import own_address

LIMIT_S = 10.0


def unused_port(family: socket.AddressFamily = socket.AF_INET) -> int:
    with socket.socket(family) as taken:
        taken.bind(("::1" if family == socket.AF_INET6 else "127.0.0.1", 0))
        return int(taken.getsockname()[1])


@contextlib.asynccontextmanager
async def serving(answer: bytes) -> AsyncIterator[int]:
    async def reply(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        await reader.read(100)
        writer.write(answer)

    async with ListeningPort("127.0.0.1", 0, reply) as port:
        yield port.port


@pytest.mark.parametrize("host", ["127.0.0.1", "::1"])
async def test_a_port_that_is_closed_is_said_to_refuse(host: str) -> None:
    family = socket.AF_INET6 if host == "::1" else socket.AF_INET
    with pytest.raises(UnreachableError) as refused:
        await find_service(ServiceAddress("arm", host, unused_port(family)), LIMIT_S)
    assert str(refused.value).count("Connection refused") == 2


async def test_what_answers_and_is_no_robot_is_named() -> None:
    async with serving(b"HTTP/1.1 200 OK\r\nContent-Length: 0\r\n\r\n") as port:
        with pytest.raises(UnreachableError, match=r"a web server answers that is none \(status 200\)"):
            await find_service(ServiceAddress("arm", "127.0.0.1", port), LIMIT_S)
    async with serving(b"SSH-2.0-OpenSSH_9.2\r\n") as port:
        with pytest.raises(UnreachableError, match="what answers is no web server"):
            await find_service(ServiceAddress("arm", "127.0.0.1", port), LIMIT_S)


async def test_an_opc_ua_server_at_an_ipv6_address_is_not_said_to_have_answered() -> None:
    config = OpcUaConfig.model_validate(
        {
            "driver": "opc_ua",
            "name": "arm",
            "address": "::1",
            "port": unused_port(socket.AF_INET6),
            "model": "yaskawa_gp25",
            "serial": "Y-1",
            "speed_limit_rad_s": 0.3,
        }
    )
    with pytest.raises(UnreachableError, match="no connection to the OPC UA server"):
        async with config.open():
            pass


async def test_the_reason_is_the_system_s_and_no_tuple_of_a_library() -> None:
    with pytest.raises(OSError, match="Connect call failed") as failed:
        await asyncio.open_connection("::1", unused_port(socket.AF_INET6))
    assert find_reason(failed.value) == "Connection refused"


async def test_a_server_without_tls_is_not_said_to_forbid_anything() -> None:
    async with serving(b"no TLS here") as port:
        with pytest.raises(UnreachableError, match=r"https://127.0.0.1:\d+: no TLS connection \(") as raised:
            await find_service(ServiceAddress("arm", "127.0.0.1", port), LIMIT_S)
    assert "not permitted" not in str(raised.value)
    assert "Exec format" not in str(raised.value)


@pytest.mark.parametrize(
    ("answer", "cause"),
    [(b"", "the connection broke"), (bytes.fromhex("000100000003010382"), "sent what is no Modbus answer")],
)
async def test_what_never_answered_as_modbus_may_be_another_device(answer: bytes, cause: str) -> None:
    async with serving(answer) as port:
        link = ModbusLink("gauge", "127.0.0.1", port, deadline_s=LIMIT_S)
        with pytest.raises(DeviceError, match=cause) as raised:
            await link.read(1, 2)
        assert "address and port" in raised.value.remedy
        await link.close()


async def test_why_there_is_no_modbus_connection_is_told() -> None:
    link = ModbusLink("gauge", "127.0.0.1", unused_port(), deadline_s=LIMIT_S)
    with pytest.raises(UnreachableError, match="Connection refused") as raised:
        await link.open()
    assert "address and port" in raised.value.remedy


async def test_the_opc_ua_client_and_the_dashboard_tell_the_system_s_reason() -> None:
    config = OpcUaConfig.model_validate(
        {"driver": "opc_ua", "name": "arm", "address": "127.0.0.1", "port": unused_port(), "serial": "Y-1",
         "model": "yaskawa_gp25", "speed_limit_rad_s": 0.3}
    )  # fmt: skip
    for opening in (config.open(), _ur_at_nothing().open()):
        with pytest.raises(UnreachableError, match="Connection refused") as raised:
            async with opening:
                pass
        assert "Connect call" not in str(raised.value)


def _ur_at_nothing() -> UniversalRobotConfig:
    return UniversalRobotConfig.model_validate(
        {"driver": "universal_robots", "name": "ur", "address": own_address(), "model": "ur10e", "serial": "1",
         "speed_limit_rad_s": 0.3}
    )  # fmt: skip
