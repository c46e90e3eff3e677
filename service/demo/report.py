"""What the demo found, as the one object of ``cellcal demo --json``."""

from dataclasses import dataclass, field

from cellcal.service.demo.timing import RobotTime


@dataclass(frozen=True, slots=True)
class JointReport:
    """One joint: what the world took, what the recovery gave back, and how wrong that is in truth."""

    name: str
    turns_lost: int
    turns_restored: int
    offset_error_rad: float
    offset_u_rad: float


@dataclass(frozen=True, slots=True)
class TcpError:
    """Distance between where the tool stands and where it stood for the same command before the loss."""

    mean: float
    max: float


@dataclass(frozen=True, slots=True)
class DemoReport:
    """The end of the story."""

    loss: str
    detected_by: str
    captures: int
    joints: tuple[JointReport, ...]
    tcp_error_before_m: TcpError
    tcp_error_after_m: TcpError
    verdict: str
    reason: str
    seconds: float
    robot_time_s: float = 0.0  # of turning joints; rests, index runs and computing not counted
    clock: RobotTime | None = None  # of the whole recovery
    gate: tuple[tuple[str, bool, str], ...] = field(default=())

    def as_object(self) -> dict[str, object]:
        """Return the object of ``--json``."""
        return {
            "loss": self.loss,
            "detected_by": self.detected_by,
            "captures": self.captures,
            "joints": [
                {
                    "name": joint.name,
                    "turns_lost": joint.turns_lost,
                    "turns_restored": joint.turns_restored,
                    "offset_error_rad": joint.offset_error_rad,
                    "offset_u_rad": joint.offset_u_rad,
                }
                for joint in self.joints
            ],
            "tcp_error_before_m": {"mean": self.tcp_error_before_m.mean, "max": self.tcp_error_before_m.max},
            "tcp_error_after_m": {"mean": self.tcp_error_after_m.mean, "max": self.tcp_error_after_m.max},
            "verdict": self.verdict,
            "reason": self.reason,
            "robot_time_s": self.robot_time_s,
            "clock_s": None if self.clock is None else self.clock.total_s,
            "clock_parts_s": {} if self.clock is None else dict(self.clock.parts_s),
        }
