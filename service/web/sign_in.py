r"""Signing in: this computer's console, enrolled devices, people with a PIN.

What a page does: ``GET /api/sign-in`` says what is wanted. A device that was enrolled asks for a challenge, signs
``cellcal device sign-in\n<origin>\n<challenge>`` with its key and sends it; it may look on and stop. Then a person
gives name and PIN. ``POST /api/sign-in/confirm`` is the PIN again: after idling, and before an approval.
"""

import asyncio
from typing import Annotated, Any, Literal

from fastapi import APIRouter, Request
from fastapi.responses import JSONResponse, RedirectResponse, Response
from pydantic import BaseModel, ConfigDict, StringConstraints

from cellcal.service.people.naming import LONGEST_NAME, LONGEST_SECRET
from cellcal.service.people.sessions import WHOLE_S
from cellcal.service.web.dependencies import (
    Who,
    app_context,
    cookie_of,
    sign_in_state,
    sign_in_state_of,
    token_of,
)
from cellcal.service.web.session_control import control_changes

router = APIRouter()
Token = Annotated[str, StringConstraints(min_length=1, max_length=200)]
Secret = Annotated[str, StringConstraints(min_length=1, max_length=LONGEST_SECRET)]


class _SignInModel(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


class DeviceEnrolment(_SignInModel):
    """A browser that an administrator invited; its public key as SPKI in base64url."""

    token: Token
    public_key: Annotated[str, StringConstraints(max_length=400)]


class DeviceProof(_SignInModel):
    """A device's signature of a challenge (r and s, 64 bytes, base64url)."""

    device: Token
    challenge: Token
    signature: Token


class NameAndPin(_SignInModel):
    """The name and PIN of a person who signs in."""

    name: Annotated[str, StringConstraints(min_length=1, max_length=LONGEST_NAME)]
    secret: Secret


class PinAgain(_SignInModel):
    """The PIN of the signed-in person."""

    secret: Secret


class SignedInPerson(BaseModel):
    """The person who is signed in; ``alone``: no person was set up yet, the console is the technician."""

    name: str
    role: str
    locked: bool
    alone: bool
    rights: list[str]


class SignInState(BaseModel):
    """The next step of a sign-in, and who asks."""

    wanted: Literal["device", "person", "pin", "nothing"]
    person: SignedInPerson | None


class Done(BaseModel):
    """It is done."""

    ok: Literal[True]


class SignInDone(Done, SignInState):
    """It is done, and this is wanted next."""


@router.get("/sign-in", response_model=SignInState)
async def get_state(request: Request) -> Any:
    """Return what is wanted next: a device's proof, a person, the PIN again, or nothing."""
    told_now = sign_in_state(request)
    session_id = app_context(request).authenticator.open_local_session(token_of(request))
    return told_now if session_id is None else _with_session(JSONResponse(told_now), request, session_id)


@router.get("/sign-in/console", response_class=RedirectResponse, include_in_schema=False)
async def open_console(request: Request, token: Token) -> Response:
    """Open a session with the address that the console showed; it works once."""
    session = app_context(request).authenticator.from_console(token)
    return _with_session(RedirectResponse("/", status_code=303), request, session)


@router.get("/sign-in/people")
async def list_people(request: Request, who: Who) -> list[dict[str, str]]:
    """Return who may sign in here, for a list to pick from."""
    del who
    return [
        {"name": each.name, "role": each.role}
        for each in app_context(request).authenticator.accounts.list_people()
    ]


@router.post("/sign-in/devices")
async def enrol_device(enrolment: DeviceEnrolment, request: Request) -> dict[str, str]:
    """Enrol this browser; the token of the address works once."""
    device = app_context(request).authenticator.enrol_device(enrolment.token, enrolment.public_key)
    return {"device": device.id, "name": device.name}


@router.post("/sign-in/challenges")
async def create_challenge(request: Request) -> dict[str, str]:
    """Return what a device has to sign within a minute, and the address that it has to name."""
    return {"challenge": app_context(request).authenticator.create_challenge()}


@router.post("/sign-in/device", response_model=SignInDone)
async def sign_in_device(proof: DeviceProof, request: Request) -> Response:
    """Open a session for an enrolled device, which may look on and ask for a stop; say what is wanted next."""
    origin = f"{request.url.scheme}://{request.headers['host']}"
    session = app_context(request).authenticator.from_device(
        proof.device, proof.challenge, proof.signature, origin
    )
    return _with_session(JSONResponse({"ok": True, **sign_in_state_of(request, session)}), request, session)


@router.post("/sign-in/person", response_model=Done)
async def sign_in_person(credentials: NameAndPin, request: Request) -> Response:
    """Let a person in on this device."""
    authenticator, old = app_context(request).authenticator, token_of(request)
    session_id = _session_id(request)
    session = await asyncio.to_thread(authenticator.sign_in, old, credentials.name, credentials.secret)
    await _end_session(request, session_id)
    return _with_session(JSONResponse({"ok": True}), request, session)


@router.post("/sign-in/confirm")
async def confirm_pin(pin: PinAgain, request: Request) -> dict[str, bool]:
    """Take the PIN again: it unlocks the screen, and counts two minutes for an approval."""
    await asyncio.to_thread(app_context(request).authenticator.confirm_pin, token_of(request), pin.secret)
    return {"ok": True}


@router.post("/sign-in/leave", response_model=Done)
async def sign_out(request: Request) -> Response:
    """Sign the person out; the device goes on looking on, and the run goes on."""
    session_id = _session_id(request)
    session = app_context(request).authenticator.sign_out(token_of(request))
    await _end_session(request, session_id)
    return _with_session(JSONResponse({"ok": True}), request, session)


def _session_id(request: Request) -> str:
    session = app_context(request).authenticator.sessions.find_session(token_of(request))
    return "" if session is None else session.session_id


async def _end_session(request: Request, session_id: str) -> None:
    """Close the screens of a session that has ended, and give up its control."""
    context = app_context(request)
    async with control_changes(context) as control:
        control.release_control(session_id)
    context.screens.close_session(session_id)


def _with_session(response: Response, request: Request, token: str) -> Response:
    response.set_cookie(
        cookie_of(request), token, max_age=int(WHOLE_S), path="/", httponly=True, samesite="strict",
        secure=app_context(request).settings.tls,
    )  # fmt: skip
    return response
