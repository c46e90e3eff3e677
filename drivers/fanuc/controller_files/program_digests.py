"""Which programs a controller holds, each with a hash of what it does: its statements and positions.

The head of a listing is left out: it holds sizes and dates that change without the program.
"""

import hashlib
import re

from cellcal.drivers.fanuc.controller_files.file_sources import PROGRAM_SUFFIX, FileSource

_PROGRAM = re.compile(rb"\A\s*/PROG\s+(\S+)", re.IGNORECASE)
_STATEMENTS = re.compile(rb"^/MN\b.*?(?=^/END\b)", re.MULTILINE | re.DOTALL)
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


def is_program_name(name: str) -> bool:
    """Whether a file is the listing of a program, by its name in lower case."""
    return name.endswith(PROGRAM_SUFFIX) and name not in _LISTS_OF_ALARMS


def read_program_digests(source: FileSource) -> dict[str, str]:
    """Return the hash of each program by its name.

    "damaged" stands for a listing that ends before its end, "not read" for one that is named and not given.
    """
    found: dict[str, str] = {}
    for name in source.list_names():
        if not is_program_name(name):
            continue
        content = source.read_file(name)
        if content is None:
            found[name.removesuffix(PROGRAM_SUFFIX).upper()] = "not read"
            continue
        head = _PROGRAM.match(content)
        if head is None:
            continue
        statements = statements_of(content)
        digest = "damaged" if statements is None else hashlib.sha256(statements).hexdigest()
        found[head[1].decode("cp437").upper()] = digest
    return found
