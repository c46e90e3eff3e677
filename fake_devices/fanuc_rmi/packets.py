"""What the controller replies to each packet.

Imitates
    The commands of the Remote Motion Interface that a host needs for reading, moving and stopping one arm.
Source
    FANUC B-84184EN/03; field names also as fanuc-rmi 0.3.1 and fanuc-ucl 2.0.2 send and expect them.
Modelled
    See the table; JRep joint moves absolute and relative. A missing TermValue is accepted.
Not modelled
    Everything else is answered "Unknown", RMIT-020.
"""

import json
import math
from collections.abc import Callable
from typing import Any

import numpy as np

from cellcal.fake_devices.fanuc_rmi.controller import (
    FRAME_NUMBER,
    FRAMES,
    GROUP,
    TOOL_NUMBER,
    UNKNOWN,
    VALUE,
    QueuedMotion,
    RmiController,
    RmiRefusal,
)

Fields = dict[str, Any]
_KEYS = ("X", "Y", "Z", "W", "P", "R")
_OWN_GROUP = {"Group": 1}  # replies about a group name it
_SPEED_TYPES = ("Percent", "mSec", "Time")


class PacketTable:
    """Replies of one controller."""

    def __init__(self, controller: RmiController) -> None:
        self._c = controller
        c = controller
        self._replies: dict[str, Callable[[Fields], Fields]] = {
            "FRC_Initialize": lambda _: self._carry_out(c.initialise, GroupMask=1),
            "FRC_Abort": lambda _: self._carry_out(c.abort),
            "FRC_Pause": lambda _: self._carry_out(c.pause),
            "FRC_Continue": lambda _: self._carry_out(self._go_on),
            "FRC_Reset": lambda _: self._carry_out(c.reset),
            "FRC_GetStatus": lambda _: self._answer_status(),
            "FRC_ReadError": self._read_errors,
            "FRC_ReadJointAngles": self._read_joints,
            "FRC_ReadCartesianPosition": lambda _: self._answer_position(),
            "FRC_GetUFrameUTool": lambda _: {
                **_OWN_GROUP,
                "UFrameNumber": c.frame_number,
                "UToolNumber": c.tool_number,
            },
            "FRC_SetUFrameUTool": self._select_frames,
            "FRC_ReadUToolData": lambda f: self._read_frame(f, c.tools, "ToolNumber", TOOL_NUMBER),
            "FRC_ReadUFrameData": lambda f: self._read_frame(f, c.frames, "FrameNumber", FRAME_NUMBER),
            "FRC_WriteUToolData": lambda f: self._write_frame(f, c.tools, "ToolNumber", TOOL_NUMBER),
            "FRC_WriteUFrameData": lambda f: self._write_frame(f, c.frames, "FrameNumber", FRAME_NUMBER),
            "FRC_SetOverRide": self._set_override,
            "FRC_ReadTCPSpeed": lambda _: {"TimeTag": 0, "Speed": 0.0},
        }

    def answer_command(self, fields: Fields) -> Fields:
        """Return the reply of a command."""
        name = str(fields.get("Command"))
        if name not in self._replies:
            return {"Command": "Unknown", "ErrorID": RmiRefusal(UNKNOWN).error_id}
        try:
            return {"Command": name, "ErrorID": 0, **self._replies[name](fields)}
        except RmiRefusal as refusal:
            return {"Command": name, "ErrorID": refusal.error_id}

    def take_instruction(self, fields: Fields, client: object) -> Fields | None:
        """Queue a motion; return a reply at once where it is refused."""
        name, sequence_id = str(fields.get("Instruction")), fields.get("SequenceID")
        try:
            if name not in ("FRC_JointMotionJRep", "FRC_JointRelativeJRep"):
                raise RmiRefusal(UNKNOWN)
            if not isinstance(sequence_id, int):
                raise RmiRefusal(VALUE)
            angles = np.radians(
                [_read_number(fields.get("JointAngle", {}), f"J{axis}") for axis in range(1, 7)]
            )
            if name == "FRC_JointRelativeJRep":
                angles = self._c.arm.joints_rad + angles
            speed_type, speed = fields.get("SpeedType"), _read_number(fields, "Speed")
            if speed_type not in _SPEED_TYPES or speed <= 0 or (speed_type == "Percent" and speed > 100):
                raise RmiRefusal(VALUE)
            self._c.queue_motion(QueuedMotion(name, sequence_id, angles, str(speed_type), speed, client))
        except RmiRefusal as refusal:
            return {"Instruction": name, "ErrorID": refusal.error_id, "SequenceID": sequence_id}
        return None

    def _carry_out(self, order: Callable[[], None], **reply: Any) -> Fields:
        order()
        return reply

    def _go_on(self) -> None:
        self._c.is_paused = False

    def _answer_status(self) -> Fields:
        c = self._c
        return {
            "ServoReady": int(c.has_servo_power),
            "TPMode": int(c.pendant_enabled),
            "RMIMotionStatus": int(c.motion_runs),
            "ProgramStatus": 1 if c.is_paused else 0 if c.motion_runs else 2,
            "SingleStepMode": 0,
            "NumberUTool": FRAMES,
            "NumberUFrame": FRAMES,
            "NextSequenceID": c.next_sequence_id,
            "Override": c.override_percent,
        }

    def _read_errors(self, fields: Fields) -> Fields:
        count = int(_read_number(fields, "Count", 1.0))
        texts = self._c.alarm_texts[:count]
        return {"ErrorData" if k == 0 else f"ErrorData{k + 1}": text for k, text in enumerate(texts)} or {
            "ErrorData": ""
        }

    def _read_joints(self, fields: Fields) -> Fields:
        """Return the joints of a group; nine, whatever the arm has."""
        group = int(_read_number(fields, "Group", 1.0))
        further = self._c.second_group if group == 2 else None
        if group != 1 and further is None:
            raise RmiRefusal(GROUP)
        joints = (
            [*self._c.shown_joints_deg(), *self._c.external] if further is None else self._fill_nine(further)
        )
        named = {f"J{k}": value for k, value in enumerate(joints, 1)}
        return {"TimeTag": 0, "JointAngle": named, "Group": group}

    def _answer_position(self) -> Fields:
        values, frame, tool = self._c.shown_position()
        turns = {"Front": 1, "Up": 1, "Left": 0, "Flip": 0, "Turn4": 0, "Turn5": 0, "Turn6": 0}
        position = dict(zip(_KEYS, values, strict=True)) | {
            f"Ext{k}": value for k, value in enumerate(self._c.external, 1)
        }
        configuration = {"UToolNumber": tool, "UFrameNumber": frame, **turns}
        return {**_OWN_GROUP, "TimeTag": 0, "Configuration": configuration, "Position": position}

    def _select_frames(self, fields: Fields) -> Fields:
        frame, tool = int(_read_number(fields, "UFrameNumber")), int(_read_number(fields, "UToolNumber"))
        if not 0 <= frame <= FRAMES:
            raise RmiRefusal(FRAME_NUMBER)
        if not 0 <= tool <= FRAMES:
            raise RmiRefusal(TOOL_NUMBER)
        self._c.frame_number, self._c.tool_number = frame, tool
        return dict(_OWN_GROUP)

    def _read_frame(self, fields: Fields, table: list[list[float]], key: str, wrong: int) -> Fields:
        number = self._read_index(fields, key, wrong)
        frame = dict(zip(_KEYS, table[number - 1], strict=True))
        return {**_OWN_GROUP, key.replace("Frame", "UFrame").replace("Tool", "UTool"): number, "Frame": frame}

    def _write_frame(self, fields: Fields, table: list[list[float]], key: str, wrong: int) -> Fields:
        number = self._read_index(fields, key, wrong)
        if self._c.arm.is_moving:
            raise RmiRefusal(15)
        table[number - 1] = [round(_read_number(fields.get("Frame", {}), name), 5) for name in _KEYS]
        return dict(_OWN_GROUP)

    def _read_index(self, fields: Fields, key: str, wrong: int) -> int:
        number = int(_read_number(fields, key))
        if not 1 <= number <= FRAMES:
            raise RmiRefusal(wrong)
        return number

    def _set_override(self, fields: Fields) -> Fields:
        value = _read_number(fields, "Value")
        if not 1 <= value <= 100:
            raise RmiRefusal(5)
        self._c.set_override(int(value))
        return {}

    @staticmethod
    def _fill_nine(values: list[float]) -> list[float]:
        return [*values, *(0.0,) * (9 - len(values))]


def _read_number(fields: Fields, key: str, otherwise: float | None = None) -> float:
    value = fields.get(key, otherwise)
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        raise RmiRefusal(VALUE)
    return float(value)


def parse_packet(line: bytes) -> Fields | None:
    """Return the fields of a line; None for what is no JSON object."""
    try:
        fields = json.loads(line)
    except ValueError:
        return None
    return fields if isinstance(fields, dict) else None
