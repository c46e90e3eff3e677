"""The gauge's object table as data, and the one decoder for it."""

import struct
from functools import cache
from importlib.resources import files
from typing import Literal

from pydantic import BaseModel, ConfigDict, Field

from cellcal.calibration.documents.toml_text import parse_toml

_FORMS = {"u8": "<B", "u16": "<H", "u32": "<I", "i16": "<h", "i32": "<i"}


class ObjectEntry(BaseModel):
    """One object: where it is and how it is written down."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    index: int = Field(ge=0x1000, le=0xFFFF)
    sub: int = Field(ge=0, le=0xFF)
    type: Literal["u8", "u16", "u32", "i16", "i32"]
    scale: float = 1.0  # SI units per bit
    source: str


class ObjectTable(BaseModel):
    """The addresses of a draw-wire's objects by CiA 406."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    device_profile: int
    objects: dict[str, ObjectEntry]


def decode_entry(entry: ObjectEntry, data: bytes) -> int:
    """Return the whole number in ``data``; ValueError for a wrong length."""
    form = _FORMS[entry.type]
    if len(data) != struct.calcsize(form):
        raise ValueError(f"{len(data)} bytes instead of {struct.calcsize(form)}")
    return int(struct.unpack(form, data)[0])


@cache
def load_objects() -> ObjectTable:
    """Read ``objects.toml``."""
    text = files("cellcal.drivers.draw_wire").joinpath("objects.toml").read_text(encoding="utf-8")
    return ObjectTable.model_validate(parse_toml(text))
