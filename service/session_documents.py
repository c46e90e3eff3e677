"""The two documents that the cell's process sends to everything that shows or reports a cell.

`SessionDocument` is everything that is not a live value; it is sent whenever something of it changes.
`LiveDocument` holds the newest values of the devices; it is sent ten times a second. Both are JSON on every way, so
they are typed dictionaries. ``service/web/response_models.py`` describes the same session for ``/openapi.json``, and
tests compare what is sent with that description.
"""

from collections.abc import Callable, Mapping
from typing import Any, NotRequired, TypedDict

from cellcal.drivers.supervision import TroubleDocument


class RobotEntry(TypedDict):
    """A robot of the cell."""

    name: str
    model: str
    serial: str
    axis_names: list[str]


class ConnectionDocument(TypedDict):
    """Whether the devices are connected; otherwise the cause and the next action."""

    connected: bool
    message: str
    remedy: str


class PhaseDocument(TypedDict):
    """A phase of the run; ``repeats`` is None where the number of its steps is not known."""

    name: str
    repeats: int | None
    adaptive: bool


class RunEventDocument(TypedDict):
    """One event of the run, numbered from 1."""

    n: int
    kind: str
    step: str
    message: str


class SignatureDocument(TypedDict):
    """The person who signed the lines of a verdict, and when."""

    who: str
    at_s: float


class CertificateDocument(TypedDict, total=False):
    """The name of the run's certificate file, or the reason why there is none."""

    certificate: str | None
    no_certificate: str


class OutcomeDocument(CertificateDocument):
    """The outcome of the run. ``judgement`` and ``result`` are those of the procedure."""

    verdict: str
    reason: str
    remedy: str
    code: NotRequired[str]
    judgement: NotRequired[dict[str, Any] | None]
    result: NotRequired[Any]
    signed: NotRequired[SignatureDocument]


class PlanPoseDocument(TypedDict):
    """A pose of the approved plan."""

    name: str
    joints_rad: list[float]


class PlanDocument(TypedDict):
    """The progress of the run in the approved plan: ``next`` and ``measured`` are indices of ``poses``."""

    poses: list[PlanPoseDocument]
    next: int | None
    elsewhere_rad: list[float] | None
    measured: list[int]


class RunDocument(TypedDict):
    """The run that is in progress, or the last one until its page is left."""

    id: str
    procedure: str
    title: str
    who: str
    state: str
    step: str
    index: int
    expected: int
    phases: list[PhaseDocument]
    found: list[str]
    events: list[RunEventDocument]
    outcome: OutcomeDocument | None
    hold_to_move: bool
    does: str
    instrument: str
    left_s: float | None
    series: PlanDocument | None


class QuestionDocument(TypedDict):
    """The identity of a question: an approval counts for exactly this text."""

    id: str
    key: str
    text: str


class PromptDocument(QuestionDocument):
    """The open question of a run; the kind of page decides what ``data`` holds."""

    kind: str
    unit: str
    step: str
    page: str
    data: dict[str, Any]
    yes: str  # what the button says that agrees, and the one that declines
    no: str
    question: str  # in place of the words, which then stand behind "show"; may be empty
    is_folded: bool
    drawing: str


class LossDocument(TypedDict):
    """A position that was lost or is in doubt, and the procedure that is prepared for it."""

    robot: str
    what: str
    detected_by: str
    mode: str
    words: str
    procedure: str | None
    settings: Mapping[str, Any]
    reasons: list[str]
    alone_wanted: bool


class SessionDocument(TypedDict):
    """Everything that is not a live value."""

    rev: int
    cell: str
    robots: list[RobotEntry]
    robot: str
    level: str
    connection: ConnectionDocument
    run: RunDocument | None
    prompt: PromptDocument | None
    waits_for_hold: bool
    losses: list[LossDocument]
    journal_end: str
    troubles: list[TroubleDocument]


class OtherQuestion(TypedDict):
    """A question that a page asks without a run, such as for the rollback of parameters: ``rev`` is their version."""

    rev: int
    prompt: QuestionDocument | None


class SettleDocument(TypedDict):
    """Whether a gauge is at rest: standard deviation of its last readings, and the limit for it."""

    std_m: float | None
    limit_m: float
    settled: bool


class StopDocument(TypedDict):
    """The cause of a stopped robot, such as a pressed emergency stop."""

    message: str
    remedy: str


class DeviceDocument(TypedDict):
    """The newest state and value of one device, with their ages; the kind of device decides ``value``."""

    role: str
    name: str
    live: bool
    typed: bool
    asked: bool
    state: str
    message: str
    remedy: str
    stop: StopDocument | None  # also of a robot whose state is another, graver one
    age_s: float | None
    value: dict[str, Any] | None
    value_age_s: float | None
    due: str
    settle: SettleDocument | None


class RecordingDocument(TypedDict):
    """Whether the open question can be answered by a record just now, and what prevents it."""

    prompt_id: str
    ready: bool
    why: str
    words: str
    remedy: str
    warning: str
    figures: Any


class GuidanceDocument(TypedDict):
    """The progress of what a prompt asks for: a turn of an axis, while a person makes it."""

    prompt_id: str
    text: str
    values: dict[str, Any]


class LiveValues(TypedDict):
    """The values that the selected robot's connection has of the devices."""

    devices: list[DeviceDocument]
    record: NotRequired[RecordingDocument | None]
    guidance: NotRequired[GuidanceDocument | None]


class LiveDocument(LiveValues):
    """Newest values of all devices; ``rev`` is the session's, ``at_s`` the time of day."""

    rev: int
    at_s: float


class CommandDocument(TypedDict):
    """A command as the web process sends it; the cell's process checks it (`messages.SessionCommand`)."""

    id: str
    rev: int
    who: str
    people: NotRequired[list[dict[str, str]]]
    order: Mapping[str, object]


class OrderReply(TypedDict):
    """The answer to an order: whether it was obeyed, otherwise the cause; with the session where it changed."""

    ok: bool
    code: NotRequired[str]
    message: NotRequired[str]
    remedy: NotRequired[str]
    rev: NotRequired[int]
    session: NotRequired[SessionDocument]


class NoContent(TypedDict):
    """The content of the event "gone"."""


QuestionContext = SessionDocument | OtherQuestion  # where an answer is judged
EventContent = SessionDocument | LiveDocument | NoContent
OnCellEvent = Callable[[str, EventContent], None]  # "session", "live" or "gone", and its content
