"""The state of a KUKA controller with one arm, its variables, and CELLCAL running on it.

Imitates
    A KR C4 with a variable server, an arm of six axes, CELLCAL and its part of the submit interpreter.
Source
    Names of system variables: KUKA, system variables KSS 8.x, as far as public; deploy/controller_setup/kuka for
    the programs, whose statements are played by hand here.
Modelled
    Joints, pose, frames, mode, override, safety, drives, stop messages, mastering flags, mastering by gauge head and
    dial, the handshake with its heartbeat, brake and release.
Not modelled
    The KRL interpreter; advance run; T1 speed limits.
"""

import math
from collections.abc import Callable

import numpy as np

from cellcal.fake_devices.arm import SimulatedArm
from cellcal.fake_devices.kinematics import Array, invert_pose, matrix_from_xyzwpr, wpr_from_matrix
from cellcal.fake_devices.shown_joints import ShownJoints

FRAMES = 16
HEARTBEAT_REAL_S = 0.5
OFF, WAITING, MOVING, STOPPED = range(4)
_ACCELERATION_RAD_S2 = 4.0
_BRAKING_RAD_S2 = 8.0
_COUNTERS = ("CC_REQ", "CC_ACK", "CC_VEL", "CC_HB")


class KukaController:
    """Everything behind the variable server."""

    def __init__(
        self, arm: SimulatedArm, names: tuple[str, str], real_s: Callable[[], float], zeros: ShownJoints
    ) -> None:
        self.arm, self.zeros = arm, zeros
        self.serial, self.title = names
        arm.convert_to_shown = zeros.to_shown_joints
        self.mastering_deg = [0.0] * 6  # the angle at each notch
        self.mode, self.override_percent = "AUT", 100
        self.safety_closed, self.stop_message, self.drives_on = True, False, True
        self.mastered = [True] * 6
        self.tool_number, self.base_number = 1, 0
        self.tools = [[0.0] * 6 for _ in range(FRAMES)]
        self.tools[0], self.tools[1] = [10.0, -5.0, 180.0, 0.0, 10.0, 0.0], [0.0, 0.0, 95.0, 30.0, 0.0, 0.0]
        self.bases = [[0.0] * 6 for _ in range(FRAMES)]  # seen from WORLD
        self.root, self.ipo_mode = [0.0] * 6, "BASE"  # $ROBROOT, $IPO_MODE
        self.loads_kg = [3.5, 1.25] + [0.0] * (FRAMES - 2)
        self.program_runs, self.state, self.life = True, WAITING, 0
        self.counters = dict.fromkeys(_COUNTERS, 0)
        self.stop_flag, self.target_deg = False, [0.0] * 6
        self.heartbeat_s = HEARTBEAT_REAL_S
        self._real_s = real_s
        self._beat_seen = (0, real_s())

    # what it shows

    def tool_matrix(self) -> Array:
        """Return the active tool (4, 4)."""
        return np.eye(4) if not self.tool_number else matrix_of(self.tools[self.tool_number - 1])

    def base_matrix(self) -> Array:
        """Return the active base (4, 4)."""
        return np.eye(4) if not self.base_number else matrix_of(self.bases[self.base_number - 1])

    def tip_in_base(self) -> Array:
        """Return the pose that $POS_ACT shows."""
        flange = self.arm.believed_flange(self.arm.controller_joints_rad)[0]
        return np.asarray(
            invert_pose(self.base_matrix()) @ matrix_of(self.root) @ flange @ self.tool_matrix()
        )

    @property
    def may_move(self) -> bool:
        """Whether a program may drive the arm."""
        automatic = self.mode in ("AUT", "EX")
        return (
            automatic
            and self.safety_closed
            and self.drives_on
            and not self.stop_message
            and all(self.mastered)
        )

    # the programs on it

    def run_programs(self) -> None:
        """One cycle of the submit interpreter and of CELLCAL."""
        if not self.program_runs:
            self.state = OFF
            return
        self.life = self.life % 30_000 + 1
        self._watch_heartbeat()
        if not self.may_move or self.stop_flag:
            self._brake(finish=self.state == MOVING)
        elif self.state in (STOPPED, OFF) or (self.state == MOVING and not self.arm.is_moving):
            self.state, self.counters["CC_ACK"] = WAITING, self.counters["CC_REQ"]
        elif self.state == WAITING and self.counters["CC_REQ"] != self.counters["CC_ACK"]:
            self._begin_move()

    def _watch_heartbeat(self) -> None:
        beat, now_s = self.counters["CC_HB"], self._real_s()
        if beat != self._beat_seen[0] or self.state != MOVING:
            self._beat_seen = (beat, now_s)
        elif now_s - self._beat_seen[1] > self.heartbeat_s:
            self.stop_flag = True

    def _begin_move(self) -> None:
        shown = np.radians(self.target_deg)
        target = self.zeros.to_true_joints(shown)
        percent = self.counters["CC_VEL"]
        if (
            not 1 <= percent <= 100
            or (shown < self.arm.lower_rad).any()
            or (shown > self.arm.upper_rad).any()
        ):
            self.stop_message = True
            return
        way = np.abs(target - self.arm.joints_rad)
        longest = float(way.max())
        if longest > 0.0:
            pace = percent / 100.0 * self.override_percent / 100.0
            needed_s = float((way / (self.arm.max_speed_rad_s * pace)).max())
            self.arm.start_move(target, longest / needed_s, _ACCELERATION_RAD_S2)
        self.state = MOVING

    def _brake(self, *, finish: bool) -> None:
        if finish:
            self.arm.stop(_BRAKING_RAD_S2)
            self.counters["CC_ACK"] = self.counters["CC_REQ"]
        self.state = STOPPED

    # what happens

    def set_override(self, percent: int) -> None:
        """Turn the override."""
        if not 1 <= percent <= 100:
            raise ValueError("the override is 1 to 100 %")
        self.arm.change_pace(percent / self.override_percent)
        self.override_percent = percent

    def mount(self, xyzabc: list[float]) -> None:
        """Let the robot's base stand elsewhere in WORLD, which its machine data tell."""
        self.root = xyzabc

    def use_external_tool(self) -> None:
        """Let the robot carry the workpiece."""
        self.ipo_mode = "TCP"

    def open_gate(self, *, is_open: bool) -> None:
        """Open or close the operator safety."""
        self.safety_closed, self.drives_on = not is_open, not is_open

    def lose_mastering(self, axes: list[int]) -> None:
        """Let the resolver memory of some axes fail: the controller unmasters them."""
        for axis in axes:
            self.mastered[axis] = False
        self.zeros.lose_turns(axes)

    def master_with_gauge(self, axis: int) -> None:
        """Master an axis with the gauge head; it fails, and the axis stays as it was, where no notch is near."""
        self.mastered[axis] = self.zeros.find_notch(axis)

    def master_with_dial(self, axis: int) -> None:
        """Master an axis where it stands, by a dial gauge that a person reads."""
        self.zeros.set_zero(axis)
        self.mastered[axis] = True

    def mend(self) -> None:
        """Set everything right at the pendant, and let the program run."""
        self.safety_closed, self.stop_message, self.drives_on, self.program_runs = True, False, True, True
        self.mastered, self.mode = [True] * 6, "AUT"
        self.mastering_deg = [0.0] * 6
        self.root, self.ipo_mode = [0.0] * 6, "BASE"
        self.zeros.mend()


def matrix_of(values: list[float]) -> Array:
    """Return the pose (4, 4) of X Y Z [mm] and A B C [deg], turns about z, y, x."""
    x, y, z, a, b, c = values
    return np.asarray(matrix_from_xyzwpr([x, y, z, c, b, a]))


def values_of(pose: Array) -> list[float]:
    """Return X Y Z [mm] and A B C [deg] of a pose."""
    roll, pitch, yaw = wpr_from_matrix(pose[:3, :3])
    found = [*(float(value) * 1e3 for value in pose[:3, 3]), yaw, pitch, roll]
    if not all(map(math.isfinite, found)):
        raise ValueError("the pose is not finite")
    return found
