"""What a page sends to identify a robot from a file of measurements, and what it is answered: numbers are SI."""

from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field, StringConstraints

from cellcal.service.engineering.page_jobs import JobState
from cellcal.service.engineering.programs.jobs.shapes import UploadedFile

REQUEST_FILE, RESULT_FILE = "request.json", "result.json"  # of a job's folder
SOURCES, JOINTS, CHECK, LAYOUT, DRAFTS = "sources", "joints", "check", "layout", "drafts"
DESCRIBED = "description"  # folder of a job: what its robot was described by
LinkName = Annotated[str, StringConstraints(max_length=120, pattern=r"^[\w./:-]*$")]  # no mark of a reference
ColumnMeaning = Literal["joints", "position", "length", "rotation", "controller", "group"]
UnitMeaning = Literal["joints", "slides", "position", "length", "rotation", "controller"]
_Name = Annotated[str, StringConstraints(max_length=200)]
_MOST_COLUMNS = 24  # of one meaning


class IdentifyWishes(BaseModel):
    """Options that override detection; each is an option of ``cellcal identify``."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    level: Literal[0, 1, 2, 3, 4, 5] | None = None  # None: chosen by cross-validation
    columns: dict[ColumnMeaning, Annotated[list[_Name], Field(max_length=_MOST_COLUMNS)]] = {}
    units: dict[UnitMeaning, _Name] = {}
    convention: _Name = ""  # of the measured attitude; "none" leaves it out
    joint_coupling: Literal["", "controller", "geometric"] = ""
    sheet: _Name = ""


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

    file: UploadedFile | None = None
    again: Annotated[str, StringConstraints(max_length=32)] = ""  # or the job whose files are used once more
    robot: Annotated[str, StringConstraints(max_length=120)] = ""  # its name; empty: the cell's first
    description: RobotDescription | None = None
    joints: UploadedFile | None = None  # that holds the joints of the rows, where the readings stand alone
    check: UploadedFile | None = None  # another file, on which the finished model is evaluated
    layout: UploadedFile | None = None  # says what the columns are; of several devices, all readings
    wishes: IdentifyWishes = IdentifyWishes()


class JobRequest(BaseModel):
    """The request to a job's process: written by the service into the job's folder."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    file: str  # name in the folder of sources
    joints: str
    check: str
    layout: str
    wishes: IdentifyWishes
    model: str
    described: bool  # the model is a file of the folder of descriptions
    serial: str
    who: str
    at_utc: str


class IdentifyResponseModel(BaseModel):
    """Base of the responses of this package."""

    model_config = ConfigDict(frozen=True)


class IdentifyFault(IdentifyResponseModel):
    """A fault, and the cure."""

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
    wishes: IdentifyWishes
    joints: str  # the name of that file; empty where there is none
    check: str
    layout: str
    headings: list[str]  # of the file's columns, once it was read
    understood: Annotated[
        dict[str, Any],
        Field(description="how a file was read that does not fit, as its result says it; empty otherwise"),
    ]
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
    levels: list[str]  # in words, from 0
    conventions: list[str]  # of attitudes
    angle_units: list[str]
    length_units: list[str]


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
    """Parameters that these measurements cannot determine, and what to measure so that they can."""

    cure: str
    hidden: list[HiddenParameters]


class RowErrors(IdentifyResponseModel):
    """Errors of rows that were not fitted, in the order of the file; of many rows the largest of each few."""

    rows: list[int]  # data rows of the file, counted from 0
    before_m: list[float]  # of the nominal robot
    held_out_m: list[float]
    rejected: list[bool]
    rows_per_point: int


class MeasuredSeriesErrors(IdentifyResponseModel):
    """Errors of the readings that one device took of one target: RMS [m]."""

    name: str
    rows: int
    rejected: int
    is_held_out: bool  # else before_m and held_out_m say nothing: the series is too short
    before_m: float  # of the nominal robot
    held_out_m: float  # of rows that were not fitted
    fit_m: float  # residuals, not an accuracy


class IdentifyResult(IdentifyResponseModel):
    """The result: ``report`` is the object that ``cellcal identify --json`` prints."""

    report: Annotated[
        dict[str, Any], Field(description="as `cellcal identify --json` prints it; numbers are SI")
    ]
    parameters: list[DeterminedParameter]
    ripple_count: int  # determined coefficients of ripple, which are not listed
    unknown: list[UnknownParameters]
    row_errors: RowErrors
    understood: Annotated[
        dict[str, Any], Field(description="columns, units and convention, as `--show-layout` prints them")
    ]
    series: list[MeasuredSeriesErrors]  # of a layout of several readings; empty of a single device
    not_savable: IdentifyFault | None  # why there is nothing to save


class IdentifyJobWithResult(IdentifyJob):
    """An identification with its result, once it is done."""

    result: IdentifyResult | None
    newest_version: int  # of the robot's parameters; 0 where none were saved
