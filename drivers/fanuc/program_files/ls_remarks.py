"""What a program does with positions besides moving to them, and what it lacks.

Statements are looked at, never executed; remarks, disabled lines and comments in brackets are passed over. German
statements are those of public programs of German controllers; other languages are not known. Registers PR[…] are the
same in all.
"""

import re
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cellcal.calibration.message import make_message
from cellcal.drivers.fanuc.program_files.ls_positions import REMOTE
from cellcal.drivers.programs.positions import Positions, Remark

# A controller breaks a long line: what follows has no number, and no letter of a motion right behind the colon.
_NO_END = rb"(?:[^;\n]|;(?![ \t\r]*+(?:\n|\Z)))*+"
_TO_LINE_END = _NO_END + rb"(?:\n[ \t]++:(?![JLCAS][ \t])" + _NO_END + rb")*+"
_SILENT_LINE = re.compile(
    rb"^[ \t]*+\d*+[ \t]*+:[ \t]*+(?://|!|--)"
    + _TO_LINE_END
    + rb"|(?<=:)//"
    + _TO_LINE_END
    + rb"|'[^'\n]*+'",
    re.MULTILINE,
)
_COMMENT = re.compile(rb"(\[ *+(?:GP\d *+: *+)?+\d{1,5}+(?: *+, *+\d{1,2}+)?+) *+:[^\]\n]*+\]")
_SMALL_LETTERS = re.compile(
    rb"^[ \t]*+\d*+[ \t]*+:[ \t]*+[a-z]|^[ \t]*+\d*+[ \t]*+:[JLCAS][ \t]++p", re.MULTILINE
)
_USED = re.compile(rb"P(?<![A-Za-z]P)\[ *+(\d{1,5}+)")

# Each begins with a letter, which is found fast in a million lines.
_KINDS: tuple[tuple[str, str, tuple[bytes, ...]], ...] = (
    (
        "indirect",
        "a register chooses the position ({what}…): which one, only the running program knows.",
        (rb"P(?<![A-Z]P)R?+\[ *+[A-Za-z]{1,3}+\[ *+\d{0,5}+\]?+",),
    ),
    (
        "position_register",
        "{what} is a position register: it is kept in the controller, not in this file.",
        (rb"PR(?<![A-Z]PR)\[ *+(?:GP\d *+: *+)?+\d[^\]\n]{0,80}+\]?+",),
    ),
    (
        "offset",
        "{what} shifts the motion by a register that is not in this file.",
        (rb"Tool_Offset\b", rb"Offset(?<!_Offset)\b", rb"TOOL_OFFSET\b", rb"OFFSET(?<![A-Z_]OFFSET)\b"),
    ),
    (
        "vision",
        "a camera shifts the motion ({what}): the taught position is not where the robot goes.",
        (rb"VR(?<![A-Z]VR)\[ *+\d{0,5}+\]?+", rb"VOFFSET\b", rb"VISION\b"),
    ),
    (
        "relative",
        "{what} makes the motion depend on another position or group, not on the user frame alone.",
        (rb"INC(?<![A-Za-z_]INC)\b", rb"COORD(?<![A-Za-z_]COORD)\b", rb"RTCP(?<![A-Za-z_]RTCP)\b"),
    ),
    (
        "computed",
        "{what} is set or decided while the program runs.",
        (
            rb"UFRAME_NUM *+= *+[A-Z]{1,3}+\[ *+\d{0,5}+\]?+",
            rb"UTOOL_NUM *+= *+[A-Z]{1,3}+\[ *+\d{0,5}+\]?+",
            rb"BENUTZER_NUM *+= *+[A-Za-z]{1,3}+\[ *+\d{0,5}+\]?+",
            rb"WKZ_NUM *+= *+[A-Za-z]{1,3}+\[ *+\d{0,5}+\]?+",
            rb"UFRAME\[[^\]\n]{0,40}+\] *+=",
            rb"UTOOL\[[^\]\n]{0,40}+\] *+=",
            rb"Skip,",
            rb"Interrupt,",
            rb"SKIP CONDITION",
            rb"IRQ BEDINGUNG",
            rb"PALLETIZING",
            rb"PAL_\d",
            rb"Track(?<![A-Za-z]Track)\b",
        ),
    ),
    (
        "foreign",
        "{what} runs another program; its positions are in its own file.",
        (rb"CALL(?<![A-Za-z_]CALL) ++[A-Za-z_]\w{0,40}+", rb"AUFRUF ++[A-Za-z_]\w{0,40}+",
         rb"RUN(?<![A-Za-z_]RUN) ++\w{1,40}+"),
    ),
)  # fmt: skip
_LETTERS = re.compile(rb"[A-Za-z_]+")
_OF_REMOTE_TOOL = (
    "{count} positions are written with RX to RR, as for a tool that stands in the cell; where they are in the user "
    "frame, the listing does not say, and they are left."
)


