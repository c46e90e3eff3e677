"""The state of a FANUC controller with the Remote Motion Interface: frames, servo, one queue of motions.

Imitates
    An R-30iB Plus with option R912 and one six-axis arm.
Source
    FANUC B-84184EN/03: packets, error numbers, the queue of eight instructions, sequence numbers.
Modelled
    Status, frames, joint moves with FINE, pause, continue, abort, reset, hold after a wrong sequence number,
    emergency stop, teach pendant, override, alarms. The sequence number lives on over an initialisation, as it was
    measured on a CRX (airo-fanuc), unlike the manual.
Not modelled
    Cartesian moves, CNT, register packets, ASCII packets, groups but for the joints of a second one.
"""

from collections import deque
from dataclasses import dataclass
from typing import Any

import numpy as np

from cellcal.fake_devices.arm import SimulatedArm
from cellcal.fake_devices.kinematics import Array, invert_pose, matrix_from_xyzwpr, wpr_from_matrix

FRAMES = 9
QUEUE = 8
_ACCELERATION_RAD_S2 = 4.0
_BRAKING_RAD_S2 = 8.0
_ERROR_BASE = 2_556_928
(
    SERVO_OFF, PENDANT_ON, NOT_RUNNING, UNKNOWN, VALUE, HELD, QUEUE_FULL, SEQUENCE, TOOL_NUMBER, FRAME_NUMBER, STATE,
    GROUP,
) = (
    7, 8, 9, 20, 21, 24, 28, 29, 2, 3, 15, 39,
)  # fmt: skip


class RmiRefusal(Exception):  # noqa: N818 - an answer, no fault of the program
    """The controller says no: RMIT-n."""

    def __init__(self, number: int) -> None:
        super().__init__(f"RMIT-{number:03d}")
        self.error_id = _ERROR_BASE + number


@dataclass
class QueuedMotion:
    """One instruction of the queue, and the client that waits for its reply."""

    name: str
    sequence_id: int
    target_rad: Array
    speed_type: str
    speed: float
    client: Any


