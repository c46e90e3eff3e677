"""The way back to a controller: what an operator types, or a .VA file with other numbers in the same places.

Nothing else in the file changes by a byte. A number takes the maker's field: three decimals, a leading zero only
before ``0.000``; a count is a whole number of 32 bits.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from cellcal.calibration.geometry import Pose
from cellcal.calibration.message import make_message
from cellcal.calibration.orientation import values_from
from cellcal.drivers.fanuc.program_files.va_backup import DRIVES, FRAMES, MASTERING, REGISTERS, FanucBackup
from cellcal.drivers.fanuc.program_files.va_positions import VaPosition
from cellcal.drivers.fanuc.program_files.va_spots import ValueSpot
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
class VariableEdit:
    """One number to change: where on the pendant, which variable, and where in which file."""

    menu: str
    variable: str
    old: str
    new: str
    unit: str
    file: str  # upper case, as in the folder of the backup
    spot: ValueSpot

    def __str__(self) -> str:
        """Say it as one line for the operator."""
        unit = f" {self.unit}" if self.unit else ""
        return f"{self.menu}: {self.variable} from {self.old.strip()}{unit} to {self.new.strip()}{unit}"


def frame_edits(
    backup: FanucBackup, *, frames: Mapping[tuple[int, int], Pose], tools: Mapping[tuple[int, int], Pose]
) -> tuple[VariableEdit, ...]:
    """Return what to type for new user frames and tools, by (group, number); equal numbers are left out.

    Raises
    ------
    ProgramFileError
        The backup holds no such frame, or a number does not fit its field.
    """
    edits: list[VariableEdit] = []
    for name, poses, requested in (
        ("$MNUFRAME", backup.frame_positions, frames),
        ("$MNUTOOL", backup.tool_positions, tools),
    ):
        for key, pose in requested.items():
            position = poses.get(key)
            if position is None or not (position.is_initialised and position.is_cartesian):
                raise ProgramFileError(
                    FRAMES,
                    make_message(
                        "{variable}[{group},{index}] is not in the backup, or was never set.",
                        variable=name,
                        group=key[0],
                        index=key[1],
                    ),
                    remedy="Set it on the pendant once (Direct Entry), and save the backup again.",
                )
            edits += _pose_edits(name, position, pose)
    return tuple(edits)


def register_edits(
    backup: FanucBackup, group: int, *, poses: Mapping[int, Pose], joints: Mapping[int, Sequence[float]]
) -> tuple[VariableEdit, ...]:
    """Return what to type for new position registers of a group, by number; equal numbers are left out.

    Joints [rad] are what the controller shows.

    Raises
    ------
    ProgramFileError
        The backup holds no such register in that form, or a number does not fit its field.
    """
    edits: list[VariableEdit] = []
    for number, pose in poses.items():
        edits += _pose_edits(
            "$POSREG", _stored_register(backup, group, number, cartesian=True), pose, REGISTERS
        )
    for number, angles in joints.items():
        position = _stored_register(backup, group, number, cartesian=False)
        for axis, angle in enumerate(angles, 1):
            spot, unit = position.numbers[f"J{axis}"], position.units[f"J{axis}"]
            new = _field_text(position, f"J{axis}", angle * 1e3 if unit == "mm" else float(np.degrees(angle)))
            if float(new) != float(spot.text):
                variable = f"{position.path}.J{axis}"
                edits.append(VariableEdit(_MENU["$POSREG"], variable, spot.text, new, unit, REGISTERS, spot))
    return tuple(edits)


def _stored_register(backup: FanucBackup, group: int, number: int, *, cartesian: bool) -> VaPosition:
    position = backup.registers.get((group, number))
    if position is None or not position.is_initialised or position.is_cartesian != cartesian:
        raise ProgramFileError(
            REGISTERS,
            make_message(
                "PR[{number}] of group {group} is not in the backup as a {detail}.",
                number=number,
                group=group,
                detail="pose" if cartesian else "posture",
            ),
            remedy="Record it on the pendant, and save the backup again.",
        )
    return position


def count_edits(backup: FanucBackup, group: int, counts_at_zero: Sequence[int]) -> tuple[VariableEdit, ...]:
    """Return what to type for other counts at zero; equal ones are left out.

    Raises
    ------
    ProgramFileError
        The backup holds no mastering of this group, other axes, or a count is beyond 32 bits.
    """
    group_mastering = backup.mastering.get(group)
    if group_mastering is None or len(group_mastering.spots) != len(counts_at_zero):
        axes = 0 if group_mastering is None else len(group_mastering.spots)
        raise ProgramFileError(
            MASTERING,
            make_message(
                "group {group} has {axes} axes in the backup; {counts_at_zero_count} counts are given.",
                group=group,
                axes=axes,
                counts_at_zero_count=len(counts_at_zero),
            ),
            remedy=make_message(
                "Take the backup of this robot, with {mastering} and {drives}.",
                mastering=MASTERING,
                drives=DRIVES,
            ),
        )
    edits = []
    for axis, (spot, count) in enumerate(zip(group_mastering.spots, counts_at_zero, strict=True), 1):
        if not -(2**31) <= count < 2**31:
            raise ProgramFileError(
                MASTERING,
                make_message("{count} counts are beyond 32 bits.", count=count),
                line=spot.line,
                remedy="Check the counts.",
            )
        if int(count) != int(spot.text):
            variable = f"$DMR_GRP[{group}].$MASTER_COUN[{axis}]"
            edits.append(
                VariableEdit(_MENU["$DMR_GRP"], variable, spot.text, str(int(count)), "", MASTERING, spot)
            )
    return tuple(edits)


def changed_files(backup: FanucBackup, edits: Sequence[VariableEdit]) -> dict[str, bytes]:
    """Return the files that the edits touch, by upper-case name, with the new numbers in place."""
    found = {}
    for name in sorted({edit.file for edit in edits}):
        places = {edit.spot: edit.new for edit in edits if edit.file == name}
        found[name] = backup.files[name].replace_values(places)
    return found


def edit_instructions(edits: Sequence[VariableEdit]) -> tuple[str, ...]:
    """Return a numbered list for the operator, with what makes new counts effective at its end."""
    groups = sorted(
        {edit.variable.split("[")[1][0] for edit in edits if edit.variable.startswith("$DMR_GRP")}
    )
    ends = [step.format(group=group) for group in groups for step in AFTER_COUNTS]
    return tuple(f"{number}. {line}" for number, line in enumerate([*map(str, edits), *ends], 1))


def _pose_edits(name: str, position: VaPosition, pose: Pose, file: str = FRAMES) -> list[VariableEdit]:
    angles = np.degrees(values_from("fanuc_wpr", pose.rotation_matrix()))
    values = dict(zip("XYZ", (1e3 * value for value in pose.position_m), strict=True))
    if not _is_same_attitude(position, pose):
        values |= dict(zip("WPR", map(float, angles), strict=True))
    edits = []
    for field, value in values.items():
        spot = position.numbers[field]
        new = _field_text(position, field, value)
        if float(new) != float(spot.text):
            unit, variable = "mm" if field in "XYZ" else "deg", f"{position.path}.{field}"
            edits.append(VariableEdit(_MENU[name], variable, spot.text, new, unit, file, spot))
    return edits


def _is_same_attitude(position: VaPosition, pose: Pose) -> bool:
    """Return whether the old angles say the new attitude already; near P = 90 many angles say the same."""
    old = position.to_pose()
    if old is None:
        return False
    step = max(NumberFormat.from_text(position.numbers[field].text).unit_step for field in "WPR")
    apart = np.linalg.norm(old.rotation_matrix() - pose.rotation_matrix()) / np.sqrt(2.0)
    return bool(apart < 0.5 * np.radians(step))


def _field_text(position: VaPosition, field: str, value: float) -> str:
    """Write a number as the controller does: ``0.000``, ``-.182``, ``884.000``."""
    spot = position.numbers[field]
    if not abs(value) <= _LARGEST_MM:
        raise ProgramFileError(
            position.file,
            make_message(
                "{path}.{field} cannot be {value:.3f}: the field holds {largest_mm:.0f} at most.",
                path=position.path,
                field=field,
                value=value,
                largest_mm=_LARGEST_MM,
            ),
            line=spot.line,
            remedy="Check the pose; its lengths are metres.",
        )
    decimals = NumberFormat.from_text(spot.text).decimals
    text = f"{round(value, decimals) + 0.0:.{decimals}f}"
    whole, point, fraction = text.partition(".")
    return f"{whole[:-1]}{point}{fraction}" if whole in ("0", "-0") and float(text) != 0 else text
