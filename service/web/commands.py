"""Orders to the desk: what a person presses."""

from typing import Any

from fastapi import APIRouter, Request
from fastapi.responses import JSONResponse
from pydantic import BaseModel, ConfigDict

from service.desk.messages import Name, Order
from service.web.door import Who, house_of

router = APIRouter()


class Pressed(BaseModel):
    """One press of a button: its own name, the session the person looked at, and the order."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    id: Name
    rev: int
    order: Order


class Obeyed(BaseModel):
    """The desk did it; the session that follows has at least this revision."""

    ok: bool = True
    rev: int


@router.post(
    "/commands",
    response_model=Obeyed,
    responses={409: {"description": "the page was out of date, or the order is not possible just now"}},
)
async def command(pressed: Pressed, request: Request, who: Who) -> Any:
    """Do what a person asks for; the same id sent again is done once. 409 carries the present session."""
    house = house_of(request)
    link = house.link
    name = house.permits.granted(who, pressed.id, pressed.rev, pressed.order, link.session)
    reply = await link.order({**pressed.model_dump(mode="json"), "who": name})
    if reply["ok"]:
        return reply
    return JSONResponse({"session": link.session, **reply}, status_code=409)