@dataclass(frozen=True, slots=True)
class _PatternSearch:
    """One expression, and the letters that each of its finds begins with: most programs hold few of them."""

    letters: bytes
    pattern: re.Pattern[bytes]

    @classmethod
    def from_pattern(cls, pattern: bytes) -> "_PatternSearch":
        found = _LETTERS.match(pattern)
        return cls(found[0] if found else b"", re.compile(pattern))


_PATTERNS = tuple(
    (code, text, tuple(map(_PatternSearch.from_pattern, patterns))) for code, text, patterns in _KINDS
)


def remarks_of(data: bytes, start: int, end: int, positions: Positions) -> tuple[Remark, ...]:
    """Return what the statements between two offsets say about positions; line numbers are the file's."""
    statements = _active_statements(data[start:end])
    breaks = np.flatnonzero(np.frombuffer(statements, dtype=np.uint8) == ord("\n"))
    first_line = data.count(b"\n", 0, start) + 1
    remarks = [
        Remark(first_line + line, code, make_message(text, what=what))
        for code, text, searches in _PATTERNS
        for line, what in _find_occurrences(searches, statements, breaks, once=code == "foreign")
    ]
    remarks += _of_remote(positions)
    remarks += _unused_and_missing_remarks(
        statements, first_line, positions, {remark.code for remark in remarks}
    )
    return tuple(sorted(remarks, key=lambda remark: remark.line))


def statements_of(data: bytes) -> tuple[int, bytes]:
    """Return the line at which a listing's statements begin, and their text, comments and remarks blanked."""
    start, end = data.find(b"/MN"), data.rfind(b"/POS")
    start = max(start, 0)
    return data.count(b"\n", 0, start) + 1, _active_statements(
        data[start : end if end > start else len(data)]
    )


def _active_statements(statements: bytes) -> bytes:
    """Return statements without comments; in capitals where an editor wrote one in small letters."""
    active = _COMMENT.sub(_blanked_comment, _SILENT_LINE.sub(_blank_match, statements))
    return active.upper() if _SMALL_LETTERS.search(active) else active


def _blank_match(found: re.Match[bytes]) -> bytes:
    return b"\n".join(b" " * len(line) for line in found[0].split(b"\n"))


def _blanked_comment(found: re.Match[bytes]) -> bytes:
    number = found[1]
    return number + b"]" + b" " * (len(found[0]) - len(number) - 1)


def _find_occurrences(
    searches: tuple[_PatternSearch, ...], statements: bytes, breaks: NDArray[np.int64], *, once: bool
) -> Iterator[tuple[int, str]]:
    """Yield line (from 0) and text, one a line, or one a text with ``once``."""
    yielded: set[object] = set()
    for search in searches:
        if search.letters not in statements:
            continue
        found = [(match.start(), match[0]) for match in search.pattern.finditer(statements)]
        if not found:  # as nearly always
            continue
        lines = np.searchsorted(breaks, [at for at, _ in found]).tolist()
        for line, (_, text) in zip(lines, found, strict=True):
            key = text if once else line
            if key not in yielded:
                yielded.add(key)
                yield line, text.decode("cp437")


def _of_remote(positions: Positions) -> Iterator[Remark]:
    if REMOTE in positions.kinds:
        line = int(positions.lines[positions.kinds.index(REMOTE)])
        yield Remark(line, "relative", make_message(_OF_REMOTE_TOOL, count=positions.kinds.count(REMOTE)))


def _unused_and_missing_remarks(
    statements: bytes, first_line: int, positions: Positions, codes: set[str]
) -> Iterator[Remark]:
    used = set(map(int, _USED.findall(statements)))
    recorded = {int(name[2:-1]) for name in positions.names}
    missing = used - recorded
    places = {int(use[1]): use.start() for use in reversed([*_USED.finditer(statements)])} if missing else {}
    for number in sorted(missing):
        line = first_line + statements.count(b"\n", 0, places[number])
        yield Remark(
            line,
            "missing",
            make_message("P[{number}] is used here, but not recorded under /POS.", number=number),
        )
    spare = sorted(recorded - used)
    if spare and "indirect" not in codes:
        shown = ", ".join(f"P[{number}]" for number in spare[:20]) + (" and more" if len(spare) > 20 else "")
        yield Remark(
            0,
            "unused",
            make_message(
                "{spare_count} positions are recorded, but no statement uses them: {shown}.",
                spare_count=len(spare),
                shown=shown,
            ),
        )
