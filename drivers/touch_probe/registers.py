"""The coupler's registers and its analogue words, as data."""

from functools import cache
from importlib.resources import files

from pydantic import BaseModel, ConfigDict, Field

from cellcal.calibration.documents.toml_text import parse_toml
from cellcal.calibration.message import make_message


class _CouplerTable(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid")


class CouplerRegister(_CouplerTable):
    """The address of a value; addresses count from 0."""

    address: int = Field(ge=0, le=0xFFFF)
    words: int = Field(ge=1, le=125)
    source: str


class CouplerConstants(_CouplerTable):
    """Words that every coupler answers alike: who does not, is none, or swaps bytes."""

    values: tuple[int, ...]


class CurrentLoop(_CouplerTable):
    """The form in which a 4-20 mA terminal gives its value."""

    shift: int
    steps: int  # at 20 mA; 4 mA is 0
    fault_mask: int
    below: int
    source: str

    def decode_steps(self, word: int) -> int:
        """Return the value in steps; ValueError says what the terminal reports instead of one."""
        if word & self.fault_mask == self.fault_mask:
            what = "below 4 mA or a broken wire" if word == self.below else "above 20 mA"
            raise ValueError(what)
        count = word >> self.shift
        if not 0 <= count <= self.steps:
            raise ValueError(make_message("the word {word:04X}h, which no current makes", word=word))
        return count


class CouplerMap(_CouplerTable):
    """Everything in ``registers.toml``."""

    registers: dict[str, CouplerRegister]
    constants: CouplerConstants
    current_loop: CurrentLoop


@cache
def load_map() -> CouplerMap:
    """Read ``registers.toml``."""
    text = files("cellcal.drivers.touch_probe").joinpath("registers.toml").read_text(encoding="utf-8")
    return CouplerMap.model_validate(parse_toml(text))
