"""What a procedure may ask of a device. Protocols for the type checker, frozen dataclasses for the borders.

Optional abilities are Protocols of their own, one per flag of the capabilities:

=============================  ==========================
flag                           Protocol
=============================  ==========================
``moves_joints``               ``MovesJoints``
``jogs_single_axes``           ``JogsAxes``
``reads_encoder_counts``       ``ReadsEncoderCounts``
``reads_mastering``            ``ReadsMastering``
``writes_mastering``           ``MasteringStore``
``writes_tool_frame``          ``ToolFrameStore``
``writes_user_frame``          ``UserFrameStore``
``tells_active_frames``        ``KnowsActiveFrames``
``tells_mode``                 ``KnowsMode``
``tells_speed_override``       ``KnowsSpeedOverride``
``position_cure``              ``TellsPositionData``
``measures_poses``             ``MeasuresPoses``
=============================  ==========================

SI units. Every call ends within the deadline of the driver's configuration or raises a DeviceError.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum
from typing import Any, Protocol, runtime_checkable

from cellcal.calibration.geometry import Pose
from cellcal.calibration.mastering.counts import DriveTrain
from cellcal.calibration.mastering.position_record import ShownValue

Joints = tuple[float, ...]
Counts = tuple[int, ...]


@dataclass(frozen=True, slots=True)
class Identity:
    """Who answers at this address."""

    vendor: str
    model: str
    serial: str
    firmware: str


class Readiness(StrEnum):
    """Whether a device can be used, and if not, who must act."""

    READY = "ready"
    NOT_READY = "not_ready"  # a person at the device can make it ready
    STOPPED = "stopped"  # emergency or protective stop
    POSITION_LOST = "position_lost"  # encoders or mastering: the recovery's business
    UNREACHABLE = "unreachable"


class PositionCure(StrEnum):
    """How a person at the pendant brings a lost position back, where no wire writes it."""

    REVOLUTION_COUNTERS = "revolution_counters"  # ABB: each axis at its mark, the fraction of a turn is kept
    ABSOLUTE_DATA = "absolute_data"  # Yaskawa: the absolute data of each axis are typed or made anew
    MASTERING_GAUGE = "mastering_gauge"  # KUKA: EMD or dial gauge in the cartridge of each axis


class AlarmKind(StrEnum):
    """What an alarm says about the position; every driver tells it of its maker's codes."""

    TURNS = "turns"  # the turns of a motor are lost, or its count is not the one from before
    ENCODER = "encoder"  # an encoder or its cable fails; whether the position is lost shows when it is mended
    COLLISION = "collision"
    BATTERY_LOW = "battery_low"  # of the encoders; the position is still there
    OTHER = "other"  # known, and nothing of these
    UNKNOWN = "unknown"


@dataclass(frozen=True, slots=True)
class Alarm:
    """One active alarm in the maker's words."""

    code: str  # "SRVO-062"
    text: str  # "BZAL alarm (Group:1 Axis:3)"
    axis: int | None = None  # 0-based, where the alarm names one
    kind: AlarmKind = AlarmKind.UNKNOWN


@dataclass(frozen=True, slots=True)
class Condition:
    """Ready, or why not. ``message`` and ``remedy`` are sentences for a technician."""

    readiness: Readiness
    message: str = ""
    remedy: str = ""
    alarms: tuple[Alarm, ...] = ()


@dataclass(frozen=True, slots=True)
class JointReading:
    """Joint angles as the controller believes them, with the raw form they came in."""

    joints_rad: Joints
    moving: bool
    taken_at_s: float  # host monotonic clock
    device_time_s: float | None = None
    raw: str = ""  # hex of the wire form


