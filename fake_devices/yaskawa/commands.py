"""What the controller answers to each command of the robot port, and the files of the file port.

Imitates
    The commands that a host needs for reading, moving and stopping one arm.
Source
    As packets.py.
Modelled
    0x70 alarms, 0x71 history, 0x72 status, 0x74 axis names, 0x75 position, 0x7A and 0x7C variables, 0x82 reset,
    0x83 hold and servo, 0x89 system information, 0x8B move by pulses; list, save, load and delete of files
    (TOOL.CND, ABSO.DAT, jobs).
Not modelled
    Everything else: status 08, as a controller answers what it does not know.
"""

import struct
from collections.abc import Callable

import numpy as np

from cellcal.fake_devices.kinematics import wpr_from_matrix
from cellcal.fake_devices.yaskawa.controller import AXES, LOST_TEXT, PLAY, REMOTE, TEACH, YaskawaController
from cellcal.fake_devices.yaskawa.packets import CommandRefusal, HostRequest

Alarms = list[tuple[int, int, str, str]]
_GET_ALL, _SET_ALL, _GET_ONE, _SET_ONE = 0x01, 0x02, 0x0E, 0x10
_UNDEFINED, _NO_INSTANCE, _NO_ELEMENT = 0x08, 0x28, 0x09
_DECIMAL, _AXES_OF_USER = 1, 3  # types of an alarm's data
_VARIABLE_OCTETS = {0x7A: 1, 0x7C: 4}
_SAVE, _LIST, _DELETE = 0x16, 0x32, 0x09
_NO_FILE = 0xE2B3
_NOT_REMOTE = 0x2100


