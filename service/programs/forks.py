"""Work on many programs shared out among the processors, where that pays."""

import multiprocessing
import os
from collections.abc import Callable, Iterator, Sequence
from typing import TypeVar

from service.programs.files import Source

Part = TypeVar("Part")
_WORTH_BYTES = 8 << 20  # below, starting processes costs more than they bring
_AT_ONCE_BYTES = 4 << 20

_work: Callable[[int], object] | None = None  # what a forked process finds


def forked(work: Callable[[Sequence[Source]], Part], sources: Sequence[Source]) -> Iterator[Part]:
    """Yield what work makes of sources, in their order; large lines are worked on by all processors.

    Processes are forked, because what they work with cannot be sent to them; where a system cannot fork, and for
    a few programs, there is one.
    """
    shares = list(_shares(sources, [_size(source) for source in sources]))
    processors = min(_processors(), len(shares))
    if processors < 2 or not pays(sources):
        yield from map(work, shares)
        return
    global _work  # noqa: PLW0603  forked processes inherit it; a closure cannot be sent
    _work = lambda number: work(shares[number])  # noqa: E731  a share's number is sent, its sources are there
    try:
        with multiprocessing.get_context("fork").Pool(processors) as pool:
            yield from pool.imap(_of_share, range(len(shares)))
    finally:
        _work = None


def pays(sources: Sequence[Source]) -> bool:
    """Tell whether sources are large enough, and the system able, to share them out."""
    large = sum(map(_size, sources)) >= _WORTH_BYTES
    return large and "fork" in multiprocessing.get_all_start_methods()


def _of_share(number: int) -> object:
    assert _work is not None
    return _work(number)


def _shares(sources: Sequence[Source], sizes: Sequence[int]) -> Iterator[Sequence[Source]]:
    first = total = 0
    for i, size in enumerate(sizes):
        if total + size > _AT_ONCE_BYTES and i > first:
            yield sources[first:i]
            first, total = i, 0
        total += size
    if first < len(sources):
        yield sources[first:]


def _processors() -> int:
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def _size(source: Source) -> int:
    try:
        return source.path.stat().st_size
    except OSError:
        return 0
