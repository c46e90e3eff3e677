"""What every device of a cell has: its identity, its condition, its alarms."""

from dataclasses import dataclass
from enum import StrEnum
from typing import Protocol, runtime_checkable

from cellcal.calibration.message import limit_to_line

_MOST_OF_ANSWER = 400  # characters of what a device sent, in one text


@dataclass(frozen=True, slots=True)
class Identity:
    """The identity of the device that answers at this address."""

    vendor: str
    model: str
    serial: str
    firmware: str

    def __post_init__(self) -> None:
        _limit_texts(self, "vendor", "model", "serial", "firmware")


class Readiness(StrEnum):
    """Whether a device can be used, and if not, who must act."""

    READY = "ready"
    NOT_READY = "not_ready"  # a person at the device can make it ready
    STOPPED = "stopped"  # emergency or protective stop
    POSITION_LOST = "position_lost"  # encoders or mastering: the recovery's business
    UNREACHABLE = "unreachable"


class AlarmKind(StrEnum):
    """The meaning of an alarm for the position; every driver maps its maker's codes to it."""

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

    def __post_init__(self) -> None:
        _limit_texts(self, "code", "text")


@dataclass(frozen=True, slots=True)
class Condition:
    """Ready, or why not. ``message`` and ``remedy`` are sentences for a technician."""

    readiness: Readiness
    message: str = ""
    remedy: str = ""
    alarms: tuple[Alarm, ...] = ()
    stop: "Condition | None" = (
        None  # what stops a robot that has lost its position, such as an emergency stop
    )

    def __post_init__(self) -> None:
        _limit_texts(self, "message", "remedy")


def _limit_texts(described: Identity | Alarm | Condition, *names: str) -> None:
    """Let what a device sent be no line of its own on a terminal, and no load for pages that get it each second."""
    for name in names:
        object.__setattr__(described, name, limit_to_line(getattr(described, name), _MOST_OF_ANSWER))


class Device(Protocol):
    """Anything in the cell with a cable, or a pair of hands."""

    @property
    def name(self) -> str: ...
    async def identify(self) -> Identity: ...
    async def read_condition(self) -> Condition:
        """Never raises for a sulking device: an unreachable one has a condition too."""
        ...


@runtime_checkable
class DoubtsIdentity(Protocol):
    """Devices whose name plate may leave open who answers."""

    async def identity_doubts(self) -> str:
        """Return in sentences what the name plate does not prove, and what a person does; "" where it proves all."""
        ...
