"""Damage for program files: what a disk, an editor and a transfer do, and what none would."""

import re
from collections.abc import Callable

import numpy as np

_NUMBER = re.compile(rb"[+-]?\d*+\.?+\d++|[+-]?\d++")
_SIGN = re.compile(rb"\W")


def mutate_file(data: bytes, seed: int) -> bytes:
    """Return the file with one to three kinds of damage; never the file itself."""
    rng = np.random.default_rng([seed, 77])
    damaged = data
    for _ in range(int(rng.integers(1, 4))):
        damage = _DAMAGE[int(rng.integers(len(_DAMAGE)))]
        damaged = damage(damaged or b" ", rng)
    return damaged if damaged != data else _insert_bytes(data, rng)


def _pick_offset(data: bytes, rng: np.random.Generator) -> int:
    return int(rng.integers(len(data)))


def _pick_size(rng: np.random.Generator, least: int, most: int) -> int:
    """Return a size of any order of magnitude: the largest show what grows with the square, and are dear."""
    return int(least * (most / least) ** rng.random())


def _flip_bits(data: bytes, rng: np.random.Generator) -> bytes:
    at = _pick_offset(data, rng)
    return data[:at] + bytes([data[at] ^ (1 << int(rng.integers(8)))]) + data[at + 1 :]


def _insert_bytes(data: bytes, rng: np.random.Generator) -> bytes:
    at = _pick_offset(data, rng)
    pieces = (
        b" ",
        b"\t",
        b"\n",
        b"\r",
        b";",
        b",",
        b"}",
        b"{",
        b"]",
        b"=",
        b'"',
        b"-",
        b".",
        b"9",
        b"\0",
        b"!",
        b":",
    )
    return data[:at] + pieces[int(rng.integers(len(pieces)))] + data[at:]


def _delete_bytes(data: bytes, rng: np.random.Generator) -> bytes:
    at = _pick_offset(data, rng)
    return data[:at] + data[at + int(rng.integers(1, 12)) :]


def _cut_short(data: bytes, rng: np.random.Generator) -> bytes:
    return data[: _pick_offset(data, rng)]


def _change_lines(data: bytes, rng: np.random.Generator) -> bytes:
    """A line is doubled, dropped, cut, or two change places."""
    lines = data.splitlines(keepends=True) or [b""]
    i, j = int(rng.integers(len(lines))), int(rng.integers(len(lines)))
    kind = int(rng.integers(4))
    if kind == 0:
        lines.insert(j, lines[i])
    elif kind == 1:
        del lines[i]
    elif kind == 2:
        lines[i] = lines[i][: int(rng.integers(len(lines[i]) + 1))]
    else:
        lines[i], lines[j] = lines[j], lines[i]
    return b"".join(lines)


def _swap_words(data: bytes, rng: np.random.Generator) -> bytes:
    """Two words or signs, or the same one twice, change places."""
    (a, b), (c, d) = sorted(
        (_word_at(data, _pick_offset(data, rng)), _word_at(data, _pick_offset(data, rng)))
    )
    return data if a == c else data[:a] + data[c:d] + data[b:c] + data[a:b] + data[d:]


def _word_at(data: bytes, at: int) -> tuple[int, int]:
    """Return where the word begins and ends that a place is in; a sign or a blank is one by itself."""
    after = _SIGN.search(data, at)
    end = after.start() if after else len(data)
    if end == at:
        return at, at + 1
    start = at
    while start > 0 and not _SIGN.match(data, start - 1):
        start -= 1
    return start, end


_ODD_NUMBERS = [
    *b"1e308 1E400 nan inf -inf NaN 0x10 1_0 1,5 --1 1e -0 +7 1.2.3 . 1e-400 \xb2 1d5 0012.50 123456789.5".split(),
    b"9" * 400,
]


def _odd_number(data: bytes, rng: np.random.Generator) -> bytes:
    at = _pick_offset(data, rng)
    start, end = data.rfind(b"\n", 0, at) + 1, data.find(b"\n", at)
    numbers = list(_NUMBER.finditer(data, start, end if end >= 0 else len(data)))
    if not numbers:
        return _insert_bytes(data, rng)
    hit = numbers[int(rng.integers(len(numbers)))]
    return data[: hit.start()] + _ODD_NUMBERS[int(rng.integers(len(_ODD_NUMBERS)))] + data[hit.end() :]


def _huge_line(data: bytes, rng: np.random.Generator) -> bytes:
    at = _pick_offset(data, rng)
    filling = (b"x", b" ", b"9", b"{", b"P[1]", b"-", b'"', b"<a>", b"((", b"\t;")[int(rng.integers(10))]
    return data[:at] + filling * (_pick_size(rng, 200, 40_000) // len(filling)) + data[at:]


def _nest_brackets(data: bytes, rng: np.random.Generator) -> bytes:
    at, depth = _pick_offset(data, rng), _pick_size(rng, 20, 3000)
    opening, closing = ((b"[", b"]"), (b"{", b"}"), (b"(", b")"), (b"<g>", b"</g>"))[int(rng.integers(4))]
    return data[:at] + opening * depth + closing * depth + data[at:]


def _insert_foreign_text(data: bytes, rng: np.random.Generator) -> bytes:
    kind = int(rng.integers(4))
    if kind == 0:
        return data.decode("latin-1").encode("utf-16")
    if kind == 1:
        return b"\xef\xbb\xbf" + data
    at = _pick_offset(data, rng)
    return data[:at] + (b"\x81\xe1\x9a\xff", "Größe".encode())[kind - 2] + data[at:]


def _zero_part(data: bytes, rng: np.random.Generator) -> bytes:
    at = _pick_offset(data, rng)
    return data[:at] + b"\0" * int(rng.integers(1, 600)) + data[at + 600 :]


def _change_line_endings(data: bytes, rng: np.random.Generator) -> bytes:
    kind = int(rng.integers(3))
    unix = data.replace(b"\r\n", b"\n")
    return (unix, unix.replace(b"\n", b"\r\n"), unix.replace(b"\n", b"\r"))[kind]


_DAMAGE: tuple[Callable[[bytes, np.random.Generator], bytes], ...] = (
    _flip_bits, _flip_bits, _insert_bytes, _insert_bytes, _delete_bytes, _delete_bytes, _cut_short,
    _change_lines, _change_lines, _change_lines,
    _swap_words, _swap_words, _odd_number, _odd_number, _odd_number, _huge_line, _nest_brackets,
    _insert_foreign_text, _zero_part, _change_line_endings,
)  # fmt: skip
