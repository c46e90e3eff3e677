"""What is checked of new points of arms that have not six turning joints."""

from collections.abc import Callable

import numpy as np

from cellcal.calibration.arm.model_references import is_linkage
from cellcal.calibration.geometry import Array
from cellcal.calibration.message import make_message
from cellcal.calibration.programs.scara import elbow_side
from cellcal.calibration.programs.transfer_other_arms import OtherArm
from cellcal.service.engineering.programs.program_points import ProgramPoints, Rows
from cellcal.service.engineering.programs.project import Project
from cellcal.service.engineering.programs.project_poses import ProjectError

_SHOWN_RAD = 1e-5
_STRETCHED = 1e-3  # sine of an elbow that is on neither side
CHANGE_LEANS = (
    "the change would turn it by {lean_deg:.2f} deg more than an arm of {joints} joints can follow; "
    "largest_tilt_deg under [robot] allows {most_deg:g} deg"
)
OWN_LEAN = (
    "up to {lean_deg:.3f} deg of the orientation stay uncorrected: an arm of {joints} joints cannot turn so"
)
RODS = (
    "rods drive axis 3 of {model_name}: what they are off by changes with the posture, is in no parameter and stays "
    "uncorrected; {setting} counts it"
)
ELBOW = "the elbow would change its side"
BORDER = (
    "joint {joint} would pass a border that its configuration {text} names in a way that is not known for an arm of "
    "{joints} joints"
)


def refuse_another_kind(source: Project, target: Project) -> None:
    """Refuse to bring points from one robot to another with joints of another number or kind.

    Raises
    ------
    ProjectError
        With both numbers.
    """
    if source.nominal.kinds != target.nominal.kinds and None in (source.other_arm, target.other_arm):
        raise ProjectError(
            make_message(
                "{source_name} has {source_joints} joints and {target_name} has {target_joints}, or of another kind: "
                "points of one are no points of the other.",
                source_name=source.name,
                source_joints=source.nominal.axis_count,
                target_name=target.name,
                target_joints=target.nominal.axis_count,
            ),
            remedy="Clone between robots whose joints are of the same number and kind.",
        )


def rods_left_out(source: Project, target: Project) -> list[str]:
    """Return what is said of identified arms of which rods drive an axis: no parameter holds the errors of these."""
    found = {
        one.nominal.label: one.held_out_setting
        for one in (source, target)
        if one.identified is not None and is_linkage(one.nominal.name)
    }
    return [make_message(RODS, model_name=name, setting=setting) for name, setting in found.items()]


def own_leans(points: ProgramPoints, left_rad: Array) -> list[str]:
    """Return what is said of arms whose own errors turn the tool in a way that their joints cannot correct."""
    changed = np.array([not reason for reason in points.reasons], dtype=bool) & np.isfinite(left_rad)
    most = float(left_rad[changed].max(initial=0.0))
    if most < _SHOWN_RAD:
        return []
    return [make_message(OWN_LEAN, joints=points.joints.shape[1], lean_deg=float(np.degrees(most)))]


def check_tilts(points: ProgramPoints, rows: Rows, tilt_rad: Array, cell: Project) -> None:
    """Leave points that the change turns in a way that the arm cannot follow."""
    most_rad, joints = cell.largest_tilt_rad, cell.nominal.axis_count
    too_much = tilt_rad > most_rad
    lean = dict(zip(rows[too_much].tolist(), np.degrees(tilt_rad[too_much]).tolist(), strict=True))
    points.refuse_points(
        rows[too_much],
        lambda i: make_message(
            CHANGE_LEANS, lean_deg=lean[i], joints=joints, most_deg=float(np.degrees(most_rad))
        ),
    )


def check_postures(points: ProgramPoints, rows: Rows, before: Array, after: Array, arm: OtherArm) -> None:
    """Leave points whose elbow would change its side, or that pass a border of an uninterpreted configuration."""
    if arm.scara is not None:
        sides = elbow_side(arm.scara, before), elbow_side(arm.scara, after)
        other = (sides[0] * sides[1] < 0) & (np.abs(sides[0]) > _STRETCHED)
        points.refuse_points(rows[other], ELBOW)
    _check_borders(points, rows, before, after, arm)


def _check_borders(points: ProgramPoints, rows: Rows, before: Array, after: Array, arm: OtherArm) -> None:
    for i, row in enumerate(rows.tolist()):
        text = points.texts[row]
        sort = _SORTS.get(points.programs[int(points.of[row])].brand)
        if not text or sort is None:
            continue
        passed = np.flatnonzero((sort(before[i]) != sort(after[i])) & arm.turning)
        if len(passed):
            why = make_message(BORDER, joint=int(passed[0]) + 1, text=text, joints=len(before[i]))
            points.refuse_points(rows[[i]], why)


def _whole_turns(joints: Array) -> Array:
    return np.asarray(np.floor((joints + np.pi) / (2 * np.pi)))


def _quadrants(joints: Array) -> Array:
    return np.asarray(np.floor(joints / (0.5 * np.pi)))


def _signs(joints: Array) -> Array:
    return np.asarray(joints < 0.0)


def _beyond_half_turns(joints: Array) -> Array:
    return np.asarray(np.abs(joints) >= np.pi)


# What configurations of six-axis arms are counted in, by brand: a number of one of these may stand in the text.
_SORTS: dict[str, Callable[[Array], Array]] = {
    "fanuc": _whole_turns,
    "abb": _quadrants,
    "kuka": _signs,
    "yaskawa": _beyond_half_turns,
}
