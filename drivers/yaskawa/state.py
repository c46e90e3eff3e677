"""What the controller says of itself: status, alarms, position, identity."""

import struct
from collections.abc import Sequence
from dataclasses import dataclass

from cellcal.calibration.message import make_message
from cellcal.drivers.errors import RefusedError, WireProtocolError
from cellcal.drivers.interfaces import ShownExternalAxis
from cellcal.drivers.wire.link_errors import unreadable_answer_error
from cellcal.drivers.yaskawa.hses_frames import HsesRequest
from cellcal.drivers.yaskawa.hses_link import HsesLink

AXES = 6
PULSE_POSITION, CARTESIAN_POSITION = 1, 101  # instances of robot 1
_READ_ALL, _ALARMS, _LOGGED = 0x01, 4, 100
MARKED = 8  # alarms by which a place of the history is known: a clock that starts anew repeats itself
_PULSE_TYPE = 0
_ALARM = struct.Struct("<III16s32s")
_STATION_DITHER_PULSES = 20.0  # of axes that servos hold; some hundredths of a millimetre or degree
_POSITION = struct.Struct("<5I8i")


@dataclass(frozen=True, slots=True)
class ControllerStatus:
    """Two status words (command 0x72)."""

    word_1: int
    word_2: int

    @property
    def is_running(self) -> bool:
        """Whether a job or an ordered move is under way."""
        return bool(self.word_1 & 0x08)

    @property
    def is_teaching(self) -> bool:
        """Whether the mode switch is at TEACH."""
        return bool(self.word_1 & 0x20)

    @property
    def is_remote(self) -> bool:
        """Whether orders over the network count."""
        return bool(self.word_1 & 0x80)

    @property
    def is_on_hold(self) -> bool:
        """Whether the pendant or an external signal holds the robot; our own hold is not meant."""
        return bool(self.word_2 & 0x06)

    @property
    def has_alarm(self) -> bool:
        """Whether an alarm or an error is active."""
        return bool(self.word_2 & 0x30)

    @property
    def has_servo_power(self) -> bool:
        """Whether the motors have power."""
        return bool(self.word_2 & 0x40)

    @property
    def mode_name(self) -> str:
        """Return the mode as the pendant calls it."""
        if self.is_remote:
            return "REMOTE"
        return "TEACH" if self.is_teaching else "PLAY"


@dataclass(frozen=True, slots=True)
class AlarmEntry:
    """One alarm (command 0x70) in the maker's words; ``data_type`` tells what its data are."""

    code: int
    data: int
    name: str
    data_type: int


@dataclass(frozen=True, slots=True)
class LoggedAlarm:
    """One alarm of the history (command 0x71), and when it came by the controller's clock."""

    alarm: AlarmEntry
    mark: str


@dataclass(frozen=True, slots=True)
class PulsePosition:
    """Command 0x75, instance 1: motor pulses from the home position, by axis S L U R B T."""

    pulses: tuple[int, ...]
    tool_number: int
    raw: str


@dataclass(frozen=True, slots=True)
class StationGroup:
    """A group of axes beside the robot, and under which instance of command 0x75 its pulses are."""

    name: str
    instance: int
    axes: int


@dataclass(frozen=True, slots=True)
class CartesianPosition:
    """Command 0x75, instance 101: the tool's tip in the robot's base."""

    position_m: tuple[float, float, float]
    rotation_deg: tuple[float, float, float]  # Rx, Ry, Rz; the rotation is Rz Ry Rx
    tool_number: int
    user_frame_number: int


_STATION_GROUPS = (StationGroup("B1", 11, 3), *(StationGroup(f"S{k}", 20 + k, 6) for k in range(1, 4)))


async def read_status(link: HsesLink) -> ControllerStatus:
    """Read both status words in one telegram."""
    data = await link.ask(HsesRequest(0x72, 1, 0, _READ_ALL))
    return ControllerStatus(*_unpack(link, struct.Struct("<II"), data))


async def read_alarms(link: HsesLink) -> tuple[AlarmEntry, ...]:
    """Read the active alarms, newest first."""
    found: list[AlarmEntry] = []
    for instance in range(1, _ALARMS + 1):
        logged = await _read_alarm(link, 0x70, instance)
        if logged is None:
            break
        found.append(logged.alarm)
    return tuple(found)


async def read_logged_alarms(
    link: HsesLink, first: int, known: tuple[str, ...] | None
) -> tuple[LoggedAlarm, ...]:
    """Return the alarms of one list of the history down to those with known marks, newest first.

    ``first`` is the number of the newest alarm of the list; None as marks: the newest few alone. All that there are
    where the known ones are not among them, or were all that there were.
    """
    found: list[LoggedAlarm] = []
    for instance in range(first, first + (MARKED if known is None else _LOGGED)):
        logged = await _read_alarm(link, 0x71, instance)
        if logged is None:
            break
        found.append(logged)
        if known is not None and len(known) == MARKED and marks_of(found[-MARKED:]) == known:
            break
    return tuple(found)


