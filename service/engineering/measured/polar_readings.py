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
