"""Docstrings, comments and documents name what exists, and say it in plain words."""

import ast
import re
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import NamedTuple

import pytest

ROOT = Path(__file__).parents[2]
PACKAGES = ("calibration", "drivers", "procedures", "service", "fake_devices", "deploy", "tests")
QUOTED_NAME = re.compile(r"`([A-Za-z_][\w.]*)(?:\(\))?`")
METAPHOR = re.compile(r"\b(desk|furniture|entrance|lends?|lent|control door)\b", re.IGNORECASE)
INDEFINITE_PERSON = re.compile(r"\b(whoever|(no|some|any|every)body)\b", re.IGNORECASE)
LISTED_FILE = re.compile(r"`([\w.-]+\.py)`")
QUOTED_FILE = re.compile(r"`([\w.-]+/[\w./-]+\.(?:py|ts|svelte|css|sh))`")
TOKEN = re.compile(
    r'''""".*?(?<!\\)"""|\d\w*'''
    r"""|(?P<text>"(?:\\.|[^"\\\n])*"|'(?:\\.|[^'\\\n])*')"""
    r"|(?P<comment>#[^\n]*)|(?P<name>[^\W\d]\w*)",
    re.DOTALL,
)
# Written in backticks without being a name of the code: symbols of formulas, words of a controller's programs, and
# examples of names.
OTHER_WORDS = frozenset(
    ("P_k", "link_1", "W_deg", "P_deg", "R_deg", "BC00003", "BP003", "EC00003", "EX003", "arm_1")
)


@cache
def sources() -> dict[str, str]:
    """Return the text of each Python file by its path in the tree."""
    return {
        str(file.relative_to(ROOT)): file.read_text(encoding="utf-8")
        for package in PACKAGES
        for file in sorted((ROOT / package).rglob("*.py"))
    }


class FileWords(NamedTuple):
    """What a file contains: its names with the words of its short strings, and its docstrings and comments by line."""

    words: frozenset[str]
    remarks: tuple[tuple[int, str], ...]


def documented_nodes(
    parent: ast.AST,
) -> Iterator[ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef]:
    """Yield what has a docstring in a module, from the statements alone: expressions hold none and are many."""
    if isinstance(parent, ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef):
        yield parent
    for part in ("body", "orelse", "handlers", "finalbody", "cases"):
        for child in getattr(parent, part, ()):
            yield from documented_nodes(child)


@cache
def words_of_file(path: str) -> FileWords:
    """Read a file once, by one expression: Python's own tokens take ten times as long."""
    text = sources()[path]
    words = {part.removesuffix(".py") for part in Path(path).parts}
    remarks = [
        (getattr(node, "lineno", 1), ast.get_docstring(node) or "")
        for node in documented_nodes(ast.parse(text))
    ]
    line, counted = 1, 0
    for token in TOKEN.finditer(text):
        if token.lastgroup == "name":
            words.add(token.group())
        elif token.lastgroup == "text":
            words.update(re.findall(r"\w+", token.group()))
        elif token.lastgroup == "comment":
            line, counted = line + text.count("\n", counted, token.start()), token.start()
            remarks.append((line, token.group()))
    return FileWords(frozenset(words), tuple(remarks))


@cache
def words_of_the_code() -> frozenset[str]:
    """Return every name of the code, every word of its short strings, and the names of files and folders."""
    return frozenset().union(*(words_of_file(path).words for path in sources()))


def remarks_of(package: str) -> Iterator[tuple[str, str]]:
    """Yield place and text of each docstring and comment of a package."""
    for path in sources():
        if Path(path).parts[0] == package:
            yield from ((f"{path}:{line}", remark) for line, remark in words_of_file(path).remarks)


@pytest.mark.parametrize("package", PACKAGES)
def test_names_in_docstrings_and_comments_are_in_the_code(package: str) -> None:
    found = [(place, name) for place, remark in remarks_of(package) for name in QUOTED_NAME.findall(remark)]
    known_words = words_of_the_code() | OTHER_WORDS
    unknown = [
        f"{place} {name}" for place, name in found if not {name, name.rpartition(".")[2]} & known_words
    ]
    assert found
    assert not unknown


@pytest.mark.parametrize("package", PACKAGES)
def test_docstrings_and_comments_contain_no_metaphors(package: str) -> None:
    found = [f"{place} {word}" for place, remark in remarks_of(package) for word in METAPHOR.findall(remark)]
    assert not found


def own_documents(folder: Path) -> list[Path]:
    """Return the documents below a folder that are ours: not those of installed packages."""
    return [file for file in folder.rglob("*.md") if "node_modules" not in file.parts]


def test_files_that_a_document_names_are_in_the_tree() -> None:
    documents = [
        *ROOT.glob("*.md"),
        *(file for package in PACKAGES for file in own_documents(ROOT / package)),
    ]
    missing = [
        f"{document.relative_to(ROOT)}: {path}"
        for document in documents
        if "dist" not in document.parts
        for path in QUOTED_FILE.findall(document.read_text(encoding="utf-8"))
        if not any(
            (folder / path).exists()
            for folder in (ROOT, document.parent, *(ROOT / each for each in PACKAGES))
        )
    ]
    assert len(documents) > 10
    assert not missing


def documents() -> list[Path]:
    """Return the documents for readers of the code; the history keeps the words of its time."""
    history = {"CHANGELOG.md", "DECISIONS.md"}
    found = [file for package in PACKAGES for file in sorted(own_documents(ROOT / package))]
    return [*found, *(file for file in sorted(ROOT.glob("*.md")) if file.name not in history)]


@pytest.mark.parametrize("file", documents(), ids=lambda file: str(file.relative_to(ROOT)))
def test_documents_are_written_in_plain_words(file: Path) -> None:
    lines = enumerate(file.read_text(encoding="utf-8").splitlines(), 1)
    found = [
        f"{number}: {line}"
        for number, line in lines
        if METAPHOR.search(line) or INDEFINITE_PERSON.search(line)
    ]
    assert not found


@pytest.mark.parametrize(
    "file",
    [file for file in documents() if file.parent != ROOT],
    ids=lambda file: str(file.relative_to(ROOT)),
)
def test_files_that_a_readme_lists_are_in_its_folder(file: Path) -> None:
    below = {python.name for python in file.parent.rglob("*.py")}
    assert not set(LISTED_FILE.findall(file.read_text(encoding="utf-8"))) - below
