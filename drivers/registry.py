"""Every driver that a cell file may name. Adding a device means one line here."""

from drivers.draw_wire.config import DrawWireConfig
from drivers.modbus_robot.config import ModbusRobotConfig

RobotConfig = ModbusRobotConfig
GaugeConfig = DrawWireConfig
