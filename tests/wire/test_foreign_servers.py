"""A server of another kind at a controller's address: what is said names that, and waits for nothing that never comes."""

import asyncio
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager, suppress

import pytest

from cellcal.drivers.errors import DeviceError, WireProtocolError
from cellcal.drivers.kuka.variables.variable_link import VariableLink
from cellcal.drivers.wire.modbus import ModbusLink
from cellcal.fake_devices.listening_port import ListeningPort
from tests.machine_speed import stretched_s

PAGE = b"HTTP/1.1 400 Bad Request\r\nContent-Length: 0\r\n\r\n"


@asynccontextmanager
async def foreign_server(answer: bytes) -> AsyncIterator[int]:
    """Answer every request with the same octets, and stay connected."""

    async def serve(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        with suppress(ConnectionError):
            while await reader.read(1000):
                writer.write(answer)
                await writer.drain()

    async with ListeningPort("127.0.0.1", 0, serve) as port:
        yield port.port


@pytest.mark.parametrize("answer", [PAGE, b"\xff" * 16, b"\x00\x00\x00\x06\x00\x00\x00\x00\x00\x01"])
async def test_what_is_no_variable_server_is_named_at_once(answer: bytes) -> None:
    async with foreign_server(answer) as port:
        link = VariableLink("kuka", "127.0.0.1", port, deadline_s=stretched_s(30.0))
        with pytest.raises(WireProtocolError, match="does not speak the protocol of a KUKA variable server"):
            await link.read_variable("$AXIS_ACT")
        await link.close()


@pytest.mark.parametrize(
    ("answer", "words"),
    [
        (PAGE, "no whole Modbus answer"),
        (b"\x00\x01\x00\x00\x00\x03\x01\x55\x00", "sent what is no Modbus answer"),
    ],
)
async def test_what_is_no_modbus_answer_is_not_called_silence_and_prints_nothing(
    answer: bytes, words: str, caplog: pytest.LogCaptureFixture
) -> None:
    async with foreign_server(answer) as port:
        link = ModbusLink("fanuc", "127.0.0.1", port, deadline_s=stretched_s(0.5))
        with pytest.raises(DeviceError, match=words):
            await link.read(1, 2)
        await link.close()
    assert [record for record in caplog.records if record.name == "asyncio"] == []
