"""Units and order of axes: what is unknown is refused, never assumed."""

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass

from asyncua import ua

from cellcal.calibration.message import make_message
from cellcal.drivers.errors import RefusedError

_CEFACT = "http://www.opcfoundation.org/UA/units/un/cefact"
_ROTARY_PROFILES, _LINEAR_PROFILES = frozenset((1, 2)), frozenset((3,))  # AxisMotionProfileEnumeration
_NUMBERED = re.compile(r"(.*?)(\d+)")


@dataclass(frozen=True, slots=True)
class AxisUnit:
    """A unit of positions."""

    symbol: str
    to_si: float  # radians, or metres
    is_length: bool


_DEGREE = AxisUnit("deg", math.radians(1.0), is_length=False)
_RADIAN = AxisUnit("rad", 1.0, is_length=False)
_MILLIMETRE = AxisUnit("mm", 1e-3, is_length=True)
_BY_CODE = {17476: _DEGREE, 4405297: _RADIAN, 5066068: _MILLIMETRE}  # UNECE recommendation 20: DD, C81, MMT
_BY_NAME = {
    "deg": _DEGREE, "°": _DEGREE, "degree": _DEGREE, "degrees": _DEGREE,
    "rad": _RADIAN, "radian": _RADIAN, "radians": _RADIAN,
    "mm": _MILLIMETRE, "millimetre": _MILLIMETRE, "millimeter": _MILLIMETRE,
}  # fmt: skip
_NO_CODE = (-1, 0)


def unit_of_axis(device: str, axis: str, stated: object, motion_profile: int) -> AxisUnit:
    """Return the unit that a server states for an axis.

    Raises
    ------
    RefusedError
        The unit is unknown, contradicts itself, or does not fit the motion of the axis.
    """
    if not isinstance(stated, ua.EUInformation):
        raise _unit_error(device, axis, type(stated).__name__)
    shown = ((stated.DisplayName and stated.DisplayName.Text) or "").strip()
    named = _BY_NAME.get(shown.casefold())
    has_code = stated.UnitId not in _NO_CODE and (stated.NamespaceUri or _CEFACT).rstrip("/") == _CEFACT
    coded = _BY_CODE.get(stated.UnitId) if has_code else None
    unit = named if stated.UnitId in _NO_CODE else coded
    if unit is None or (named is not None and named is not unit):
        raise _unit_error(device, axis, f"{shown} {stated.UnitId}".strip())
    if motion_profile not in (_LINEAR_PROFILES if unit.is_length else _ROTARY_PROFILES):
        raise RefusedError(
            device,
            make_message(
                "{axis} has the unit {symbol} and the MotionProfile {motion_profile}, which do not fit.",
                axis=axis,
                symbol=unit.symbol,
                motion_profile=motion_profile,
            ),
            remedy="Correct the axis on the controller's OPC UA server, or ask its maker.",
        )
    return unit


def order_axes(device: str, found: Sequence[str], selected: Sequence[str], count: int) -> list[str]:
    """Return the names of the axes in the model's order.

    Raises
    ------
    RefusedError
        The server shows other axes than the cell file names, or their order does not follow from their names.
    """
    if selected:
        if any(list(found).count(name) != 1 for name in selected):
            raise _order_error(device, found, "which are not the axes of the cell file")
        return list(selected)
    parts = [_NUMBERED.fullmatch(name) for name in found]
    numbers = {int(part[2]): part[0] for part in parts if part is not None}
    prefixes = {part[1] for part in parts if part is not None}
    ordered = sorted(numbers)
    if (
        None in parts
        or len(prefixes) != 1
        or len(found) != count
        or ordered != list(_run_from(ordered, count))
    ):
        raise _order_error(device, found, "whose order does not follow from their names")
    return [numbers[number] for number in ordered]


def _run_from(ordered: Sequence[int], count: int) -> range:
    return range(ordered[0], ordered[0] + count) if ordered else range(0)


def _unit_error(device: str, axis: str, stated: str) -> RefusedError:
    return RefusedError(
        device,
        make_message(
            "the unit of {axis} is {stated}, which is none of deg, rad, mm.", axis=axis, stated=stated
        ),
        remedy="Correct EngineeringUnits of the axis on the controller's OPC UA server, or ask its maker.",
    )


def _order_error(device: str, found: Sequence[str], why: str) -> RefusedError:
    return RefusedError(
        device,
        make_message("the server shows the axes {names}, {why}.", names=", ".join(found) or "none", why=why),
        remedy="Write their browse names in the model's order in the cell file: axes = [...].",
    )
