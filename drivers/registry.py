"""Every driver that a cell file may name. Adding a device means one line here."""

from collections.abc import Mapping
from typing import Annotated, TypeAlias

from pydantic import Field

from cellcal.drivers.abb.robot_web_services.config import AbbWebServicesConfig
from cellcal.drivers.draw_wire.config import DrawWireConfig, ModbusDrawWireConfig
from cellcal.drivers.fanuc.rmi.config import FanucRmiConfig
from cellcal.drivers.file_import.config import FileGaugeConfig, FileTrackerConfig
from cellcal.drivers.kuka.variables.config import KukaVariablesConfig
from cellcal.drivers.laser_tracker.config import LaserTrackerConfig
from cellcal.drivers.modbus_robot import fanuc_program
from cellcal.drivers.modbus_robot.config import ModbusRobotConfig
from cellcal.drivers.opc_ua.config import OpcUaConfig
from cellcal.drivers.touch_probe.config import DialGaugeConfig, TouchProbeConfig
from cellcal.drivers.universal_robots.config import UniversalRobotConfig
from cellcal.drivers.universal_robots.program_files import program_file
from cellcal.drivers.wire.program_file import ProgramWriter
from cellcal.drivers.yaskawa.config import YaskawaConfig

RobotConfig: TypeAlias = Annotated[
    ModbusRobotConfig
    | UniversalRobotConfig
    | AbbWebServicesConfig
    | FanucRmiConfig
    | KukaVariablesConfig
    | OpcUaConfig
    | YaskawaConfig,
    Field(discriminator="driver"),
]
_AnyDrawWire: TypeAlias = Annotated[DrawWireConfig | ModbusDrawWireConfig, Field(discriminator="interface")]
GaugeConfig: TypeAlias = Annotated[_AnyDrawWire | FileGaugeConfig, Field(discriminator="driver")]
TrackerConfig: TypeAlias = Annotated[LaserTrackerConfig | FileTrackerConfig, Field(discriminator="driver")]
ProbeConfig: TypeAlias = Annotated[TouchProbeConfig | DialGaugeConfig, Field(discriminator="driver")]
# Languages of pendants, by the robot's profile or else its driver.
PROGRAM_WRITERS: Mapping[str, ProgramWriter] = {
    "fanuc_hmi": fanuc_program.PROGRAM_WRITER,
    "fanuc_tp": fanuc_program.PROGRAM_WRITER,
    "universal_robots": program_file.PROGRAM_WRITER,
}
