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
from cellcal.service.web.door import Who, cookie_of, house_of, standing, standing_with, token_of
from cellcal.service.web.session_control import told

router = APIRouter()
Token = Annotated[str, StringConstraints(min_length=1, max_length=200)]
Secret = Annotated[str, StringConstraints(min_length=1, max_length=LONGEST_SECRET)]


class _Given(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


class NewDevice(_Given):
    """A browser that an administrator invited; its public key as SPKI in base64url."""

    token: Token
    public_key: Annotated[str, StringConstraints(max_length=400)]


class Proof(_Given):
    """A device's signature of a challenge (r and s, 64 bytes, base64url)."""

    device: Token
    challenge: Token
    signature: Token


class NameAndPin(_Given):
    """Who wants in."""

    name: Annotated[str, StringConstraints(min_length=1, max_length=LONGEST_NAME)]
    secret: Secret


class PinAgain(_Given):
    """The PIN of whoever is signed in."""

    secret: Secret


class Somebody(BaseModel):
    """Who is signed in; ``alone``: nobody was set up yet, the console is the technician."""

    name: str
    role: str
    locked: bool
    alone: bool
    rights: list[str]


class Standing(BaseModel):
    """What is wanted next, and who asks."""

    wanted: Literal["device", "person", "pin", "nothing"]
    person: Somebody | None


class Done(BaseModel):
    """It is done."""

    ok: Literal[True]


class StandingNow(Done, Standing):
    """It is done, and this is wanted next."""


@router.get("/sign-in", response_model=Standing)
async def state(request: Request) -> Any:
    """Return what is wanted next: a device's proof, a person, the PIN again, or nothing."""
    told_now = standing(request)
    seat = house_of(request).entrance.seat(token_of(request))
    return told_now if seat is None else _with_session(JSONResponse(told_now), request, seat)


@router.get("/sign-in/console", response_class=RedirectResponse, include_in_schema=False)
async def console(request: Request, token: Token) -> Response:
    """Open a session with the address that the console showed; it works once."""
    session = house_of(request).entrance.from_console(token)
    return _with_session(RedirectResponse("/", status_code=303), request, session)


@router.get("/sign-in/people")
async def people(request: Request, who: Who) -> list[dict[str, str]]:
    """Return who may sign in here, for a list to pick from."""
    del who
    return [{"name": each.name, "role": each.role} for each in house_of(request).entrance.register.people()]


@router.post("/sign-in/devices")
async def enrol(given: NewDevice, request: Request) -> dict[str, str]:
    """Enrol this browser; the token of the address works once."""
    device = house_of(request).entrance.enrol(given.token, given.public_key)
    return {"device": device.id, "name": device.name}


@router.post("/sign-in/challenges")
async def challenge(request: Request) -> dict[str, str]:
    """Return what a device has to sign within a minute, and the address that it has to name."""
    return {"challenge": house_of(request).entrance.challenge()}


@router.post("/sign-in/device", response_model=StandingNow)
async def device(given: Proof, request: Request) -> Response:
    """Open a session for an enrolled device, which may look on and ask for a stop; say what is wanted next."""
    origin = f"{request.url.scheme}://{request.headers['host']}"
    session = house_of(request).entrance.from_device(given.device, given.challenge, given.signature, origin)
    return _with_session(JSONResponse({"ok": True, **standing_with(request, session)}), request, session)


@router.post("/sign-in/person", response_model=Done)
async def person(given: NameAndPin, request: Request) -> Response:
    """Let a person in on this device."""
    entrance, old = house_of(request).entrance, token_of(request)
    seat = _seat(request)
    session = await asyncio.to_thread(entrance.sign_in, old, given.name, given.secret)
    await _left(request, seat)
    return _with_session(JSONResponse({"ok": True}), request, session)


@router.post("/sign-in/confirm")
async def confirm(given: PinAgain, request: Request) -> dict[str, bool]:
    """Take the PIN again: it unlocks the screen, and counts two minutes for an approval."""
    await asyncio.to_thread(house_of(request).entrance.confirm, token_of(request), given.secret)
    return {"ok": True}


@router.post("/sign-in/leave", response_model=Done)
async def leave(request: Request) -> Response:
    """Sign the person out; the device goes on looking on, and the run goes on."""
    seat = _seat(request)
    session = house_of(request).entrance.leave(token_of(request))
    await _left(request, seat)
    return _with_session(JSONResponse({"ok": True}), request, session)


def _seat(request: Request) -> str:
    session = house_of(request).entrance.sessions.find(token_of(request))
    return "" if session is None else session.seat


async def _left(request: Request, seat: str) -> None:
    """Close the screens of a session that has ended, and give up its control."""
    house = house_of(request)
    async with told(house) as control:
        control.release(seat)
    house.screens.close(seat)


def _with_session(response: Response, request: Request, token: str) -> Response:
    response.set_cookie(
        cookie_of(request), token, max_age=int(WHOLE_S), path="/", httponly=True, samesite="strict",
        secure=house_of(request).settings.tls,
    )  # fmt: skip
    return response
