"""Program files by the ten thousand: printed as read, and damaged in every way, for every brand."""

import sys
import time
from collections.abc import Callable
from functools import partial

from tests.programs.fuzz import (
    FuzzTally,
    GeneratorSource,
    check_mutants,
    check_roundtrip,
    generator_sources,
    split_range,
    token_invariant,
)
from tests.soak.campaign_figures import CampaignFigures

_BLOCK = 2000
_SLOWEST_S = 1.0


def of_one_generator() -> dict[str, tuple[Callable[[int], CampaignFigures], int]]:
    """Return both campaigns of one brand's files, as ``programs_mutated.kuka``."""
    return {
        f"{name}.{source.name}": (partial(campaign, only=source.name), full)
        for name, campaign, full in (
            ("programs_roundtrip", programs_roundtrip, 10_000),
            ("programs_mutated", programs_mutated, 100_000),
        )
        for source in generator_sources()
    }


def _sources_of(only: str) -> list[GeneratorSource]:
    return [source for source in generator_sources() if only in ("", source.name)]


def programs_roundtrip(count: int, only: str = "") -> CampaignFigures:
    """Parse and print ``count`` generated files a generator; every tenth is also changed and compared."""
    words, reached = [], True
    for source in _sources_of(only):
        tally = check_roundtrip(source.brand, source.generate, range(count), suffix=source.suffix)
        proved, wrong = _count_changes(source, count // 10)
        reached &= not tally.failures and not wrong
        words.append(
            f"{source.name} {tally.files - len(tally.failures)} of {tally.files} files byte-identical "
            f"({tally.positions} positions), {proved} changed in coordinates only, {len(wrong)} otherwise"
        )
        _print_failures(tally.failures + wrong)
    return CampaignFigures("programs_roundtrip: " + "; ".join(words), reached)


def _count_changes(source: GeneratorSource, count: int) -> tuple[int, list[str]]:
    proved, wrong = 0, []
    for seed in range(count):
        try:
            data = source.generate(seed)
            proved += token_invariant(
                source.brand,
                data,
                seed,
                suffix=source.suffix,
                unpacked=source.unpacked,
                consistent=source.consistent,
            )
        except Exception as error:
            wrong.append(f"{source.name} seed {seed}: {type(error).__name__}: {error}")
    return proved, wrong


def programs_mutated(count: int, only: str = "") -> CampaignFigures:
    """Read ``count`` damaged files a generator: refused, or kept with every byte and every point."""
    words, reached = [], True
    for source in _sources_of(only):
        total = FuzzTally()
        for seeds in split_range(count, _BLOCK):
            _add_tally(total, _tally_mutants(source, seeds))
            sys.stderr.write(
                f"{time.strftime('%H:%M:%S')} {source.name} {seeds.stop} of {count}, {len(total.failures)} failures\n"
            )
        reached &= not total.failures and total.slowest_s < _SLOWEST_S
        words.append(
            f"{source.name} {total.files} damaged files: {len(total.failures)} crashes or changed points, "
            f"{total.refused} refused ({total.located} with a line), "
            f"{total.changed} read and changed in coordinates only, "
            f"slowest {total.slowest_s:.2f} s CPU (seed {total.slowest_seed})"
        )
        _print_failures(total.failures)
    return CampaignFigures("programs_mutated: " + "; ".join(words), reached)


def _tally_mutants(source: GeneratorSource, seeds: range) -> FuzzTally:
    return check_mutants(
        source.brand,
        source.generate,
        seeds,
        suffix=source.suffix,
        unpacked=source.unpacked,
        packed=source.packed,
        consistent=source.consistent,
    )


def _add_tally(total: FuzzTally, part: FuzzTally) -> None:
    total.files += part.files
    total.positions += part.positions
    total.refused += part.refused
    total.located += part.located
    total.changed += part.changed
    total.failures += part.failures
    total.note_duration(part.slowest_s, part.slowest_seed)


def _print_failures(failures: list[str]) -> None:
    for failure in failures[:20]:
        sys.stderr.write(f"  {failure[:300]}\n")
