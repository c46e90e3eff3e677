"""Words of a Modbus controller to SI numbers and back. What lies where is data: see ``profile.py``."""

import math
import struct
from collections.abc import Sequence
from enum import StrEnum
from typing import Literal

from pydantic import BaseModel, ConfigDict, Field

Words = tuple[int, ...]

_SI = {
    "": 1.0,
    "mm": 1e-3,
    "deg": math.pi / 180,
    "deg/s": math.pi / 180,
    "counts/deg": 180 / math.pi,
    "%": 0.01,
    "rad": 1.0,
    "rad/count": 1.0,
    "counts": 1.0,
}
_WORDS_PER_VALUE = {"float32": 2, "int32": 2, "int16": 1, "text": 1}


class RegisterAccess(StrEnum):
    """The writers that a register allows."""

    READ = "read"
    WRITE = "write"
    BOTH = "read_write"


class RobotRegister(BaseModel):
    """One line of a profile: where a quantity lies and how it is written down."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    address: int = Field(ge=1, le=65536)  # counted from 1
    words: int = Field(ge=1, le=100)
    type: Literal["float32", "int32", "int16", "text"]
    multiply: float = Field(default=1.0, gt=0)  # integer types: word value = round(value x multiply)
    unit: Literal["", "mm", "deg", "deg/s", "counts/deg", "%", "rad", "rad/count", "counts"] = ""
    access: RegisterAccess
    source: str
    stride: int = Field(default=0, ge=0)  # where the quantity repeats: words from one to the next
    repeats: int = Field(default=1, ge=1)

    def register_of_item(self, number: int) -> "RobotRegister":
        """Return the register of item ``number``, counted from 1, of a repeated quantity."""
        if not 1 <= number <= self.repeats:
            raise ValueError(f"number {number} is not 1 to {self.repeats}")
        return self.model_copy(update={"address": self.address + self.stride * (number - 1)})


def decode_words(register: RobotRegister, words: Sequence[int]) -> tuple[float, ...]:
    """Return the SI values in ``words``; ValueError where they are none (NaN, infinite, wrong length)."""
    if len(words) != register.words:
        raise ValueError(f"{len(words)} words instead of {register.words}")
    if not all(0 <= word <= 0xFFFF for word in words):
        raise ValueError("a word is outside 0 to 65535")
    size = _WORDS_PER_VALUE[register.type]
    raw = [_from_words(register.type, words[i : i + size]) for i in range(0, len(words), size)]
    if not all(math.isfinite(value) for value in raw):
        raise ValueError("a value is not a finite number")
    if register.type == "float32":
        return tuple(value * _SI[register.unit] for value in raw)
    return tuple(value / register.multiply * _SI[register.unit] for value in raw)


def decode_text(register: RobotRegister, words: Sequence[int]) -> str:
    """Return the text in ``words``: two characters a word, low byte first, up to the first NUL."""
    if register.type != "text" or len(words) != register.words:
        raise ValueError(f"no text of {register.words} words")
    data = struct.pack(f"<{len(words)}H", *words).split(b"\0", 1)[0]
    return data.decode("ascii", errors="replace").strip()


def encode_values(register: RobotRegister, values: Sequence[float]) -> Words:
    """Return the words of SI values; ValueError for a value that the register cannot hold."""
    size = _WORDS_PER_VALUE[register.type]
    if register.type == "text" or len(values) * size != register.words:
        raise ValueError(f"{len(values)} values do not fill {register.words} words of {register.type}")
    if not all(math.isfinite(value) for value in values):
        raise ValueError("a value is not a finite number")
    raw = [value / _SI[register.unit] for value in values]
    try:
        return tuple(word for value in raw for word in _to_words(register, value))
    except (struct.error, OverflowError) as error:
        raise ValueError(f"a value does not fit into {register.type}: {error}") from error


def _from_words(kind: str, words: Sequence[int]) -> float:
    """Put the words together, low word first: little-endian by words."""
    data = struct.pack(f"<{len(words)}H", *words)
    form = {"float32": "<f", "int32": "<i", "int16": "<h"}[kind]
    return float(struct.unpack(form, data)[0])


def _to_words(register: RobotRegister, value: float) -> Words:
    if register.type == "float32":
        return struct.unpack("<2H", struct.pack("<f", value))
    whole = round(value * register.multiply)
    if register.type == "int32":
        return struct.unpack("<2H", struct.pack("<i", whole))
    return struct.unpack("<H", struct.pack("<h", whole))
