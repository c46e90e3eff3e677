"""Which programs a controller holds, each with a hash of what it does: its statements and positions.

The head of a listing is left out: it holds sizes and dates that change without the program.
"""

import hashlib
import re

from cellcal.drivers.fanuc.controller_files.file_sources import PROGRAM_SUFFIX, FileSource
from cellcal.drivers.fanuc.controller_files.ftp_replies import FileNotGivenError

UNREAD_DIGEST = "not read"
_PROGRAM = re.compile(rb"\A\s*/PROG\s+(\S+)", re.IGNORECASE)
_STATEMENTS = re.compile(rb"^/MN\b.*?(?=^/END\b)", re.MULTILINE | re.DOTALL)
_GROUPS = re.compile(rb"^DEFAULT_GROUP[ \t]*=([^;\n]*);", re.MULTILINE | re.IGNORECASE)
_LISTS_OF_ALARMS = frozenset(
    f"{name}.ls"
    for name in (
        *(
            "errall",
            "erract",
            "errhist",
            "errapp",
            "errcomm",
            "errcurr",
            "errext",
            "errmot",
            "errpwd",
            "errsys",
        ),
        *("logbook", "hist", "histe", "histi", "histp", "hists"),
    )
)


def statements_of(content: bytes) -> bytes | None:
    """Return statements and positions of a listing, whatever its line ends; None of one that has no end."""
    found = _STATEMENTS.search(content.replace(b"\r\n", b"\n"))
    return None if found is None else found[0]


def groups_of(content: bytes) -> bytes:
    """Return the motion groups that a listing moves, as its head states them, without those at the end it has not."""
    found = _GROUPS.search(content)
    return b"" if found is None else re.sub(rb"(?:,\*)*$", b"", b"".join(found[1].split()))


def is_program_name(name: str) -> bool:
    """Whether a file is the listing of a program, by its name in lower case."""
    return name.endswith(PROGRAM_SUFFIX) and name not in _LISTS_OF_ALARMS


def read_program_digests(source: FileSource) -> dict[str, str]:
    """Return the hash of each program by its name.

    "damaged" stands for a listing that ends before its end, UNREAD_DIGEST for one that is named and not given.
    """
    found: dict[str, str] = {}
    for name in source.list_names():
        if not is_program_name(name):
            continue
        content = _read_or_none(source, name)
        if content is None:
            found[name.removesuffix(PROGRAM_SUFFIX).upper()] = UNREAD_DIGEST
            continue
        head = _PROGRAM.match(content)
        if head is None:
            continue
        statements = statements_of(content)
        digest = "damaged" if statements is None else hashlib.sha256(statements).hexdigest()
        found[head[1].decode("cp437").upper()] = digest
    return found


def _read_or_none(source: FileSource, name: str) -> bytes | None:
    try:
        return source.read_file(name)
    except FileNotGivenError:
        return None
