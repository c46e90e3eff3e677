"""What a FANUC controller knows and writes into its files: one state, from which every file is made when it is read.

Imitates
    An R-30iB Plus controller with one six-axis robot; where wanted on a rail as axis 7, and with
    a positioner as a second group.
Source
    The files of public backups, read for their layout and relations: R-1000iA/80F, V9.40; R-2000iC/210L on a rail,
    V9.30P/17 (axis 7: $ENCSCALES are counts per mm, $GEAR_RATIO mm per motor turn, CURPOS.DG shows EXTAXS);
    M-900iB/700 with a servo gun as group 2, V9.30P/15 (AXIS.DG repeats its tables for each group, from J1; the gun
    has no $INTERACTION, $MOSIGN FALSE, $ENCSCALES in counts per mm; DCSVRFY.DG ends with signature numbers).
Modelled
    Counts from the joints that the pendant shows (motor signs, J3 counted from J2, wrist coupling), mastering,
    frames, tools, active alarms, programs, the clock; SPC_COUNT that follows the counts.
Not modelled
    Motion, servo data, and variables that no reader asks for beyond a few of each kind.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from datetime import datetime, timedelta

import numpy as np

COUNTS_PER_TURN = 2**19
RATIOS = (138.75, 185.0, 133.5, 100.1607, 116.5714, 77.8788)  # motor turns per joint turn
MOTOR_SIGNS = (-1, 1, 1, 1, 1, 1)  # $MOSIGN: shown joint against motor
LINK_SIGNS = (-1, -1, 1, 1, 1, 1)  # $INTERACTION: angle of the link against motor
WRIST = {
    (4, 3): -0.0171153,
    (5, 3): -0.0109301,
    (5, 4): -0.0095316,
}  # share of the motor that is turned along
FIRST_COUNTS = (-412345, 11987654, 8765432, 13210987, 24680, 8135792)
FIRST_JOINTS_DEG = (-35.0, -42.0, -30.0, -42.0, 40.0, 35.0)
SPEED_LIMITS_DEG_S = (170.0, 140.0, 160.0, 230.0, 230.0, 350.0)
EMPTY = (0.0,) * 6


@dataclass
class FanucCabinet:
    """One controller. Tests and the control port change it; its files show its state at that moment."""

    f_number: str = "F123456"
    robot: str = "R-1000iA/80F"
    robot_name: str = "R01"
    software: str = "V9.40P/83"
    now: datetime = field(default_factory=lambda: datetime(2026, 8, 27, 13, 14, 6))  # noqa: DTZ001  no zone there
    joints_deg: list[float] = field(default_factory=lambda: list(FIRST_JOINTS_DEG))
    counts_at_zero: list[int] = field(default_factory=lambda: list(FIRST_COUNTS))
    effective_zero: list[int] | None = None  # of the last CALIBRATE; None: the same
    ratios: Sequence[float] = RATIOS
    third_follows_second: bool = True
    states_coupling: bool = True  # the software has $AXS_COUPLE and $INTRAC_NUM
    master_done: bool = True
    axis_states: list[int] = field(default_factory=lambda: [2] * 6)
    alarms: list[tuple[str, str]] = field(default_factory=list)  # code, text
    frames: dict[int, tuple[float, ...]] = field(default_factory=dict)
    safety_signature: int = 1945160182  # of the DCS position and speed check
    tools: dict[int, tuple[float, ...]] = field(
        default_factory=lambda: {1: (-275.0, 0.0, 280.0, -180.0, -90.0, 0.0)}
    )
    programs: dict[str, str] = field(default_factory=lambda: {"MAIN": "CALL PICK", "PICK": "UTOOL_NUM=1"})
    servo_on: bool = False
    held_beside_deg: tuple[float, float] = (0.0, 0.0)  # J2 and J3 under power, beside what is shown
    positioner_counts: list[int] | None = None  # of a second group with one axis
    positioner_ratio: float = 121.0
    gun_mm_per_turn: float | None = None  # its axis slides, as that of a servo gun, with the motor against it
    positioner_at: float = 0.0  # deg or mm
    positioner_mastered: bool = True
    rail_count_at_zero: int | None = None  # of axis 7, which slides
    rail_mm: float = -1444.07
    rail_mm_per_turn: float = 6.896
    rail_state: int = 2
    stale: "FanucCabinet | None" = None  # what its files say in place of what is so
    moves_counts_each_reading: int = 0
    stands_after_readings: int | None = None  # of AXIS.DG, by when it has come to rest
    readings: int = 0

    @property
    def axes(self) -> int:
        """Number of axes of the robot."""
        return len(self.ratios)

    @property
    def knows_position(self) -> bool:
        """Whether the controller shows angles."""
        return self.master_done and all(state == 2 for state in self.axis_states)

    def link_matrix(self) -> np.ndarray:
        """Return $INTERACTION: link angle [rad] per count, with what one motor of the wrist turns along."""
        n = self.axes
        matrix = np.zeros((n, n))
        for axis, (sign, ratio) in enumerate(zip(LINK_SIGNS[:n], self.ratios, strict=True)):
            matrix[axis, axis] = sign * 2 * np.pi / (ratio * COUNTS_PER_TURN)
        for (row, column), share in WRIST.items():
            if row < n:
                matrix[row, column] = share * abs(matrix[row, row])
        return matrix

    def link_angles_rad(self) -> np.ndarray:
        """Return the angles of the links for the joints that the pendant shows."""
        shown = np.radians(self.joints_deg[: self.axes])
        links: np.ndarray = shown * np.array(MOTOR_SIGNS[: self.axes]) * np.array(LINK_SIGNS[: self.axes])
        if self.third_follows_second and self.axes > 2:
            links[2] = shown[2] + shown[1]
        return links

    def pulses(self) -> list[int]:
        """Return what the encoders read now."""
        zero = self.effective_zero or self.counts_at_zero
        matrix, links = self.link_matrix(), self.link_angles_rad()
        moved: list[float] = []
        for row in range(self.axes):
            along = sum(matrix[row, column] * moved[column] for column in range(row))
            moved.append((links[row] - along) / matrix[row, row])
        readings = self.readings
        if self.stands_after_readings is not None:
            readings = min(readings, self.stands_after_readings)
        drift = self.moves_counts_each_reading * readings
        return [round(count + turned) + drift for count, turned in zip(zero, moved, strict=True)]

    def rail_pulses(self) -> list[int]:
        """Return what the encoder of the rail reads; nothing where there is no rail."""
        if self.rail_count_at_zero is None:
            return []
        return [self.rail_count_at_zero + round(self.rail_mm / self.rail_mm_per_turn * COUNTS_PER_TURN)]

    def positioner_pulses(self) -> list[int]:
        """Return what the encoder of the second group reads; nothing where there is none."""
        if self.positioner_counts is None:
            return []
        turns = self.positioner_at / 360 * self.positioner_ratio
        if self.gun_mm_per_turn is not None:
            turns = -self.positioner_at / self.gun_mm_per_turn
        return [self.positioner_counts[0] + round(turns * COUNTS_PER_TURN)]

    def shown_deg(self) -> list[float]:
        """Return the joints as the pendant shows them, also while a drifting robot moves."""
        shown = list(self.joints_deg[: self.axes])
        if self.servo_on:
            shown[1:3] = [
                angle + offset for angle, offset in zip(shown[1:3], self.held_beside_deg, strict=False)
            ]
        return shown

    def let_time_pass(self, **amount: float) -> None:
        """Turn the controller's clock on."""
        self.now += timedelta(**amount)

    def lose_position(self, axes: Sequence[int], code: str = "SRVO-062", text: str = "BZAL alarm") -> None:
        """Forget the turns of some motors: alarms, and a mastering that no longer counts."""
        self.master_done = False
        for axis in axes:
            self.axis_states[axis - 1] = 0
            self.alarms.append((code, f"{text} (Group:1 Axis:{axis})"))
