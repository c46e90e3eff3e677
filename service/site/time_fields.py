"""Times of day and days as fields of models that are read from files and messages.

Beside `service.times`, which commands need without models of this kind.
"""

from typing import Annotated

from pydantic import AfterValidator

from cellcal.service.times import read_day, read_time


def _checked_time(text: str) -> str:
    read_time(text)
    return text


def _checked_day(text: str) -> str:
    if read_day(text).isoformat() != text:
        raise ValueError("a day is written as YYYY-MM-DD")  # other forms of ISO 8601 do not sort with it
    return text


ZonedTime = Annotated[str, AfterValidator(_checked_time)]
Day = Annotated[str, AfterValidator(_checked_day)]
