"""An address at which no such controller answers: the cause is the system's own, for IPv6 and host names too."""

import asyncio
import contextlib
import socket
from collections.abc import AsyncIterator

import pytest

from cellcal.drivers.abb.robot_web_services.generation import ServiceAddress, find_service
from cellcal.drivers.errors import UnreachableError
from cellcal.drivers.opc_ua.config import OpcUaConfig
from cellcal.drivers.wire.link_errors import find_reason
from cellcal.fake_devices.listening_port import ListeningPort

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
