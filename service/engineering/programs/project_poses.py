"""What a project file writes in millimetres and degrees: poses, and numbers for each axis."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Self

import numpy as np
from pydantic import model_validator

from cellcal.calibration.errors import CalibrationError, CellError
from cellcal.calibration.geometry import Array, homogeneous_matrix
from cellcal.calibration.message import make_message
from cellcal.calibration.orientation import CONVENTIONS, rotation_from
from cellcal.service.engineering.programs.checked_table import (
    CheckedTable,
    NonNegative,
    Quadruple,
    Triple,
    refuse_value,
)


@dataclass(frozen=True, eq=False)
class ProjectTool:
    """A tool as the controller has it, and as it really is."""

    entered: Array  # (4, 4) flange_tip in the controller
    real: Array  # (4, 4), the same where it was not measured
    sigma_m: float = 0.0  # of one coordinate of the real tip
    measured: bool = False


class ProjectError(CellError):
    """A project file cannot be used; the user can mend it."""

    code = "usage"


def axis_numbers(values: Sequence[float], key: str, count: int, where: str) -> Array:
    """Return the numbers (count,) that a project writes for the axes of its robot.

    Raises
    ------
    ProjectError
        Not as many as there are axes.
    """
    if len(values) != count:
        raise ProjectError(
            make_message(
                "{where}: {key} is a list of {count} finite numbers, not of {length}.",
                where=where,
                key=key,
                count=count,
                length=len(values),
            ),
            remedy="Write one number for each axis of the robot.",
        )
    return np.asarray(values, dtype=float)


class OrientationTable(CheckedTable):
    """At most one orientation, by the name of its convention in `calibration.orientation` and its unit."""

    fanuc_wpr_deg: Triple | None = None
    ur_rotation_vector_rad: Triple | None = None
    ur_rpy_deg: Triple | None = None
    abb_quaternion: Quadruple | None = None
    abb_euler_zyx_deg: Triple | None = None
    kuka_abc_deg: Triple | None = None
    yaskawa_rpy_deg: Triple | None = None
    staubli_rxryrz_deg: Triple | None = None
    kawasaki_oat_deg: Triple | None = None
    comau_zyz_deg: Triple | None = None
    mitsubishi_abc_deg: Triple | None = None
    denso_rpy_deg: Triple | None = None
    epson_uvw_deg: Triple | None = None
    doosan_zyz_deg: Triple | None = None
    ros_rpy_deg: Triple | None = None
    ros_quaternion: Quadruple | None = None
    instrument_xyz_deg: Triple | None = None
    instrument_zyx_deg: Triple | None = None

    @model_validator(mode="after")
    def _has_one_orientation(self) -> Self:
        keys = self.orientation_keys
        if len(keys) > 1:
            refuse_value(make_message("one orientation is enough: {keys}.", keys=", ".join(keys)))
        try:
            self.rotation()
        except CalibrationError as refused:
            refuse_value(
                make_message("{key}: {refused_message}", key=keys[0], refused_message=refused.message),
                refused.remedy,
            )
        return self

    @property
    def orientation_keys(self) -> tuple[str, ...]:
        """Return the keys of the orientations that are written."""
        return tuple(key for key in CONVENTION_KEYS if key in self.model_fields_set)

    def rotation(self) -> Array:
        """Return the rotation matrix (3, 3); without an orientation the axes are parallel.

        Raises
        ------
        CalibrationError
            A quaternion that is not of unit length.
        """
        for key in self.orientation_keys:
            values = np.asarray(getattr(self, key), dtype=float)
            return rotation_from(CONVENTION_KEYS[key], np.deg2rad(values) if key.endswith("_deg") else values)
        return np.eye(3)


class PoseTable(OrientationTable):
    """A pose: a place and an orientation. An empty table leaves it to the controller's backup."""

    position_mm: Triple | None = None

    @model_validator(mode="after")
    def _has_a_position(self) -> Self:
        if not self.is_empty and self.position_mm is None:
            refuse_value(make_message("{name} is missing.", name="position_mm"))
        return self


class MeasuredPoseTable(PoseTable):
    """A pose as it was measured."""

    sigma_mm: NonNegative | None = None  # of one coordinate


def pose_of(table: PoseTable, where: str) -> Array:
    """Return (4, 4) of a pose.

    Raises
    ------
    ProjectError
        An empty table.
    """
    if table.position_mm is None:
        raise ProjectError(make_message("{where}: {name} is missing.", where=where, name="position_mm"))
    return homogeneous_matrix(table.rotation(), np.asarray(table.position_mm) / 1e3)


def _convention_key(convention: str) -> str:
    if convention.endswith("quaternion"):
        return convention
    return f"{convention}_rad" if convention.endswith("vector") else f"{convention}_deg"


CONVENTION_KEYS = {_convention_key(name): name for name in CONVENTIONS}
