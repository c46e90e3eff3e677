"""A reader of QR codes as they are drawn in SVG, after ISO/IEC 18004: versions 6 to 8, level M, bytes.

It corrects nothing: a drawing on a page has no dirt, and one wrong module must show.
"""

import re
from collections.abc import Iterator

Modules = list[list[bool]]

_ALIGNED = {6: (6, 34), 7: (6, 22, 38), 8: (6, 24, 42)}
_BLOCKS = {6: (27,) * 4, 7: (31,) * 4, 8: (38, 38, 39, 39)}  # data bytes of each block, level M
_MASKS = (
    lambda r, c: (r + c) % 2,
    lambda r, _: r % 2,
    lambda _, c: c % 3,
    lambda r, c: (r + c) % 3,
    lambda r, c: (r // 2 + c // 3) % 2,
    lambda r, c: r * c % 2 + r * c % 3,
    lambda r, c: (r * c % 2 + r * c % 3) % 2,
    lambda r, c: ((r + c) % 2 + r * c % 3) % 2,
)


def read_svg(svg: str) -> str:
    """Return what a drawn code says."""
    return read_modules(modules_of(svg))


def modules_of(svg: str) -> Modules:
    """Return the modules of a drawing: its dark lines are one module high; white stands around them."""
    side = int(re.search(r'viewBox="0 0 (\d+) \1"', svg)[1])  # type: ignore[index]
    path = re.search(r'<path[^>]*stroke="#000"[^>]* d="([^"]+)"', svg)
    assert path
    dark, x, y = set(), 0.0, 0.0
    for move, one, other in re.findall(r"([Mmh])(-?[\d.]+)(?: (-?[\d.]+))?", path[1]):
        if move == "h":
            dark |= {(int(y), int(x) + k) for k in range(int(one))}
            x += float(one)
        else:
            x, y = (float(one), float(other)) if move == "M" else (x + float(one), y + float(other))
    rows, columns = ([at[axis] for at in dark] for axis in (0, 1))
    white = min(rows)
    assert white == min(columns) == side - 1 - max(rows) == side - 1 - max(columns) >= 4
    size = side - 2 * white
    return [[(white + row, white + column) in dark for column in range(size)] for row in range(size)]


def read_modules(modules: Modules) -> str:
    """Return what a code says."""
    size = len(modules)
    version = (size - 17) // 4
    bits = [modules[8][column] for column in (0, 1, 2, 3, 4, 5, 7, 8)]
    bits += [modules[row][8] for row in (7, 5, 4, 3, 2, 1, 0)]
    form = int("".join("01"[bit] for bit in bits), 2) ^ 0x5412
    assert form >> 13 == 0, "level M"
    mask = _MASKS[form >> 10 & 7]
    data = [modules[row][column] ^ (mask(row, column) == 0) for row, column in _data_modules(version, size)]
    codewords = [int("".join("01"[b] for b in data[k : k + 8]), 2) for k in range(0, len(data) - 7, 8)]
    stream = "".join(f"{word:08b}" for word in _in_order(codewords, _BLOCKS[version]))
    assert stream[:4] == "0100", "bytes"
    count = int(stream[4:12], 2)
    return bytes(int(stream[12 + 8 * k : 20 + 8 * k], 2) for k in range(count)).decode()


def _in_order(codewords: list[int], blocks: tuple[int, ...]) -> list[int]:
    """Undo the weaving of the blocks."""
    found: list[list[int]] = [[] for _ in blocks]
    codeword_iterator = iter(codewords)
    for place in range(max(blocks)):
        for block, length in zip(found, blocks, strict=True):
            if place < length:
                block.append(next(codeword_iterator))
    return [word for block in found for word in block]


def _data_modules(version: int, size: int) -> Iterator[tuple[int, int]]:
    """Go through the modules that carry data: two columns at a time from the right, up and down in turn."""
    upwards = True
    for right in (*range(size - 1, 6, -2), 5, 3, 1):
        for row in range(size - 1, -1, -1) if upwards else range(size):
            for column in (right, right - 1):
                if not _is_pattern(row, column, version, size):
                    yield row, column
        upwards = not upwards


def _is_pattern(row: int, column: int, version: int, size: int) -> bool:
    corner = (row < 9 and (column < 9 or column >= size - 8)) or (row >= size - 8 and column < 9)
    numbered = version >= 7 and (
        (row < 6 and size - 11 <= column < size - 8) or (column < 6 and size - 11 <= row < size - 8)
    )
    centres = _ALIGNED[version]
    aligned = any(
        abs(row - a) <= 2 and abs(column - b) <= 2
        for a in centres
        for b in centres
        if (a, b) not in ((6, 6), (6, centres[-1]), (centres[-1], 6))
    )
    return corner or numbered or aligned or 6 in (row, column)
