"""What routes answer whose answers are put together as JSON: for ``/openapi.json``, which tests hold the answers to.

`Free` stands where a procedure or a maker decides what is in it: its settings and results are described by the
procedure (``GET /api/procedures``), not by the route.
"""

from typing import Annotated, Any, Literal

from fastapi.responses import JSONResponse
from pydantic import BaseModel, ConfigDict, Field
from pydantic_core import to_json, to_jsonable_python

from cellcal.calibration.message_table import with_messages

Free = Annotated[dict[str, Any], Field(description="what is in it, the procedure says")]
FreeValue = Annotated[Any, Field(description="what it is, the procedure says")]


class ResponseShape(BaseModel):
    """An object with these fields and no others."""

    model_config = ConfigDict(extra="forbid", frozen=True)


class MessageJsonResponse(JSONResponse):
    """JSON with the template and arguments of the texts in it, under the key ``messages``."""

    def render(self, content: Any) -> bytes:
        """Return the bytes."""
        return super().render(with_messages(content))


class FiniteJsonResponse(JSONResponse):
    """The same of anything; a number that is not finite is null, as JSON has none."""

    def render(self, content: Any) -> bytes:
        """Return the bytes."""
        return to_json(with_messages(to_jsonable_python(content, inf_nan_mode="null")))


def response_options(shape: Any, description: str) -> dict[str, Any]:
    """Return what a route says of its answer, for `APIRouter.get(path, **answering(...))`; tests check it."""
    responses = {200: {"model": shape, "description": description}}
    return {"response_model": None, "response_class": FiniteJsonResponse, "responses": responses}


class ControlSeen(ResponseShape):
    """The seat in control of the session, as one seat sees it."""

    mine: bool
    holder: str | None
    asking: str | None
    asking_mine: bool
    remaining_s: float | None
    approved: str  # the question that waits for a second person; empty for none
    approved_by: str


class PersonSeen(ResponseShape):
    """The person at the screen."""

    name: str
    role: str
    locked: bool
    alone: bool
    rights: list[str]


class RobotSeen(ResponseShape):
    """A robot of the cell; ``axis_names`` as its pendant shows them."""

    name: str
    model: str
    serial: str
    axis_names: list[str]


class ConnectionSeen(ResponseShape):
    """Whether the cell's devices are connected."""

    connected: bool
    message: str
    remedy: str


class PhaseSeen(ResponseShape):
    """A step of an outline; ``repeats`` steps are called ``name 1``, ``name 2``."""

    name: str
    repeats: int | None
    adaptive: bool


class RunEvent(ResponseShape):
    """Something that a run told."""

    n: int
    kind: str
    step: str
    message: str


class ContributionSeen(ResponseShape):
    """A line of an uncertainty budget."""

    name: str
    standard_uncertainty: float
    source: str


class CharacteristicSeen(ResponseShape):
    """One figure of a verdict; SI units."""

    name: str
    value: float
    unit: str
    standard_uncertainty: float
    coverage: float
    expanded_uncertainty: float
    limit: float | None
    decision: str | None
    rule: str
    budget: list[ContributionSeen]


class ChangeSeen(ResponseShape):
    """Something as it was before and as it is after."""

    name: str
    before: float | None
    after: float | None
    unit: str


class SetAsideSeen(ResponseShape):
    """A measurement that was taken and not used."""

    step: str
    reason: str


class JudgementSeen(ResponseShape):
    """All that a finished procedure claims, and what it does not."""

    word: Literal["pass", "fail", "undecided"]
    characteristics: list[CharacteristicSeen]
    limits_from: str
    not_verified: list[str]
    remarks: list[str]
    changes: list[ChangeSeen]
    set_aside: list[SetAsideSeen]
    to_sign: list[str]


class SignedSeen(ResponseShape):
    """The person who confirmed a verdict's lines, and when."""

    who: str
    at_s: float


class OutcomeSeen(ResponseShape):
    """The outcome of a run."""

    verdict: str
    reason: str
    remedy: str
    code: str = ""
    judgement: JudgementSeen | None = None
    result: FreeValue = None
    certificate: str | None = None
    no_certificate: str = ""
    signed: SignedSeen | None = None


class SeriesPose(ResponseShape):
    """A pose of the plan that a run works off."""

    name: str
    joints_rad: list[float]


class PlanSeen(ResponseShape):
    """The progress of a run in the plan that was approved last."""

    poses: list[SeriesPose]
    next: Annotated[int | None, Field(description="the pose that is gone to or measured at just now")]
    elsewhere_rad: Annotated[
        list[float] | None, Field(description="gone to just now, where that is none of them")
    ]
    measured: list[int]


class RunSeen(ResponseShape):
    """The run that is under way, or has just ended."""

    id: str
    procedure: str
    title: str
    who: Annotated[str, Field(description="who began or resumed it: a name, `watch` or `service`")]
    state: Literal["starting", "running", "paused", "ended"]
    step: str
    index: int
    expected: int
    phases: list[PhaseSeen]
    found: list[str]
    events: list[RunEvent]
    outcome: OutcomeSeen | None
    hold_to_move: bool
    does: str
    instrument: str
    left_s: float | None
    series: PlanSeen | None


