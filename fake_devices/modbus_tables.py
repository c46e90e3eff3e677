"""Modbus devices with four tables: bits and words to read, bits and words to write.

Imitates
    The server side of the Modbus application protocol in a device that knows which addresses it has.
Source
    Modbus Application Protocol V1.1b3, sections 6.1 to 6.6, 6.11, 6.12 and 7.
Modelled
    Function codes 1 to 6, 15 and 16; exceptions 1 (function), 2 (address), 3 (value) and whatever a table raises.
Not modelled
    Function codes 7, 8, 11, 22, 23, 43.
"""

import struct
from typing import Protocol

from cellcal.fake_devices.modbus_robot.server import ModbusError

_READS, _WRITES = (1, 2, 3, 4), (5, 6, 15, 16)
_ON, _OFF = 0xFF00, 0x0000


class ModbusTables(Protocol):
    """The contents by address; addresses count from 0. Raise ModbusError(2) for what is not there."""

    def read_words(self, function: int, address: int, count: int) -> list[int]: ...
    def read_bits(self, function: int, address: int, count: int) -> list[bool]: ...
    def write_words(self, address: int, values: list[int]) -> None: ...
    def write_bits(self, address: int, values: list[bool]) -> None: ...


def answer_request(tables: ModbusTables, request: bytes) -> bytes:
    """Return the response PDU to a request PDU; raise ModbusError."""
    function = request[0]
    if function not in _READS + _WRITES:
        raise ModbusError(1)
    if len(request) < 5:
        raise ModbusError(3)
    address, second = struct.unpack(">HH", request[1:5])
    if function in _READS:
        return _read_response(tables, function, address, second)
    if function == 5:
        if second not in (_ON, _OFF):
            raise ModbusError(3)
        tables.write_bits(address, [second == _ON])
    elif function == 6:
        tables.write_words(address, [second])
    else:
        _write_many(tables, function, address, second, request)
    return request[:5]


def _read_response(tables: ModbusTables, function: int, address: int, count: int) -> bytes:
    if not 1 <= count <= (2000 if function in (1, 2) else 125):
        raise ModbusError(3)
    if function in (1, 2):
        data = _pack_bits(tables.read_bits(function, address, count))
    else:
        data = struct.pack(f">{count}H", *tables.read_words(function, address, count))
    return bytes([function, len(data)]) + data


def _write_many(tables: ModbusTables, function: int, address: int, count: int, request: bytes) -> None:
    size = 2 * count if function == 16 else (count + 7) // 8
    data = request[6:]
    if not 1 <= count <= 1968 or len(request) < 6 or not len(data) == request[5] == size:
        raise ModbusError(3)
    if function == 16:
        tables.write_words(address, list(struct.unpack(f">{count}H", data)))
    else:
        tables.write_bits(address, [bool(data[k // 8] >> k % 8 & 1) for k in range(count)])


def _pack_bits(bits: list[bool]) -> bytes:
    data = bytearray((len(bits) + 7) // 8)
    for k, bit in enumerate(bits):
        data[k // 8] |= bit << k % 8
    return bytes(data)
