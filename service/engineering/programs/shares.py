"""Many programs shared out among the processors, each with what the others say of its positions."""

from collections.abc import Callable, Iterator, Sequence
from typing import TypeVar

from cellcal.service.engineering.programs.files import Source
from cellcal.service.engineering.programs.forks import forked
from cellcal.service.engineering.programs.siblings import read_siblings

Part = TypeVar("Part")


def shared_out(work: Callable[[Sequence[Source]], Part], sources: Sequence[Source]) -> Iterator[Part]:
    """Yield what work makes of sources, in their order; large lines are worked on by all processors."""
    read_siblings(sources)
    yield from forked(work, sources)
