"""Orders to the desk: what a person presses."""

import asyncio
from typing import TYPE_CHECKING, Annotated, Any

from fastapi import APIRouter, Request
from fastapi.responses import JSONResponse
from pydantic import BaseModel, ConfigDict, StringConstraints, model_validator

from cellcal.calibration.errors import CellError
from cellcal.service.cell_process.messages import CommandId, Hold, Order, Revision, without_conditions
from cellcal.service.people.authorization import StaleViewError
from cellcal.service.people.naming import LONGEST_NAME, LONGEST_SECRET
from cellcal.service.shown_paths import without_paths
from cellcal.service.web.door import Who, house_of, token_of
from cellcal.service.web.error_responses import RefusedOrder
from cellcal.service.web.session_control import permitted, told

if TYPE_CHECKING:
    from cellcal.service.web.context import House

router = APIRouter()


class Pressed(BaseModel):
    """One press of a button: its own name, the session the person looked at, and the order."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    id: CommandId
    rev: Revision
    order: Order

    @model_validator(mode="before")
    @classmethod
    def _stop_needs_nothing(cls, given: Any) -> Any:
        return without_conditions(given, cls.model_fields)


class HoldElsewhereError(CellError):
    """A "held" without the number that the screen's link told last."""

    code = "hold.not_fresh"

    def __init__(self) -> None:
        super().__init__(
            "that the button is held counts only over the screen's own link, with its newest number.",
            remedy="Hold the button on the page.",
        )


class Obeyed(BaseModel):
    """The desk did it; the session that follows has at least this revision."""

    ok: bool = True
    rev: int


class Seconded(BaseModel):
    """The same press with name and PIN of a second person, who stands beside the first."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    pressed: Pressed
    name: Annotated[str, StringConstraints(min_length=1, max_length=LONGEST_NAME)]
    secret: Annotated[str, StringConstraints(min_length=1, max_length=LONGEST_SECRET)]


@router.post(
    "/commands",
    response_model=Obeyed,
    responses={
        409: {
            "model": RefusedOrder,
            "description": "the page was out of date, or the order is not possible just now",
        }
    },
)
async def command(pressed: Pressed, request: Request, who: Who) -> Any:
    """Do what a person asks for; the same id sent again is done once. 409 carries the present session."""
    house = house_of(request)
    if isinstance(pressed.order, Hold) and pressed.order.held:
        raise HoldElsewhereError
    try:
        name = await permitted(house, who, pressed.id, pressed.rev, pressed.order)
    except StaleViewError as behind:
        return _refreshed(house, behind)
    return await _sent(house, pressed, name)


@router.post(
    "/commands/second",
    response_model=Obeyed,
    responses={
        409: {
            "model": RefusedOrder,
            "description": "no first approval waits for this one, or the page was out of date",
        }
    },
)
async def second(given: Seconded, request: Request, who: Who) -> Any:
    """Take the second approval of what writes, at the first person's screen: both names go to the desk."""
    del who
    house, pressed = house_of(request), given.pressed
    witness = await asyncio.to_thread(house.entrance.vouched, token_of(request), given.name, given.secret)
    session = house.link.session
    async with told(house):
        if not house.permits.awaits(witness, pressed.order, pressed.rev, session):
            return _refreshed(house, StaleViewError())
        name = house.permits.granted(witness, pressed.id, pressed.rev, pressed.order, session)
    return await _sent(house, pressed, name)


def _refreshed(house: "House", behind: StaleViewError) -> JSONResponse:
    told = {"code": behind.code, "message": behind.message, "remedy": behind.remedy}
    return JSONResponse({"session": house.link.session, **told}, status_code=behind.status)


async def _sent(house: "House", pressed: Pressed, name: str) -> Any:
    people = house.permits.behind(name)
    reply = await house.link.order({**pressed.model_dump(mode="json"), "who": name, "people": people})
    if reply["ok"]:
        return reply
    said = {part: without_paths(reply[part]) for part in ("message", "remedy") if part in reply}
    return JSONResponse({"session": house.link.session, **reply, **said}, status_code=409)
