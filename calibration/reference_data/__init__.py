"""Reference problems with answers from an independent solver; what they are is in README.md beside this file."""

from importlib.resources import files
from typing import Any

from cellcal.calibration.documents.json_text import parse_json
from cellcal.calibration.errors import CalibrationError
from cellcal.calibration.message import make_message


def reference_names() -> tuple[str, ...]:
    """Return the names of the data sets that ship."""
    found = (entry.name for entry in files(__name__).iterdir() if entry.name.endswith(".json"))
    return tuple(sorted(name.removesuffix(".json") for name in found))


def load_reference(name: str) -> dict[str, Any]:
    """Return a data set: title, solver, tolerance, given, and answers as decimal strings."""
    if name not in reference_names():
        raise CalibrationError(
            f"there is no reference data set {name}.",
            remedy=make_message("There are {names}.", names=", ".join(reference_names())),
        )
    text = files(__name__).joinpath(f"{name}.json").read_text(encoding="utf-8")
    document: dict[str, Any] = parse_json(text)
    return document
