"""Programs of a whole line: the door line's own, again and again, every point a little elsewhere."""

import re
import shutil
from pathlib import Path

import numpy as np

DOOR_LINE = Path(__file__).parents[2] / "deploy" / "example_projects" / "door_line"
_RECORD = re.compile(rb"P\[\d+\]\{.*?\n\};\n", re.DOTALL)
_FIELD = re.compile(rb"([XYZWPR] =)( *-?\d*\.\d+)")
_MOVE = re.compile(rb"P\[\d+\]")
_SPREAD_MM, _SPREAD_DEG = 25.0, 2.0


def line_of_programs(folder: Path, programs: int, points: int, seed: int = 1) -> tuple[Path, Path]:
    """Write a copy of the door line whose master has ``programs`` listings of ``points`` points each.

    Returns the project files of the master and of the clone.
    """
    for cell in ("cell_1", "cell_7"):
        shutil.copytree(DOOR_LINE / cell, folder / cell, ignore=shutil.ignore_patterns("programs"))
    place = folder / "cell_1" / "programs"
    place.mkdir()
    rng = np.random.default_rng(seed)
    patterns = [path.read_bytes() for path in sorted((DOOR_LINE / "cell_1" / "programs").glob("*.LS"))]
    for number in range(programs):
        name = b"LINE%05d" % number
        (place / f"{name.decode()}.LS").write_bytes(
            _program_listing(patterns[number % len(patterns)], name, points, rng)
        )
    return folder / "cell_1" / "project.toml", folder / "cell_7" / "project.toml"


def _program_listing(pattern: bytes, name: bytes, points: int, rng: np.random.Generator) -> bytes:
    head, _, rest = pattern.partition(b"/MN\n")
    instructions = rest.partition(b"/POS\n")[0].splitlines()
    statements = [line.partition(b":")[2] for line in instructions if b"P[" not in line.replace(b"PR[", b"")]
    move = next(line.partition(b":")[2] for line in instructions if b"P[" in line.replace(b"PR[", b""))
    moves = [_MOVE.sub(b"P[%d]" % (i + 1), move) for i in range(points)]
    numbered_lines = [
        b"%4d:%s" % (i + 1, text) for i, text in enumerate([*statements[:-1], *moves, statements[-1]])
    ]
    head = re.sub(rb"^/PROG  \S+", b"/PROG  " + name, head)
    head = re.sub(rb"LINE_COUNT\t= \d+", b"LINE_COUNT\t= %d" % len(numbered_lines), head)
    records = [_RECORD.sub(_record_pattern, found) for found in _RECORD.findall(pattern)]
    values = [[float(text) for _, text in _FIELD.findall(found)] for found in _RECORD.findall(pattern)]
    moved = np.array([values[i % len(values)] for i in range(points)])
    moved += rng.uniform(-1, 1, moved.shape) * np.repeat([_SPREAD_MM, _SPREAD_DEG], 3)
    moved[:, 3:] = np.remainder(moved[:, 3:] + 180.0, 360.0) - 180.0
    body = [
        records[i % len(records)] % (i + 1, *map(_format_coordinate, row))
        for i, row in enumerate(moved.tolist())
    ]
    return b"%s/MN\n%s\n/POS\n%s/END\n" % (head, b"\n".join(numbered_lines), b"".join(body))


def _record_pattern(record: re.Match[bytes]) -> bytes:
    """Return a record as a pattern that takes its number and its six coordinates."""
    text = re.sub(rb"^P\[\d+\]", b"P[%d]", record[0].replace(b"%", b"%%"))
    return _FIELD.sub(rb"\1%s", text)


def _format_coordinate(value: float) -> bytes:
    """Write a coordinate as the controller does: right-aligned in ten places, without a zero before the point."""
    text = b"%.3f" % value
    return (text.replace(b"0.", b".", 1) if -1.0 < value < 1.0 else text).rjust(10)
