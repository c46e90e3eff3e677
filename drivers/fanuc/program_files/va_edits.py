"""The way back to a controller: what an operator types, or a .VA file with other numbers in the same places.

Nothing else in the file changes by a byte. A number takes the maker's field: three decimals, a leading zero only
before ``0.000``; a count is a whole number of 32 bits.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from cellcal.calibration.geometry import Pose
from cellcal.calibration.orientation import values_from
from cellcal.drivers.fanuc.program_files.va_backup import DRIVES, FRAMES, MASTERING, REGISTERS, FanucBackup
from cellcal.drivers.fanuc.program_files.va_positions import VaPosition
from cellcal.drivers.fanuc.program_files.va_spots import Spot
from cellcal.drivers.programs.errors import ProgramFileError
from cellcal.drivers.programs.numbers import NumberFormat

_MENU = {
    "$MNUFRAME": "MENU > SETUP > Frames > OTHER > User Frame > DETAIL > Direct Entry",
    "$MNUTOOL": "MENU > SETUP > Frames > OTHER > Tool Frame > DETAIL > Direct Entry",
    "$POSREG": "MENU > DATA > Position Reg > POSITION",
    "$DMR_GRP": "MENU > NEXT > SYSTEM > Variables > $DMR_GRP > $MASTER_COUN",
}
_LARGEST_MM = 99999.999  # what the field of a coordinate holds
AFTER_COUNTS = (
    "set $DMR_GRP[{group}].$MASTER_DONE to TRUE",
    "MENU > NEXT > SYSTEM > Master/Cal > CALIBRATE, and answer YES; then DONE",
    "compare the joint angles that the pendant shows with the marks on the arm before anything moves",
)


@dataclass(frozen=True, slots=True)
class Edit:
    """One number to change: where on the pendant, which variable, and where in which file."""

    menu: str
    variable: str
    old: str
    new: str
    unit: str
    file: str  # upper case, as in the folder of the backup
    spot: Spot

    def __str__(self) -> str:
        """Say it as one line for the operator."""
        unit = f" {self.unit}" if self.unit else ""
        return f"{self.menu}: {self.variable} from {self.old.strip()}{unit} to {self.new.strip()}{unit}"


def frame_edits(
    backup: FanucBackup, *, frames: Mapping[tuple[int, int], Pose], tools: Mapping[tuple[int, int], Pose]
) -> tuple[Edit, ...]:
    """Return what to type for new user frames and tools, by (group, number); equal numbers are left out.

    Raises
    ------
    ProgramFileError
        The backup holds no such frame, or a number does not fit its field.
    """
    edits: list[Edit] = []
    for name, held, asked in (
        ("$MNUFRAME", backup.frame_positions, frames),
        ("$MNUTOOL", backup.tool_positions, tools),
    ):
        for key, pose in asked.items():
            position = held.get(key)
            if position is None or not (position.initialised and position.cartesian):
                raise ProgramFileError(
                    FRAMES,
                    f"{name}[{key[0]},{key[1]}] is not in the backup, or was never set.",
                    remedy="Set it on the pendant once (Direct Entry), and save the backup again.",
                )
            edits += _pose_edits(name, position, pose)
    return tuple(edits)


def register_edits(
    backup: FanucBackup, group: int, *, poses: Mapping[int, Pose], joints: Mapping[int, Sequence[float]]
) -> tuple[Edit, ...]:
    """Return what to type for new position registers of a group, by number; equal numbers are left out.

    Joints [rad] are what the controller shows.

    Raises
    ------
    ProgramFileError
        The backup holds no such register in that form, or a number does not fit its field.
    """
    edits: list[Edit] = []
    for number, pose in poses.items():
        edits += _pose_edits("$POSREG", _register(backup, group, number, cartesian=True), pose, REGISTERS)
    for number, angles in joints.items():
        position = _register(backup, group, number, cartesian=False)
        for axis, angle in enumerate(angles, 1):
            spot, unit = position.numbers[f"J{axis}"], position.units[f"J{axis}"]
            new = _in_field(position, f"J{axis}", angle * 1e3 if unit == "mm" else float(np.degrees(angle)))
            if float(new) != float(spot.text):
                variable = f"{position.path}.J{axis}"
                edits.append(Edit(_MENU["$POSREG"], variable, spot.text, new, unit, REGISTERS, spot))
    return tuple(edits)


def _register(backup: FanucBackup, group: int, number: int, *, cartesian: bool) -> VaPosition:
    position = backup.registers.get((group, number))
    if position is None or not position.initialised or position.cartesian != cartesian:
        raise ProgramFileError(
            REGISTERS,
            f"PR[{number}] of group {group} is not in the backup as a {'pose' if cartesian else 'posture'}.",
            remedy="Record it on the pendant, and save the backup again.",
        )
    return position


def count_edits(backup: FanucBackup, group: int, counts_at_zero: Sequence[int]) -> tuple[Edit, ...]:
    """Return what to type for other counts at zero; equal ones are left out.

    Raises
    ------
    ProgramFileError
        The backup holds no mastering of this group, other axes, or a count is beyond 32 bits.
    """
    held = backup.mastering.get(group)
    if held is None or len(held.spots) != len(counts_at_zero):
        axes = 0 if held is None else len(held.spots)
        raise ProgramFileError(
            MASTERING,
            f"group {group} has {axes} axes in the backup; {len(counts_at_zero)} counts are given.",
            remedy=f"Take the backup of this robot, with {MASTERING} and {DRIVES}.",
        )
    edits = []
    for axis, (spot, count) in enumerate(zip(held.spots, counts_at_zero, strict=True), 1):
        if not -(2**31) <= count < 2**31:
            raise ProgramFileError(
                MASTERING, f"{count} counts are beyond 32 bits.", line=spot.line, remedy="Check the counts."
            )
        if int(count) != int(spot.text):
            variable = f"$DMR_GRP[{group}].$MASTER_COUN[{axis}]"
            edits.append(Edit(_MENU["$DMR_GRP"], variable, spot.text, str(int(count)), "", MASTERING, spot))
    return tuple(edits)


def changed_files(backup: FanucBackup, edits: Sequence[Edit]) -> dict[str, bytes]:
    """Return the files that the edits touch, by upper-case name, with the new numbers in place."""
    found = {}
    for name in sorted({edit.file for edit in edits}):
        places = {edit.spot: edit.new for edit in edits if edit.file == name}
        found[name] = backup.files[name].replaced(places)
    return found


def instructions(edits: Sequence[Edit]) -> tuple[str, ...]:
    """Return a numbered list for the operator, with what makes new counts effective at its end."""
    groups = sorted(
        {edit.variable.split("[")[1][0] for edit in edits if edit.variable.startswith("$DMR_GRP")}
    )
    ends = [step.format(group=group) for group in groups for step in AFTER_COUNTS]
    return tuple(f"{number}. {line}" for number, line in enumerate([*map(str, edits), *ends], 1))


def _pose_edits(name: str, position: VaPosition, pose: Pose, file: str = FRAMES) -> list[Edit]:
    angles = np.degrees(values_from("fanuc_wpr", pose.rotation()))
    values = dict(zip("XYZ", (1e3 * value for value in pose.position_m), strict=True))
    if not _turned_alike(position, pose):
        values |= dict(zip("WPR", map(float, angles), strict=True))
    edits = []
    for field, value in values.items():
        spot = position.numbers[field]
        new = _in_field(position, field, value)
        if float(new) != float(spot.text):
            unit, variable = "mm" if field in "XYZ" else "deg", f"{position.path}.{field}"
            edits.append(Edit(_MENU[name], variable, spot.text, new, unit, file, spot))
    return edits


def _turned_alike(position: VaPosition, pose: Pose) -> bool:
    """Tell whether the old angles say the new attitude already; near P = 90 many angles say the same."""
    old = position.pose()
    if old is None:
        return False
    step = max(NumberFormat.of(position.numbers[field].text).resolution for field in "WPR")
    apart = np.linalg.norm(old.rotation() - pose.rotation()) / np.sqrt(2.0)
    return bool(apart < 0.5 * np.radians(step))


def _in_field(position: VaPosition, field: str, value: float) -> str:
    """Write a number as the controller does: ``0.000``, ``-.182``, ``884.000``."""
    spot = position.numbers[field]
    if not abs(value) <= _LARGEST_MM:
        raise ProgramFileError(
            position.file,
            f"{position.path}.{field} cannot be {value:.3f}: the field holds {_LARGEST_MM:.0f} at most.",
            line=spot.line,
            remedy="Check the pose; its lengths are metres.",
        )
    decimals = NumberFormat.of(spot.text).decimals
    text = f"{round(value, decimals) + 0.0:.{decimals}f}"
    whole, point, fraction = text.partition(".")
    return f"{whole[:-1]}{point}{fraction}" if whole in ("0", "-0") and float(text) != 0 else text
