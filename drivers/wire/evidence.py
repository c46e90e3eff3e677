"""What stands behind each ability of a driver: a maker's document, an independent program, a robot. Kept as TSV."""

import csv
from dataclasses import dataclass
from functools import cache
from importlib.resources import files

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
    source = files(f"cellcal.drivers.{driver}").joinpath(_FILE)
    if not source.is_file():
        return ()
    lines = source.read_text(encoding="utf-8").splitlines()
    rows = csv.DictReader((line for line in lines if not line.startswith("#")), delimiter="\t")
    return tuple(
        AbilityEvidence(row["ability"], row["document"], row["client"], row["robot"])
        for row in rows
        if row["profile"] in ("", profile)
    )
