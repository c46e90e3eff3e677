"""Damaged answers of controllers are refused in the way that the drivers expect; the long run is `wire_answers`."""

import pytest

from tests.soak.controllers import READERS, wire_answers


def test_each_example_is_read_whole() -> None:
    for read, example in READERS.values():
        assert read(example) is not None


@pytest.mark.parametrize("count", [300])
def test_no_damaged_answer_ends_in_an_unexpected_error(count: int) -> None:
    figures = wire_answers(count)
    assert figures.reached, figures.line