@dataclass(frozen=True, slots=True)
class RobotCapabilities:
    """What this robot can do; a procedure's needs are compared with this before it is offered."""

    axes: int
    moves_joints: bool = True
    moves_slowly: bool = True  # joint moves of 2 deg/s and less, the pace of a robot that may be lost
    moves_linear: bool = False
    hand_guiding: bool = False
    jogs_single_axes: bool = False
    reads_encoder_counts: bool = False
    tells_lost_position: bool = False  # by an alarm, or by a state of each axis, in its condition
    reads_mastering: bool = False
    writes_mastering: bool = False  # who writes it reads it, too
    writes_tool_frame: bool = False
    writes_user_frame: bool = False
    tells_active_frames: bool = False
    tells_mode: bool = False
    tells_speed_override: bool = False
    position_cure: PositionCure | None = None  # what a person does about a lost position; None: nothing known


@dataclass(frozen=True, slots=True)
class MasteringData:
    """The controller's mastering: joints = drive.joints(counts, counts_at_zero) when ``mastered``."""

    counts_at_zero: Counts
    mastered: bool


class Device(Protocol):
    """Anything in the cell with a cable, or a pair of hands."""

    @property
    def name(self) -> str: ...
    async def identify(self) -> Identity: ...
    async def read_condition(self) -> Condition:
        """Never raises for a sulking device: an unreachable one has a condition too."""
        ...


class Robot(Device, Protocol):
    """An arm. Each sentence below is a test in tests/wire/contract_robot.py.

    A move returns when the arm has settled at the target, or raises. A cancelled move stops the arm, waits for
    standstill and re-raises. A second command during a move raises BusyError at once. Reading never moves the arm.
    Writes are read back. Every call ends within its configured deadline.
    """

    @property
    def capabilities(self) -> RobotCapabilities: ...
    async def read_joints(self) -> JointReading: ...
    async def flange_pose(self) -> Pose:
        """Return base_flange as the controller reports it, the active tool taken off."""
        ...

    async def move_joints(self, target_rad: Joints, *, speed_rad_s: float) -> None: ...
    async def stop(self) -> None:
        """Ask the robot to stop and wait for standstill. May be called at any time, also twice."""
        ...


class JogsAxes(Protocol):
    """Robots with capabilities.jogs_single_axes: one axis at a time, also while not mastered."""

    async def jog_axis(self, axis: int, delta_rad: float, *, speed_rad_s: float) -> None:
        """Turn one joint by ``delta_rad`` (relative), wait until it has settled. Cancel and busy as for a move."""
        ...


class ReadsEncoderCounts(Protocol):
    """Robots with capabilities.reads_encoder_counts."""

    async def encoder_counts(self) -> Counts:
        """Read the pulse coder counts of all axes in one telegram."""
        ...

    async def drive_train(self) -> DriveTrain: ...
    async def encoder_epoch(self) -> int:
        """Return a number that changes when the encoders may have lost their position."""
        ...


class ReadsMastering(ReadsEncoderCounts, Protocol):
    """Robots with capabilities.reads_mastering; these read their encoder counts, too."""

    @property
    def name(self) -> str: ...
    async def read_mastering(self) -> MasteringData: ...


class MasteringStore(ReadsEncoderCounts, Protocol):
    """Robots with capabilities.writes_mastering; these read their encoder counts, too."""

    async def read_mastering(self) -> MasteringData: ...
    async def write_mastering(self, counts_at_zero: Counts) -> MasteringData:
        """Write, make it effective, read back. All axes or none: on a partial write the old data are restored."""
        ...

    async def restore_mastering(self, data: MasteringData) -> MasteringData:
        """Put earlier data back, the flag included: a robot that was not mastered is not mastered again."""
        ...

    async def reset_position_alarms(self) -> None:
        """Acknowledge a lost position (FANUC: RES_PCA). Idempotent; the controller may ask for a power cycle."""
        ...


class TellsPositionData(Protocol):
    """Robots with capabilities.position_cure: what their controllers show about the position."""

    async def position_data(self) -> tuple[ShownValue, ...]:
        """Return joints, states and whatever else the maker documents, in the controller's own texts."""
        ...


