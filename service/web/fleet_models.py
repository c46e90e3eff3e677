"""What the monitor's routes answer, for its ``/openapi.json``.

What a cell says is described as it is checked (`site/state_shape.py`): a newer cell may say more.
"""

from typing import Literal

from cellcal.service.site.state_shape import (
    StateAlarm,
    StateAsks,
    StateCertificate,
    StateDrift,
    StateDue,
    StateRun,
)
from cellcal.service.web.response_models import ResponseShape


class EventsSeen(ResponseShape):
    """The numbers of a cell's events that are here, that exist, and that cannot be had any more."""

    have: int
    known: int
    lost: int


class CellRow(ResponseShape):
    """One cell as it stands."""

    cell: str
    name: str
    link: Literal["online", "silent", "offline", "never"]
    alarms: list[StateAlarm]
    run: StateRun | None
    asks: StateAsks | None
    attended: bool
    drift: list[StateDrift]
    certificate: StateCertificate | None
    due: list[StateDue]
    events: EventsSeen
    clock_off_s: int


class NotBelieved(ResponseShape):
    """Something that was heard of a cell and dropped."""

    wall: str
    cell: str
    what: str


class FleetSeen(ResponseShape):
    """Every cell of the site; ``ages`` are seconds since cells were heard that are not heard just now."""

    site: str
    router: bool
    cells: int
    ages: dict[str, int]
    not_believed: list[NotBelieved]
    rows: list[CellRow]
