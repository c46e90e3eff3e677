"""What a screen sees: the session whenever it changes, live values ten times a second, who it is, who has control."""

import asyncio
import contextlib
import time
from collections import OrderedDict
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Literal

from fastapi import APIRouter, Request, WebSocket, WebSocketDisconnect
from pydantic import BaseModel, ConfigDict, ValidationError

from cellcal.service.cell_process.hold_to_move import DEAD_MAN_S
from cellcal.service.cell_process.messages import Flag, HoldOrder, Revision
from cellcal.service.people.errors import NotSignedInError, PeopleError
from cellcal.service.web.cell_client import CellProcessGoneError
from cellcal.service.web.dependencies import Who, app_context, person_of, sign_in_state, token_of
from cellcal.service.web.response_models import SessionSeen, response_options
from cellcal.service.web.session_control import authorize_order, control_changes, show_control
from cellcal.service.web.task_troubles import troubles_of
from cellcal.service.web.websocket_hub import OpenScreen, encode_message

if TYPE_CHECKING:
    from cellcal.service.web.context import AppContext

router = APIRouter()
_LOOK_S = 5.0
_BEATS = 16


class HoldMessage(BaseModel):
    """The only thing that a screen may say: whether its hold-to-move button is held."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    op: Literal["hold"]
    held: Flag
    beat: Revision = 0


@dataclass
class HeartbeatNumbers:
    """Numbers that a screen says back: a word is no older than the number in it.

    A link that broke delivers later what it could not deliver then. "Held" from seconds ago must not move a robot,
    and from a moment ago only for what is left of the time that a word counts.
    """

    clock: Callable[[], float] = time.monotonic
    _sent_at_s: OrderedDict[int, float] = field(default_factory=OrderedDict)
    _count: int = 0

    def next_number(self) -> int:
        """Return the number to tell now."""
        self._count += 1
        self._sent_at_s[self._count] = self.clock()
        while len(self._sent_at_s) > _BEATS:
            self._sent_at_s.popitem(last=False)
        return self._count

    def age_s(self, number: int) -> float:
        """Return how long ago a number was told; infinity for one that never was, or too long ago to be kept."""
        return self.clock() - self._sent_at_s.get(number, float("-inf"))


@router.get("/session", **response_options(SessionSeen, "the whole present state"))
async def get_session(request: Request, who: Who) -> dict[str, object]:
    """Return the whole present state: run, question, devices, losses; null while the cell process starts."""
    del who
    context = app_context(request)
    return {
        "session": context.link.session,
        "troubles": troubles_of(context.link.session),
        **sign_in_state(request),
        "demo": context.settings.demo,
    }


@router.websocket("/screen")
async def serve_screen(socket: WebSocket) -> None:
    """Feed one screen; the only thing it may say is whether its hold-to-move button is held."""
    context, who = app_context(socket), person_of(socket)
    await socket.accept()
    shown, beats = OpenScreen(socket, who.name, who.session_id), HeartbeatNumbers()
    shown.show_message("person", encode_message("person", sign_in_state(socket)))
    shown.show_message("troubles", encode_message("troubles", troubles_of(context.link.session)))
    show_control(context, shown)
    _show_cell(context, shown)

    async def receive_messages() -> None:
        with contextlib.suppress(WebSocketDisconnect, NotSignedInError):
            last_state = sign_in_state(socket)
            while True:
                person_of(socket)  # a session that has ended, or whose device was revoked, sees nothing more
                if (now := sign_in_state(socket)) != last_state:  # locked by idling, or made something else
                    last_state = now
                    shown.show_message("person", encode_message("person", last_state))
                async with control_changes(context):
                    pass  # a holder who was locked out, or a requester that left, is shown no longer
                with contextlib.suppress(TimeoutError):
                    async with asyncio.timeout(_LOOK_S):
                        text = await socket.receive_text()
                    await _handle_text(socket, shown, beats, text)

    await context.screens.serve_screen(shown, receive_messages)
    if context.control.takeover_requester is not None:  # a holder without a page is waited for less long
        for screen in context.screens.open_screens:
            show_control(context, screen)


def _show_cell(context: "AppContext", shown: OpenScreen) -> None:
    """Tell a screen that opens what is known of the cell, and before that whether it is a demo.

    A page that learned of the demo later would be pushed down by the demo's bar.
    """
    if context.settings.demo:
        shown.show_message("demo", encode_message("demo", True))
    if context.link.session is not None:
        shown.show_message("session", encode_message("session", context.link.session))
    if context.link.live_values is not None:  # a page that opens does not wait for the next tenth of a second
        shown.show_message("live", encode_message("live", context.link.live_values))


async def _handle_text(socket: WebSocket, shown: OpenScreen, beats: HeartbeatNumbers, text: str) -> None:
    context, who = app_context(socket), person_of(socket)
    try:
        message = HoldMessage.model_validate_json(text)
    except ValidationError:
        return  # a screen that babbles moves nothing
    at_s: float | None = None
    if message.held:
        shown.show_message("beat", encode_message("beat", beats.next_number()))
        age_s = beats.age_s(message.beat)
        if age_s >= DEAD_MAN_S:
            return
        at_s = time.monotonic() - age_s  # the cell's process has the same clock: what waits in between counts
    hold = HoldOrder(op="hold", held=message.held, at_s=at_s)
    with contextlib.suppress(CellProcessGoneError, PeopleError):
        name = await authorize_order(context, who, "hold", 0, hold)
        if hold.held:
            context.authenticator.note_activity(token_of(socket))
        await context.link.send_order({"id": "hold", "rev": 0, "who": name, "order": hold.model_dump()})
