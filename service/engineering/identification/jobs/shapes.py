"""What a page sends to identify a robot from a file of measurements, and what it is answered: numbers are SI."""

from typing import Annotated, Any

from pydantic import BaseModel, ConfigDict, Field, StringConstraints

from cellcal.service.engineering.page_jobs import JobState
from cellcal.service.engineering.programs.jobs.shapes import UploadedFile

REQUEST_FILE, RESULT_FILE = "request.json", "result.json"  # of a job's folder
SOURCES, DRAFTS = "sources", "drafts"
DESCRIBED = "description"  # folder of a job: what its robot was described by
LinkName = Annotated[str, StringConstraints(max_length=120, pattern=r"^[\w./:-]*$")]  # no mark of a reference


class RobotDescription(BaseModel):
    """The robot together with what carries it or its target: a track or a positioner as joints of the chain."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    file: UploadedFile  # URDF with every xacro expanded, or a model file (.toml)
    base: LinkName = ""  # of a URDF: where the chain begins; empty: its root
    tip: LinkName = ""  # and where it ends


class IdentifyRequest(BaseModel):
    """A file of measurements as the instrument wrote it, and the robot of this cell that was measured.

    With a description the robot stands on external axes, which the cell file's model does not hold.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

    file: UploadedFile
    robot: Annotated[str, StringConstraints(max_length=120)] = ""  # its name; empty: the cell's first
    description: RobotDescription | None = None


class IdentifyResponseModel(BaseModel):
    """What is answered here."""

    model_config = ConfigDict(frozen=True)


class IdentifyFault(IdentifyResponseModel):
    """What is wrong, and the cure."""

    message: str
    remedy: str


class RobotToIdentify(IdentifyResponseModel):
    """A robot of this cell."""

    robot: str
    serial: str
    model: str
    version: int | None  # of its parameters; None where none were saved


class IdentifyJob(IdentifyResponseModel):
    """An identification that is being computed, or was."""

    id: str
    file: str
    robot: str
    serial: str
    model: str
    who: str
    at_utc: str
    state: JobState
    stage: str  # what is being done, in words
    done: int
    total: int
    fault: IdentifyFault | None
    saved_version: int | None  # of the robot's parameters, once the result was saved


class IdentifyOverview(IdentifyResponseModel):
    """The robots that can be identified, what was computed last, and how large a file may be."""

    robots: list[RobotToIdentify]
    jobs: list[IdentifyJob]
    most_bytes: int


class DeterminedParameter(IdentifyResponseModel):
    """One deviation from the nominal robot that the measurements determine."""

    name: str
    unit: str  # rad | m | rad/m | 1
    deviation: float
    standard_uncertainty: float


class HiddenParameters(IdentifyResponseModel):
    """Parameters that the measurements leave open together."""

    names: list[str]
    behind: str  # what moves with them unseen; empty where they simply do not show


class UnknownParameters(IdentifyResponseModel):
    """What cannot be known from these measurements, and what to measure so that it can."""

    cure: str
    hidden: list[HiddenParameters]


class RowErrors(IdentifyResponseModel):
    """Errors of rows that were not fitted, in the order of the file; of many rows the largest of each few."""

    rows: list[int]  # data rows of the file, counted from 0
    before_m: list[float]  # of the nominal robot
    held_out_m: list[float]
    rejected: list[bool]
    rows_per_point: int


class IdentifyResult(IdentifyResponseModel):
    """What was found: ``report`` is the object that ``cellcal identify --json`` prints."""

    report: Annotated[
        dict[str, Any], Field(description="as `cellcal identify --json` prints it; numbers are SI")
    ]
    parameters: list[DeterminedParameter]
    ripple_count: int  # determined coefficients of ripple, which are not listed
    unknown: list[UnknownParameters]
    row_errors: RowErrors
    not_savable: IdentifyFault | None  # why there is nothing to save


class IdentifyJobWithResult(IdentifyJob):
    """An identification with its result, once it is done."""

    result: IdentifyResult | None
    newest_version: int  # of the robot's parameters; 0 where none were saved
