"""What routes ask of a request: the house, and who is asking."""

from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, cast

from fastapi import Depends
from starlette.requests import HTTPConnection

if TYPE_CHECKING:
    from service.web.app import House


@dataclass(frozen=True, slots=True)
class Person:
    """Who sits at a screen."""

    name: str
    role: str  # viewer, technician, engineer, admin


def house_of(connection: HTTPConnection) -> "House":
    """Return what the routes of this service share."""
    return cast("House", connection.app.state.house)


def person_of(connection: HTTPConnection) -> Person:
    """Return who asks. On loopback, before people are set up, it is the technician at this computer."""
    del connection
    return Person("local technician", "technician")


Who = Annotated[Person, Depends(person_of)]
