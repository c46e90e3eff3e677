"""One screen orders, the others look on: what the doors ask before an order, and the routes to take over."""

import contextlib
from collections.abc import AsyncIterator
from typing import TYPE_CHECKING, Any, Literal

from fastapi import APIRouter, Request
from pydantic import BaseModel, ConfigDict

from cellcal.service.cell_process.messages import Hold, Order
from cellcal.service.people.authentication import Person
from cellcal.service.people.errors import NotAllowedError, PinAgainError
from cellcal.service.people.roles import Right, need_of
from cellcal.service.people.session_control import Control, Seat
from cellcal.service.web.cell_client import DeskGoneError
from cellcal.service.web.door import Who, house_of
from cellcal.service.web.response_models import ControlSeen, answering
from cellcal.service.web.websocket_hub import Screen, framed

if TYPE_CHECKING:
    from cellcal.service.web.context import House

router = APIRouter()


class Wish(BaseModel):
    """What somebody wants with the control of the session."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    do: Literal["ask", "withdraw", "give", "refuse"]


@router.post("/control", **answering(ControlSeen, "who has control now"))
async def wish(given: Wish, request: Request, who: Who) -> dict[str, Any]:
    """Ask to take over, or answer whoever asks; every screen is shown what came of it."""
    house = house_of(request)
    async with told(house) as control:
        if given.do == "ask":
            _refuse_whoever_only_looks(who)
            control.ask(Seat(who.seat, who.name))
        elif given.do == "withdraw":
            control.withdraw(who.seat)
        else:
            control.answer(who.seat, give=given.do == "give")
    return _as_seen(house, who.seat)


def _refuse_whoever_only_looks(who: Person) -> None:
    if who.locked:
        raise PinAgainError("this screen was left alone for a while:")
    if not who.may(Right.RUN):
        raise NotAllowedError(who.name, who.role, Right.RUN.value, "Let a technician or an engineer sign in.")


async def permitted(
    house: "House", who: Person, press: str, rev: int, order: Order, session: dict[str, Any] | None = None
) -> str:
    """Return the name in which an order may go to the desk: the right, the PIN, the second person, the control.

    ``session`` is what the order answers, where that is no question of the desk.

    Raises
    ------
    PeopleError
        What is missing, and the cure.
    """
    session = house.link.session if session is None else session
    async with told(house) as control:
        stops = need_of(order, None).right is Right.STOP
        if (
            who.seat
            and not stops
            and who.may(Right.RUN)
            and not house.permits.awaits(who, order, rev, session)
        ):
            control.take(Seat(who.seat, who.name))
        return house.permits.granted(who, press, rev, order, session)


@contextlib.asynccontextmanager
async def told(house: "House") -> AsyncIterator[Control]:
    """Lend the control; afterwards show every screen what has changed, and let go what its last holder held."""
    control = house.control
    holder, shown = control.holder, _shown(house)
    control.settle(house.entrance.is_in_charge)
    try:
        yield control
    finally:
        if _shown(house) != shown:
            for screen in house.screens.open:
                show_control(house, screen)
        if holder is not None and control.holder != holder:
            await _let_go(house, holder)


def show_control(house: "House", screen: Screen) -> None:
    """Put into a screen's slot who has control, as its own seat sees it, and what waits for a second person."""
    screen.show("control", framed("control", _as_seen(house, screen.seat)))


def _as_seen(house: "House", seat: str) -> dict[str, Any]:
    first = house.permits.first
    return {**house.control.told(seat), "approved": first.prompt_id, "approved_by": first.name}


def _shown(house: "House") -> tuple[object, ...]:
    return house.control.holder, house.control.asks, house.permits.first


async def _let_go(house: "House", seat: Seat) -> None:
    order = Hold(op="hold", held=False).model_dump()
    with contextlib.suppress(DeskGoneError):
        await house.link.order({"id": "hold", "rev": 0, "who": seat.name, "order": order})
