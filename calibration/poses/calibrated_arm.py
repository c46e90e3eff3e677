"""What a calibration of one robot leaves behind: deviations from nominal, how surely, and for which mastering."""

import hashlib
from dataclasses import dataclass, field

from cellcal.calibration.identification.identifiability import is_learnt


@dataclass(frozen=True, slots=True)
class FoundParameter:
    """One deviation from the nominal arm, k = 1."""

    name: str
    unit: str
    value: float
    sigma: float
    prior: float
    role: str

    @property
    def is_determined(self) -> bool:
        """Whether the readings say more than the prior did."""
        return is_learnt(self.sigma, self.prior)


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
    # Of each parameter with those before it; empty in what was kept by versions that did not keep them, whose
    # hashes must stay what they were.
    correlations: tuple[tuple[float, ...], ...] = field(default=(), repr=False)

    @property
    def sha256(self) -> str:
        """A hash of everything in it."""
        correlated = repr(self.correlations) if self.correlations else ""
        return hashlib.sha256((repr(self) + correlated).encode()).hexdigest()

    def parameter_values(self) -> dict[str, float]:
        """Return the deviations by name, SI."""
        return {parameter.name: parameter.value for parameter in self.parameters}
