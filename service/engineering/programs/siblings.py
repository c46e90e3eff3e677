"""What the programs of one batch say of each other's positions, read before any of them is changed."""

from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import cast

from cellcal.calibration.errors import CellError
from cellcal.drivers.program_registry import SUFFIXES, brand_named, brand_of, read_programs
from cellcal.drivers.programs.brands import DeclaringProgram
from cellcal.drivers.programs.cross_file_uses import BatchDeclarations
from cellcal.drivers.programs.file_declarations import FileDeclarations
from cellcal.drivers.programs.positions import ProgramFile
from cellcal.service.engineering.programs.files import ProgramSource, read_bytes
from cellcal.service.engineering.programs.folders_above import lists_above
from cellcal.service.engineering.programs.worker_processes import is_worthwhile, run_in_processes


def read_siblings(sources: Sequence[ProgramSource]) -> None:
    """Read what a batch's programs say of each other, once; needed where one process starts others."""
    for siblings in {id(one.siblings): one.siblings for one in sources if one.siblings is not None}.values():
        if siblings.across is None:
            informative = [one for one in siblings.sources if _may_inform(one)]
            if is_worthwhile(informative):
                statements = {
                    file: statements
                    for some in run_in_processes(_statements_of, informative)
                    for file, statements in some
                }
            else:
                statements = {}
                for file, data in _bytes_of(informative):
                    if (statement := _quick_statement(file, data)) is not None:
                        statements[file] = statement
                    elif (program := _read_informative(file, data)) is not None:
                        siblings.read[file], statements[file] = program, program.declarations
            above = lists_above([one.path for one in informative]) if siblings.looks_above else {}
            lists = {place: brand for place, brand in above.items() if str(place) not in statements}
            statements |= _list_statements({**lists, **siblings.lists})
            siblings.across = BatchDeclarations(statements)


def cached_program(source: ProgramSource, data: bytes) -> ProgramFile | None:
    """Return a program that was read with its siblings, once; None where it was not, or the file changed since."""
    if source.siblings is None:
        return None
    program = source.siblings.read.pop(str(source.path), None)
    return program if program is not None and program.to_bytes() == data else None


def with_siblings(source: ProgramSource, program: ProgramFile) -> ProgramFile:
    """Return a program with what the others of its batch say of its positions."""
    if not brand_named(program.brand).tells:
        return program
    if source.siblings is None:
        across = BatchDeclarations({str(source.path): cast(DeclaringProgram, program).declarations})
    else:
        read_siblings([source])
        across = cast(BatchDeclarations, source.siblings.across)
    external_uses = across.uses_of_file(str(source.path))
    return (
        program
        if external_uses is None
        else cast(DeclaringProgram, program).with_external_uses(external_uses)
    )


def _may_inform(source: ProgramSource) -> bool:
    suffix = source.path.suffix.lower()
    return any(brand_named(brand).tells for brand, suffixes in SUFFIXES.items() if suffix in suffixes)


def _list_statements(lists: Mapping[Path, str]) -> Iterator[tuple[str, FileDeclarations]]:
    """Yield what lists of a controller say, of the brand that each is of."""
    for place, brand in lists.items():
        with suppress(CellError):
            if (statement := brand_named(brand).says(str(place), read_bytes(place))) is not None:
                yield str(place), statement.of_machine()


def _statements_of(sources: Sequence[ProgramSource]) -> list[tuple[str, FileDeclarations]]:
    """Return what files say without keeping them: read whole only where a look does not tell."""
    return [
        (file, statement)
        for file, data in _bytes_of(sources)
        if (statement := _quick_statement(file, data) or _full_statement(file, data))
    ]


def _quick_statement(file: str, data: bytes) -> FileDeclarations | None:
    brand = brand_of(file, data)
    try:
        return None if brand is None or not brand.tells else brand.says(file, data)
    except CellError:
        return None


def _full_statement(file: str, data: bytes) -> FileDeclarations | None:
    program = _read_informative(file, data)
    return None if program is None else program.declarations


def _read_informative(file: str, data: bytes) -> DeclaringProgram | None:
    """Return a program; None for one that tells nothing, and for one that is refused when its turn comes."""
    (program,) = read_programs([(file, data)])
    if isinstance(program, CellError) or not brand_named(program.brand).tells:
        return None
    return cast(DeclaringProgram, program)


def _bytes_of(sources: Sequence[ProgramSource]) -> Iterator[tuple[str, bytes]]:
    for source in sources:
        try:
            yield str(source.path), read_bytes(source.path)
        except CellError:
            continue  # it is refused when its turn comes