class ToolFrameStore(Protocol):
    """Robots with capabilities.writes_tool_frame."""

    async def read_tool_frame(self, number: int) -> Pose: ...
    async def write_tool_frame(self, number: int, flange_tool: Pose) -> Pose:
        """Write, read back, return what was read."""
        ...


class UserFrameStore(Protocol):
    """Robots with capabilities.writes_user_frame."""

    async def read_user_frame(self, number: int) -> Pose: ...
    async def write_user_frame(self, number: int, base_user: Pose) -> Pose:
        """Write, read back, return what was read."""
        ...


@dataclass(frozen=True, slots=True)
class ActiveFrames:
    """What the controller works with at one moment; None is what it does not tell."""

    tool_number: int | None = None  # None also where tools have no numbers
    flange_tool: Pose | None = None  # the active tool itself, seen from the flange
    user_frame_number: int | None = None  # 0: the base itself, also where there is no other frame to work in
    payload_kg: float | None = None


class KnowsActiveFrames(Protocol):
    """Robots with capabilities.tells_active_frames."""

    async def active_frames(self) -> ActiveFrames:
        """Return the tool, user frame and payload that are active. Fresh: read after the call began."""
        ...


class KnowsSpeedOverride(Protocol):
    """Robots with capabilities.tells_speed_override."""

    async def speed_override(self) -> float:
        """Return the share of a commanded speed that the pendant lets through, 0 to 1. Fresh: read after the call."""
        ...


class KnowsMode(Protocol):
    """Robots with capabilities.tells_mode."""

    async def controller_mode(self) -> str:
        """Return how the controller is switched, as its maker calls it. Fresh: read after the call began."""
        ...


@dataclass(frozen=True, slots=True)
class GaugeCapabilities:
    """What a length gauge can do."""

    range_m: float
    resolution_m: float
    sigma_m: float
    answers_alone: bool = (
        True  # false: a reading takes a person or another program, so none is requested in vain
    )
    typed: bool = False  # by a person, when a run asks for it


@dataclass(frozen=True, slots=True)
class LengthReading:
    """One length. ``raw`` is the wire form, so that the journal can be evaluated again after a bug."""

    value_m: float
    sigma_m: float
    taken_at_s: float  # host monotonic clock
    raw: int


class DistanceGauge(Device, Protocol):
    """Draw-wire, dial gauge: one length at a time. A reading is fresh: taken after the call began.

    A dial gauge's length is how far its plunger is pushed in; a plunger that is free is no reading.
    """

    @property
    def capabilities(self) -> GaugeCapabilities: ...
    async def read_distance(self) -> LengthReading: ...


@dataclass(frozen=True, slots=True)
class TrackerCapabilities:
    """What a device that measures places can do."""

    measures_poses: bool
    range_m: float  # farthest target it is used for
    sigma_m: float  # of one coordinate close by
    sigma_per_m: float = 0.0  # what each metre of distance adds to it
    sigma_rad: float = 0.0  # of one angle, where poses are measured
    typed: bool = False  # by a person, when a run asks for it


@dataclass(frozen=True, slots=True)
class Air:
    """The air that the light went through, as the device knows it."""

    temperature_c: float
    pressure_pa: float
    humidity_percent: float


@dataclass(frozen=True, slots=True)
class PointReading:
    """One point in the device's own frame.

    ``station`` counts where the device stands: another station is another frame, and readings of two stations
    are never used together as if they were of one.
    """

    position_m: tuple[float, float, float]
    sigma_m: tuple[float, float, float]  # standard uncertainty per axis
    taken_at_s: float  # host monotonic clock
    station: int
    air: Air | None = None
    covariance_m2: tuple[float, float, float] = (0.0, 0.0, 0.0)  # between x and y, x and z, y and z
    raw: str = ""  # hex of the wire form, or the text a person gave


