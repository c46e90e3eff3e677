"""A diff applied as `patch` does it, strictly: every line that it names must stand where it says."""

import re

_HUNK = re.compile(rb"@@ -(\d+),(\d+) \+(\d+),(\d+) @@")


def apply_diff(old: bytes, diff: bytes) -> bytes:
    """Return the new file."""
    lines, new, at = old.split(b"\n"), [], 0
    rows = diff.split(b"\n")[2:-1]
    for i, row in enumerate(rows):
        hunk = _HUNK.fullmatch(row)
        if hunk:
            start = int(hunk[1]) - 1
            new += lines[at:start]
            at = start
            continue
        if row.startswith(b"\\"):
            continue
        last = i + 1 < len(rows) and rows[i + 1].startswith(b"\\")
        if row[:1] in b" -":
            assert lines[at] == row[1:], (at, lines[at], row)
            assert (at == len(lines) - 1) == last
            at += 1
        if row[:1] in b" +":
            new.append(row[1:])
    return b"\n".join([*new, *lines[at:]])