def marks_of(alarms: Sequence[LoggedAlarm]) -> tuple[str, ...]:
    """Return the marks of logged alarms."""
    return tuple(each.mark for each in alarms)


async def _read_alarm(link: HsesLink, command: int, instance: int) -> LoggedAlarm | None:
    """Return the alarm at a place; None of an empty one."""
    data = await link.ask(HsesRequest(command, instance, 0, _READ_ALL))
    code, detail, kind, stamp, name = _unpack(link, _ALARM, data)
    if kind == 0 and code == 0:
        return None
    alarm = AlarmEntry(code, detail, text_of(name), kind)
    return LoggedAlarm(alarm, f"{text_of(stamp)} {code} {detail}")


async def read_pulses(link: HsesLink) -> PulsePosition:
    """Read the pulses of robot 1 in one telegram."""
    data = await link.ask(HsesRequest(0x75, PULSE_POSITION, 0, _READ_ALL))
    kind, _, tool, _, _, *axes = _unpack_position(link, data)
    if kind != _PULSE_TYPE:
        raise _unreadable_error(
            link, make_message("a position of type {kind} came where pulses were asked for", kind=kind), data
        )
    return PulsePosition(tuple(axes[:AXES]), tool, data.hex())


async def read_station_axes(link: HsesLink, group: StationGroup) -> tuple[ShownExternalAxis, ...]:
    """Read the pulses of a base axis group or of a station."""
    data = await link.ask(HsesRequest(0x75, group.instance, 0, _READ_ALL))
    kind, _, _, _, _, *axes = _unpack_position(link, data)
    if kind != _PULSE_TYPE:
        raise _unreadable_error(
            link, make_message("a position of type {kind} came where pulses were asked for", kind=kind), data
        )
    pulses = enumerate(axes[: group.axes], 1)
    return tuple(
        ShownExternalAxis(f"{group.name} axis {axis}", float(value), wanders=_STATION_DITHER_PULSES)
        for axis, value in pulses
    )


async def find_station_groups(link: HsesLink) -> tuple[StationGroup, ...]:
    """Return the groups of axes beside robot 1 whose pulses the controller tells."""
    found = []
    for group in _STATION_GROUPS:
        try:
            await read_station_axes(link, group)
        except (RefusedError, WireProtocolError):  # it has none, or tells it in another form
            continue
        found.append(group)
    return tuple(found)


async def read_cartesian(link: HsesLink) -> CartesianPosition:
    """Read the tip of the active tool in the base."""
    data = await link.ask(HsesRequest(0x75, CARTESIAN_POSITION, 0, _READ_ALL))
    kind, _, tool, user, _, x, y, z, rx, ry, rz, *_ = _unpack_position(link, data)
    if kind not in (16, 17):
        raise _unreadable_error(
            link, make_message("a position of type {kind} came where the base was asked for", kind=kind), data
        )
    return CartesianPosition((x * 1e-6, y * 1e-6, z * 1e-6), (rx * 1e-4, ry * 1e-4, rz * 1e-4), tool, user)


async def read_system(link: HsesLink, *, number: int = 1) -> tuple[str, str]:
    """Return the software's version and the model of a robot of the controller."""
    data = await link.ask(HsesRequest(0x89, 10 + number, 0, _READ_ALL))
    version, model, _ = _unpack(link, struct.Struct("<24s16s8s"), data)
    return text_of(version), text_of(model)


def text_of(octets: bytes) -> str:
    """Return the text before the first zero octet; what is not ASCII is replaced."""
    return octets.partition(b"\0")[0].decode("ascii", "replace").strip()


def _unpack_position(link: HsesLink, data: bytes) -> tuple[int, ...]:
    if len(data) == _POSITION.size - 4:  # controllers of seven axes leave the eighth out
        data += bytes(4)
    return _unpack(link, _POSITION, data)


def _unpack(link: HsesLink, form: struct.Struct, data: bytes) -> tuple:  # type: ignore[type-arg]
    if len(data) < form.size:
        raise _unreadable_error(
            link,
            make_message("{count} octets came where {size} belong", count=len(data), size=form.size),
            data,
        )
    return form.unpack_from(data)


def _unreadable_error(link: HsesLink, what: str, data: bytes) -> WireProtocolError:
    return unreadable_answer_error(
        link.device, what, "Check that robot 1 of this controller is an arm of six axes.", data.hex()
    )
