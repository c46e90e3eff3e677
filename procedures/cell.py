"""What a procedure's steps are lent: the devices of one cell, and what is known about them."""

from dataclasses import dataclass, field

from calibration.kinematics import RobotModel
from calibration.mastering import MasteringRecord
from drivers.interfaces import (
    DistanceGauge,
    Identity,
    JogsAxes,
    MasteringStore,
    Operator,
    Robot,
    ToolFrameStore,
    UserFrameStore,
)


@dataclass(frozen=True, slots=True)
class MotionLimits:
    """Caps that no step exceeds, whatever a spec asks for."""

    speed_rad_s: float = 0.5
    jog_speed_rad_s: float = 0.035  # 2 deg/s, also the pace while a robot does not know where it is
    settle_s: float = 1.0
    joint_tolerance_rad: float = 2e-3


@dataclass(frozen=True, slots=True)
class GaugeSetup:
    """Where a draw-wire is fixed, as well as a tape measure tells."""

    anchor_in_base_m: tuple[float, float, float]
    hook_in_flange_m: tuple[float, float, float]
    sigma_anchor_m: float = 0.010
    sigma_hook_m: float = 0.002


@dataclass(frozen=True, slots=True)
class DeviceMark:
    """One device of the fingerprint."""

    role: str
    identity: Identity


@dataclass(frozen=True, slots=True)
class Fingerprint:
    """What must be the same when a run is resumed."""

    cell: str
    devices: tuple[DeviceMark, ...]
    config_sha256: str
    encoder_epoch: int | None = None


@dataclass(frozen=True, eq=False)
class Cell:
    """One robot and what stands around it. An ability the cell lacks is None."""

    name: str
    robot: Robot
    operator: Operator
    jogs: JogsAxes | None = None
    mastering: MasteringStore | None = None
    tool_frames: ToolFrameStore | None = None
    user_frames: UserFrameStore | None = None
    gauge: DistanceGauge | None = None
    gauge_setup: GaugeSetup | None = None
    model: RobotModel | None = None  # nominal kinematics
    record: MasteringRecord | None = None  # the latest of this robot
    limits: MotionLimits = field(default_factory=MotionLimits)
    config_sha256: str = ""


async def fingerprint(cell: Cell) -> Fingerprint:
    """Ask every device who it is."""
    marks = [DeviceMark("robot", await cell.robot.identify())]
    if cell.gauge is not None:
        marks.append(DeviceMark("gauge", await cell.gauge.identify()))
    epoch = await cell.mastering.encoder_epoch() if cell.mastering is not None else None
    return Fingerprint(cell.name, tuple(marks), cell.config_sha256, epoch)
