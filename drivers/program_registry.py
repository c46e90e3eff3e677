"""Every brand of robot program that can be read; a brand's package is loaded with its first program."""

from codecs import BOM_UTF8, BOM_UTF16_BE, BOM_UTF16_LE
from collections.abc import Callable, Mapping, Sequence
from functools import cache
from pathlib import PurePath

from cellcal.calibration.message import make_message
from cellcal.drivers.programs.brands import ProgramBrand
from cellcal.drivers.programs.errors import ProgramFileError
from cellcal.drivers.programs.positions import PositionChange, ProgramFile


def _load_abb() -> ProgramBrand:
    from cellcal.drivers.abb.program_files.programs import BRAND  # noqa: PLC0415  its patterns take long to make

    return BRAND


def _load_fanuc() -> ProgramBrand:
    from cellcal.drivers.fanuc.program_files.programs import BRAND  # noqa: PLC0415  its patterns take long to make

    return BRAND


def _load_kuka() -> ProgramBrand:
    from cellcal.drivers.kuka.program_files.programs import BRAND  # noqa: PLC0415  its patterns take long to make

    return BRAND


def _universal_robots() -> ProgramBrand:
    from cellcal.drivers.universal_robots.program_files.programs import BRAND  # noqa: PLC0415  its patterns take long to make

    return BRAND


def _load_yaskawa() -> ProgramBrand:
    from cellcal.drivers.yaskawa.program_files.programs import BRAND  # noqa: PLC0415  its patterns take long to make

    return BRAND


_LOADED: Mapping[str, Callable[[], ProgramBrand]] = {
    "abb": _load_abb,
    "fanuc": _load_fanuc,
    "kuka": _load_kuka,
    "universal_robots": _universal_robots,
    "yaskawa": _load_yaskawa,
}
SUFFIXES: Mapping[str, tuple[str, ...]] = {
    "abb": (".mod", ".prg", ".sys", ".modx", ".sysx"),
    "fanuc": (".ls",),
    "kuka": (".src", ".dat", ".sub"),
    "universal_robots": (".script", ".urp", ".installation"),
    "yaskawa": (".jbi",),
}

_LOOKED_AT = 1 << 16  # bytes in which a program names itself
_UTF16 = {  # how a text of UTF-16 begins: with its mark, or with a letter or a sign and a zero
    BOM_UTF16_LE: "utf-16",
    BOM_UTF16_BE: "utf-16",
    **{f"{sign}".encode("utf-16-le"): "utf-16-le" for sign in "/ \r\n%mMlL&!"},
    **{f"{sign}".encode("utf-16-be"): "utf-16-be" for sign in "/ \r\n%mMlL&!"},
}


@cache
def brand_named(name: str) -> ProgramBrand:
    """Return a brand by its package's name."""
    return _LOADED[name]()


def all_brands() -> tuple[ProgramBrand, ...]:
    """Return every brand."""
    return tuple(map(brand_named, SUFFIXES))


def brand_of(name: str, data: bytes) -> ProgramBrand | None:
    """Return whose program a file is, by its suffix and a look inside; None for a file that is no program."""
    suffix = PurePath(name).suffix.lower()
    fitting = (brand_named(brand) for brand, suffixes in SUFFIXES.items() if suffix in suffixes)
    return next((brand for brand in fitting if brand.writes_program(data)), None)


def brand_of_list(name: str) -> ProgramBrand | None:
    """Return whose controller has a list of this name, which is no program itself; None for any other file."""
    path = PurePath(name)
    if any(path.suffix.lower() in suffixes for suffixes in SUFFIXES.values()):
        return None
    file_name = path.name.casefold()
    return next(
        (brand for brand in all_brands() if file_name in {each.name.casefold() for each in brand.beside}),
        None,
    )


def is_resaved_program(name: str, data: bytes) -> bool:
    """Return whether a file is a program that an editor saved in an encoding that no controller reads."""
    if data.startswith(BOM_UTF8):
        return brand_of(name, data[len(BOM_UTF8) :]) is not None
    text = data[:_LOOKED_AT]
    encodings = [encoding for mark, encoding in _UTF16.items() if text.startswith(mark)]
    return any(brand_of(name, text.decode(each, "ignore").encode("latin-1", "ignore")) for each in encodings)


