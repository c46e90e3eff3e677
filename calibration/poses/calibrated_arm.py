"""What a calibration of one robot leaves behind: deviations from nominal, how surely, and for which mastering."""

import hashlib
from dataclasses import dataclass

from calibration.poses.arm_fit import FoundParameter


@dataclass(frozen=True, slots=True)
class CalibratedArm:
    """One robot's parameters. They hold for the mastering that they were found with, and for no other."""

    robot_serial: str
    model: str
    counts_at_zero: tuple[int, ...]  # empty where the robot keeps none
    device: str  # what measured: wire | tracker
    parameters: tuple[FoundParameter, ...]
    target_in_flange_m: tuple[float, float, float]
    fitted_joints_rad: tuple[tuple[float, ...], ...]

    @property
    def sha256(self) -> str:
        """A hash of everything in it."""
        return hashlib.sha256(repr(self).encode()).hexdigest()

    def values(self) -> dict[str, float]:
        """Return the deviations by name, SI."""
        return {parameter.name: parameter.value for parameter in self.parameters}
