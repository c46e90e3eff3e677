"""What a procedure's steps work with: the devices of one cell, and what is known about them."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Protocol

from cellcal.calibration.arm.kinematics import RobotModel
from cellcal.calibration.drift.reference import DriftReference
from cellcal.calibration.mastering.counts import MasteringRecord
from cellcal.calibration.mastering.position_record import ArmPositionRecord
from cellcal.calibration.points.alignment import Alignment
from cellcal.calibration.poses.calibrated_arm import CalibratedArm
from cellcal.drivers.interfaces import (
    ActiveFrames,
    Device,
    DistanceGauge,
    Identity,
    JogsAxes,
    Joints,
    KnowsActiveFrames,
    KnowsMode,
    KnowsSpeedOverride,
    MasteringData,
    MasteringStore,
    Operator,
    Robot,
    TellsPositionData,
    ToolFrameStore,
    TouchProbe,
    Tracker,
    UserFrameStore,
)
from cellcal.procedures.shown_motors import ShownMotors
from cellcal.procedures.surroundings import NOTHING_KNOWN, Surroundings


class MotionLevel(StrEnum):
    """The way in which a robot is moved. Procedures do not know it; `procedures.motion.motion_gate` does."""

    OBSERVE = "observe"  # a person with the pendant, to the joints that are shown
    PROGRAM = "program"  # a person lets the pendant run a small program that was written for it
    COMMANDED = "commanded"  # this software


class Permit(Protocol):
    """The right to command a robot, which can be lost while it is used."""

    def check_held(self) -> None:
        """Raise a CellError where the right is no longer ours."""
        ...


class PendantProgramWriter(Protocol):
    """Writes programs for a pendant, where the robot's make is known."""

    def write_program(self, way_rad: tuple[Joints, ...], speed_rad_s: float) -> str:
        """Write joint moves along a way; return the file's name for the technician."""
        ...


@dataclass(slots=True)
class MotionApproval:
    """The approvals of one entry into a run that the gate remembers."""

    approved: bool = False  # a person has said yes to the plan, or to moving from where the robot stands
    agreed_at_s: float | None = None  # when an operator last agreed to motion; None: never
    epoch: int | None = None
    frames: ActiveFrames | None = None  # None: not yet read
    override: float | None = None  # the highest at which an operator watched the arm, or agreed to

    def note_approval(self, now_s: float) -> None:
        """Note that a person has just said yes to motion that was shown or told."""
        self.approved, self.agreed_at_s = True, now_s


@dataclass(frozen=True, slots=True)
class MotionCaps:
    """Caps that no step exceeds, whatever a spec asks for."""

    speed_rad_s: float = 0.5
    tip_speed_m_s: float = 0.25  # of any point of arm and tool; the speed of teaching by hand
    jog_speed_rad_s: float = 0.035  # 2 deg/s, also the pace while a robot does not know where it is
    settle_s: float = 1.0
    joint_tolerance_rad: float = 2e-3
    look_s: float = 0.1  # between looks at the counts while a person turns an axis


@dataclass(frozen=True, slots=True)
class GaugeSetup:
    """The place of a draw-wire, as well as a tape measure tells."""

    anchor_in_base_m: tuple[float, float, float]
    hook_in_flange_m: tuple[float, float, float]
    sigma_anchor_m: float = 0.010
    sigma_hook_m: float = 0.002
    mouth_at_m: tuple[float, float, float] | None = (
        None  # a place in front of it; None: its direction is unknown
    )


@dataclass(frozen=True, slots=True)
class TrackerSetup:
    """The place of a tracker's target on the flange, as well as a ruler tells."""

    target_in_flange_m: tuple[float, float, float]
    sigma_target_m: float = 0.002


@dataclass(frozen=True, slots=True)
class ProbeSetup:
    """The place of the tip of a probe or dial gauge on the flange, as well as a ruler tells."""

    tip_in_flange_m: tuple[float, float, float]
    sigma_tip_m: float = 0.001
    axis_in_flange: tuple[float, float, float] = (0.0, 0.0, 1.0)  # from the flange to the tip


@dataclass(frozen=True, slots=True)
class DeviceMark:
    """One device of the fingerprint."""

    role: str
    identity: Identity


