"""Many programs shared out among the processors, each with what the others say of its positions."""

from collections.abc import Callable, Iterator, Sequence
from typing import TypeVar

from cellcal.service.engineering.programs.files import ProgramSource
from cellcal.service.engineering.programs.siblings import read_siblings
from cellcal.service.engineering.programs.worker_processes import run_in_processes

Part = TypeVar("Part")


def share_work(
    work: Callable[[Sequence[ProgramSource]], Part], sources: Sequence[ProgramSource]
) -> Iterator[Part]:
    """Yield what work makes of sources, in their order; large lines are worked on by all processors."""
    read_siblings(sources)
    yield from run_in_processes(work, sources)
