"""The robot controller behind the server: what it shows of its arm, and its switches.

Imitates
    Any maker's controller, as far as OPC UA for Robotics shows it.
Source
    OPC 40010-1, release 1.02: the published Opc.Ua.Robotics.NodeSet2.xml.
Modelled
    Joints of one arm, emergency and protective stop, operational mode, speed override, name plate.
Not modelled
    Programs, loads, motors, temperatures.
"""

import math
from dataclasses import dataclass, field

from cellcal.fake_devices.arm import SimulatedArm

# OperationalModeEnumeration
MANUAL_REDUCED, MANUAL_HIGH, AUTOMATIC, EXTERNAL = 1, 2, 3, 4
_BRAKING_RAD_S2 = 4.0


@dataclass(frozen=True)
class NamePlate:
    """The data on the arm's plate."""

    manufacturer: str = "Example Robotics"
    model: str = "ER-16"
    product_code: str = "ER-16/2.0"
    serial: str = "0"


@dataclass
class RobotController:
    """One controller with its arm."""

    arm: SimulatedArm
    plate: NamePlate
    mode: int = AUTOMATIC
    emergency_stop: bool = False
    protective_stop: bool = False
    override_percent: float = 100.0
    payload_kg: float = field(default=0.0)

    def shown_joint(self, axis: int, unit: str) -> float:
        """Return an axis' position in the unit that the server states."""
        angle = float(self.arm.controller_joints_rad[axis])
        if unit == "mm":
            return 1000.0 * angle  # a sliding axis: metres
        return angle if unit == "rad" else math.degrees(angle)

    def press_emergency_stop(self) -> None:
        """Brake, and stay stopped until it is released."""
        self.emergency_stop = True
        self.arm.stop(_BRAKING_RAD_S2)

    def enter_protective_stop(self) -> None:
        """Brake, as for an open safety gate."""
        self.protective_stop = True
        self.arm.stop(_BRAKING_RAD_S2)

    def mend(self) -> None:
        """Release every stop, and switch to automatic."""
        self.emergency_stop = self.protective_stop = False
        self.mode, self.override_percent = AUTOMATIC, 100.0
