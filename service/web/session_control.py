"""One screen orders, the others look on: the check before an order, and the routes to take over."""

import contextlib
from collections.abc import AsyncIterator
from typing import TYPE_CHECKING, Literal

from fastapi import APIRouter, Request
from pydantic import BaseModel, ConfigDict

from cellcal.service.cell_process.messages import AnswerPrompt, HoldOrder, Order
from cellcal.service.people.authentication import Person
from cellcal.service.people.roles import Right, need_of
from cellcal.service.people.session_control import SessionControl, SessionHolder
from cellcal.service.session_documents import OtherQuestion, QuestionContext
from cellcal.service.web.cell_client import CellProcessGoneError
from cellcal.service.web.dependencies import Who, app_context, require_right
from cellcal.service.web.response_models import ControlSeen, response_options
from cellcal.service.web.websocket_hub import OpenScreen, encode_message

if TYPE_CHECKING:
    from cellcal.service.web.context import AppContext

router = APIRouter()
_VERSION_KEY = "write_parameter_version"  # for the permits: it writes


class ControlRequest(BaseModel):
    """A request about the control of the session."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    do: Literal["ask", "withdraw", "give", "refuse"]


@router.post("/control", **response_options(ControlSeen, "who has control now"))
async def change_control(requested: ControlRequest, request: Request, who: Who) -> dict[str, object]:
    """Request to take over, or answer a request; the result is shown on every screen."""
    context = app_context(request)
    async with control_changes(context) as control:
        if requested.do == "ask":
            require_right(who, Right.RUN)
            control.request_control(SessionHolder(who.session_id, who.name))
        elif requested.do == "withdraw":
            control.withdraw_request(who.session_id)
        else:
            control.answer_request(who.session_id, give=requested.do == "give")
    return _control_to_json(context, who.session_id)


async def authorize_order(
    context: "AppContext",
    who: Person,
    press: str,
    rev: int,
    order: Order,
    session: QuestionContext | None = None,
) -> str:
    """Return the name in which an order may go to the cell process: the right, PIN, second person, control.

    ``session`` is what the order answers, where that is no question of the cell process.

    Raises
    ------
    PeopleError
        What is missing, and the cure.
    """
    answered: QuestionContext | None = context.link.session if session is None else session
    async with control_changes(context) as control:
        stops = need_of(order, None).right is Right.STOP
        if (
            who.session_id
            and not stops
            and who.has_right(Right.RUN)
            and not context.authorizer.is_second_approval(who, order, rev, answered)
        ):
            control.take_control(SessionHolder(who.session_id, who.name))
        return context.authorizer.authorize(who, press, rev, order, answered)


async def authorize_version(
    context: "AppContext", who: Person, press: str, question: str, newest: int
) -> str:
    """Return the name in which a version of parameters may follow the ``newest``; errors as `authorize_order`.

    ``question`` says in words which version: an approval counts for exactly this text.
    """
    order = AnswerPrompt(op="answer", prompt_id=question)
    shown: OtherQuestion = {
        "rev": newest,
        "prompt": {"id": question, "key": _VERSION_KEY, "text": question},
    }
    return await authorize_order(context, who, f"{press} {question}", newest, order, shown)


@contextlib.asynccontextmanager
async def control_changes(context: "AppContext") -> AsyncIterator[SessionControl]:
    """Yield the control; afterwards show every screen what has changed, and let go what its last holder held."""
    control = context.control
    holder, shown = control.current_holder, _control_snapshot(context)
    control.drop_inactive(context.authenticator.is_in_charge)
    try:
        yield control
    finally:
        if _control_snapshot(context) != shown:
            for screen in context.screens.open_screens:
                show_control(context, screen)
        if holder is not None and control.current_holder != holder:
            await _let_go(context, holder)


def show_control(context: "AppContext", screen: OpenScreen) -> None:
    """Put into a screen's slot who has control, as its own seat sees it, and what waits for a second person."""
    screen.show_message("control", encode_message("control", _control_to_json(context, screen.session_id)))


def _control_to_json(context: "AppContext", session_id: str) -> dict[str, object]:
    first = context.authorizer.first_approval
    return {**context.control.to_json(session_id), "approved": first.prompt_id, "approved_by": first.name}


def _control_snapshot(context: "AppContext") -> tuple[object, ...]:
    return (
        context.control.current_holder,
        context.control.takeover_requester,
        context.authorizer.first_approval,
    )


async def _let_go(context: "AppContext", holder: SessionHolder) -> None:
    order = HoldOrder(op="hold", held=False).model_dump()
    with contextlib.suppress(CellProcessGoneError):
        await context.link.send_order({"id": "hold", "rev": 0, "who": holder.name, "order": order})
