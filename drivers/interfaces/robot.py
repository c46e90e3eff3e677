"""A robot, and what only some robots can do: one Protocol for each flag of their capabilities."""

from dataclasses import dataclass
from enum import StrEnum
from typing import Protocol, runtime_checkable

from cellcal.calibration.geometry import Pose
from cellcal.calibration.mastering.counts import DriveTrain
from cellcal.calibration.mastering.position_record import ShownValue
from cellcal.drivers.interfaces.device import Alarm, Device

Joints = tuple[float, ...]
Counts = tuple[int, ...]


@dataclass(frozen=True, slots=True)
class JointReading:
    """Joint angles as the controller believes them, with the raw form they came in."""

    joints_rad: Joints
    moving: bool
    taken_at_s: float  # host monotonic clock
    device_time_s: float | None = None
    raw: str = ""  # hex of the wire form


class PositionCure(StrEnum):
    """The actions by which a person at the pendant brings a lost position back, where no wire writes it."""

    REVOLUTION_COUNTERS = "revolution_counters"  # ABB: each axis at its mark, the fraction of a turn is kept
    ABSOLUTE_DATA = "absolute_data"  # Yaskawa: the absolute data of each axis are typed or made anew
    MASTERING_GAUGE = "mastering_gauge"  # KUKA: EMD or dial gauge in the cartridge of each axis


@dataclass(frozen=True, slots=True)
class RobotCapabilities:
    """The capabilities of a robot; a procedure's needs are compared with them before it is offered."""

    axes: int
    axis_names: tuple[str, ...] = ()  # as its pendant shows them, where they are not J1 to J6
    moves_joints: bool = True
    moves_slowly: bool = True  # joint moves of 2 deg/s and less, the pace of a robot that may be lost
    moves_linear: bool = False
    tells_flange_pose: bool = True  # without it, joints cannot be compared with the robot's model
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
    shows_position_data: bool = False  # values of its zero or its machine, which no motion changes
    keeps_position_history: bool = False  # a log that tells of a position that was lost and is back

    def axis_name(self, axis: int) -> str:
        """Return what the pendant calls an axis, counted from zero."""
        return self.axis_names[axis] if axis < len(self.axis_names) else f"J{axis + 1}"

    def all_axis_names(self) -> tuple[str, ...]:
        """Return what the pendant calls each axis."""
        return tuple(self.axis_name(axis) for axis in range(self.axes))


@dataclass(frozen=True, slots=True)
class MasteringData:
    """The controller's mastering: joints = drive.joints(counts, counts_at_zero) when ``mastered``."""

    counts_at_zero: Counts
    mastered: bool


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
        """Return base_flange as the controller reports it, the active tool taken off.

        Refused where capabilities.tells_flange_pose is false.
        """
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
    """Robots with capabilities.shows_position_data: what their controllers show about the position."""

    async def position_data(self) -> tuple[ShownValue, ...]:
        """Return joints, states and whatever else the maker documents, in the controller's own texts."""
        ...


@dataclass(frozen=True, slots=True)
class PositionHistory:
    """What a controller's log tells of the position since an entry: what was, never what is."""

    alarms: tuple[Alarm, ...]  # those that are known to concern the position, newest first
    marks: tuple[str, ...]  # of the newest entries; the next question begins behind them
    is_whole: bool  # False: the log does not reach back to the entry that was asked for


class KeepsPositionHistory(Protocol):
    """Robots with capabilities.keeps_position_history."""

    async def position_history(self, since: tuple[str, ...]) -> PositionHistory:
        """Return what came behind the entries with these marks; without marks nothing but the newest marks."""
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
class ShownExternalAxis:
    """Where an axis beside the arm stands, such as a rail or a positioner."""

    name: str  # as the maker counts it: E1, eax_a
    shown: float  # mm, deg or pulses: which of them, the link does not tell
    wanders: float = 0.02  # by so much its reading may differ while the axis stands


@dataclass(frozen=True, slots=True)
class ActiveFrames:
    """The tool and frame that the controller uses at one moment; None where it does not tell."""

    tool_number: int | None = None  # None also where tools have no numbers
    flange_tool: Pose | None = None  # the active tool itself, seen from the flange
    user_frame_number: int | None = None  # 0: the base itself, also where there is no other frame to work in
    payload_kg: float | None = None
    external_axes: tuple[ShownExternalAxis, ...] | None = (
        None  # where they stand: the arm, or the work, stands on them
    )


class KnowsActiveFrames(Protocol):
    """Robots with capabilities.tells_active_frames."""

    async def active_frames(self) -> ActiveFrames:
        """Return what is active, and where external axes stand. Fresh: read after the call began."""
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


@runtime_checkable
class ComparesJoints(Protocol):
    """Robots whose joints may come over a second link, too, which must agree with the first."""

    async def joint_sources(self) -> str:
        """Return in a sentence what comes over the second link; "" where the cell file names none.

        Raises a ``DeviceError`` where the arm stands and the links differ, or nothing can be received.
        """
        ...