class RmiController:
    """Everything behind both ports."""

    def __init__(self, arm: SimulatedArm) -> None:
        self.arm = arm
        self.has_servo_power, self.pendant_enabled, self.emergency_stop = True, False, False
        self.override_percent = 100
        self.tool_number, self.frame_number = 1, 0
        self.tools = [[0.0] * 6 for _ in range(FRAMES)]
        self.tools[0], self.tools[1] = [10.0, -5.0, 180.0, 0.0, 10.0, 0.0], [0.0, 0.0, 95.0, 0.0, 0.0, 30.0]
        self.frames = [[0.0] * 6 for _ in range(FRAMES)]
        self.external = [0.0, 0.0, 0.0]  # J7 to J9 of group 1 [mm or deg]
        self.second_group: list[float] | None = None  # its joints [deg]; None where there is none
        self.alarm_texts: list[str] = []
        self.motion_runs = self.is_paused = self.is_held = False
        self.next_sequence_id = 1
        self.restarts_sequence = False  # as the manual says; a CRX does not
        self.queue: deque[QueuedMotion] = deque()
        self.running: QueuedMotion | None = None
        self.most_queued = 0  # ever, for tests

    # what it shows

    def shown_joints_deg(self) -> list[float]:
        """Return the joints as they are told, to 0.001 deg."""
        return [round(float(value), 3) for value in np.degrees(self.arm.joints_rad)]

    def shown_position(self) -> tuple[list[float], int, int]:
        """Return X Y Z W P R of the tip in the active user frame, and both numbers."""
        flange = self.arm.believed_flange(self.arm.joints_rad)[0]
        pose = flange @ self._tool_matrix()
        if self.frame_number:
            pose = invert_pose(matrix_from_xyzwpr(self.frames[self.frame_number - 1])) @ pose
        values = [*(float(value) * 1e3 for value in pose[:3, 3]), *wpr_from_matrix(pose[:3, :3])]
        return [round(value, 3) for value in values], self.frame_number, self.tool_number

    def _tool_matrix(self) -> Array:
        return (
            np.asarray(matrix_from_xyzwpr(self.tools[self.tool_number - 1]))
            if self.tool_number
            else np.eye(4)
        )

    # orders

    def initialise(self) -> None:
        """Start RMI_MOVE."""
        self.refuse_unless_free()
        self.motion_runs, self.is_paused, self.is_held = True, False, False
        if self.restarts_sequence:
            self.next_sequence_id = 1

    def refuse_unless_free(self) -> None:
        """Refuse what needs servo power and a pendant that is off."""
        if not self.has_servo_power:
            raise RmiRefusal(SERVO_OFF)
        if self.pendant_enabled:
            raise RmiRefusal(PENDANT_ON)

    def abort(self) -> None:
        """End program control; what is queued is forgotten, the arm brakes."""
        self.motion_runs = self.is_paused = self.is_held = False
        self._drop_motions()

    def pause(self) -> None:
        """Hold the arm."""
        self.is_paused = True
        self.arm.stop(_BRAKING_RAD_S2)

    def reset(self) -> None:
        """Reset what may be reset."""
        if self.emergency_stop:
            raise RmiRefusal(STATE)
        self.alarm_texts.clear()
        self.has_servo_power, self.is_held = True, False

    def queue_motion(self, motion: QueuedMotion) -> None:
        """Take an instruction into the queue."""
        if not self.motion_runs:
            raise RmiRefusal(NOT_RUNNING)
        if self.is_held:
            raise RmiRefusal(HELD)
        if motion.sequence_id != self.next_sequence_id:
            self.is_held = True
            raise RmiRefusal(SEQUENCE)
        if len(self.queue) + (self.running is not None) >= QUEUE:
            raise RmiRefusal(QUEUE_FULL)
        low, high = self.arm.lower_rad, self.arm.upper_rad
        if (motion.target_rad < low).any() or (motion.target_rad > high).any():
            raise RmiRefusal(23)
        self.next_sequence_id = motion.sequence_id % (2**31 - 1) + 1
        self.queue.append(motion)
        self.most_queued = max(self.most_queued, len(self.queue) + (self.running is not None))

    def advance(self) -> QueuedMotion | None:
        """Begin the next motion, or return the one that has just ended."""
        ended = None
        if self.running is not None and not self.arm.is_moving and not self.is_paused:
            ended, self.running = self.running, None
        if self.running is None and self.queue and self.motion_runs and not self.is_paused:
            self.running = self.queue.popleft()
            self._begin_motion(self.running)
        return ended

    def _begin_motion(self, motion: QueuedMotion) -> None:
        way = np.abs(motion.target_rad - self.arm.joints_rad)
        longest = float(way.max())
        if longest <= 0.0:
            return
        pace = self.override_percent / 100.0
        if motion.speed_type == "Percent":
            needed_s = float((way / (self.arm.max_speed_rad_s * motion.speed / 100.0)).max())
        else:
            needed_s = motion.speed * {"mSec": 1e-3, "Time": 0.1}[motion.speed_type]
        fastest_s = float((way / self.arm.max_speed_rad_s).max())
        self.arm.start_move(
            motion.target_rad, longest / max(needed_s, fastest_s) * pace, _ACCELERATION_RAD_S2
        )

    def _drop_motions(self) -> None:
        self.queue.clear()
        self.running = None
        self.arm.stop(_BRAKING_RAD_S2)

    # what happens

    def press_emergency_stop(self) -> None:
        """Push the red button at the operator panel."""
        self.emergency_stop = True
        self.raise_alarm("SRVO-001 Operator panel E-stop")

    def release_emergency_stop(self) -> None:
        """Turn the button back and press RESET."""
        self.emergency_stop = False
        if not any("BZAL" in text for text in self.alarm_texts):
            self.alarm_texts.clear()
            self.has_servo_power = True

    def raise_alarm(self, text: str) -> None:
        """Raise an alarm that takes the servo power."""
        self.alarm_texts.insert(0, text)
        self.has_servo_power = False
        self.motion_runs = False
        self._drop_motions()

    def clear_alarms(self) -> None:
        """Mend everything and press RESET."""
        self.alarm_texts.clear()
        self.emergency_stop, self.has_servo_power = False, True

    def enable_pendant(self, *, on: bool) -> None:
        """Switch the teach pendant."""
        self.pendant_enabled = on
        if on:
            self.motion_runs = False
            self._drop_motions()

    def set_override(self, percent: int) -> None:
        """Turn the speed override."""
        if not 1 <= percent <= 100:
            raise ValueError("the override is 1 to 100 %")
        self.arm.change_pace(percent / self.override_percent)
        self.override_percent = percent
