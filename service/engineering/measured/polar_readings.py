"""Directions and distances of a total station, theodolite or tracker: named, and not taken for a wire.

Whether a horizontal angle counts clockwise, and whether a vertical one counts from the zenith or from the horizon,
differs from maker to maker and is in no heading: a wrong guess mirrors the measurements.
"""

from collections.abc import Mapping, Sequence

from cellcal.calibration.message import make_message
from cellcal.service.engineering.measured.errors import MeasurementError

_HORIZONTAL = frozenset(
    (
        "hz",
        "h",
        "ha",
        "hza",
        "az",
        "azimuth",
        "azi",
        "horizontal",
        "horizontal_angle",
        "hz_angle",
        "bearing",
        "theta",
    )
)
_VERTICAL = frozenset(
    (
        "v",
        "va",
        "vt",
        "ze",
        "zenith",
        "zenith_angle",
        "elevation",
        "elev",
        "el",
        "vertical",
        "vertical_angle",
        "phi",
    )
)
_SURVEY = ({"easting", "east"}, {"northing", "north"}, {"height", "elevation", "elev", "up", "h"})


def with_survey_places(plain: Mapping[str, str]) -> dict[str, str]:
    """Return plain headings with easting, northing and height as x, y, z, where no other place is there.

    These three are right-handed in this order; where one of them is missing or stands twice, nothing is changed.
    """
    found = [[name for name, text in plain.items() if text in words] for words in _SURVEY]
    if any(len(names) != 1 for names in found) or set(plain.values()) & {"x", "y", "z"}:
        return dict(plain)
    return {**plain, **{names[0]: axis for names, axis in zip(found, "xyz", strict=True)}}


def refuse_directions(names: Sequence[str], plain: Mapping[str, str]) -> None:
    """Refuse columns that are a horizontal and a vertical direction, where no x, y, z of the place is there.

    Raises
    ------
    MeasurementError
        Both directions are among the columns.
    """
    horizontal = [name for name in names if plain[name] in _HORIZONTAL]
    vertical = [name for name in names if plain[name] in _VERTICAL]
    if horizontal and vertical:
        raise MeasurementError(
            make_message(
                "{horizontal} and {vertical} are directions of an instrument; points are read as x, y, z only.",
                horizontal=horizontal[0],
                vertical=vertical[0],
            ),
            remedy="Let the instrument's software export x, y, z; or name the distance alone: `--columns length=D`.",
        )
