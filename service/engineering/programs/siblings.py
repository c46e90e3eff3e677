"""What the programs of one batch say of each other's positions, read before any of them is changed."""

from collections.abc import Iterator, Sequence
from typing import cast

from cellcal.calibration.errors import CellError
from cellcal.drivers.program_registry import SUFFIXES, brand_named, brand_of, read_programs
from cellcal.drivers.programs.across import Across, Said
from cellcal.drivers.programs.brands import Telling
from cellcal.drivers.programs.positions import ProgramFile
from cellcal.service.engineering.programs.files import Source, read_bytes
from cellcal.service.engineering.programs.forks import forked, pays


def read_siblings(sources: Sequence[Source]) -> None:
    """Read what a batch's programs say of each other, once; needed where one process starts others."""
    for siblings in {id(one.siblings): one.siblings for one in sources if one.siblings is not None}.values():
        if siblings.across is None:
            told = [one for one in siblings.sources if _may_tell(one)]
            if pays(told):
                said = {file: said for some in forked(_said_of, told) for file, said in some}
            else:
                said = {}
                for file, data in _bytes_of(told):
                    if (seen := _seen(file, data)) is not None:
                        said[file] = seen
                    elif (program := _read(file, data)) is not None:
                        siblings.read[file], said[file] = program, program.said
            siblings.across = Across(said)


def kept(source: Source, data: bytes) -> ProgramFile | None:
    """Return a program that was read with its siblings, once; None where it was not, or the file changed since."""
    if source.siblings is None:
        return None
    program = source.siblings.read.pop(str(source.path), None)
    return program if program is not None and program.to_bytes() == data else None


def with_siblings(source: Source, program: ProgramFile) -> ProgramFile:
    """Return a program with what the others of its batch say of its positions."""
    if not brand_named(program.brand).tells:
        return program
    if source.siblings is None:
        across = Across({str(source.path): cast(Telling, program).said})
    else:
        read_siblings([source])
        across = cast(Across, source.siblings.across)
    abroad = across.of(str(source.path))
    return program if abroad is None else cast(Telling, program).with_abroad(abroad)


def _may_tell(source: Source) -> bool:
    suffix = source.path.suffix.lower()
    return any(brand_named(brand).tells for brand, suffixes in SUFFIXES.items() if suffix in suffixes)


def _said_of(sources: Sequence[Source]) -> list[tuple[str, Said]]:
    """Return what files say without keeping them: read whole only where a look does not tell."""
    return [
        (file, said) for file, data in _bytes_of(sources) if (said := _seen(file, data) or _heard(file, data))
    ]


def _seen(file: str, data: bytes) -> Said | None:
    brand = brand_of(file, data)
    try:
        return None if brand is None or not brand.tells else brand.says(file, data)
    except CellError:
        return None


def _heard(file: str, data: bytes) -> Said | None:
    program = _read(file, data)
    return None if program is None else program.said


def _read(file: str, data: bytes) -> Telling | None:
    """Return a program; None for one that tells nothing, and for one that is refused when its turn comes."""
    (program,) = read_programs([(file, data)])
    if isinstance(program, CellError) or not brand_named(program.brand).tells:
        return None
    return cast(Telling, program)


def _bytes_of(sources: Sequence[Source]) -> Iterator[tuple[str, bytes]]:
    for source in sources:
        try:
            yield str(source.path), read_bytes(source.path)
        except CellError:
            continue  # it is refused when its turn comes
