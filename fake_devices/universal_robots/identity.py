"""Who the controller says it is.

Imitates
    Software version, model and serial number of one robot.
Source
    The maker's dashboard and primary interface pages.
Modelled
    Everything a client asks to know which robot it talks to.
Not modelled
    Licences, installed URCaps.
"""

from dataclasses import dataclass

_TYPES = {"UR5": 1, "UR10": 2, "UR3": 3, "UR16": 4, "UR20": 7, "UR30": 8, "UR15": 9}


@dataclass(frozen=True)
class UrIdentity:
    """Name plate and software."""

    model: str = "UR10e"
    serial: str = "20225500042"
    version: tuple[int, int, int, int] = (5, 11, 1, 108318)
    released: str = "Nov 18 2021"
    base_rate_hz: int = 500

    @property
    def software_text(self) -> str:
        """Return the dashboard's answer to PolyscopeVersion."""
        return f"URSoftware {'.'.join(map(str, self.version))} ({self.released})"

    @property
    def model_family(self) -> str:
        """Return the model as the dashboard tells it, without the generation."""
        return self.model.removesuffix("e").upper()

    @property
    def robot_type(self) -> int:
        """Return the number of the model on the primary interface."""
        return _TYPES.get(self.model_family, 0)