@dataclass(frozen=True, slots=True)
class PoseReading:
    """One pose of a probe in the device's own frame; ``station`` as for a point."""

    station_probe: Pose
    sigma_m: tuple[float, float, float]
    sigma_rad: tuple[float, float, float]  # about the station's x, y, z
    taken_at_s: float  # host monotonic clock
    station: int
    air: Air | None = None
    raw: str = ""


class Tracker(Device, Protocol):
    """A laser tracker, or whatever measures places. Each sentence is a test in tests/wire/contract_tracker.py.

    A reading is fresh: taken after the call began. It is in metres in the frame of its station, finite, with its
    uncertainty. A device that was moved gives no reading under the old station's number. A second measurement
    during one raises BusyError at once. A cancelled measurement leaves the device usable.
    """

    @property
    def capabilities(self) -> TrackerCapabilities: ...
    async def measure_point(self) -> PointReading: ...


class MeasuresPoses(Protocol):
    """Trackers with capabilities.measures_poses."""

    async def measure_pose(self) -> PoseReading: ...


@dataclass(frozen=True, slots=True)
class ProbeCapabilities:
    """What a touch probe can do. The delay leads from the touch to the closed contact in the image."""

    tip_radius_m: float
    pretravel_m: float  # how far the tip gives way before its contact closes
    sigma_m: float  # scatter of that, over all directions
    overtravel_m: float  # how far the tip may give way without harm
    delay_s: float
    delay_tolerance_s: float  # the delay lies within plus and minus this
    reaction_s: float  # longest time from a touch to the end of ``wait_for_touch``


@dataclass(frozen=True, slots=True)
class ContactReading:
    """Whether the contact is closed. ``raw`` is the word that held it."""

    closed: bool
    taken_at_s: float  # host monotonic clock
    raw: int


@dataclass(frozen=True, slots=True)
class ContactEdge:
    """A touch: it happened between ``earliest_s`` and ``latest_s`` [host monotonic], the probe's delay taken off."""

    earliest_s: float
    latest_s: float
    bounces: int  # how often the contact was seen open again before it stayed closed
    steady: bool  # false: it did not stay closed within the time a bounce may take
    raw: tuple[int, ...]  # the words that were seen, from the last open one on


class TouchProbe(Device, Protocol):
    """A probe whose contact closes when its tip touches. Each sentence is a test in tests/wire/contract_probe.py.

    A reading is fresh: taken after the call began. An image of the inputs that stands still gives no reading.
    ``wait_for_touch`` returns the first touch after the call, in bounds that hold it. A contact that is
    closed already is
    refused. A second wait during one raises BusyError at once. A cancelled wait leaves the probe usable.
    """

    @property
    def capabilities(self) -> ProbeCapabilities: ...
    async def read_contact(self) -> ContactReading: ...
    async def wait_for_touch(self) -> ContactEdge:
        """Wait for a touch, as long as it takes; the caller's limit is how far the arm travels."""
        ...


@dataclass(frozen=True, slots=True)
class Instruction:
    """Something a person must do or look at. ``key`` is stable, for scripts and translations."""

    key: str
    text: str


@dataclass(frozen=True, slots=True)
class Question:
    """A number or a text that only a person knows."""

    key: str
    text: str
    unit: str = ""
    count: int = 1  # of numbers, where it has a unit


@dataclass(frozen=True, slots=True)
class Answer:
    """What a person said, and who."""

    who: str
    value: str = "yes"


class Operator(Protocol):
    """The technician."""

    async def confirm(self, instruction: Instruction) -> Answer:
        """Return when the person says yes; raise DeclinedError-like RefusedError on no."""
        ...

    async def ask_question(self, question: Question) -> Answer: ...


@runtime_checkable
class GuidesPerson(Protocol):
    """Operators that show how what they ask for goes on, until it is answered."""

    def show_guidance(self, text: str, values: Mapping[str, Any]) -> None:
        """Show it in words; ``values`` are for a picture, in SI units."""
        ...