class CommandTable:
    """Answers of one controller."""

    def __init__(self, controller: YaskawaController) -> None:
        self._c = controller
        self._answers: dict[int, Callable[[HostRequest], bytes]] = {
            0x70: lambda request: self._answer_alarm(request, self._c.alarms, 4),
            0x71: self._logged_alarm,
            0x72: self._answer_status,
            0x74: lambda _: b"".join(name.encode().ljust(4, b"\0") for name in AXES).ljust(32, b"\0"),
            0x75: self._answer_position,
            0x7A: self._answer_variable,
            0x7C: self._answer_variable,
            0x82: self._reset_alarms,
            0x83: self._switch_servo,
            0x89: self._answer_system,
            0x8B: self._begin_move,
        }

    def answer_command(self, request: HostRequest) -> bytes:
        """Return the data of an answer, or refuse."""
        if request.command not in self._answers:
            raise CommandRefusal(_UNDEFINED)
        return self._answers[request.command](request)

    def read_file(self, request: HostRequest) -> bytes:
        """Return the file that is asked for, or the list of files."""
        name = request.data.partition(b"\0")[0].decode("ascii", "replace").upper()
        if request.service == _SAVE and name == "TOOL.CND":
            return self._c.tool_file().encode()
        if request.service == _SAVE and name == "ABSO.DAT":
            return self._c.home_file().encode()
        if request.service == _SAVE and name in self._c.jobs:
            return self._c.jobs[name]
        if request.service == _LIST:
            other = "ABSO.DAT" if name.endswith(".DAT") else "TOOL.CND"
            names = sorted(self._c.jobs) if name.endswith(".JBI") else [other]
            return "".join(f"{each}\r\n" for each in names).encode()
        if request.service == _DELETE and name in self._c.jobs:
            self.require_writable()
            del self._c.jobs[name]
            return b""
        raise CommandRefusal(0x1F, _NO_FILE) if request.service == _SAVE else CommandRefusal(_UNDEFINED)

    def require_writable(self) -> None:
        """Refuse to change files where orders over the network do not count."""
        if self._c.mode != REMOTE:
            raise CommandRefusal(0x1F, _NOT_REMOTE)

    def store_job(self, name: str, content: bytes) -> None:
        """Take a job that has come whole."""
        self._c.jobs[name.upper()] = content

    def _answer_alarm(self, request: HostRequest, entries: Alarms, places: int) -> bytes:
        if not 1 <= request.instance <= places:
            raise CommandRefusal(_NO_INSTANCE)
        return self._alarm_at(entries, request.instance - 1)

    def _logged_alarm(self, request: HostRequest) -> bytes:
        """Answer from a list of the history: major alarms from 1, minor ones, from number 4000, from 1001."""
        of_list, place = divmod(request.instance - 1, 1000)
        if of_list not in (0, 1) or place >= 100:
            raise CommandRefusal(_NO_INSTANCE)
        return self._alarm_at(
            [each for each in self._c.history if (each[0] >= 4000) == (of_list == 1)], place
        )

    def _alarm_at(self, entries: Alarms, place: int) -> bytes:
        if place >= len(entries):
            return bytes(60)
        code, data, stamp, text = entries[place]
        data_type = _AXES_OF_USER if text == LOST_TEXT else _DECIMAL
        return struct.pack("<III16s32s", code, data, data_type, stamp.encode(), text.encode())

    def _answer_status(self, request: HostRequest) -> bytes:
        c = self._c
        word_1 = 0x02 | (0x08 if c.arm.is_moving and not c.is_jogged else 0)
        word_1 |= {TEACH: 0x20, PLAY: 0x40, REMOTE: 0xC0}[c.mode]
        word_2 = 0x02 * c.holds["pendant"] | 0x04 * c.holds["external"] | 0x08 * c.holds["command"]
        word_2 |= (0x10 if c.alarms else 0) | (0x40 if c.has_servo_power else 0)
        words = struct.pack("<II", word_1, word_2)
        if request.service == _GET_ALL:
            return words
        if request.attribute not in (1, 2):
            raise CommandRefusal(_NO_ELEMENT)
        return words[:4] if request.attribute == 1 else words[4:]

    def _answer_position(self, request: HostRequest) -> bytes:
        c = self._c
        if request.instance == 1:
            return struct.pack("<5I8i", 0, 0, c.tool_number, 0, 0, *c.pulses(), 0, 0)
        if request.instance in c.stations:
            axes = c.stations[request.instance]
            return struct.pack("<5I8i", 0, 0, 0, 0, 0, *axes, *(0,) * (8 - len(axes)))
        if request.instance != 101:
            raise CommandRefusal(_NO_INSTANCE)
        pose = c.base_tip()
        place = [round(float(value) * 1e6) for value in pose[:3, 3]]
        turn = [round(value * 1e4) for value in wpr_from_matrix(pose[:3, :3])]
        return struct.pack("<5I8i", 16, 0, c.tool_number, c.user_frame, 0, *place, *turn, 0, 0)

    def _answer_variable(self, request: HostRequest) -> bytes:
        octets, key = _VARIABLE_OCTETS[request.command], (request.command, request.instance)
        if request.instance > 99:
            raise CommandRefusal(0x1F, 0xB001)
        if request.service == _SET_ONE:
            self._c.variables[key] = request.data[:octets].ljust(octets, b"\0")
            return b""
        return self._c.variables.get(key, bytes(octets))

    def _reset_alarms(self, request: HostRequest) -> bytes:
        if request.instance not in (1, 2):
            raise CommandRefusal(_NO_INSTANCE)
        self._c.reset_alarms()
        return b""

    def _switch_servo(self, request: HostRequest) -> bytes:
        if len(request.data) != 4:
            raise CommandRefusal(_NO_ELEMENT)
        on = struct.unpack("<I", request.data)[0] == 1
        if request.instance == 1:
            self._c.order_hold(on=on)
        elif request.instance == 2:
            self._c.order_servo(on=on)
        elif request.instance != 3:
            raise CommandRefusal(_NO_INSTANCE)
        return b""

    def _answer_system(self, request: HostRequest) -> bytes:
        if request.instance not in ((11, 12, 101) if self._c.has_second_robot else (11, 101)):
            raise CommandRefusal(_NO_INSTANCE)
        return struct.pack("<24s16s8s", b"YAS2.80.00A(EN/DE)-00", self._c.title.encode(), b"12.34-00")

    def _begin_move(self, request: HostRequest) -> bytes:
        if request.service != _SET_ALL or len(request.data) != 88:
            raise CommandRefusal(_NO_ELEMENT)
        group, station, speed_class, speed, *rest = struct.unpack("<4I8i10i", request.data)
        if group != 1 or station != 0:
            raise CommandRefusal(0x1F, 0xB008)
        if request.instance not in (1, 2) or speed_class != 0 or not 1 <= speed <= 10000:
            raise CommandRefusal(_NO_ELEMENT)
        pulses = rest[: len(AXES)]
        if any(rest[len(AXES) : 8]) or not np.isfinite(pulses).all():
            raise CommandRefusal(0x1F, 0xB008)
        self._c.order_move(pulses, speed / 10000.0)
        return b""
