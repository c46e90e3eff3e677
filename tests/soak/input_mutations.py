"""Damage to valid examples of any input: what a hand, a disk, an attacker or another program may do to a file."""

import gzip
import re

import numpy as np

NASTY_WORDS = [
    b"NaN", b"-Infinity", b"inf", b"1e999", b"-0", b"0x10", b"9" * 5000, b"18446744073709551616", b"-1", b"1e-400",
    b"9223372036854775808", b"1" + b"0" * 30, b"null", b"true", b'""', b"[]", b"{}", b"\xff\xfe",
    b"\x00", b"\xed\xa0\x80",
    b"\\ud800", b"\\u0000", b"\xef\xbb\xbf", b"=cmd()", b"[red]", b":robot:", b"../../x", b"/dev/zero", b"\r", b"\n",
    b'"',
    b"'", b"\\", b"&a;", b"<!DOCTYPE a>", b"]]>", b"-->", b"\xe2\x80\xae", b"%s%n", b"{0}", b"1_000", b"1,5",
    b"\xc2\xa0",
    b"1979-05-27T07:32:00", b"99:99:99", b"\x1b[31m", b"a" * 140_000,
]  # fmt: skip
_BIG = [
    b"[" * 100_000,
    b"a." * 200_000,
    b"{" * 100_000,
    b"<a>" * 50_000,
    b"(" * 20_000,
    b'{"a":' * 50_000,
    b"1," * 100_000,
]
_NUMBER = re.compile(rb"-?\d+(?:\.\d+)?")
_WORD = re.compile(rb"\"[^\"\n]*\"|[A-Za-z_]{2,}")


def mutated_input(example: bytes, seed: int) -> bytes:
    """Return one example with one to four kinds of damage; the same seed gives the same."""
    rng = np.random.default_rng(seed)
    data = example
    for _ in range(int(rng.integers(1, 5))):
        data = _KINDS[int(rng.integers(len(_KINDS)))](data, rng)
    if rng.random() < 0.02:
        data = _replace_whole(data, rng)
    return data


def _pick_offset(data: bytes, rng: np.random.Generator) -> int:
    return int(rng.integers(len(data) + 1))


def _flip_bits(data: bytes, rng: np.random.Generator) -> bytes:
    changed = bytearray(data)
    for _ in range(int(rng.integers(1, 8))):
        if changed:
            changed[int(rng.integers(len(changed)))] = int(rng.integers(256))
    return bytes(changed)


def _cut_out(data: bytes, rng: np.random.Generator) -> bytes:
    start, end = sorted((_pick_offset(data, rng), _pick_offset(data, rng)))
    end = min(end, start + int(rng.integers(1, 400)))
    return data[:start] + data[end:]


def _truncate_file(data: bytes, rng: np.random.Generator) -> bytes:
    return data[: _pick_offset(data, rng)]


def _repeat_part(data: bytes, rng: np.random.Generator) -> bytes:
    start = _pick_offset(data, rng)
    piece = data[start : start + int(rng.integers(1, 300))]
    return data[:start] + piece * int(rng.integers(2, 6)) + data[start:]


def _insert_bytes(data: bytes, rng: np.random.Generator) -> bytes:
    at, word = _pick_offset(data, rng), NASTY_WORDS[int(rng.integers(len(NASTY_WORDS)))]
    return data[:at] + word + data[at:]


def _insert_big(data: bytes, rng: np.random.Generator) -> bytes:
    if rng.random() > 0.05:
        return _insert_bytes(data, rng)
    at, word = _pick_offset(data, rng), _BIG[int(rng.integers(len(_BIG)))]
    return data[:at] + word + data[at:]


def _exchange_matches(pattern: re.Pattern[bytes]) -> "Kind":
    def exchange_match(data: bytes, rng: np.random.Generator) -> bytes:
        found = [match.span() for match in pattern.finditer(data)]
        if not found:
            return _insert_bytes(data, rng)
        start, end = found[int(rng.integers(len(found)))]
        return data[:start] + NASTY_WORDS[int(rng.integers(len(NASTY_WORDS)))] + data[end:]

    return exchange_match


def _swap_lines(data: bytes, rng: np.random.Generator) -> bytes:
    lines = data.split(b"\n")
    one, other = int(rng.integers(len(lines))), int(rng.integers(len(lines)))
    lines[one], lines[other] = lines[other], lines[one]
    return b"\n".join(lines)


def _replace_whole(data: bytes, rng: np.random.Generator) -> bytes:
    text = data.decode("utf-8", errors="replace")
    forms = [
        lambda: text.encode("utf-16"), lambda: text.encode("utf-8-sig"), lambda: text.encode("utf-32"),
        lambda: gzip.compress(data), lambda: b"", lambda: b"\0" * 4096, lambda: data * 3,
        lambda: gzip.compress(b"\0" * 40_000_000), lambda: data.replace(b"\n", b"\r"),
    ]  # fmt: skip
    return forms[int(rng.integers(len(forms)))]()


Kind = type(_flip_bits)
_KINDS = [
    _flip_bits, _cut_out, _truncate_file, _repeat_part, _insert_bytes, _insert_big, _exchange_matches(_NUMBER), _exchange_matches(_NUMBER), _exchange_matches(_WORD),
    _swap_lines,
]  # fmt: skip
