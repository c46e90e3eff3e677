"""Damage for program files: what a disk, an editor and a transfer do, and what nobody would."""

import re
from collections.abc import Callable

import numpy as np

_NUMBER = re.compile(rb"[+-]?\d*+\.?+\d++|[+-]?\d++")
_SIGN = re.compile(rb"\W")


def mutate(data: bytes, seed: int) -> bytes:
    """Return the file with one to three kinds of damage; never the file itself."""
    rng = np.random.default_rng([seed, 77])
    damaged = data
    for _ in range(int(rng.integers(1, 4))):
        damage = _DAMAGE[int(rng.integers(len(_DAMAGE)))]
        damaged = damage(damaged or b" ", rng)
    return damaged if damaged != data else _inserted(data, rng)


def _place(data: bytes, rng: np.random.Generator) -> int:
    return int(rng.integers(len(data)))


def _size(rng: np.random.Generator, least: int, most: int) -> int:
    """Return a size of any order of magnitude: the largest show what grows with the square, and are dear."""
    return int(least * (most / least) ** rng.random())


def _flipped(data: bytes, rng: np.random.Generator) -> bytes:
    at = _place(data, rng)
    return data[:at] + bytes([data[at] ^ (1 << int(rng.integers(8)))]) + data[at + 1 :]


def _inserted(data: bytes, rng: np.random.Generator) -> bytes:
    at = _place(data, rng)
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


def _deleted(data: bytes, rng: np.random.Generator) -> bytes:
    at = _place(data, rng)
    return data[:at] + data[at + int(rng.integers(1, 12)) :]


def _cut_short(data: bytes, rng: np.random.Generator) -> bytes:
    return data[: _place(data, rng)]


def _lines(data: bytes, rng: np.random.Generator) -> bytes:
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


def _swapped(data: bytes, rng: np.random.Generator) -> bytes:
    """Two words or signs, or the same one twice, change places."""
    (a, b), (c, d) = sorted((_word_at(data, _place(data, rng)), _word_at(data, _place(data, rng))))
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
    at = _place(data, rng)
    start, end = data.rfind(b"\n", 0, at) + 1, data.find(b"\n", at)
    numbers = list(_NUMBER.finditer(data, start, end if end >= 0 else len(data)))
    if not numbers:
        return _inserted(data, rng)
    hit = numbers[int(rng.integers(len(numbers)))]
    return data[: hit.start()] + _ODD_NUMBERS[int(rng.integers(len(_ODD_NUMBERS)))] + data[hit.end() :]


def _huge_line(data: bytes, rng: np.random.Generator) -> bytes:
    at = _place(data, rng)
    filling = (b"x", b" ", b"9", b"{", b"P[1]", b"-", b'"', b"<a>", b"((", b"\t;")[int(rng.integers(10))]
    return data[:at] + filling * (_size(rng, 200, 40_000) // len(filling)) + data[at:]


def _nested(data: bytes, rng: np.random.Generator) -> bytes:
    at, depth = _place(data, rng), _size(rng, 20, 3000)
    opening, closing = ((b"[", b"]"), (b"{", b"}"), (b"(", b")"), (b"<g>", b"</g>"))[int(rng.integers(4))]
    return data[:at] + opening * depth + closing * depth + data[at:]


def _foreign(data: bytes, rng: np.random.Generator) -> bytes:
    kind = int(rng.integers(4))
    if kind == 0:
        return data.decode("latin-1").encode("utf-16")
    if kind == 1:
        return b"\xef\xbb\xbf" + data
    at = _place(data, rng)
    return data[:at] + (b"\x81\xe1\x9a\xff", "Größe".encode())[kind - 2] + data[at:]


def _emptied(data: bytes, rng: np.random.Generator) -> bytes:
    at = _place(data, rng)
    return data[:at] + b"\0" * int(rng.integers(1, 600)) + data[at + 600 :]


def _endings(data: bytes, rng: np.random.Generator) -> bytes:
    kind = int(rng.integers(3))
    unix = data.replace(b"\r\n", b"\n")
    return (unix, unix.replace(b"\n", b"\r\n"), unix.replace(b"\n", b"\r"))[kind]


_DAMAGE: tuple[Callable[[bytes, np.random.Generator], bytes], ...] = (
    _flipped, _flipped, _inserted, _inserted, _deleted, _deleted, _cut_short, _lines, _lines, _lines,
    _swapped, _swapped, _odd_number, _odd_number, _odd_number, _huge_line, _nested, _foreign, _emptied, _endings,
)  # fmt: skip
