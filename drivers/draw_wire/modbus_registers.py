"""The registers of a Modbus encoder as data, and the one decoder for them."""

import struct
from functools import cache
from importlib.resources import files
from typing import Literal

from pydantic import BaseModel, ConfigDict, Field, model_validator

from cellcal.calibration.documents.toml_text import parse_toml
from cellcal.drivers.wire.modbus import Words

_FORMS = {"u32": ">I", "i32": ">i"}


class _EncoderTable(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid")


class EncoderRegister(_EncoderTable):
    """Two words, high word first."""

    at: int = Field(ge=0, le=0xFFFE)
    type: Literal["u32", "i32"]
    source: str


class EncoderMap(_EncoderTable):
    """One kind of encoder: a block that is read in one telegram, and what lies in it."""

    name: str
    vendor: str
    first: int = Field(ge=0, le=0xFFFF)
    words: int = Field(ge=2, le=125)
    registers: dict[str, EncoderRegister]
    alarms: dict[int, str]

    @model_validator(mode="after")
    def _all_inside(self) -> "EncoderMap":
        for name, register in self.registers.items():
            if not self.first <= register.at <= self.first + self.words - 2:
                raise ValueError(f"register {name} lies outside the block")
        return self

    def decode_value(self, name: str, block: Words) -> int:
        """Return one whole number out of the block."""
        register = self.registers[name]
        start = register.at - self.first
        form = _FORMS[register.type]
        return int(struct.unpack(form, struct.pack(">2H", *block[start : start + 2]))[0])


@cache
def load_encoder_map() -> EncoderMap:
    """Read ``modbus_registers.toml``."""
    text = files("cellcal.drivers.draw_wire").joinpath("modbus_registers.toml").read_text(encoding="utf-8")
    return EncoderMap.model_validate(parse_toml(text))
