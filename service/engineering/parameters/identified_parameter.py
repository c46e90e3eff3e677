"""One identified parameter, as reports and parameter sets name it."""

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class IdentifiedParameter:
    """One parameter in SI, with its standard deviation and what its prior allowed."""

    name: str
    unit: str
    value: float
    sigma: float
    prior: float
    held: bool = False  # not fitted: as it was known before
