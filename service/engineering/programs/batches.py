"""Programs read a few at once: enough to be quick, few enough to be small, one brand at a time."""

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import TypeVar

from cellcal.calibration.errors import CellError
from cellcal.drivers.program_registry import read_programs
from cellcal.drivers.programs.positions import ProgramFile
from cellcal.service.engineering.programs.files import ProgramSource, RefusedProgram, read_bytes
from cellcal.service.engineering.programs.siblings import cached_program, read_siblings, with_siblings

Found = TypeVar("Found")
_POINTS_AT_ONCE = 20_000
_FILES_AT_ONCE = 500
_BYTES_AT_ONCE = 4 << 20


@dataclass(frozen=True, eq=False)
class ReadProgram:
    """A program and where it comes from."""

    source: ProgramSource
    data: bytes
    program: ProgramFile


def read_batches(
    sources: Iterable[ProgramSource], check: Callable[[ProgramSource], object], refused: list[RefusedProgram]
) -> Iterator[list[ReadProgram]]:
    """Yield programs of one brand at a time; what ``check`` or the reader refuses goes to the refused."""
    batch: list[ReadProgram] = []
    points = 0
    for read in _read_programs(sources, check, refused):
        if batch and batch[0].program.brand != read.program.brand:
            yield batch
            batch, points = [], 0
        batch.append(read)
        points += len(read.program.positions)
        if points >= _POINTS_AT_ONCE or len(batch) >= _FILES_AT_ONCE:
            yield batch
            batch, points = [], 0
    if batch:
        yield batch


def process_batch(
    batch: Sequence[ReadProgram],
    work: Callable[[Sequence[ProgramFile]], Sequence[Found]],
    refused: list[RefusedProgram],
) -> Iterator[tuple[ReadProgram, Found]]:
    """Yield programs with what was found of them; where one of them is refused, the halves are worked on."""
    try:
        found = work([read.program for read in batch])
    except CellError as error:
        if len(batch) == 1:
            refused.append(RefusedProgram.from_error(batch[0].source.path, error))
            return
        middle = len(batch) // 2
        yield from process_batch(batch[:middle], work, refused)
        yield from process_batch(batch[middle:], work, refused)
        return
    yield from zip(batch, found, strict=True)


def _read_programs(
    sources: Iterable[ProgramSource], check: Callable[[ProgramSource], object], refused: list[RefusedProgram]
) -> Iterator[ReadProgram]:
    """Yield programs in the order of their sources, read some at once."""
    for some in _bytes_of(sources, check, refused):
        read_siblings([source for source, _ in some])
        cached = [cached_program(source, data) for source, data in some]
        new = [
            (str(source.path), data) for (source, data), one in zip(some, cached, strict=True) if one is None
        ]
        rest = iter(read_programs(new))
        for (source, data), one in zip(some, cached, strict=True):
            program = next(rest) if one is None else one
            if isinstance(program, CellError):
                refused.append(RefusedProgram.from_error(source.path, program))
            else:
                yield ReadProgram(source, data, with_siblings(source, program))


def _bytes_of(
    sources: Iterable[ProgramSource], check: Callable[[ProgramSource], object], refused: list[RefusedProgram]
) -> Iterator[list[tuple[ProgramSource, bytes]]]:
    some: list[tuple[ProgramSource, bytes]] = []
    size = 0
    for source in sources:
        try:
            check(source)
            data = read_bytes(source.path)
        except CellError as error:
            refused.append(RefusedProgram.from_error(source.path, error))
            continue
        some.append((source, data))
        size += len(data)
        if size >= _BYTES_AT_ONCE or len(some) >= _FILES_AT_ONCE:
            yield some
            some, size = [], 0
    if some:
        yield some
