"""A unified diff of a program before and after, byte by byte as the files are; a packed one is unpacked first.

Moving points changes lines and never their number, so equal lines face each other: one pass, whatever the size.
"""

from collections.abc import Iterator, Sequence

from cellcal.calibration.documents import DocumentError
from cellcal.calibration.documents.gzip_bytes import unpack_gzip
from cellcal.service.engineering.programs.files import LARGEST_BYTES

_CONTEXT = 3
_GZIP = b"\x1f\x8b"
_NO_NEWLINE = b"\n\\ No newline at end of file\n"


def unified_diff(before: bytes, after: bytes, old_name: str, new_name: str) -> bytes:
    """Return a diff that `patch` applies, empty where nothing changed.

    Raises
    ------
    ValueError
        The number of lines differs: this is no moved program.
    """
    old, new = _split_lines(before), _split_lines(after)
    if len(old) != len(new):
        raise ValueError(f"{new_name}: a moved program keeps its {len(old)} lines, this one has {len(new)}")
    changed = [i for i, pair in enumerate(zip(old, new, strict=True)) if pair[0] != pair[1]]
    if not changed:
        return b""
    head = [f"--- {old_name}\n".encode(errors="surrogateescape")]
    head.append(f"+++ {new_name}\n".encode(errors="surrogateescape"))
    return b"".join(
        [*head, *(part for hunk in _group_hunks(changed) for part in _format_hunk(old, new, hunk))]
    )


def unpack_program(data: bytes) -> bytes:
    """Return a program's text: a .urp file is gzip.

    Raises
    ------
    ValueError
        It is larger than any program, or damaged.
    """
    if not data.startswith(_GZIP):
        return data
    try:
        return unpack_gzip(data, LARGEST_BYTES)
    except DocumentError as error:
        raise ValueError(f"it cannot be unpacked: {error.why}") from error


def _split_lines(data: bytes) -> list[bytes]:
    return unpack_program(data).split(b"\n")


def _group_hunks(changed: Sequence[int]) -> Iterator[list[int]]:
    """Yield changed lines in groups whose contexts touch."""
    group: list[int] = []
    for i in changed:
        if group and i - group[-1] > 2 * _CONTEXT:
            yield group
            group = []
        group.append(i)
    yield group


def _format_hunk(old: Sequence[bytes], new: Sequence[bytes], changed: list[int]) -> Iterator[bytes]:
    lines = len(old) - 1 if old[-1] == new[-1] == b"" else len(old)
    start, stop = max(changed[0] - _CONTEXT, 0), min(changed[-1] + 1 + _CONTEXT, lines)
    yield f"@@ -{start + 1},{stop - start} +{start + 1},{stop - start} @@\n".encode()
    i = start
    while i < stop:
        end = i
        while end < stop and old[end] != new[end]:
            end += 1
        if end == i:
            yield _format_line(b" ", old, i)
            i += 1
            continue
        yield from (_format_line(b"-", old, j) for j in range(i, end))
        yield from (_format_line(b"+", new, j) for j in range(i, end))
        i = end


def _format_line(sign: bytes, lines: Sequence[bytes], i: int) -> bytes:
    return sign + lines[i] + (b"\n" if i < len(lines) - 1 else _NO_NEWLINE)
