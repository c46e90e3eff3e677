"""Refusals of sign-in and of orders: each names what is wrong and the cure, never what an attacker could use."""

import math

from cellcal.calibration.errors import CellError
from cellcal.calibration.message import make_message


class PeopleError(CellError):
    """The request is not permitted. ``status`` is the response's HTTP status."""

    code = "people"
    status = 403
    retry_after_s: int | None = None


class NotSignedInError(PeopleError):
    """The requester is not signed in."""

    code = "people.sign_in"
    status = 401

    def __init__(self) -> None:
        super().__init__(
            "no person is signed in here.",
            remedy="Use the address that `cellcal serve` printed, or sign in on an enrolled device.",
        )


class WrongSecretError(PeopleError):
    """A PIN, token or signature that is not right; it is not said which part."""

    code = "people.wrong"
    status = 403

    def __init__(self, what: str, remedy: str) -> None:
        super().__init__(make_message("{what} is not right, or no longer valid.", what=what), remedy=remedy)


class TooManyGuessesError(PeopleError):
    """Further guesses have to wait. Looking on and asking for a stop stay possible."""

    code = "people.wait"
    status = 429

    def __init__(self, wait_s: float) -> None:
        minutes = math.ceil(wait_s / 60.0)
        self.retry_after_s = math.ceil(wait_s)
        super().__init__(
            make_message("too many wrong PINs; the next try is possible in {minutes} min.", minutes=minutes),
            remedy="Wait, or let an administrator run `cellcal people reset`. Stop works all the time.",
        )


class NotAllowedError(PeopleError):
    """The person's role does not include it."""

    code = "people.role"

    def __init__(self, name: str, role: str, what: str, remedy: str) -> None:
        super().__init__(
            make_message("{name} ({role}) may not {what}.", name=name, role=role, what=what), remedy=remedy
        )


class PinAgainError(PeopleError):
    """The PIN is wanted again: the screen was left alone, or what is approved is weighty."""

    code = "people.pin"
    status = 401

    def __init__(self, why: str) -> None:
        super().__init__(
            make_message("{why} the PIN is asked for again.", why=why),
            remedy="Enter the PIN, then press once more.",
        )


class SecondPersonError(PeopleError):
    """A first approval is noted; another person has to give the second."""

    code = "people.second_person"
    status = 409

    def __init__(self, name: str) -> None:
        super().__init__(
            make_message(
                "the approval of {name} is noted; writing to a controller takes an engineer or a second "
                "person.",
                name=name,
            ),
            remedy="Let an engineer, or another technician, sign in and approve the same question.",
        )


class ElsewhereError(PeopleError):
    """Another screen has the session in hand."""

    code = "people.elsewhere"
    status = 409

    def __init__(self, name: str) -> None:
        super().__init__(
            make_message("the session is controlled by {name}.", name=name),
            remedy="Ask to take over; asking for a stop works always.",
        )
