"""What stands behind each ability of a driver: a maker's document, an independent program, a robot. Kept as TSV."""

from dataclasses import dataclass
from functools import cache
from importlib.resources import files

from cellcal.drivers.wire.tables import read_table_rows

_FILE = "evidence.tsv"
NOT_CONFIRMED = "none"


@dataclass(frozen=True, slots=True)
class AbilityEvidence:
    """One ability; each basis is named, or "none"."""

    ability: str
    document: str  # where the maker says that the controller can do it
    client: str  # which program that is not ours was run against our side
    robot: str  # on which controller it was confirmed


@cache
def driver_evidence(driver: str, profile: str = "") -> tuple[AbilityEvidence, ...]:
    """Return the evidence of a driver, and of its profile where it has several; empty where none is written."""
    package = f"cellcal.drivers.{driver}"
    if not files(package).joinpath(_FILE).is_file():
        return ()
    return tuple(
        AbilityEvidence(row["ability"], row["document"], row["client"], row["robot"])
        for row in read_table_rows(package, _FILE)
        if row["profile"] in ("", profile)
    )