@dataclass(frozen=True, slots=True)
class Fingerprint:
    """The facts that must be the same when a run is resumed."""

    cell: str
    devices: tuple[DeviceMark, ...]
    config_sha256: str
    encoder_epoch: int | None = None
    active_frames: ActiveFrames | None = None


@dataclass(frozen=True, slots=True)
class DeviceCertificate:
    """Whose calibration an instrument has, and for which days; ISO dates."""

    number: str
    issued: str
    due: str

    def is_valid_on(self, day: str) -> bool:
        """Return whether it is valid on that day (ISO date)."""
        return self.issued <= day <= self.due


@dataclass(frozen=True, slots=True)
class MasteringBackup:
    """The mastering in a robot's controller before a run wrote its own, and the hash of its stored form."""

    of_run: str
    at_utc: str
    robot_serial: str
    data: MasteringData
    epoch: int  # of the encoders at that write: in another one the counts mean nothing
    sha256: str


@dataclass(frozen=True, eq=False)
class Cell:
    """One robot and what stands around it. An ability the cell lacks is None."""

    name: str
    robot: Robot
    operator: Operator
    jogs: JogsAxes | None = None
    mastering: MasteringStore | None = None
    position_data: TellsPositionData | None = None
    shown_motors: ShownMotors | None = None  # where encoders cannot be read, and the gear ratios are known
    tool_frames: ToolFrameStore | None = None
    user_frames: UserFrameStore | None = None
    frames: KnowsActiveFrames | None = None
    mode: KnowsMode | None = None
    override: KnowsSpeedOverride | None = None
    named_frames: ActiveFrames = field(default_factory=ActiveFrames)  # what the cell file wants active
    gauge: DistanceGauge | None = None
    gauge_setup: GaugeSetup | None = None
    tracker: Tracker | None = None
    tracker_setup: TrackerSetup | None = None
    probe: TouchProbe | None = None
    probe_setup: ProbeSetup | None = None
    dial: DistanceGauge | None = None  # its length is how far the plunger is pushed in
    dial_setup: ProbeSetup | None = None
    certificates: Mapping[str, DeviceCertificate] = field(
        default_factory=dict
    )  # of instruments, by their roles
    model: RobotModel | None = None  # nominal kinematics
    record: MasteringRecord | None = None  # the latest of this robot
    position_record: ArmPositionRecord | None = (
        None  # the latest of this robot, where encoders cannot be read
    )
    backups: tuple[MasteringBackup, ...] = ()  # of this robot's mastering before each write, oldest first
    alignments: tuple[Alignment, ...] = ()  # of every robot with every fixture, oldest first
    calibrated: CalibratedArm | None = None  # the latest parameters of this robot
    drift_references: tuple[DriftReference, ...] = ()  # of this robot, oldest first
    limits: MotionCaps = field(default_factory=MotionCaps)
    level: MotionLevel = MotionLevel.OBSERVE
    surroundings: Surroundings = NOTHING_KNOWN
    permit: Permit | None = None  # None: no other client can reach this robot
    programs: PendantProgramWriter | None = None
    motion: MotionApproval = field(default_factory=MotionApproval)
    config_sha256: str = ""

    @property
    def is_jogged_by_hand(self) -> bool:
        """Whether a person at the pendant turns the axes of this robot while it does not know where it is."""
        return self.level is not MotionLevel.COMMANDED or self.jogs is None

    @property
    def measuring_devices(self) -> dict[str, Device]:
        """The measuring devices of this cell, by their roles."""
        there: tuple[tuple[str, Device | None], ...] = (
            ("gauge", self.gauge),
            ("tracker", self.tracker),
            ("probe", self.probe),
            ("dial", self.dial),
        )
        return {role: device for role, device in there if device is not None}


async def read_fingerprint(cell: Cell) -> Fingerprint:
    """Ask every device who it is."""
    marks = [DeviceMark("robot", await cell.robot.identify())]
    for role, device in cell.measuring_devices.items():
        marks.append(DeviceMark(role, await device.identify()))
    epoch = await cell.mastering.encoder_epoch() if cell.mastering is not None else None
    frames = await cell.frames.active_frames() if cell.frames is not None else None
    return Fingerprint(cell.name, tuple(marks), cell.config_sha256, epoch, frames)
