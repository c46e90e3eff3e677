"""Position registers of a backup as positions of a program: what is carried like one, and written back."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from cellcal.calibration.geometry import Array, Pose
from cellcal.calibration.message import make_message
from cellcal.drivers.fanuc.program_files.va_backup import REGISTERS, FanucBackup, with_registers
from cellcal.drivers.fanuc.program_files.va_edits import VariableEdit, changed_files, register_edits
from cellcal.drivers.fanuc.program_files.va_positions import VaPosition
from cellcal.drivers.programs.errors import ProgramFileError
from cellcal.drivers.programs.positions import (
    CARTESIAN,
    JOINTS,
    PositionChange,
    Positions,
    ProgramFrames,
    Remark,
)

GROUP = 1  # of the robot
_STEP_M, _STEP_RAD = 1e-6, np.radians(1e-3)  # as the file is printed


@dataclass(frozen=True, slots=True)
class RegisterPlace:
    """A register that motions go to, with the frame and the tool in force there."""

    number: int
    user_frame: str | None
    tool: str | None


@dataclass(frozen=True, eq=False)
class RegisterPlaces:
    """Some registers of group 1, each with a position in the backup; ``drivers.programs.positions.ProgramFile``."""

    backup: FanucBackup
    places: tuple[RegisterPlace, ...]
    brand: str = "fanuc"
    name: str = "POSREG"
    remarks: tuple[Remark, ...] = ()

    @property
    def frames(self) -> ProgramFrames:
        """Return nothing: frames are the controller's."""
        return ProgramFrames()

    def to_bytes(self) -> bytes:
        """Return POSREG.VA."""
        return self.backup.files[REGISTERS].data

    @cached_property
    def positions(self) -> Positions:
        """Return the registers in the order of their numbers."""
        register_positions = [self.backup.registers[GROUP, place.number] for place in self.places]
        count = len(register_positions)
        return Positions(
            names=tuple(f"PR[{place.number}]" for place in self.places),
            kinds=tuple(CARTESIAN if each.is_cartesian else JOINTS for each in register_positions),
            lines=np.array([each.line for each in register_positions], dtype=np.int64),
            groups=np.ones(count, dtype=np.int64),
            frame_tip=np.array([_pose_matrix(each) for each in register_positions]).reshape(count, 4, 4),
            joints=_padded_table([each.to_joints() or () for each in register_positions]),
            external=_padded_table([each.external_axes() for each in register_positions]),
            user_frames=tuple(place.user_frame for place in self.places),
            tools=tuple(place.tool for place in self.places),
            configurations=tuple(each.configuration for each in register_positions),
            resolution_m=np.full(count, _STEP_M),
            resolution_rad=np.full(count, _STEP_RAD),
        )

    def with_changes(self, change: PositionChange) -> "RegisterPlaces":
        """Return the registers with new coordinates.

        Raises
        ------
        ProgramFileError
            Another configuration, or a number that does not fit its field.
        """
        rows = np.asarray(change.rows).tolist()
        for row, text in zip(rows, change.configurations or (), strict=False):
            if text != self.positions.configurations[row]:
                raise ProgramFileError(
                    REGISTERS,
                    make_message(
                        "PR[{places_number}] would need the configuration {text}.",
                        places_number=self.places[row].number,
                        text=text,
                    ),
                    line=int(self.positions.lines[row]),
                    remedy="Teach this register on the pendant.",
                )
        edits = self.edits_for(self.backup, rows, change.frame_tip, change.joints)
        if not edits:
            return self
        data = changed_files(self.backup, edits)[REGISTERS]
        return RegisterPlaces(with_registers(self.backup, data), self.places)

    def edits_for(
        self, backup: FanucBackup, rows: Sequence[int], frame_tip: Array | None, joints: Array | None
    ) -> tuple[VariableEdit, ...]:
        """Return what to type into a controller, this one or another, for new coordinates of some rows.

        Raises
        ------
        ProgramFileError
            Its backup holds no such register in this form, or a number does not fit.
        """
        numbers = [self.places[row].number for row in rows]
        kinds = [self.positions.kinds[row] for row in rows]
        poses = {} if frame_tip is None else dict(zip(numbers, frame_tip, strict=True))
        postures = {} if joints is None else dict(zip(numbers, joints, strict=True))
        return register_edits(
            backup,
            GROUP,
            poses={
                n: Pose.from_matrix(poses[n]) for n, k in zip(numbers, kinds, strict=True) if k == CARTESIAN
            },
            joints={n: postures[n].tolist() for n, k in zip(numbers, kinds, strict=True) if k == JOINTS},
        )


def _pose_matrix(position: VaPosition) -> Array:
    found = position.to_pose()
    return np.full((4, 4), np.nan) if found is None else found.to_matrix()


def _padded_table(rows: Sequence[Sequence[float]]) -> Array:
    width = max(map(len, rows), default=0)
    return np.array([[*row, *[np.nan] * (width - len(row))] for row in rows]).reshape(len(rows), width)
