"""What a message must look like before a monitor shows anything of it: one cell must not spoil the view of all."""

from typing import Annotated

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from cellcal.calibration.message import make_message
from cellcal.service.site.time_fields import Day, ZonedTime

_MOST = 500
_Word = Annotated[str, Field(max_length=300)]
_Text = Annotated[str, Field(max_length=4000)]
_Count = Annotated[int, Field(ge=0, le=2**53 - 1)]  # what pages and SQLite can carry
_Metres = Annotated[float, Field(ge=0.0, le=1e6)]


class _StateModel(BaseModel):
    model_config = ConfigDict(frozen=True, extra="ignore", strict=True, allow_inf_nan=False)


class StateAlarm(_StateModel):
    """Something that is wrong in a cell."""

    id: _Word
    code: _Word
    source: _Word
    text: _Text
    remedy: _Text = ""


class StateRun(_StateModel):
    """The run that is under way in a cell, or has just ended."""

    procedure: _Word
    state: _Word
    step: _Text
    index: _Count
    expected: _Count
    verdict: _Word | None


class StateAsks(_StateModel):
    """The requests of a cell to a person."""

    key: _Word
    step: _Text


class StateDrift(_StateModel):
    """The result of a drift check: how far the robot's points have moved."""

    run_id: _Word
    ended_utc: ZonedTime
    change_rms_m: _Metres
    change_max_m: _Metres | None
    word: _Word


class StateCertificate(_StateModel):
    """A cell's newest certificate, or record of a refusal."""

    run_id: _Word
    procedure: _Word
    word: _Word
    ended_utc: ZonedTime


class StateDue(_StateModel):
    """The due dates of a cell, by day."""

    what: _Text
    due: Day


class _StateMessage(_StateModel):
    cell: _Word
    alarms: list[StateAlarm] = Field(max_length=_MOST)
    run: StateRun | None
    asks: StateAsks | None
    attended: bool
    drift: list[StateDrift] = Field(max_length=_MOST)
    certificate: StateCertificate | None
    due: list[StateDue] = Field(max_length=_MOST)
    outbox: dict[str, _Count]


def is_alarm(body: object) -> bool:
    """Whether an alarm's event can be shown."""
    try:
        StateAlarm.model_validate(body)
    except ValidationError:
        return False
    return True


def state_flaw(body: object) -> str:
    """Return what is wrong with a state; nothing where it can be shown."""
    try:
        _StateMessage.model_validate(body)
    except ValidationError as error:
        first = error.errors()[0]
        return make_message(
            "its state is not one of ours ({map}: {first}): another version?",
            map=".".join(map(str, first["loc"])),
            first=first["msg"],
        )
    return ""
