"""Every brand of robot program that can be read."""

from collections.abc import Mapping
from pathlib import PurePath

from drivers.abb import programs as abb
from drivers.fanuc import programs as fanuc
from drivers.kuka import programs as kuka
from drivers.programs.brands import ProgramBrand
from drivers.programs.errors import ProgramFileError
from drivers.programs.positions import ProgramFile
from drivers.universal_robots import programs as universal_robots
from drivers.yaskawa import programs as yaskawa

BRANDS: tuple[ProgramBrand, ...] = (abb.BRAND, fanuc.BRAND, kuka.BRAND, universal_robots.BRAND, yaskawa.BRAND)


def brand_of(name: str, data: bytes) -> ProgramBrand | None:
    """Return whose program a file is, by its suffix and a look inside; None for a file that is no program."""
    suffix = PurePath(name).suffix.lower()
    fitting = (brand for brand in BRANDS if suffix in brand.suffixes)
    return next((brand for brand in fitting if brand.writes_program(data)), None)


def read_program(name: str, data: bytes) -> ProgramFile:
    """Read a program, whatever its brand.

    Raises
    ------
    ProgramFileError
        No brand writes such files, or the file is damaged or not understood: with line and column.
    """
    brand = brand_of(name, data)
    if brand is None:
        known = ", ".join(sorted({suffix for each in BRANDS for suffix in each.suffixes}))
        raise ProgramFileError(
            name, "this is not a robot program that can be read.", remedy=f"There are {known}."
        )
    return brand.read(name, data)


def brands_by_name() -> Mapping[str, ProgramBrand]:
    """Return the brands by their package's name."""
    return {brand.brand: brand for brand in BRANDS}
