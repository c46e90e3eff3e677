"""The state of a KUKA controller with one arm, its variables, and CELLCAL running on it.

Imitates
    A KR C4 with a variable server, an arm of six axes, CELLCAL and its part of the submit interpreter.
Source
    Names of system variables: KUKA, system variables KSS 8.x, as far as public; deploy/controller_setup/kuka for
    the programs, whose text is executed (program.py).
Modelled
    Joints, external axes, pose, frames, mode, override, safety, drives, stop messages, mastering flags, mastering by
    gauge head and dial; what stops the program: the gate, the mode switch, drives that are off, a lost mastering.
Not modelled
    Motion in T1; repositioning before START; external axes that need a mastering.
"""

import math
from collections.abc import Callable

import numpy as np

from cellcal.fake_devices.arm import SimulatedArm
from cellcal.fake_devices.kinematics import Array, invert_pose, matrix_from_xyzwpr, wpr_from_matrix
from cellcal.fake_devices.kuka_variables.program import CellcalPrograms, KrlPrograms
from cellcal.fake_devices.shown_joints import ShownJoints

FRAMES = 16


class KukaController:
    """Everything behind the variable server."""

    def __init__(
        self,
        arm: SimulatedArm,
        names: tuple[str, str],
        real_s: Callable[[], float],
        zeros: ShownJoints,
        sources: KrlPrograms | None = None,
    ) -> None:
        self.arm, self.zeros, self.real_s = arm, zeros, real_s
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
        self.load_kg = self.loads_kg[0]  # $LOAD
        self.external = [0.0] * 6  # E1 to E6 [mm or deg]
        self.timer_factor = 1.0  # timers run so many times slower, for machines that have other work
        self.programs = CellcalPrograms(self, sources or KrlPrograms())

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

    def shown_axes(self) -> dict[str, float]:
        """Return $AXIS_ACT."""
        angles = np.degrees(self.arm.controller_joints_rad)
        joints = {f"A{axis}": float(angle) for axis, angle in enumerate(angles, 1)}
        return joints | {f"E{axis}": value for axis, value in enumerate(self.external, 1)}

    def run_programs(self) -> None:
        """One cycle of the submit interpreter and of CELLCAL; what bars motion stops the program."""
        if not self.may_move:
            self.programs.robot.stop_program()
        self.programs.run_cycle()

    # what happens

    def set_override(self, percent: int) -> None:
        """Turn the override."""
        if not 1 <= percent <= 100:
            raise ValueError("the override is 1 to 100 %")
        self.arm.change_pace(percent / self.override_percent)
        self.override_percent = percent

    def select_tool(self, number: int) -> None:
        """Make a tool the active one; which load counts then, $LOAD says."""
        self.tool_number = number

    def mount(self, xyzabc: list[float]) -> None:
        """Let the robot's base stand elsewhere in WORLD, which its machine data tell."""
        self.root = xyzabc

    def use_external_tool(self) -> None:
        """Let the robot carry the workpiece."""
        self.ipo_mode = "TCP"

    def open_gate(self) -> None:
        """Open the operator safety; in automatic that is a message which is acknowledged at the pendant."""
        self.safety_closed, self.drives_on = False, False
        self.stop_message = self.stop_message or self.mode in ("AUT", "EX")

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

    def acknowledge(self) -> None:
        """Close the gate, acknowledge messages and switch the drives on; the program stays stopped."""
        self.safety_closed, self.stop_message, self.drives_on = True, False, True

    def turn_to_automatic(self) -> None:
        """Turn the switch to AUT and press START: a program that was stopped goes on."""
        self.mode = "AUT"
        self.programs.robot.press_start()

    def mend(self) -> None:
        """Set everything right at the pendant, and let the program run."""
        self.safety_closed, self.stop_message, self.drives_on = True, False, True
        self.mastered, self.mode = [True] * 6, "AUT"
        self.mastering_deg = [0.0] * 6
        self.root, self.ipo_mode = [0.0] * 6, "BASE"
        self.zeros.mend()
        self.programs.restart()


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
