"""The setting of a cell file that tells the gears of a six-axis arm."""

from typing import Annotated

from pydantic import AfterValidator, Field

_LEAST, _MOST = 10.0, 1000.0


def _check_ratio(value: float) -> float:
    if not _LEAST <= abs(value) <= _MOST:
        raise ValueError("each number is the motor turns of one turn of the joint, signed; 10 to 1000")
    return value


_Ratio = Annotated[float, AfterValidator(_check_ratio)]
MotorTurns = Annotated[tuple[_Ratio, ...], Field(min_length=6, max_length=6)] | None
