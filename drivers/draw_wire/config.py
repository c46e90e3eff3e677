"""[[gauge]] driver = "draw_wire" in cell.toml, on the bus that ``interface`` names. The models are the factories."""

from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from typing import TYPE_CHECKING, Literal

from pydantic import BaseModel, ConfigDict, Field, model_validator

from cellcal.drivers.wire.device_connection import connection_to

if TYPE_CHECKING:
    from cellcal.drivers.draw_wire.gauge import DrawWire
    from cellcal.drivers.draw_wire.modbus_gauge import ModbusDrawWire

_TELEGRAM_SHARE = 0.5  # of the deadline: connecting takes two telegrams


class _DrawWireOptions(BaseModel):
    """The accuracy of a draw-wire."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    driver: Literal["draw_wire"]
    name: str = Field(min_length=1, max_length=64)
    serial: int = Field(ge=0, lt=2**32)
    range_m: float = Field(gt=0, le=100)
    sigma_m: float = Field(ge=1e-7, le=0.1)
    end_margin_m: float = Field(default=0.005, ge=0, le=1)
    deadline_s: float = Field(default=1.0, gt=0, le=60)


class ModbusDrawWireConfig(_DrawWireOptions):
    """How to reach a draw-wire on Modbus TCP."""

    interface: Literal["modbus"]
    host: str = Field(min_length=1)
    port: int = Field(default=502, ge=1, le=65535)
    step_um: float = Field(gt=0, le=10_000)  # drum circumference by counts per turn

    @asynccontextmanager
    async def open(self) -> AsyncIterator["ModbusDrawWire"]:
        """Connect, check the serial number, and hang up at the end."""
        from cellcal.drivers.draw_wire.modbus_gauge import EncoderOptions, ModbusDrawWire  # noqa: PLC0415  a cell file is read without the library
        from cellcal.drivers.draw_wire.modbus_registers import load_encoder_map  # noqa: PLC0415  as above
        from cellcal.drivers.wire.modbus import ModbusLink  # noqa: PLC0415  as above

        options = EncoderOptions(
            self.serial, self.step_um * 1e-6, self.range_m, self.sigma_m, self.end_margin_m, self.deadline_s
        )
        link = ModbusLink(self.name, self.host, self.port, deadline_s=_TELEGRAM_SHARE * self.deadline_s)
        gauge = ModbusDrawWire(link, load_encoder_map(), options)
        async with connection_to(gauge):
            yield gauge


class DrawWireConfig(_DrawWireOptions):
    """How to reach a draw-wire on CANopen."""

    interface: Literal["socketcand", "socketcan"]
    channel: str = Field(min_length=1)
    host: str = ""
    port: int = Field(default=29536, ge=1, le=65535)
    node_id: int = Field(ge=1, le=127)
    heartbeat_s: float = Field(default=0.1, ge=0.02, le=10)

    @model_validator(mode="after")
    def _gateway_has_a_host(self) -> "DrawWireConfig":
        if self.interface == "socketcand" and not self.host:
            raise ValueError("interface = 'socketcand' needs the host of the CAN gateway")
        return self

    @asynccontextmanager
    async def open(self) -> AsyncIterator["DrawWire"]:
        """Connect, check the serial number, and leave the bus at the end."""
        from cellcal.drivers.draw_wire.gauge import DrawWire, GaugeOptions  # noqa: PLC0415  a cell file is read without the library
        from cellcal.drivers.draw_wire.objects import load_objects  # noqa: PLC0415  as above
        from cellcal.drivers.wire.can_session import BusOptions  # noqa: PLC0415  as above
        from cellcal.drivers.wire.canopen import CanopenLink  # noqa: PLC0415  as above

        on_network = self.interface == "socketcand"
        bus = BusOptions(self.interface, self.channel, self.host if on_network else "", self.port)
        link = CanopenLink(
            self.name, bus, self.node_id, deadline_s=self.deadline_s, heartbeat_s=self.heartbeat_s
        )
        options = GaugeOptions(self.serial, self.range_m, self.sigma_m, self.end_margin_m, self.deadline_s)
        gauge = DrawWire(link, load_objects(), options)
        async with connection_to(gauge):
            yield gauge
