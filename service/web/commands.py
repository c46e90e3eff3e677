"""Orders to the cell process: what a person presses."""

import asyncio
from typing import TYPE_CHECKING, Annotated, Any

from fastapi import APIRouter, Request
from pydantic import BaseModel, ConfigDict, StringConstraints, model_validator

from cellcal.calibration.errors import CellError
from cellcal.service.cell_process.messages import CommandId, HoldOrder, Order, Revision, without_conditions
from cellcal.service.path_redaction import without_paths
from cellcal.service.people.authorization import StaleViewError
from cellcal.service.people.naming import LONGEST_NAME, LONGEST_SECRET
from cellcal.service.web.dependencies import Who, app_context, token_of
from cellcal.service.web.error_responses import OrderRefusalResponse
from cellcal.service.web.response_models import MessageJsonResponse
from cellcal.service.web.session_control import authorize_order, control_changes

if TYPE_CHECKING:
    from cellcal.service.web.context import AppContext

router = APIRouter()


class PressedOrder(BaseModel):
    """One press of a button: its own name, the session the person looked at, and the order."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    id: CommandId
    rev: Revision
    order: Order

    @model_validator(mode="before")
    @classmethod
    def _stop_needs_nothing(cls, raw: Any) -> Any:
        return without_conditions(raw, cls.model_fields)


class HoldElsewhereError(CellError):
    """A "held" without the number that the screen's link told last."""

    code = "hold.not_fresh"

    def __init__(self) -> None:
        super().__init__(
            "that the button is held counts only over the screen's own link, with its newest number.",
            remedy="Hold the button on the page.",
        )


class OrderDone(BaseModel):
    """The cell process did it; the session that follows has at least this revision."""

    ok: bool = True
    rev: int


class SecondApproval(BaseModel):
    """The same press with name and PIN of a second person, who stands beside the first."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    pressed: PressedOrder
    name: Annotated[str, StringConstraints(min_length=1, max_length=LONGEST_NAME)]
    secret: Annotated[str, StringConstraints(min_length=1, max_length=LONGEST_SECRET)]


@router.post(
    "/commands",
    response_model=OrderDone,
    responses={
        409: {
            "model": OrderRefusalResponse,
            "description": "the page was out of date, or the order is not possible just now",
        }
    },
)
async def send_command(pressed: PressedOrder, request: Request, who: Who) -> Any:
    """Do what a person asks for; the same id sent again is done once. 409 carries the present session."""
    context = app_context(request)
    if isinstance(pressed.order, HoldOrder) and pressed.order.held:
        raise HoldElsewhereError
    try:
        name = await authorize_order(context, who, pressed.id, pressed.rev, pressed.order)
    except StaleViewError as behind:
        return _stale_response(context, behind)
    return await _forward_order(context, pressed, name)


@router.post(
    "/commands/second",
    response_model=OrderDone,
    responses={
        409: {
            "model": OrderRefusalResponse,
            "description": "no first approval waits for this one, or the page was out of date",
        }
    },
)
async def approve_second(approval: SecondApproval, request: Request, who: Who) -> Any:
    """Take the second approval of what writes, at the first person's screen: both names go to the cell process."""
    del who
    context, pressed = app_context(request), approval.pressed
    witness = await asyncio.to_thread(
        context.authenticator.verify_second_person, token_of(request), approval.name, approval.secret
    )
    session = context.link.session
    async with control_changes(context):
        if not context.authorizer.is_second_approval(witness, pressed.order, pressed.rev, session):
            return _stale_response(context, StaleViewError())
        name = context.authorizer.authorize(witness, pressed.id, pressed.rev, pressed.order, session)
    return await _forward_order(context, pressed, name)


def _stale_response(context: "AppContext", behind: StaleViewError) -> MessageJsonResponse:
    error_fields = {"code": behind.code, "message": behind.message, "remedy": behind.remedy}
    return MessageJsonResponse({"session": context.link.session, **error_fields}, status_code=behind.status)


async def _forward_order(context: "AppContext", pressed: PressedOrder, name: str) -> Any:
    reply = await context.link.send_order(
        {
            "id": pressed.id,
            "rev": pressed.rev,
            "order": pressed.order.model_dump(mode="json"),
            "who": name,
            "people": context.authorizer.signers_of(name),
        }
    )
    if reply["ok"]:
        return reply
    texts = {part: without_paths(reply[part]) for part in ("message", "remedy") if part in reply}
    return MessageJsonResponse({"session": context.link.session, **reply, **texts}, status_code=409)
