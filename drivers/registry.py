"""Every driver that a cell file may name. Adding a device means one line here."""

from typing import Annotated, TypeAlias

from pydantic import Field

from drivers.draw_wire.config import DrawWireConfig
from drivers.modbus_robot.config import ModbusRobotConfig
from drivers.universal_robots.config import UniversalRobotConfig

RobotConfig: TypeAlias = Annotated[ModbusRobotConfig | UniversalRobotConfig, Field(discriminator="driver")]
GaugeConfig: TypeAlias = DrawWireConfig
