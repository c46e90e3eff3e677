"""Tables of instruments in a cell file: where each stands or sits, and who calibrated it."""

import math
from dataclasses import dataclass
from datetime import date

from pydantic import BaseModel, ConfigDict, Field, field_validator

from cellcal.drivers.registry import GaugeConfig, ProbeConfig, TrackerConfig

Triple = tuple[float, float, float]
_INSIDE_EVERY_BASE_MM = 20.0


class StrictTable(BaseModel):
    """A table of the cell file: unknown keys and numbers that are not finite are refused."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


class InstrumentCertificate(StrictTable):
    """The laboratory that calibrated an instrument, and how long that holds. Else no traceability is claimed."""

    number: str = Field(min_length=1, max_length=64)
    laboratory: str = Field(min_length=1, max_length=120)
    accreditation: str = Field(default="", max_length=120)
    issued: date
    due: date
    expanded_uncertainty_mm: float = Field(gt=0)


class GaugeSetupTable(StrictTable):
    """Where a length gauge stands, as far as a tape measure tells. The truth is fitted."""

    robot: str
    anchor_in_base_mm: Triple
    hook_in_flange_mm: Triple
    anchor_sigma_mm: float = Field(default=10.0, ge=1e-4)
    hook_sigma_mm: float = Field(default=2.0, ge=1e-4)
    mouth_at_mm: Triple | None = None  # a place straight in front of the wire's exit, in the base
    certificate: InstrumentCertificate | None = None

    @field_validator("anchor_in_base_mm")
    @classmethod
    def _is_outside_the_robot(cls, anchor: Triple) -> Triple:
        if max(map(abs, anchor)) < _INSIDE_EVERY_BASE_MM:
            raise ValueError("it stands inside the robot's base: metres written where millimetres belong?")
        return anchor

    @property
    def anchor_in_base_m(self) -> Triple:
        """Exit point of the wire in the robot's base frame [m]."""
        return _to_metres(self.anchor_in_base_mm)

    @property
    def hook_in_flange_m(self) -> Triple:
        """Hook of the wire in the robot's flange frame [m]."""
        return _to_metres(self.hook_in_flange_mm)


@dataclass(frozen=True)
class GaugeEntry:
    """One length gauge: how to reach it, and where it stands."""

    device: GaugeConfig
    setup: GaugeSetupTable


class TrackerSetupTable(StrictTable):
    """Where a tracker's target sits on a flange, as far as a ruler tells. Where the tracker stands is fitted."""

    robot: str
    target_in_flange_mm: Triple
    target_sigma_mm: float = Field(default=2.0, ge=1e-4)
    certificate: InstrumentCertificate | None = None

    @property
    def target_in_flange_m(self) -> Triple:
        """Centre of the reflector in the robot's flange frame [m]."""
        return _to_metres(self.target_in_flange_mm)


@dataclass(frozen=True)
class TrackerEntry:
    """One tracker: how to reach it, and what it looks at."""

    device: TrackerConfig
    setup: TrackerSetupTable


class ProbeSetupTable(StrictTable):
    """Where a probe's tip sits on a flange, as far as a ruler tells, and which way it points."""

    robot: str
    tip_in_flange_mm: Triple
    tip_sigma_mm: float = Field(default=1.0, ge=1e-4)
    axis_in_flange: Triple = (0.0, 0.0, 1.0)  # from the flange to the tip; of a dial gauge, along its plunger
    certificate: InstrumentCertificate | None = None

    @field_validator("axis_in_flange")
    @classmethod
    def _is_a_direction(cls, axis: Triple) -> Triple:
        if abs(math.hypot(*axis) - 1.0) > 1e-3:
            raise ValueError("must have the length 1")
        return axis


@dataclass(frozen=True)
class ProbeEntry:
    """One touch probe or dial gauge: how to reach it, and where its tip is."""

    device: ProbeConfig
    setup: ProbeSetupTable

    @property
    def role(self) -> str:
        """The role in the cell: ``probe`` or ``dial``."""
        return "probe" if self.device.driver == "touch_probe" else "dial"


InstrumentEntry = GaugeEntry | TrackerEntry | ProbeEntry


def _to_metres(millimetres: Triple) -> Triple:
    x, y, z = millimetres
    return (x * 1e-3, y * 1e-3, z * 1e-3)
