"""What a browser is told when something was refused or not understood."""

from typing import Any

from fastapi import Request
from fastapi.exceptions import RequestValidationError
from pydantic import BaseModel

from cellcal.calibration.errors import CellError
from cellcal.calibration.message import make_message
from cellcal.service.path_redaction import without_paths
from cellcal.service.people.errors import PeopleError
from cellcal.service.web.cell_client import CellProcessGoneError
from cellcal.service.web.response_models import MessageJsonResponse
from cellcal.service.web.waiting_clients import ClientGoneError


class RefusalResponse(BaseModel):
    """Why a request was refused or not understood, and what to do about it."""

    code: str
    message: str
    remedy: str


class OrderRefusalResponse(RefusalResponse):
    """The same of an order; where the page was behind, with the session as it is."""

    session: dict[str, Any] | None = None


# what every route may answer; those whose answer is no JSON name its kind in `responses`, or this would have it too
REFUSALS: dict[int | str, dict[str, Any]] = {
    422: {"model": RefusalResponse, "description": "not understood, or not possible, and what to do"},
    "default": {"model": RefusalResponse, "description": "refused, and what to do"},
}


def respond_to_error(_: Request, error: Exception) -> MessageJsonResponse:
    """Say what happened and what to do."""
    assert isinstance(error, CellError)
    body = {
        "code": error.code,
        "message": without_paths(error.message),
        "remedy": without_paths(error.remedy),
    }
    if isinstance(error, PeopleError):
        wait = {} if error.retry_after_s is None else {"retry-after": str(error.retry_after_s)}
        return MessageJsonResponse(body, status_code=error.status, headers=wait)
    return MessageJsonResponse(body, status_code=_status_of(error))


def _status_of(error: CellError) -> int:
    if isinstance(error, CellProcessGoneError):
        return 503
    # as other servers log it: no client reads this answer, and nothing was wrong with what was asked
    return 499 if isinstance(error, ClientGoneError) else 422


def refuse_request(_: Request, error: Exception) -> MessageJsonResponse:
    """Say which field is wrong, without sending back what was sent: it may be huge, or no JSON at all."""
    assert isinstance(error, RequestValidationError)
    faults = "; ".join(f"{'.'.join(map(str, each['loc']))}: {each['msg']}" for each in error.errors()[:5])
    body = {
        "code": "request",
        "message": make_message("The request is not understood: {faults}", faults=faults),
        "remedy": "See /openapi.json.",
    }
    return MessageJsonResponse(body, status_code=422)
