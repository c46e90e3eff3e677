"""Options that name nothing: refused by their words, for a word that is passed over looks as if it were followed."""

from collections.abc import Mapping

from cellcal.calibration.message import make_message
from cellcal.service.engineering.measured.attitudes import refuse_unknown_convention
from cellcal.service.engineering.measured.table import MeasurementError

_UNITS = ("joints", "slides", "position", "rotation", "length", "controller")


def refuse_unknown_options(units: Mapping[str, str], convention: str) -> None:
    """Refuse a unit of something that is no part of a table, and an attitude that is written in no known way.

    Raises
    ------
    MeasurementError
        With what is known.
    """
    unknown = [meaning for meaning in units if meaning not in _UNITS]
    if unknown:
        raise MeasurementError(
            make_message("--units knows no {meaning!r}.", meaning=unknown[0]),
            remedy=make_message("It knows {meanings}.", meanings=", ".join(_UNITS)),
        )
    refuse_unknown_convention(convention)
