"""Who the controller says it is.

Imitates
    Software version, model and serial number of one robot of any generation.
Source
    The maker's dashboard and primary interface pages; the type codes, the first software of each arm and the
    Robot API's first version are those of the maker's C++ client library 2.14.0.
Modelled
    Everything a client asks to know which robot it talks to. Arms without a code of their own report that of a
    sibling: UR7e as UR5, UR12e as UR10. The dashboard of PolyScope 5 calls them UR7 and UR12, as URSim does;
    a cell file may let it say anything else.
Not modelled
    Licences, installed URCaps.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

_TYPES = {
    "UR3": 3,
    "UR5": 1,
    "UR7": 1,
    "UR8LONG": 6,
    "UR10": 2,
    "UR12": 2,
    "UR15": 9,
    "UR16": 4,
    "UR18": 5,
    "UR20": 7,
    "UR30": 8,
}
_CB3_MODELS = ("UR3", "UR5", "UR10")
_CB3_VERSION = (3, 15, 8, 106339)
_CB3_RATE_HZ = 125
_WHOLE_API = (10, 12)  # modes can be read over the Robot API from here on
_PLATE_API = (10, 14)  # serial number and model, too


@dataclass(frozen=True)
class UrIdentity:
    """Name plate and software."""

    model: str = "UR10e"
    serial: str = "20225500042"
    version: tuple[int, int, int, int] = (5, 11, 1, 108318)
    released: str = "Nov 18 2021"
    base_rate_hz: int = 500
    dashboard_model: str = ""  # what the dashboard says where it is not the model without the generation
    type_code: int = 0  # what the primary interface says where it is not the model's own code

    @classmethod
    def of_tables(cls, table: Mapping[str, Any], settings: Mapping[str, Any]) -> "UrIdentity":
        """Read a robot's entry of the cell file and its table [fake.robots.NAME].

        Keys of the latter: ``software`` ("10.12.1.0"), ``dashboard_model``, ``type_code``.
        """
        model = str(table.get("arm_type") or table.get("model", "ur10e")).partition("@")[0]
        shown = model[:2].upper() + model[2:]
        old = shown in _CB3_MODELS
        version = _CB3_VERSION if old else cls.version
        if "software" in settings:
            parts = [int(part) for part in str(settings["software"]).split(".")] + [0, 0, 0]
            version = (parts[0], parts[1], parts[2], parts[3])
        return cls(
            model=shown,
            serial=str(table.get("serial", cls.serial)),
            version=version,
            base_rate_hz=_CB3_RATE_HZ if version[0] == 3 else cls.base_rate_hz,
            dashboard_model=str(settings.get("dashboard_model", "")),
            type_code=int(settings.get("type_code", 0)),
        )

    @property
    def is_cb3(self) -> bool:
        """Whether it is a control box of the third generation."""
        return self.version[0] == 3

    @property
    def is_polyscope_x(self) -> bool:
        """Whether it has the Robot API instead of the dashboard."""
        return self.version[0] >= 10

    @property
    def robot_api_version(self) -> str:
        """Return the version of the Robot API. That of 10.11 is only known to be below 3.1.4."""
        if self.version[:2] >= _PLATE_API:
            return "5.0.107"
        return "3.1.4" if self.version[:2] >= _WHOLE_API else "3.0.0"

    @property
    def software_text(self) -> str:
        """Return the dashboard's answer to PolyscopeVersion."""
        return f"URSoftware {'.'.join(map(str, self.version))} ({self.released})"

    @property
    def model_family(self) -> str:
        """Return the model as the dashboard tells it, without the generation."""
        return self.dashboard_model or self.model.removesuffix("e").upper()

    @property
    def robot_type(self) -> int:
        """Return the number of the model on the primary interface."""
        return self.type_code or _TYPES.get(self.model.removesuffix("e").upper(), 0)
