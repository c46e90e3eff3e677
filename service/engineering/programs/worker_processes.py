"""Work on many programs shared out among the processors, where that pays."""

import multiprocessing
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from typing import TypeVar, cast

from cellcal.service.engineering.forked_processes import prepare_process as _prepare_process
from cellcal.service.engineering.forked_processes import processor_count as _processor_count
from cellcal.service.engineering.programs.files import FilesError, ProgramSource

Part = TypeVar("Part")
_WORTH_BYTES = 8 << 20  # below, starting processes costs more than they bring
_AT_ONCE_BYTES = 4 << 20

_work: Callable[[int], object] | None = None  # what a forked process finds


def run_in_processes(
    work: Callable[[Sequence[ProgramSource]], Part], sources: Sequence[ProgramSource]
) -> Iterator[Part]:
    """Yield what work makes of sources, in their order; large lines are worked on by all processors.

    Processes are forked, because what they work with cannot be sent to them; where a system cannot fork, and for
    a few programs, there is one.
    """
    shares = list(_split_shares(sources, [_file_size(source) for source in sources]))
    processors = min(_processor_count(), len(shares))
    if processors < 2 or not is_worthwhile(sources):
        yield from map(work, shares)
        return
    global _work  # noqa: PLW0603  forked processes inherit it; a closure cannot be sent
    _work = lambda number: work(shares[number])  # noqa: E731  a share's number is sent, its sources are there
    context = multiprocessing.get_context("fork")
    try:
        with ProcessPoolExecutor(processors, context, _prepare_process) as pool:
            yield from cast(Iterator[Part], pool.map(_of_share, range(len(shares))))
    except BrokenProcessPool:
        raise FilesError(
            "A process that worked on the programs was ended from outside.",
            remedy="Memory was full, perhaps: give fewer programs at once.",
        ) from None
    finally:
        _work = None


def is_worthwhile(sources: Sequence[ProgramSource]) -> bool:
    """Return whether sources are large enough, and the system able, to share them out."""
    large = sum(map(_file_size, sources)) >= _WORTH_BYTES
    return large and "fork" in multiprocessing.get_all_start_methods()


def _of_share(number: int) -> object:
    assert _work is not None
    return _work(number)


def _split_shares(
    sources: Sequence[ProgramSource], sizes: Sequence[int]
) -> Iterator[Sequence[ProgramSource]]:
    first = total = 0
    for i, size in enumerate(sizes):
        if total + size > _AT_ONCE_BYTES and i > first:
            yield sources[first:i]
            first, total = i, 0
        total += size
    if first < len(sources):
        yield sources[first:]


def _file_size(source: ProgramSource) -> int:
    try:
        return source.path.stat().st_size
    except OSError:
        return 0
