"""A controller's register map as data: ``profiles/<name>.toml``, each line with its source."""

from collections.abc import Sequence
from functools import cache
from importlib.resources import files
from typing import Literal

from pydantic import BaseModel, ConfigDict, Field, model_validator

from cellcal.calibration.documents.toml_text import parse_toml
from cellcal.drivers.modbus_robot.registers import RobotRegister

Operation = Literal["move", "jog", "calibrate", "reset_alarms"]
SECOND_GROUP = "second_group"  # the block with its position
LONGEST_READ = 125  # registers in one telegram, Modbus Application Protocol 6.3


class _ProfileTable(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


class ProfileLimits(_ProfileTable):
    """Numbers that the document promises or demands."""

    position_tolerance_deg: float = Field(gt=0)
    jog_speed_unmastered_deg_s: float = Field(gt=0)
    stale_after_s: float = Field(gt=0)
    heartbeat_s: float = Field(gt=0)


class ProfileAbilities(_ProfileTable):
    """The abilities that the controller's document offers; the others are false."""

    jogs_single_axes: bool = True  # also one that is not mastered
    writes_mastering: bool = True  # and makes it effective


class ControllerProfile(_ProfileTable):
    """One kind of controller behind Modbus TCP."""

    name: str
    title: str
    vendor: str
    axes: int = Field(ge=1, le=9)
    blocks: dict[str, tuple[str, ...]]
    operations: dict[Operation, int]
    limits: ProfileLimits
    abilities: ProfileAbilities = ProfileAbilities()
    is_simulated: bool = False  # its handshake does what no real controller is documented to do
    alarms: dict[int, str]
    registers: dict[str, RobotRegister]

    @model_validator(mode="after")
    def _blocks_fit(self) -> "ControllerProfile":
        for name, members in self.blocks.items():
            unknown = [member for member in members if member not in self.registers]
            if unknown:
                raise ValueError(f"block {name} names unknown registers: {', '.join(unknown)}")
            first, count = self.register_span([self.registers[member] for member in members])
            if count > LONGEST_READ:
                raise ValueError(f"block {name} from {first} is {count} words, more than {LONGEST_READ}")
        return self

    @property
    def has_second_group(self) -> bool:
        """Whether the document assigns the position of motion group 2."""
        return SECOND_GROUP in self.blocks

    @staticmethod
    def register_span(registers: Sequence[RobotRegister]) -> tuple[int, int]:
        """Return first address and number of words that cover all of ``registers``."""
        first = min(register.address for register in registers)
        return first, max(register.address + register.words for register in registers) - first


@cache
def load_profile(name: str) -> ControllerProfile:
    """Read a profile that ships; FileNotFoundError for an unknown name."""
    text = (
        files("cellcal.drivers.modbus_robot").joinpath("profiles", f"{name}.toml").read_text(encoding="utf-8")
    )
    return ControllerProfile.model_validate(parse_toml(text))


def profile_names() -> tuple[str, ...]:
    """Return the names of the profiles that ship."""
    folder = files("cellcal.drivers.modbus_robot").joinpath("profiles")
    return tuple(sorted(entry.name[:-5] for entry in folder.iterdir() if entry.name.endswith(".toml")))