def read_program(name: str, data: bytes) -> ProgramFile:
    """Read a program, whatever its brand.

    Raises
    ------
    ProgramFileError
        No brand writes such files, or the file is damaged or not understood: with line and column.
    """
    found = read_programs([(name, data)])[0]
    if isinstance(found, ProgramFileError):
        raise found
    return found


def read_programs(files: Sequence[tuple[str, bytes]]) -> list[ProgramFile | ProgramFileError]:
    """Read programs by their names and bytes, whatever their brands; what is wrong with one stands at its place."""
    found: dict[int, ProgramFile | ProgramFileError] = {}
    by_brand: dict[str, list[int]] = {}
    for i, (name, data) in enumerate(files):
        brand = brand_of(name, data)
        if brand is None:
            found[i] = _unknown_program_error(name, data)
        else:
            by_brand.setdefault(brand.brand, []).append(i)
    for name, rows in by_brand.items():
        found |= zip(rows, _read_batch(brand_named(name), [files[i] for i in rows]), strict=True)
    return [found[i] for i in range(len(files))]


def change_programs(
    programs: Sequence[ProgramFile], changes: Sequence[PositionChange]
) -> Sequence[ProgramFile]:
    """Return programs of one brand with their changes.

    Raises
    ------
    ProgramFileError
        As `ProgramFile.changed`, of the first that cannot take its change.
    """
    together = brand_named(programs[0].brand).together if programs else None
    if together is not None:
        return together.change_files(programs, changes)
    return [program.with_changes(change) for program, change in zip(programs, changes, strict=True)]


def _read_batch(
    brand: ProgramBrand, files: Sequence[tuple[str, bytes]]
) -> Sequence[ProgramFile | ProgramFileError]:
    if brand.together is not None:
        return brand.together.read_files(files)
    return [_read_alone(brand, name, data) for name, data in files]


def _read_alone(brand: ProgramBrand, name: str, data: bytes) -> ProgramFile | ProgramFileError:
    try:
        return brand.read(name, data)
    except ProgramFileError as error:
        return error


# Programs of the brands in forms that no reader takes, by suffix: why, and the cure.
UNREAD_FORMS = {
    ".urpx": (
        "this is a program of PolyScope X, which is not read.",
        "Of Universal Robots .urp and .script are read; change this one's points on the robot.",
    ),
    ".tp": (
        "this is the binary form of a FANUC program, which is not read.",
        "Save it on the controller as a listing (.LS).",
    ),
    ".kl": (
        "this is a KAREL program, whose positions are not read.",
        "Change its positions on the controller, or in its source.",
    ),
}


def _unknown_program_error(name: str, data: bytes) -> ProgramFileError:
    """Return why a file is no program, an editor's marks of its encoding first."""
    if PurePath(name).suffix.lower() in (suffix for suffixes in SUFFIXES.values() for suffix in suffixes):
        is_resaved = is_resaved_program(name, data)
        if data.startswith((BOM_UTF16_LE, BOM_UTF16_BE)) or (is_resaved and not data.startswith(BOM_UTF8)):
            return ProgramFileError(
                name,
                "an editor saved this program as Unicode (UTF-16); programs of controllers are plain text.",
                remedy="Save it as plain text (ANSI), or take the controller's own file.",
            )
        if is_resaved:
            return ProgramFileError(
                name,
                "an editor put a byte order mark before this program; the controller's own files have none.",
                remedy="Save it as plain text without the mark, or take the controller's own file.",
            )
    if PurePath(name).suffix.lower() in UNREAD_FORMS:
        why, remedy = UNREAD_FORMS[PurePath(name).suffix.lower()]
        return ProgramFileError(name, why, remedy=remedy)
    suffixes_text = ", ".join(sorted({suffix for suffixes in SUFFIXES.values() for suffix in suffixes}))
    return ProgramFileError(
        name,
        "this is not a robot program that can be read.",
        remedy=make_message("There are {names}.", names=suffixes_text),
    )
