"""What a message must look like before a monitor shows anything of it: one cell must not spoil the view of all."""

from pydantic import BaseModel, ConfigDict, Field, ValidationError

_MOST = 500


class _Part(BaseModel):
    model_config = ConfigDict(frozen=True, extra="ignore", strict=True, allow_inf_nan=False)


class _Alarm(_Part):
    id: str
    code: str
    source: str
    text: str
    remedy: str = ""


class _Run(_Part):
    procedure: str
    state: str
    step: str
    index: int
    expected: int
    verdict: str | None


class _Asks(_Part):
    key: str
    step: str


class _Drift(_Part):
    run_id: str
    ended_utc: str
    change_rms_m: float
    change_max_m: float | None
    word: str


class _Certificate(_Part):
    run_id: str
    procedure: str
    word: str
    ended_utc: str


class _Due(_Part):
    what: str
    due: str


class _State(_Part):
    cell: str
    alarms: list[_Alarm] = Field(max_length=_MOST)
    run: _Run | None
    asks: _Asks | None
    attended: bool
    drift: list[_Drift] = Field(max_length=_MOST)
    certificate: _Certificate | None
    due: list[_Due] = Field(max_length=_MOST)
    outbox: dict[str, int]


def is_alarm(body: object) -> bool:
    """Whether an alarm's event can be shown."""
    try:
        _Alarm.model_validate(body)
    except ValidationError:
        return False
    return True


def state_flaw(body: object) -> str:
    """Return what is wrong with a state; nothing where it can be shown."""
    try:
        _State.model_validate(body)
    except ValidationError as error:
        first = error.errors()[0]
        return f"its state is not one of ours ({'.'.join(map(str, first['loc']))}: {first['msg']}): another version?"
    return ""
