"""What a screen may ask of the desk. Every door checks: unknown fields, NaN and long texts are refused."""

from collections.abc import Iterable
from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field, StringConstraints, model_validator

LONGEST_LINE = 1 << 20  # bytes, between web process and desk
Text = Annotated[str, StringConstraints(max_length=2000)]
Name = Annotated[str, StringConstraints(min_length=1, max_length=200)]
CommandId = Annotated[str, StringConstraints(strict=True, pattern=r"^[\x20-\x7e]{1,100}$")]
Revision = Annotated[int, Field(strict=True, ge=0, lt=2**53)]  # a JavaScript number carries no larger one
Flag = Annotated[bool, Field(strict=True)]


class _Asked(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


class Start(_Asked):
    """Run a procedure from its beginning."""

    op: Literal["start"]
    procedure: Name
    settings: dict[str, Any] = Field(default_factory=dict)
    hold_to_move: Flag = True
    accept_missing_end: Flag = False  # the person saw that the journal's end is missing, and goes on


class Resume(_Asked):
    """Go on with an interrupted run; from a step on it may be done again."""

    op: Literal["resume"]
    run_id: Name
    redo_from: Name | None = None
    hold_to_move: Flag = True
    accept_missing_end: Flag = False


class AnswerIt(_Asked):
    """Answer what is asked."""

    op: Literal["answer"]
    prompt_id: Name
    value: Text = "yes"


class Decline(_Asked):
    """Say no to what is asked."""

    op: Literal["decline"]
    prompt_id: Name


class Stop(_Asked):
    """Ask the robot to stop and end the run; it can be resumed. Not an emergency stop."""

    op: Literal["stop"]


class Pause(_Asked):
    """Let the present step finish, then wait."""

    op: Literal["pause"]


class GoOn(_Asked):
    """Go on after a pause."""

    op: Literal["go_on"]


class SelectRobot(_Asked):
    """Work with another robot of the cell."""

    op: Literal["select_robot"]
    robot: Name


class Dismiss(_Asked):
    """Leave the page of a run that has ended."""

    op: Literal["dismiss"]


class SignOff(_Asked):
    """Put one's name to what had to be done by hand after a run, line by line."""

    op: Literal["sign"]
    run_id: Name
    lines: Annotated[tuple[Text, ...], Field(min_length=1, max_length=50)]


class Hold(_Asked):
    """The button of hold-to-move is held, or let go."""

    op: Literal["hold"]
    held: Flag
    at_s: float | None = Field(default=None, strict=True)  # monotonic clock: the button was surely held then

    @model_validator(mode="after")
    def _tells_when(self) -> "Hold":
        if self.held and self.at_s is None:
            raise ValueError("'held' counts only with the moment at which it was surely so")
        return self


Order = Annotated[
    Start | Resume | AnswerIt | Decline | Stop | Pause | GoOn | SelectRobot | Dismiss | SignOff | Hold,
    Field(discriminator="op"),
]
UNGUARDED = (Stop, Hold, Pause)  # obeyed whatever the screen knew of the session


class Signer(_Asked):
    """One of the people in whose name an order comes, and the role that counted when it was given."""

    name: Name
    role: Name


def without_conditions(given: Any, known: Iterable[str]) -> Any:
    """Return what was sent; of a stop only what it needs: no flaw of anything else may swallow it."""
    order = given.get("order") if isinstance(given, dict) else None
    if not isinstance(order, dict) or order.get("op") != "stop":
        return given
    sender = {key: given[key] for key in known if key in given}
    return {**sender, "id": "stop", "rev": 0, "order": {"op": "stop"}}


class Command(_Asked):
    """One order with what its sender knew.

    ``id`` names the press of a button: sent again after a lost link it is obeyed once. ``rev`` is the session that
    the sender looked at; an order made for another one is refused, and the present session shown.
    """

    id: CommandId
    rev: Revision
    who: Name
    people: Annotated[
        tuple[Signer, ...], Field(max_length=2)
    ] = ()  # behind ``who``, where the sender knows them
    order: Order

    @model_validator(mode="before")
    @classmethod
    def _stop_needs_nothing(cls, given: Any) -> Any:
        return without_conditions(given, cls.model_fields)
