"""One answer of an OPC UA server to a reading of the opc_ua driver, and how the driver reads it."""

import asyncio
import math

from asyncua import ua
from asyncua.common.utils import Buffer
from asyncua.ua.ua_binary import struct_from_binary, struct_to_binary

from cellcal.drivers.opc_ua.axis_units import unit_of_axis
from cellcal.drivers.opc_ua.node_values import (
    check_value_count,
    read_float,
    read_integer,
    read_structure,
    read_texts,
)
from cellcal.drivers.opc_ua.server_access import ServerAccess
from cellcal.drivers.opc_ua.server_link import ServerLink


def example_answer() -> bytes:
    """Return a ReadResponse: namespaces, a position, its unit, its motion profile."""
    units = ua.EUInformation(
        "http://www.opcfoundation.org/UA/units/un/cefact",
        17476,
        ua.LocalizedText("deg"),
        ua.LocalizedText(""),
    )
    response = ua.ReadResponse()
    response.Results = [
        ua.DataValue(ua.Variant(["http://opcfoundation.org/UA/", "urn:robot"], ua.VariantType.String)),
        ua.DataValue(ua.Variant(-35.25, ua.VariantType.Double)),
        ua.DataValue(ua.Variant(units, ua.VariantType.ExtensionObject)),
        ua.DataValue(ua.Variant(1, ua.VariantType.Int32)),
    ]
    return bytes(struct_to_binary(response))


def read_opc_ua_answer(data: bytes) -> object:
    """Let the driver read it: a finite position in radians, or an error that it expects."""

    async def decode() -> list[ua.DataValue]:
        response = struct_from_binary(ua.ReadResponse, Buffer(data))
        response.ResponseHeader.ServiceResult.check()
        return list(response.Results)

    async def read() -> float:
        link = ServerLink("opc", "opc.tcp://127.0.0.1:4840/", ServerAccess(), deadline_s=1.0)
        values = await link._ask_server(decode, "values")
        check_value_count("opc", values, 4)
        read_texts("opc", "NamespaceArray", values[0])
        profile = read_integer("opc", "MotionProfile", values[3])
        unit = unit_of_axis("opc", "A1", read_structure("opc", "EngineeringUnits", values[2]), profile)
        angle = unit.to_si * read_float("opc", "ActualPosition", values[1])
        assert math.isfinite(angle)
        return angle

    return asyncio.run(read())
