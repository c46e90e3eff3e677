"""Tests that take long are listed in a file: `make test` leaves them out, `make soak ARGS=long_tests` runs them.

Each takes several seconds of processor time, and a shorter test of the same property stays in the usual suite.
"""

from collections.abc import Iterable
from pathlib import Path

import pytest

TESTS = Path(__file__).parent
LIST = TESTS / "long_tests.txt"


def mark_long_tests(items: Iterable[pytest.Item], names: frozenset[str]) -> None:
    """Mark the listed tests with `soak`."""
    for item in items:
        if item.nodeid in names:
            item.add_marker(pytest.mark.soak)


def names_without_test(items: Iterable[pytest.Item], names: Iterable[str]) -> list[str]:
    """Return the listed names that no test has, of the files that were collected and of files that are gone."""
    collected = {item.nodeid for item in items}
    files = {name.partition("::")[0] for name in collected}
    return sorted(
        name
        for name in names
        if name not in collected
        and ((file := name.partition("::")[0]) in files or not (TESTS.parent / file).is_file())
    )


def read_long_tests() -> frozenset[str]:
    """Return the names of the tests that take long, one in each line of the list."""
    return frozenset(LIST.read_text(encoding="utf-8").split("\n")) - {""}
