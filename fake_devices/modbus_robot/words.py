"""Values as 16-bit registers, the controller's way.

Imitates
    The word formats of FANUC's HMI device option.
Source
    deploy/controller_setup/fanuc_hmi.md, "Words": 32-bit values low word first, strings low byte first.
Modelled
    int32, float32, strings of two characters a word.
Not modelled
    Other multipliers than 0 and 1.
"""

import struct
from collections.abc import Iterable, Sequence


def int32_words(values: Iterable[int]) -> list[int]:
    """Return two registers per value, low word first."""
    words: list[int] = []
    for value in values:
        raw = value & 0xFFFFFFFF
        words += [raw & 0xFFFF, raw >> 16]
    return words


def words_int32(words: Sequence[int]) -> list[int]:
    """Return the signed values of register pairs."""
    raws = [words[k] | words[k + 1] << 16 for k in range(0, len(words), 2)]
    return [raw - (1 << 32) if raw & 0x80000000 else raw for raw in raws]


def float_words(values: Iterable[float]) -> list[int]:
    """Return two registers per value, IEEE single, low word first."""
    return int32_words(struct.unpack("<i", struct.pack("<f", value))[0] for value in values)


def words_float(words: Sequence[int]) -> list[float]:
    """Return the values of register pairs."""
    return [float(struct.unpack("<f", struct.pack("<i", raw))[0]) for raw in words_int32(words)]


def text_words(text: str, words: int) -> list[int]:
    """Return a string in so many registers, low byte first, padded with NUL."""
    raw = text.encode("latin-1", "replace")[: 2 * words].ljust(2 * words, b"\0")
    return [raw[k] | raw[k + 1] << 8 for k in range(0, 2 * words, 2)]
