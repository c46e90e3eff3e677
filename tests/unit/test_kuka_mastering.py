"""Which axes of a KUKA are not mastered: what the software tells, does not tell, or tells no more."""

from typing import Any

import pytest

from cellcal.drivers.errors import RefusedError
from cellcal.drivers.kuka.variables.state import _read_lost_axes, tells_mastering


class ToldVariables:
    """A link whose variables are those of a table; others are refused."""

    def __init__(self, **values: str) -> None:
        self.device, self.values, self.known_variables = "kuka", values, set[str]()

    async def read_variable(self, variable: str) -> str:
        if variable not in self.values:
            raise RefusedError(self.device, f"the controller does not give {variable}.")
        self.known_variables.add(variable)
        return self.values[variable]


def mastered(*lost: int) -> Any:
    return ToldVariables(**{f"$AXIS_CAL[{k}]": "FALSE" if k in lost else "TRUE" for k in range(1, 7)})


async def test_axes_without_mastering_are_named() -> None:
    assert await _read_lost_axes(mastered(2, 6)) == (1, 5)
    assert await _read_lost_axes(mastered()) == ()


async def test_a_software_without_the_variable_says_nothing_and_that_is_known() -> None:
    link: Any = ToldVariables()
    assert await _read_lost_axes(link) == ()
    assert not await tells_mastering(link)


@pytest.mark.parametrize("axis", [1, 4])
async def test_a_variable_that_is_given_no_more_is_no_mastered_axis(axis: int) -> None:
    link = mastered(3)
    assert await _read_lost_axes(link) == (2,)
    del link.values[f"$AXIS_CAL[{axis}]"]
    with pytest.raises(RefusedError):
        await _read_lost_axes(link)


async def test_one_axis_without_the_variable_is_not_taken_for_all() -> None:
    link = mastered(3)
    del link.values["$AXIS_CAL[5]"]
    with pytest.raises(RefusedError):
        await _read_lost_axes(link)
