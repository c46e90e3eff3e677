"""What a page asks of programs and what it is told: numbers are SI, files come along whole, no path is named."""

from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field, StringConstraints

from cellcal.service.engineering.page_jobs import JobState
from cellcal.service.engineering.programs.joint_points import JointPoints
from cellcal.service.translation import Locale

MOST_FILES, MOST_FILE_BYTES = 200, 6 * 1024 * 1024  # of all files together, before they are packed into text
_MOST_BASE64 = (MOST_FILE_BYTES // 3 + 1) * 4
_MOST_POSES = 64
Text = Annotated[str, StringConstraints(min_length=1, max_length=120)]
Triple = tuple[float, float, float]
Fours = tuple[float, float, float, float]
Verdict = Literal["fits", "reach", "limit", "singular", "flip", "collision", "unknown"]


class _RequestModel(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


class UploadedFile(_RequestModel):
    """A file that a page brings along."""

    name: Annotated[str, StringConstraints(min_length=1, max_length=255)]
    content_base64: Annotated[str, StringConstraints(max_length=_MOST_BASE64)]


class PoseInput(_RequestModel):
    """A pose, its quaternion as w, x, y, z."""

    position_m: Triple
    quaternion: Fours = (1.0, 0.0, 0.0, 0.0)


class EnteredFrame(PoseInput):
    """A tool or user frame as the controller has it, by the name that programs use."""

    name: Annotated[str, StringConstraints(min_length=1, max_length=40)]


class CellInput(_RequestModel):
    """A cell: this service's robot, a project beside the cell file by its name, or a project whose files come along.

    Tools, frames and the error at held-out poses are entered for this cell's robot only; a project names its own.
    """

    kind: Literal["here", "kept", "carried"]
    name: Annotated[str, StringConstraints(max_length=120)] = ""  # of the robot, or of the project
    files: Annotated[list[UploadedFile], Field(max_length=12)] = []
    tools: Annotated[list[EnteredFrame], Field(max_length=_MOST_POSES)] = []
    frames: Annotated[list[EnteredFrame], Field(max_length=_MOST_POSES)] = []
    held_out_rms_m: Annotated[float, Field(ge=0.0, le=1.0)] | None = None


class ProgramsRequest(_RequestModel):
    """The request to change programs."""

    do: Literal["compensate", "download", "move", "clone"]
    cell: CellInput
    clone: CellInput | None = None  # the cell that gets the programs
    offset: PoseInput | None = None  # how the work moved
    frame: Annotated[str, StringConstraints(max_length=40)] = (
        ""  # only points of it, and the offset seen from it
    )
    joints: JointPoints | None = None  # what becomes of points in joint angles without a frame
    files: Annotated[list[UploadedFile], Field(max_length=MOST_FILES)] = []
    own_files: bool = False  # the programs that the kept project names itself
    language: Locale = "en"  # of who asks: of the report's page and of what to know


class ResponseModel(BaseModel):
    """Base of the responses of this package."""

    model_config = ConfigDict(frozen=True)


class ProgramsFault(ResponseModel):
    """A fault, and the cure."""

    message: str
    remedy: str


class RefusedFile(ProgramsFault):
    """A file that was left out; zeros where it is wrong as a whole."""

    file: str
    line: int
    column: int


class RobotOfCell(ResponseModel):
    """A robot of this cell, as its programs see it."""

    robot: str
    serial: str
    model: str
    version: int | None  # of its parameters; None where none were saved
    tools: list[str]  # the names of those that runs of this cell measured
    frames: list[str]


class StoredProject(ResponseModel):
    """A project beside the cell file."""

    name: str
    serial: str
    master: str  # the name of the project whose programs it clones, where that is kept here too
    programs: int  # that it names and that are there
    readable: bool


class ProgramsJob(ResponseModel):
    """Programs that are made, or were."""

    id: str
    do: str
    who: str
    at_utc: str
    state: JobState
    done: int
    total: int
    fault: ProgramsFault | None


class ProgramsOverview(ResponseModel):
    """The changes that can be made here, the last jobs, and which files a page may upload."""

    robots: list[RobotOfCell]
    projects: list[StoredProject]
    jobs: list[ProgramsJob]
    most_files: int = MOST_FILES
    most_bytes: int = MOST_FILE_BYTES


class ProgramPreview(ResponseModel):
    """One program: what became of its points."""

    program: str
    file: str
    brand: str
    points: int
    changed: int
    unchanged: int
    left: int
    largest_shift_m: float | None
    largest_expected_m: float | None


class PicturePoint(ResponseModel):
    """One point of the picture; ``step`` is the number of its colour, -1 where its shift is not known."""

    place_m: Triple
    step: int
    left: bool
    label: str


class PointsPicture(ResponseModel):
    """Points to draw, the worst last, and what the colours mean."""

    in_base: bool  # else each in its own user frame
    points: list[PicturePoint]
    colours: list[str]
    edges_m: list[float]
    not_drawn: int


class JobPreview(ResponseModel):
    """The result: programs worst first, those refused, and what to know before any of them runs."""

    title: str
    cell: str
    parameters: str  # which identified arm, in words; empty where there is none
    counts: dict[str, int]  # changed, unchanged, left
    verdicts: dict[Verdict, int]
    collisions_checked: bool
    largest_shift_m: float | None
    largest_expected_m: float | None
    largest_uncorrected_m: float | None
    programs: list[ProgramPreview]
    refused: list[RefusedFile]
    notes: list[str]
    page_size: int
    picture: PointsPicture


class PointPreview(ResponseModel):
    """One point; positions are in its user frame. None: unknown."""

    program: str
    point: str
    line: int
    kind: str
    user_frame: str | None
    tool: str | None
    verdict: Verdict
    reason: str
    changed: bool
    shift_m: float | None
    turn_rad: float | None
    expected_m: float | None
    before_m: Triple | None
    after_m: Triple | None
    configuration_before: str
    configuration_after: str


class PointsPage(ResponseModel):
    """One page of points; ``pages`` counts from 1."""

    total: int
    pages: int
    points: list[PointPreview]


class JobWithPreview(ProgramsJob):
    """A job with its preview, once it is done."""

    preview: JobPreview | None


def request_to_json(request: ProgramsRequest) -> dict[str, Any]:
    """Return what was asked for, without the files that came along."""
    document: dict[str, Any] = request.model_dump(mode="json", exclude={"files"})
    for cell in (document["cell"], document["clone"]):
        if cell is not None:
            cell["files"] = [file["name"] for file in cell["files"]]
    return document
