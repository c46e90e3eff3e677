"""What a screen sees: the session whenever it changes, live values ten times a second, who it is, who has control."""

import asyncio
import contextlib
import time
from collections import OrderedDict
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, Literal

from fastapi import APIRouter, Request, WebSocket, WebSocketDisconnect
from pydantic import BaseModel, ConfigDict, ValidationError

from cellcal.service.cell_process.hold_to_move import DEAD_MAN_S
from cellcal.service.cell_process.messages import Flag, Hold, Revision
from cellcal.service.people.errors import NotSignedInError, PeopleError
from cellcal.service.web.cell_client import DeskGoneError
from cellcal.service.web.door import Who, house_of, person_of, standing, token_of
from cellcal.service.web.response_models import SessionSeen, answering
from cellcal.service.web.session_control import permitted, show_control, told
from cellcal.service.web.troubles import troubles_of
from cellcal.service.web.websocket_hub import Screen, framed

router = APIRouter()
_LOOK_S = 5.0
_BEATS = 16


class Said(BaseModel):
    """The only thing that a screen may say: whether its hold-to-move button is held."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    op: Literal["hold"]
    held: Flag
    beat: Revision = 0


@dataclass
class Beats:
    """Numbers that a screen says back: a word is no older than the number in it.

    A link that broke delivers later what it could not deliver then. "Held" from seconds ago must not move a robot,
    and from a moment ago only for what is left of the time that a word counts.
    """

    clock: Callable[[], float] = time.monotonic
    _told: OrderedDict[int, float] = field(default_factory=OrderedDict)
    _count: int = 0

    def next(self) -> int:
        """Return the number to tell now."""
        self._count += 1
        self._told[self._count] = self.clock()
        while len(self._told) > _BEATS:
            self._told.popitem(last=False)
        return self._count

    def age_s(self, number: int) -> float:
        """Return how long ago a number was told; infinity for one that never was, or too long ago to be kept."""
        return self.clock() - self._told.get(number, float("-inf"))


@router.get("/session", **answering(SessionSeen, "the whole present state"))
async def session(request: Request, who: Who) -> dict[str, Any]:
    """Return the whole present state: run, question, devices' connection, losses; null while the desk starts."""
    del who
    house = house_of(request)
    return {
        "session": house.link.session,
        "troubles": troubles_of(house.link.session),
        **standing(request),
        "demo": house.settings.demo,
    }


@router.websocket("/screen")
async def screen(socket: WebSocket) -> None:
    """Feed one screen; the only thing it may say is whether its hold-to-move button is held."""
    house, who = house_of(socket), person_of(socket)
    await socket.accept()
    shown, beats = Screen(socket, who.name, who.seat), Beats()
    shown.show("person", framed("person", standing(socket)))
    shown.show("troubles", framed("troubles", troubles_of(house.link.session)))
    show_control(house, shown)
    if house.link.session is not None:
        shown.show("session", framed("session", house.link.session))
    if house.link.live is not None:  # a page that opens does not wait for the next tenth of a second
        shown.show("live", framed("live", house.link.live))

    async def receive() -> None:
        with contextlib.suppress(WebSocketDisconnect, NotSignedInError):
            known = standing(socket)
            while True:
                person_of(socket)  # a session that has ended, or whose device was revoked, sees nothing more
                if (now := standing(socket)) != known:  # locked by idling, or made something else
                    known = now
                    shown.show("person", framed("person", known))
                async with told(house):
                    pass  # a holder who was locked out, or somebody who asked and left, is shown no longer
                with contextlib.suppress(TimeoutError):
                    async with asyncio.timeout(_LOOK_S):
                        text = await socket.receive_text()
                    await _take(socket, shown, beats, text)

    await house.screens.attend(shown, receive)


async def _take(socket: WebSocket, shown: Screen, beats: Beats, text: str) -> None:
    house, who = house_of(socket), person_of(socket)
    try:
        said = Said.model_validate_json(text)
    except ValidationError:
        return  # a screen that babbles moves nothing
    at_s: float | None = None
    if said.held:
        shown.show("beat", framed("beat", beats.next()))
        age_s = beats.age_s(said.beat)
        if age_s >= DEAD_MAN_S:
            return
        at_s = time.monotonic() - age_s  # the cell's process has the same clock: what waits in between counts
    hold = Hold(op="hold", held=said.held, at_s=at_s)
    with contextlib.suppress(DeskGoneError, PeopleError):
        name = await permitted(house, who, "hold", 0, hold)
        if hold.held:
            house.entrance.busy(token_of(socket))
        await house.link.order({"id": "hold", "rev": 0, "who": name, "order": hold.model_dump()})