class PromptSeen(ResponseShape):
    """The open question; ``data`` is what a page of this kind draws."""

    id: str
    kind: Literal["confirm", "enter"]
    key: str
    text: str
    unit: str
    step: str
    page: str
    data: Annotated[dict[str, Any], Field(description="what a page of this kind draws beside the words")]
    yes: Annotated[str, Field(description="what the button says that agrees")]
    no: Annotated[str, Field(description="what the button says that declines")]
    question: Annotated[str, Field(description="in place of the words; may be empty")]
    is_folded: Annotated[bool, Field(description="whether all words stand behind a fold")]
    drawing: Annotated[str, Field(description="the name of the drawing")]


class LossSeen(ResponseShape):
    """A position that was lost or is in doubt, and what is prepared for it."""

    robot: str
    what: str
    detected_by: str
    mode: str
    words: str
    procedure: str | None
    settings: Free
    reasons: Annotated[list[str], Field(description="why it was not started without a person")]
    alone_wanted: Annotated[bool, Field(description="whether the cell file wants that (recover_alone)")]


class TroubleSeen(ResponseShape):
    """A failure in a task that runs as long as its process."""

    task: str
    message: str
    remedy: str
    failures: Annotated[int, Field(description="one after the other")]
    running: Annotated[bool, Field(description="whether it runs again")]


class SessionState(ResponseShape):
    """All that is not a live value."""

    rev: int
    cell: str
    robots: list[RobotSeen]
    robot: str
    level: str
    connection: ConnectionSeen
    run: RunSeen | None
    prompt: PromptSeen | None
    waits_for_hold: bool
    losses: list[LossSeen]
    journal_end: Annotated[
        str, Field(description="in words, that the journal's end is missing; empty: whole")
    ]
    troubles: list[TroubleSeen]


class SessionSeen(ResponseShape):
    """The session, and who asks for it; null while the cell process starts."""

    session: SessionState | None
    wanted: Literal["device", "person", "pin", "nothing"]
    person: PersonSeen | None
    demo: bool
    troubles: Annotated[list[TroubleSeen], Field(description="of the service, and of the cell's process")]


class ProcedureSeen(ResponseShape):
    """A procedure of the catalogue."""

    name: str
    title: str
    version: int
    lacks: list[str] | None
    due: str | None
    remedies: Annotated[list[str], Field(description="how to get each thing that it lacks")]
    uses: Annotated[str, Field(description="what a person has at hand for it")]
    intention: str
    when: Annotated[str, Field(description="to use it")]
    minutes: Annotated[list[int], Field(description="that it usually takes, from and to")]
    for_other_controllers: Annotated[
        bool, Field(description="this robot's controller has another procedure for it")
    ]
    needs_position: Annotated[bool, Field(description="it refuses a robot that has lost its position")]
    commands_motion: Annotated[bool, Field(description="else a person moves the arm, or it stands still")]
    settings: Annotated[dict[str, Any], Field(description="JSON schema of the settings")]


class PlannedPoseSeen(ResponseShape):
    """The pose of a planned measurement."""

    label: str
    joints_rad: list[float]


class PredictionSeen(ResponseShape):
    """The predicted uncertainty of a quantity, and each class's limit for it."""

    name: str
    expanded: float
    unit: str
    limits: dict[str, float]
    sentence: str


class ForecastSeen(ResponseShape):
    """The predicted course of a run."""

    duration_s: float
    poses: list[PlannedPoseSeen]
    speed_rad_s: float | None
    predictions: list[PredictionSeen]
    assumed: list[str]
    lacks: list[str]
    not_checked: list[str]
    planned: dict[str, int]


class DryRunSeen(ResponseShape):
    """A procedure on a cell, before anything happens."""

    procedure: str
    title: str
    version: int
    robot: str
    serial: str
    settings: Free
    lacks: list[str]
    phases: list[PhaseSeen]
    expected_steps: int
    forecast: ForecastSeen | None
    problem: str


class RunLine(ResponseShape):
    """A run, on one line."""

    run_id: str
    procedure: str
    started_utc: str
    state: str
    reason: str
    word: str
    robot_serial: str
    begun_by: str
    begun_as: list[str]
    in_doubt: Annotated[
        str, Field(description="the step that may have moved the robot, or written to it, without an outcome")
    ]


class FindingSeen(ResponseShape):
    """The finding of a step of a run."""

    step: str
    value: FreeValue


class RunDetail(RunLine):
    """A run with all that is kept of it."""

    spec: Free
    findings: list[FindingSeen]
    result: FreeValue
    judgement: JudgementSeen | None


class SignedDocument(ResponseShape):
    """A certificate, or the record of a refusal, as it was signed."""

    content: Annotated[dict[str, Any], Field(description="what the certificate says; its format names it")]
    format: str
    sha256: str
    signature: dict[str, str]
