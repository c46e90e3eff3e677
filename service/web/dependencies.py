"""What routes take from a request: the service's context, and who is asking."""

from typing import TYPE_CHECKING, Annotated, cast

from fastapi import Depends
from starlette.requests import HTTPConnection

from cellcal.service.people.authentication import Person
from cellcal.service.people.errors import NotAllowedError, NotSignedInError, PinAgainError
from cellcal.service.people.roles import Right

if TYPE_CHECKING:
    from cellcal.service.web.context import AppContext


def app_context(connection: HTTPConnection) -> "AppContext":
    """Return what the routes of this service share."""
    return cast("AppContext", connection.app.state.context)


def cookie_of(connection: HTTPConnection) -> str:
    """Return the name of the session's cookie: with TLS one that no other host and no plain page can set.

    Cookies do not know ports, so the name does: two cells on one computer do not sign each other out.
    """
    server = connection.scope.get("server") or ("", None)
    name = f"cellcal-{server[1] or 0}"
    return f"__Host-{name}" if app_context(connection).settings.tls else name


def token_of(connection: HTTPConnection) -> str | None:
    """Return the token of the session, None where there is none."""
    return connection.cookies.get(cookie_of(connection))


def person_of(connection: HTTPConnection) -> Person:
    """Return who asks, as it is at this moment.

    Raises
    ------
    NotSignedInError
        The session is unknown.
    """
    return app_context(connection).authenticator.authenticate(token_of(connection))


def require_right(who: Person, right: Right) -> None:
    """Refuse a person whose role does not include something, and a screen that was left alone.

    Raises
    ------
    PinAgainError, NotAllowedError
        What is wanted first.
    """
    if who.locked:
        raise PinAgainError("this screen was left alone for a while:")
    if not who.has_right(right):
        remedy = "Let an engineer sign in."
        if right is Right.RUN:
            remedy = "Let a technician or an engineer sign in."
        raise NotAllowedError(who.name, who.role, right.value, remedy)


def sign_in_state(connection: HTTPConnection) -> dict[str, object]:
    """Return who asks and what is wanted next: a device's proof, a person, the PIN again, or nothing."""
    return sign_in_state_of(connection, token_of(connection))


def sign_in_state_of(connection: HTTPConnection, token: str | None) -> dict[str, object]:
    """Return the same for a session that has only just begun: its cookie was not sent yet."""
    authenticator = app_context(connection).authenticator
    try:
        who = authenticator.authenticate(token)
    except NotSignedInError:
        return {"wanted": "device", "person": None}
    session = authenticator.sessions.find_session(token)
    not_signed_in = session is None or session.person is None
    next_step = "pin" if who.locked else "person" if not_signed_in and not who.alone else "nothing"
    rights = [right.name.lower() for right in Right if who.has_right(right)]
    person = {"name": who.name, "role": who.role, "locked": who.locked, "alone": who.alone, "rights": rights}
    return {"wanted": next_step, "person": person}


Who = Annotated[Person, Depends(person_of)]
