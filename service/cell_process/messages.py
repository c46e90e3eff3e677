"""The orders of screens to the cell process. Every entry checks: unknown fields, NaN and long texts are refused."""

from collections.abc import Iterable
from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field, StringConstraints, model_validator

LONGEST_LINE = 1 << 20  # bytes, between web process and cell process
ALIVE = "alive"  # the question by which the web process checks that the cell process's event loop runs
BROKEN_OFF = "--broken-off"  # begun after a hang, or a stop without an answer: no run goes on by itself
Text = Annotated[str, StringConstraints(max_length=2000)]
Name = Annotated[str, StringConstraints(min_length=1, max_length=200)]
CommandId = Annotated[str, StringConstraints(strict=True, pattern=r"^[\x20-\x7e]{1,100}$")]
Revision = Annotated[int, Field(strict=True, ge=0, lt=2**53)]  # a JavaScript number carries no larger one
Flag = Annotated[bool, Field(strict=True)]


class _OrderModel(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


class StartRun(_OrderModel):
    """Run a procedure from its beginning."""

    op: Literal["start"]
    procedure: Name
    settings: dict[str, Any] = Field(default_factory=dict)
    hold_to_move: Flag = True
    accept_missing_end: Flag = False  # the person saw that the journal's end is missing, and goes on


class ResumeRun(_OrderModel):
    """Go on with an interrupted run; from a step on it may be done again."""

    op: Literal["resume"]
    run_id: Name
    redo_from: Name | None = None
    hold_to_move: Flag = True
    accept_missing_end: Flag = False


class AnswerPrompt(_OrderModel):
    """Answer what is asked."""

    op: Literal["answer"]
    prompt_id: Name
    value: Text = "yes"


class DeclinePrompt(_OrderModel):
    """Say no to what is asked."""

    op: Literal["decline"]
    prompt_id: Name


class StopRun(_OrderModel):
    """Ask the robot to stop and end the run; it can be resumed. Not an emergency stop."""

    op: Literal["stop"]


class PauseRun(_OrderModel):
    """Let the present step finish, then wait."""

    op: Literal["pause"]


class ContinueRun(_OrderModel):
    """Go on after a pause."""

    op: Literal["go_on"]


class SelectRobot(_OrderModel):
    """Work with another robot of the cell."""

    op: Literal["select_robot"]
    robot: Name


class DismissRun(_OrderModel):
    """Leave the page of a run that has ended."""

    op: Literal["dismiss"]


class SignOff(_OrderModel):
    """Put one's name to what had to be done by hand after a run, line by line."""

    op: Literal["sign"]
    run_id: Name
    lines: Annotated[tuple[Text, ...], Field(min_length=1, max_length=50)]


class HoldOrder(_OrderModel):
    """The button of hold-to-move is held, or let go."""

    op: Literal["hold"]
    held: Flag
    at_s: float | None = Field(default=None, strict=True)  # monotonic clock: the button was surely held then

    @model_validator(mode="after")
    def _require_time(self) -> "HoldOrder":
        if self.held and self.at_s is None:
            raise ValueError("'held' counts only with the moment at which it was surely so")
        return self


Order = Annotated[
    StartRun
    | ResumeRun
    | AnswerPrompt
    | DeclinePrompt
    | StopRun
    | PauseRun
    | ContinueRun
    | SelectRobot
    | DismissRun
    | SignOff
    | HoldOrder,
    Field(discriminator="op"),
]
REVISION_FREE = (StopRun, HoldOrder, PauseRun)  # obeyed whatever the screen knew of the session


class Signer(_OrderModel):
    """One of the people in whose name an order comes, and the role that counted when it was given."""

    name: Name
    role: Name


def without_conditions(raw: Any, field_names: Iterable[str]) -> Any:
    """Return what was sent; of a stop only what it needs: no flaw of anything else may swallow it."""
    order = raw.get("order") if isinstance(raw, dict) else None
    if not isinstance(order, dict) or order.get("op") != "stop":
        return raw
    sender = {key: raw[key] for key in field_names if key in raw}
    return {**sender, "id": "stop", "rev": 0, "order": {"op": "stop"}}


class SessionCommand(_OrderModel):
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
    def _stop_needs_nothing(cls, raw: Any) -> Any:
        return without_conditions(raw, cls.model_fields)
