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


def read_program_digests(source: FileSource) -> dict[str, str]:
    """Return the hash of each program by its name; "damaged" for a listing that ends before its end."""
    found: dict[str, str] = {}
    for name in source.list_names():
        if not name.endswith(PROGRAM_SUFFIX) or name in _LISTS_OF_ALARMS:
            continue
        content = source.read_file(name)
        head = None if content is None else _PROGRAM.match(content)
        if content is None or head is None:
            continue
        statements = _STATEMENTS.search(content.replace(b"\r\n", b"\n"))
        digest = "damaged" if statements is None else hashlib.sha256(statements[0]).hexdigest()
        found[head[1].decode("cp437").upper()] = digest
    return found
