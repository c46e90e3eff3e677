"""Code tables of makers and standards, kept as TSV beside the package that uses them."""

import csv
from dataclasses import dataclass
from functools import cache
from importlib.resources import files


@dataclass(frozen=True, slots=True)
class CodeEntry:
    """The meaning of one code: ``kind`` says which error it becomes, the rest is for people."""

    code: int
    kind: str
    text: str
    remedy: str


@cache
def code_table(package: str, name: str) -> dict[int, CodeEntry]:
    """Read ``name`` from ``package``: columns code (decimal or 0x…), kind, text, remedy."""
    rows = read_table_rows(package, name)
    entries = (CodeEntry(int(row["code"], 0), row["kind"], row["text"], row["remedy"]) for row in rows)
    return {entry.code: entry for entry in entries}


def read_table_rows(package: str, name: str) -> tuple[dict[str, str], ...]:
    """Read the rows of a table of a package by their headings; lines that begin with # are remarks."""
    lines = files(package).joinpath(name).read_text(encoding="utf-8").splitlines()
    return tuple(csv.DictReader((line for line in lines if not line.startswith("#")), delimiter="\t"))
