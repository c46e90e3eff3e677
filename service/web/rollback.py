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
from cellcal.calibration.message import make_message
from cellcal.service.cell_process.messages import Name
from cellcal.service.engineering.parameters.parameter_sets import FOLDER, ParameterSets
from cellcal.service.people.errors import PeopleError
from cellcal.service.review.review_models import Displacement
from cellcal.service.web.dependencies import Who, app_context
from cellcal.service.web.error_responses import RefusalResponse
from cellcal.service.web.parameters import SetHead, Version
from cellcal.service.web.residuals import compute_client_of
from cellcal.service.web.response_models import response_options
from cellcal.service.web.session_control import authorize_version
from cellcal.service.web.waiting_clients import answer_while_awaited

router = APIRouter()


class NewerVersionError(PeopleError):
    """Another version was saved since the page was loaded."""

    code = "parameters.newer"
    status = 409

    def __init__(self, serial: str, newest: int) -> None:
        super().__init__(
            make_message("robot {serial} has version {newest} by now.", serial=serial, newest=newest),
            remedy="Look at what it changed, then decide again.",
        )


class RollbackRequest(BaseModel):
    """Whose values shall hold again, and which version was the newest on the page that showed the difference."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    id: Name
    to: Annotated[int, Field(ge=1)]
    newest: Annotated[int, Field(ge=2)]
    note: Annotated[str, StringConstraints(max_length=500, strip_whitespace=True)] = ""


@router.get(
    "/parameters/{robot_serial}/displacement", **response_options(Displacement, "in metres at the tip")
)
async def get_displacement(
    robot_serial: str, request: Request, who: Who, before: Version, after: Version
) -> dict[str, Any]:
    """Return by how much the tip is displaced at most when ``after`` holds instead of ``before``."""
    del who
    sets = ParameterSets(Path(app_context(request).config.path).parent / FOLDER)
    await asyncio.to_thread(
        sets.load_set, robot_serial, after
    )  # what is not there is refused before anything starts
    arguments = {"robot_serial": robot_serial, "before": before, "after": after}
    found: dict[str, Any] = await answer_while_awaited(
        request, compute_client_of(request).ask_worker("displacement", **arguments)
    )
    return found


@router.post(
    "/parameters/{robot_serial}/rollback",
    responses={
        401: {"model": RefusalResponse, "description": "the PIN is wanted first"},
        403: {"model": RefusalResponse, "description": "the role does not include it"},
        409: {"model": RefusalResponse, "description": "a newer version, or the first of two approvals"},
    },
)
async def roll_back(robot_serial: str, requested: RollbackRequest, request: Request, who: Who) -> SetHead:
    """Save the values of an old version as the newest; nothing is removed."""
    context = app_context(request)
    sets = ParameterSets(Path(context.config.path).parent / FOLDER)
    done: SetHead | None = await asyncio.to_thread(_refused_or_done, sets, robot_serial, requested)
    question = make_message(
        "{robot_serial}: version {to} after version {newest}",
        robot_serial=robot_serial,
        to=requested.to,
        newest=requested.newest,
    )
    name = await authorize_version(context, who, requested.id, question, requested.newest)
    if done is not None:
        return done
    return await asyncio.to_thread(_save_rollback, sets, robot_serial, requested, name)


def _refused_or_done(sets: ParameterSets, serial: str, requested: RollbackRequest) -> SetHead | None:
    newest = sets.load_set(serial)
    if (newest.version, newest.rolls_back_to) == (requested.newest + 1, requested.to):
        return SetHead.model_validate(newest)  # sent again after a lost link
    if newest.version != requested.newest:
        raise NewerVersionError(serial, newest.version)
    if requested.to >= newest.version:
        raise CellError(
            make_message("version {to} is not older than the one that holds.", to=requested.to),
            remedy="Choose an older one.",
            code="usage",
        )
    return None


def _save_rollback(sets: ParameterSets, serial: str, requested: RollbackRequest, name: str) -> SetHead:
    now = datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds")
    return SetHead.model_validate(
        sets.roll_back(serial, requested.to, made_by=name, made_at=now, note=requested.note)
    )
