"""What runs calculate is calculated once in a session: most scenes ask the same, and a plan takes seconds."""

from collections.abc import Callable, Iterator
from functools import wraps
from typing import Any

import pytest
from pydantic_core import to_jsonable_python

from cellcal.procedures.canonical_json import sha256_of
from cellcal.procedures.run import Run


@pytest.fixture(scope="session", autouse=True)
def calculate_once() -> Iterator[None]:
    """Give a run the earlier result of a calculation with equal inputs: it depends on nothing else.

    A run writes what it gets as JSON and reads that back, so that no two runs share an object.
    """
    solve, results = Run.solve, dict[tuple[Callable[..., Any], str], Any]()

    async def solve_once(
        run: Run, name: str, calculation: Callable[..., Any], *args: Any, **kwargs: Any
    ) -> Any:
        @wraps(calculation)
        def find_result(*args: Any, **kwargs: Any) -> Any:
            key = (calculation, sha256_of(to_jsonable_python([args, kwargs])))
            if key not in results:
                results[key] = calculation(*args, **kwargs)
            return results[key]

        return await solve(run, name, find_result, *args, **kwargs)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Run, "solve", solve_once)
        yield
