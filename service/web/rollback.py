"""Going back to a stored version of a robot's parameters: a new version that names the old one.

It takes what writing master data takes: the control of the session, an engineer or two people, the PIN just entered,
for the very change that is shown. Nothing is removed, and nothing is written to the robot: programs that are
compensated from then on use it.
"""

import asyncio
import datetime
from pathlib import Path
from typing import Annotated, Any

from fastapi import APIRouter, Request
from pydantic import BaseModel, ConfigDict, Field, StringConstraints

from cellcal.calibration.errors import CellError
from cellcal.service.cell_process.messages import AnswerIt, Name
from cellcal.service.engineering.parameters.parameter_sets import FOLDER, ParameterSets
from cellcal.service.people.errors import PeopleError
from cellcal.service.review.review_models import Displacement
from cellcal.service.web.door import Who, house_of
from cellcal.service.web.error_responses import Refused
from cellcal.service.web.parameters import Head, Version
from cellcal.service.web.residuals import solver_of
from cellcal.service.web.response_models import answering
from cellcal.service.web.session_control import permitted

router = APIRouter()
_KEY = "write_parameter_version"  # for the permits: it writes


class NewerVersionError(PeopleError):
    """Somebody saved another version since the page was loaded."""

    code = "parameters.newer"
    status = 409

    def __init__(self, serial: str, newest: int) -> None:
        super().__init__(
            f"robot {serial} has version {newest} by now.",
            remedy="Look at what it changed, then decide again.",
        )


class GoBack(BaseModel):
    """Whose values shall hold again, and which version was the newest on the page that showed the difference."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    id: Name
    to: Annotated[int, Field(ge=1)]
    newest: Annotated[int, Field(ge=2)]
    note: Annotated[str, StringConstraints(max_length=500, strip_whitespace=True)] = ""


@router.get("/parameters/{robot_serial}/displacement", **answering(Displacement, "in metres at the tip"))
async def displaced(
    robot_serial: str, request: Request, who: Who, before: Version, after: Version
) -> dict[str, Any]:
    """Return by how much the tip is displaced at most when ``after`` holds instead of ``before``."""
    del who
    sets = ParameterSets(Path(house_of(request).config.path).parent / FOLDER)
    await asyncio.to_thread(
        sets.load, robot_serial, after
    )  # what is not there is refused before anything starts
    given = {"robot_serial": robot_serial, "before": before, "after": after}
    found: dict[str, Any] = await solver_of(request).ask("displacement", **given)
    return found


@router.post(
    "/parameters/{robot_serial}/rollback",
    responses={
        401: {"model": Refused, "description": "the PIN is wanted first"},
        403: {"model": Refused, "description": "the role does not include it"},
        409: {"model": Refused, "description": "a newer version, or the first of two approvals"},
    },
)
async def go_back(robot_serial: str, wanted: GoBack, request: Request, who: Who) -> Head:
    """Save the values of an old version as the newest; nothing is removed."""
    house = house_of(request)
    sets = ParameterSets(Path(house.config.path).parent / FOLDER)
    done: Head | None = await asyncio.to_thread(_refused_or_done, sets, robot_serial, wanted)
    asked = f"{robot_serial}: version {wanted.to} after version {wanted.newest}"
    order = AnswerIt(op="answer", prompt_id=asked)
    shown = {"rev": wanted.newest, "prompt": {"id": asked, "key": _KEY, "text": asked}}
    name = await permitted(house, who, f"{wanted.id} {asked}", wanted.newest, order, shown)
    if done is not None:
        return done
    return await asyncio.to_thread(_saved, sets, robot_serial, wanted, name)


def _refused_or_done(sets: ParameterSets, serial: str, wanted: GoBack) -> Head | None:
    newest = sets.load(serial)
    if (newest.version, newest.rolls_back_to) == (wanted.newest + 1, wanted.to):
        return Head.model_validate(newest)  # sent again after a lost link
    if newest.version != wanted.newest:
        raise NewerVersionError(serial, newest.version)
    if wanted.to >= newest.version:
        raise CellError(
            f"version {wanted.to} is not older than the one that holds.",
            remedy="Choose an older one.",
            code="usage",
        )
    return None


def _saved(sets: ParameterSets, serial: str, wanted: GoBack, name: str) -> Head:
    now = datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds")
    return Head.model_validate(sets.rollback(serial, wanted.to, made_by=name, made_at=now, note=wanted.note))
