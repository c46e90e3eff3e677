"""What every new point is checked for before it is written: reach, limits, singularity, configuration, collision."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cellcal.calibration.arm.joint_kinds import beyond_limits, shown_units
from cellcal.calibration.arm.kinematics import RobotModel
from cellcal.calibration.errors import CalibrationError
from cellcal.calibration.geometry import Array
from cellcal.calibration.message import make_message
from cellcal.calibration.motion.collision import CollisionCheck, ShapeContact
from cellcal.calibration.programs.branches import AxesAtZero, branch_numbers
from cellcal.calibration.programs.transfer import TransferResult, smallest_sigma
from cellcal.drivers.programs.brands import ConfigurationRule, SharedConfigurations
from cellcal.service.engineering.programs.external.moving_axes import NO_AXES, CellAxes
from cellcal.service.engineering.programs.other_arm_checks import check_postures
from cellcal.service.engineering.programs.program_points import ProgramPoints, Rows
from cellcal.service.engineering.programs.project import Project

_ROUNDED_RAD = 1e-6
_FLIPPED_RAD = 0.5 * np.pi
_MOVED = 1e-9
_SHAPES_UNCHECKED = "shapes are not checked at points whose external axes are away from zero"


@dataclass(frozen=True, eq=False)
class TransferChecks:
    """Checks points of one cell; what fails is said in ``points.reasons``."""

    project: Project
    rule: ConfigurationRule | None
    collisions: CollisionCheck | None
    axes: CellAxes = NO_AXES  # external axes of the cell that the points come from

    @classmethod
    def for_project(
        cls, project: Project, rule: ConfigurationRule | None, axes: CellAxes = NO_AXES
    ) -> "TransferChecks":
        """Prepare the checks of a cell; without shapes there is none for collisions."""
        shapes = project.shapes
        check = None if shapes is None else CollisionCheck.from_model(project.controller, shapes)
        return cls(project, rule, check, axes)

    def check_points(
        self, points: ProgramPoints, rows: Rows, before_rad: Array, found: TransferResult
    ) -> None:
        """Say of each point why it must be left.

        Parameters
        ----------
        points : Points
            Their reasons are added to.
        rows : (K,)
            The points that were transferred.
        before_rad : (K, n)
            Their joints in the cell they come from.
        found : Transferred
            Where they would go.
        """
        points.refuse_points(
            rows[~found.reached],
            _row_reason(
                rows[~found.reached],
                found.left_m[~found.reached],
                "unreachable: the arm ends {found:.1f} mm away",
                1e3,
            ),
        )
        self._check_limits(points, rows, found.joints_rad)
        sigma = smallest_sigma(
            self.project.controller, found.joints_rad, self.project.smallest_sigma, self.project.held_joints
        )
        near = sigma < self.project.smallest_sigma
        reason = _row_reason(
            rows[near],
            sigma[near],
            "near a singularity: {found:.4f} m/rad, at least {least:g} is wanted",
            least=self.project.smallest_sigma,
        )
        points.refuse_points(rows[near], reason)
        other = self.project.other_arm
        if other is not None:
            check_postures(points, rows, before_rad, found.joints_rad, other)
        else:
            self._check_flips(points, rows, before_rad, found.joints_rad)
        self._check_configurations(points, rows, found.joints_rad)
        self._check_collisions(points, rows, found.joints_rad)

    def unchecked_shapes(self, points: ProgramPoints) -> list[str]:
        """Return what is said of a cell whose shapes are not checked while external axes are away from zero."""
        rows = np.arange(len(points), dtype=np.intp)
        if self.collisions is None or self._at_zero(points, rows).all():
            return []
        return [_SHAPES_UNCHECKED]

    def _at_zero(self, points: ProgramPoints, rows: Rows) -> NDArray[np.bool_]:
        """Return at which points no external axis has moved anything: shapes are stated there."""
        zeros = np.array([axis.entered.zero for axis in self.axes.axes])
        if not len(zeros):
            return np.ones(len(rows), dtype=bool)
        apart = np.abs(points.axis_values[rows] - zeros)
        found: NDArray[np.bool_] = ~(apart > _MOVED).any(axis=1)
        return found

    def _check_limits(self, points: ProgramPoints, rows: Rows, joints: Array) -> None:
        model = self.project.controller
        units = shown_units(model)[1]
        beyond = beyond_limits(model, joints)
        worst = np.argmax(beyond, axis=1)
        excess = beyond[np.arange(len(rows)), worst]
        over = excess > _ROUNDED_RAD
        reasons = {
            int(i): make_message(
                "joint {joint} would pass its limit by {by:.1f} deg", joint=joint + 1, by=np.degrees(by)
            )
            if joint < model.axis_count and units[joint] == "deg"
            else make_message(
                "joint {joint} would pass its limit by {by_mm:.1f} mm", joint=joint + 1, by_mm=by * 1e3
            )
            if joint < model.axis_count
            else _past_sum(model, int(joint) - model.axis_count, float(by))
            for i, joint, by in zip(rows[over], worst[over], excess[over], strict=True)
        }
        points.refuse_points(rows[over], reasons.__getitem__)

    def _check_flips(self, points: ProgramPoints, rows: Rows, before: Array, joints: Array) -> None:
        """Find arms that would reach the pose in another way, which a program of joints or poses does not name.

        A wrist that turns over moves joints 4 and 6 by half a turn each. Otherwise a joint goes far and a singularity
        is between: a large turn alone may be that of the change.
        """
        turned = np.abs(joints - before)
        flipped = (turned[:, 3] > _FLIPPED_RAD) & (turned[:, 5] > _FLIPPED_RAD)
        points.refuse_points(rows[flipped], "the wrist would flip")
        far = np.flatnonzero((turned > _FLIPPED_RAD).any(axis=1) & ~flipped & np.isfinite(joints).all(axis=1))
        if not len(far):
            return
        try:
            zero = AxesAtZero.from_model(self.project.nominal)
        except CalibrationError:
            return  # no other posture of such an arm is looked for
        apart = branch_numbers(zero, before[far]) != branch_numbers(zero, joints[far])
        reasons = {
            int(rows[i]): make_message(
                "the arm would change its posture: joint {joint} would turn by {by:.0f} deg",
                joint=int(np.argmax(turned[i])) + 1,
                by=float(np.degrees(turned[i].max())),
            )
            for i in far[apart].tolist()
        }
        points.refuse_points(rows[far[apart]], reasons.__getitem__)

    def _check_configurations(self, points: ProgramPoints, rows: Rows, joints: Array) -> None:
        if self.rule is None:
            return
        configured = [
            i for i in np.flatnonzero(points.cartesian[rows]).tolist() if points.texts[int(rows[i])]
        ]
        texts = [points.texts[int(rows[i])] for i in configured]
        same = self.rule.keeps_posture(self.project.controller, joints[configured], texts)
        other = [i for i, agrees in zip(configured, same.tolist(), strict=True) if not agrees]
        if other:
            old = [points.texts[int(rows[i])] for i in other]
            new = self.rule.write_configurations(self.project.controller, joints[other], old)
            reasons = {
                int(rows[i]): make_message(
                    "the wrist would flip or the arm change its posture: {a} would become {b}", a=a, b=b
                )
                for i, a, b in zip(other, old, new, strict=True)
            }
            points.refuse_points(rows[other], reasons.__getitem__)

    def _check_collisions(self, points: ProgramPoints, rows: Rows, joints: Array) -> None:
        if self.collisions is None:
            return
        at_zero = self._at_zero(points, rows)
        rows, joints = rows[at_zero], joints[at_zero]
        bad = np.flatnonzero(~self.collisions.is_free(joints))
        contacts = self.collisions.narrowest_contacts(joints[bad]) if len(bad) else ()
        reasons = {int(rows[i]): _describe_contact(contact) for i, contact in zip(bad, contacts, strict=True)}
        points.refuse_points(rows[bad], reasons.__getitem__)

    def new_configurations(self, points: ProgramPoints, rows: Rows, joints: Array) -> dict[int, str]:
        """Return the configurations that must be written anew, by point: turn numbers that are others now."""
        if self.rule is None:
            return {}
        configured = [
            i for i in np.flatnonzero(points.cartesian[rows]).tolist() if points.texts[int(rows[i])]
        ]
        texts = [points.texts[int(rows[i])] for i in configured]
        same = self.rule.matches_postures(self.project.controller, joints[configured], texts, turns=True)
        other = [i for i, agrees in zip(configured, same.tolist(), strict=True) if not agrees]
        if not other:
            return {}
        old = [points.texts[int(rows[i])] for i in other]
        new = self.rule.write_configurations(self.project.controller, joints[other], old)
        if isinstance(self.rule, SharedConfigurations):
            for i, before, after in zip(other, old, new, strict=True):
                points.refuse_points(rows[[i]], self.rule.refuses_change(before, after))
            return {}
        right = self.rule.matches_postures(self.project.controller, joints[other], new, turns=True)
        texts_by_row = {int(rows[i]): text for i, text in zip(other, new, strict=True)}
        wrong = [int(rows[i]) for i, agrees in zip(other, right.tolist(), strict=True) if not agrees]
        points.refuse_points(
            np.array(wrong, dtype=np.intp), "its configuration cannot be written in the file's spelling"
        )
        return {i: text for i, text in texts_by_row.items() if i not in wrong}


def _describe_contact(contact: ShapeContact) -> str:
    if contact.clearance_m <= 0:
        return make_message("collides: {first} and {second}", first=contact.first, second=contact.second)
    return make_message(
        "comes too close: {clearance_mm:.0f} mm between {first} and {second}",
        clearance_mm=contact.clearance_m * 1000.0,
        first=contact.first,
        second=contact.second,
    )


class _RowReason:
    def __init__(self, rows: Rows, values: Array, template: str, limits: Mapping[str, float]) -> None:
        self._by_row = dict(zip(rows.tolist(), values.tolist(), strict=True))
        self._template, self._limits = template, limits

    def __call__(self, row: int) -> str:
        return make_message(self._template, found=self._by_row[row], **self._limits)


def _row_reason(rows: Rows, values: Array, template: str, factor: float = 1.0, **limits: float) -> _RowReason:
    return _RowReason(rows, values * factor, template, limits)


def _past_sum(model: RobotModel, limit: int, by_rad: float) -> str:
    joints = model.combined_limits[limit].name
    return make_message(
        "joints {joints} together would pass their limit by {by_deg:.1f} deg",
        joints=joints,
        by_deg=np.degrees(by_rad),
    )
