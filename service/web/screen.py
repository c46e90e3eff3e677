"""What a screen sees: the session whenever it changes, live values ten times a second."""

import asyncio
import contextlib
from typing import Any

from fastapi import APIRouter, Request, WebSocket, WebSocketDisconnect
from pydantic import TypeAdapter, ValidationError

from service.desk.messages import Hold
from service.people.errors import NotSignedInError, PeopleError
from service.web.door import Who, house_of, person_of, token_of
from service.web.link import DeskGoneError
from service.web.screens import Screen, framed

router = APIRouter()
_LOOK_S = 5.0
_HOLD: TypeAdapter[Hold] = TypeAdapter(Hold)


@router.get("/session")
async def session(request: Request, who: Who) -> dict[str, Any]:
    """Return the whole present state: run, question, devices' connection, losses; null while the desk starts."""
    house = house_of(request)
    return {
        "session": house.link.session,
        "person": {"name": who.name, "role": who.role, "locked": who.locked},
        "demo": house.settings.demo,
    }


@router.websocket("/screen")
async def screen(socket: WebSocket) -> None:
    """Feed one screen; the only thing it may say is whether its hold-to-move button is held."""
    house, who = house_of(socket), person_of(socket)
    await socket.accept()
    shown = Screen(socket, who.name)
    if house.link.session is not None:
        shown.show("session", framed("session", house.link.session))

    async def receive() -> None:
        with contextlib.suppress(WebSocketDisconnect, NotSignedInError):
            while True:
                person_of(socket)  # a session that has ended, or whose device was revoked, sees nothing more
                with contextlib.suppress(TimeoutError):
                    async with asyncio.timeout(_LOOK_S):
                        text = await socket.receive_text()
                    await _take(socket, text)

    await house.screens.attend(shown, receive)


async def _take(socket: WebSocket, text: str) -> None:
    house, who = house_of(socket), person_of(socket)
    try:
        hold = _HOLD.validate_json(text)
    except ValidationError:
        return  # a screen that babbles moves nothing
    with contextlib.suppress(DeskGoneError, PeopleError):
        name = house.permits.granted(who, "hold", 0, hold, None)
        if hold.held:
            house.entrance.busy(token_of(socket))
        await house.link.order({"id": "hold", "rev": 0, "who": name, "order": hold.model_dump()})
