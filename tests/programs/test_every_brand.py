"""A slice of the campaigns of ``make soak``, for every brand that is registered."""

import re

import pytest

from cellcal.drivers.program_registry import SUFFIXES, all_brands, read_program
from cellcal.drivers.programs.errors import ProgramFileError
from tests.programs.fuzz import (
    GeneratorSource,
    check_mutants,
    check_roundtrip,
    generator_sources,
    token_invariant,
)

_SOURCES = generator_sources()


@pytest.mark.parametrize("source", _SOURCES, ids=lambda source: source.name)
def test_a_file_is_printed_as_it_was_read(source: GeneratorSource):
    tally = check_roundtrip(source.brand, source.generate, range(50), suffix=source.suffix)
    assert not tally.failures
    assert tally.positions > 150


@pytest.mark.parametrize("source", _SOURCES, ids=lambda source: source.name)
def test_a_changed_position_changes_its_coordinates_and_nothing_else(source: GeneratorSource):
    proved = [
        token_invariant(
            source.brand,
            source.generate(seed),
            seed,
            suffix=source.suffix,
            unpacked=source.unpacked,
            consistent=source.consistent,
        )
        for seed in range(60)
    ]
    assert sum(proved) >= 50


@pytest.mark.parametrize("source", _SOURCES, ids=lambda source: source.name)
def test_a_damaged_file_is_refused_or_kept_to_the_last_byte(source: GeneratorSource):
    tally = check_mutants(
        source.brand,
        source.generate,
        range(300),
        suffix=source.suffix,
        unpacked=source.unpacked,
        packed=source.packed,
        consistent=source.consistent,
    )
    assert not tally.failures
    assert tally.refused > 30
    assert tally.changed > 30


@pytest.mark.parametrize("source", _SOURCES, ids=lambda source: source.name)
def test_a_number_of_thousands_of_digits_is_refused_or_kept(source: GeneratorSource):
    whole = source.unpacked(source.generate(4))
    remedies = []
    for number in list(re.finditer(rb"\d+", whole))[::3]:
        data = source.packed(whole[: number.start()] + b"9" * 5000 + whole[number.end() :])
        try:
            assert source.brand.read(f"generated{source.suffix}", data).to_bytes() == data
        except ProgramFileError as error:
            remedies.append(error.remedy)
    assert remedies
    assert all(remedies)


def test_a_brand_s_suffixes_are_known_before_it_is_loaded():
    assert {brand.brand: brand.suffixes for brand in all_brands()} == dict(SUFFIXES)


@pytest.mark.parametrize(("name", "what"), [("A.TP", "binary"), ("a.urpx", "PolyScope X"), ("a.kl", "KAREL")])
def test_a_form_that_no_reader_takes_says_what_it_is(name: str, what: str) -> None:
    with pytest.raises(ProgramFileError, match=what) as refused:
        read_program(name, b"\0\1\2")
    assert refused.value.remedy
