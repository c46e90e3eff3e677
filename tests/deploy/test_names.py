"""Names in Python are plain: no bare participles or metaphors, few one-word functions, one meaning for a class name."""

import ast
import re
from collections import defaultdict
from collections.abc import Iterable, Iterator
from functools import cache
from pathlib import Path
from typing import NamedTuple

import pytest

ROOT = Path(__file__).parents[2]
PACKAGES = ("calibration", "drivers", "procedures", "service", "fake_devices")
PARTICIPLES = frozenset(
    (
        "told",
        "said",
        "heard",
        "seen",
        "held",
        "kept",
        "given",
        "known",
        "asked",
        "lent",
        "wanted",
        "left",
        "untold",
        "unsaid",
        "ungiven",
        "felt",
        "hoped",
        "dealt",
        "foreseen",
        "forgiven",
        "vouched",
    )
)
METAPHORS = frozenset(
    (
        "house",
        "door",
        "desk",
        "entrance",
        "hands",
        "furniture",
        "mishap",
        "mishaps",
        "paper",
        "carrier",
        "story",
        "storyteller",
        "teller",
        "dice",
        "keepsake",
        "outlook",
        "hover",
        "greet",
        "spoil",
        "stranger",
        "surprise",
        "twin",
        "wish",
        "glance",
        "whoever",
        "nobody",
        "somebody",
    )
)  # fmt: skip  `room` is a setting of procedures that journals and cell files contain
MOST_PLAIN_FAULTS = 3.0  # of 1000 identifiers
MOST_ONE_WORD = 0.25  # of the functions of a package
FEWEST_FUNCTIONS = 20  # of a subpackage whose share says something
MOST_PERSON_LINES = 10  # of the five packages together: a class name and a code that journals contain
INDEFINITE_PERSON = re.compile("whoever|(no|some|any|every)body|(some|any|every)one", re.IGNORECASE)
# Class names that two packages use on purpose: fakes share no code with drivers, and the words are the field's.
SHARED_CLASS_NAMES: frozenset[str] = frozenset(("RuntimeState", "Waypoint"))


class PackageNames(NamedTuple):
    """The names that a package defines; its syntax trees would fill a gigabyte and are not kept."""

    identifiers: tuple[str, ...]
    functions: tuple[str, ...]
    public_classes: frozenset[str]


@cache
def names_of(package: str) -> PackageNames:
    """Return the names of a package."""
    found, functions, classes = list[str](), list[str](), set[str]()
    for file in sorted((ROOT / package).rglob("*.py")):
        nodes = list(ast.walk(ast.parse(file.read_text(encoding="utf-8"))))
        found += identifiers(nodes)
        functions += function_names(nodes)
        classes |= {node.name for node in nodes if isinstance(node, ast.ClassDef)}
    return PackageNames(
        tuple(found), tuple(functions), frozenset(name for name in classes if not name.startswith("_"))
    )


def identifiers(nodes: Iterable[ast.AST]) -> Iterator[str]:
    """Yield the names that a file's nodes define: functions, classes, parameters, variables, attributes."""
    for node in nodes:
        match node:
            case ast.FunctionDef(name=name) | ast.AsyncFunctionDef(name=name) | ast.ClassDef(name=name):
                yield name
            case ast.arg(arg=name):
                yield name
            case ast.Name(id=name, ctx=ast.Store()) | ast.Attribute(attr=name, ctx=ast.Store()):
                yield name


def function_names(nodes: Iterable[ast.AST]) -> Iterator[str]:
    """Yield the names of functions and methods, special methods excluded."""
    for node in nodes:
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef) and not node.name.startswith("__"):
            yield node.name


def class_packages() -> dict[str, set[str]]:
    """Return in which packages each public class name occurs."""
    found: dict[str, set[str]] = defaultdict(set)
    for package in PACKAGES:
        for name in names_of(package).public_classes:
            found[name].add(package)
    return found


@pytest.mark.parametrize("words", [PARTICIPLES, METAPHORS], ids=("participles", "metaphors"))
@pytest.mark.parametrize("package", [*PACKAGES, "tests"])
def test_bare_participles_and_metaphors_are_rare_as_names(package: str, words: frozenset[str]) -> None:
    names = names_of(package).identifiers
    faults = [name for name in names if name.strip("_").lower() in words]
    assert len(names) > 1000
    assert 1000 * len(faults) / len(names) <= MOST_PLAIN_FAULTS, sorted(set(faults))


@pytest.mark.parametrize("package", [*PACKAGES, "deploy", "tests"])
def test_function_names_have_more_than_one_word(package: str) -> None:
    names = names_of(package).functions
    one_word = [name for name in names if "_" not in name.strip("_")]
    assert len(names) > 20
    assert len(one_word) / len(names) <= MOST_ONE_WORD, sorted(set(one_word))


def test_function_names_of_each_subpackage_have_more_than_one_word() -> None:
    """Names that the interfaces of devices demand do not count: one driver may hold little else."""
    demanded = frozenset(names_of("drivers/interfaces").functions)
    shares = {}
    for folder in sorted(
        {file.parent.relative_to(ROOT) for p in PACKAGES for file in (ROOT / p).rglob("*.py")}
    ):
        names = [name for name in names_of(str(folder)).functions if name not in demanded]
        if len(names) > FEWEST_FUNCTIONS:
            shares[str(folder)] = sum("_" not in name.strip("_") for name in names) / len(names)
    assert len(shares) > 40
    assert {folder: share for folder, share in shares.items() if share > MOST_ONE_WORD} == {}


def test_indefinite_persons_are_rare() -> None:
    lines = [
        f"{file.relative_to(ROOT)}:{number}"
        for package in PACKAGES
        for file in sorted((ROOT / package).rglob("*.py"))
        for number, line in enumerate(file.read_text(encoding="utf-8").splitlines(), 1)
        if INDEFINITE_PERSON.search(line)
    ]
    assert len(lines) <= MOST_PERSON_LINES, lines


def test_a_class_name_occurs_in_one_package() -> None:
    shared = {name for name, packages in class_packages().items() if len(packages) > 1}
    assert shared == SHARED_CLASS_NAMES, sorted(shared ^ SHARED_CLASS_NAMES)
