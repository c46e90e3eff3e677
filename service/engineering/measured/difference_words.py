"""Columns that headings call a difference from a place, and what is asked about them."""

from collections.abc import Mapping, Sequence

from cellcal.calibration.identification.column_options import columns_option
from cellcal.calibration.message import make_message
from cellcal.service.engineering.measured.column_words import DIFFERENCE_WORDS, find_triples, key_words
from cellcal.service.engineering.measured.headings import without_unit

_NO_PLACE = {
    "min", "max", "upper", "lower", "range", "velocity", "vel", "speed", "acceleration", "acc", "force", "torque",
    "tol", "tolerance", "tolplus", "tolminus", "test", "out",
}  # fmt: skip
_WORDS = (DIFFERENCE_WORDS - _NO_PLACE) | {"error", "err", "errors"}


def find_differences(names: Sequence[str], plain: Mapping[str, str]) -> tuple[str, ...]:
    """Return columns of x, y, z that headings call a difference or an error; empty without any."""
    triples = find_triples(names, plain, "xyz")
    return next((found for key, found in triples.items() if key_words(key) & _WORDS), ())


def sum_remedy(differences: Sequence[str], places: Sequence[str]) -> str:
    """Return how differences from places become what was measured: which way they are taken, a person knows."""
    return make_message(
        "{differences} are differences from {places}. If they are measured minus nominal, take the sum: "
        "{sums}; if nominal minus measured, write - in place of +. Rows do not tell which: "
        "both fit alike, and every error is turned round.",
        differences=", ".join(differences),
        places=", ".join(places),
        sums=columns_option(
            "position",
            [
                f"{without_unit(place)}+{without_unit(each)}"
                for place, each in zip(places, differences, strict=True)
            ],
        ),
    )
