"""A joint that slides, described as one that turns, or the other way: the same rows with that joint so."""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from cellcal.calibration.arm.joint_kinds import PRISMATIC, REVOLUTE, rotations_about_z
from cellcal.calibration.arm.kinematics import RobotModel
from cellcal.calibration.errors import DegenerateDataError
from cellcal.calibration.geometry import Array
from cellcal.calibration.identification.column_options import columns_option
from cellcal.calibration.identification.misfit_hypotheses import (
    FileNames,
    JointInterpretation,
)
from cellcal.calibration.identification.observations import LengthObservations, Observations
from cellcal.calibration.message import make_message

_DEGREES = float(np.degrees(1.0))
_LENGTHS = (("m", 1.0), ("mm", 1e-3))
_LONGEST_M = 100.0
_STRAIGHT = 0.005  # of the length of a line: what stands beside it
_MOST_TURNED_RAD = 4 * np.pi


def refuse_straight_line(model: RobotModel, observations: Observations) -> None:
    """Refuse places along a line where the arm moves along a line, too: no other cause is to be looked for.

    Raises
    ------
    DegenerateDataError
        With what such rows do tell.
    """
    if isinstance(observations, LengthObservations):
        return
    flange = model.tip_positions(observations.joints_rad, np.zeros(3))
    if not (_lie_on_line(flange) and _lie_on_line(observations.positions_m)):
        return
    raise DegenerateDataError(
        make_message(
            "only slides of {model_name} move in these rows, along one line: they leave open how the robot and its "
            "device are turned about it.",
            model_name=model.label,
        ),
        remedy="Record rows in which joints that turn move, too, at several places of the slide, with a model that "
        "holds both the slide and the arm on it.",
    )


def _lie_on_line(places_m: Array) -> bool:
    sizes = np.linalg.svd(places_m - places_m.mean(axis=0), compute_uv=False)
    return bool(sizes[0] > 0.0 and sizes[1] < _STRAIGHT * sizes[0])


def slide_readings(model: RobotModel, joints_rad: Array, names: FileNames) -> Iterator[JointInterpretation]:
    """Return, for each joint that turns, the rows as if it slid by the numbers of the file."""
    raw = {"deg": (_DEGREES,), "rad": (1.0,)}.get(names.angle_unit, (_DEGREES, 1.0))
    for joint in range(model.axis_count):
        if model.kinds[joint] == PRISMATIC:
            continue
        sliding = with_slide(model, joint)
        for number in raw:
            for unit, metres in _LENGTHS:
                moved = joints_rad.copy()
                moved[:, joint] *= number * metres
                if float(np.abs(moved[:, joint]).max()) > _LONGEST_M:
                    continue
                yield JointInterpretation(
                    "slide",
                    1,
                    moved,
                    make_message(
                        "{joint} slides, by {unit}, and does not turn", joint=names.joints[joint], unit=unit
                    ),
                    make_message(
                        "Describe joint {joint} as prismatic, with limits in metres (URDF) or millimetres (model "
                        "file).",
                        joint=model.joint_names[joint],
                    ),
                    model=sliding,
                )


def turn_readings(model: RobotModel, joints_rad: Array, names: FileNames) -> Iterator[JointInterpretation]:
    """Return, for each joint that slides, the rows as if it turned by the numbers of the file."""
    for joint in range(model.axis_count):
        if model.kinds[joint] != PRISMATIC:
            continue
        turning = with_turn(model, joint)
        for _, metres in _LENGTHS:
            for unit, angle in (("deg", 1.0 / _DEGREES), ("rad", 1.0)):
                moved = joints_rad.copy()
                moved[:, joint] *= angle / metres
                if float(np.abs(moved[:, joint]).max()) > _MOST_TURNED_RAD:
                    continue
                yield JointInterpretation(
                    "turn",
                    1,
                    moved,
                    make_message(
                        "{joint} turns, by {unit}, and does not slide", joint=names.joints[joint], unit=unit
                    ),
                    make_message(
                        "Describe joint {joint} as revolute, with limits in radians (URDF) or degrees (model file).",
                        joint=model.joint_names[joint],
                    ),
                    model=turning,
                )


def moved_slide_readings(
    model: RobotModel, joints_rad: Array, names: FileNames
) -> Iterator[JointInterpretation]:
    """Return the rows as if the one slide at one end of the chain stood at the other end of the file."""
    slides = np.flatnonzero([kind == PRISMATIC for kind in model.kinds]).tolist()
    last = model.axis_count - 1
    if slides not in ([0], [last]):
        return
    order = [last, *range(last)] if slides == [0] else [*range(1, last + 1), 0]
    number = _DEGREES if names.angle_unit in ("", "deg") else 1.0
    columns = [names.joints[at] for at in order]
    for taken in (1.0, 1e3):  # slides as m, or as mm
        moved = joints_rad[:, order].copy()
        # What was taken as an angle is a length, and the other way.
        turning = order.index(slides[0])
        moved[:, turning] *= taken / number
        for unit, metres in _LENGTHS:
            if float(np.ptp(moved[:, slides[0]])) * number * metres > _LONGEST_M:
                continue
            yield JointInterpretation(
                "order",
                1,
                np.where(np.arange(last + 1) == slides[0], moved * number * metres, moved),
                make_message(
                    "the columns of the joints are in another order: {columns}", columns=", ".join(columns)
                ),
                make_message(
                    "Name them in this order: {columns_option}.",
                    columns_option=f"{columns_option('joints', names.as_typed(columns))} `--units slides={unit}`",
                ),
                model=model,
            )


def with_turn(model: RobotModel, joint: int) -> RobotModel:
    """Return a model one of whose joints turns about the axis along which it slid."""
    kinds = tuple(REVOLUTE if i == joint else kind for i, kind in enumerate(model.kinds))
    lower, upper = model.lower_rad.copy(), model.upper_rad.copy()
    lower[joint], upper[joint] = -_MOST_TURNED_RAD, _MOST_TURNED_RAD
    return replace(model, dh=None, joint_types=kinds, lower_rad=lower, upper_rad=upper, combined_limits=())


def with_slide(model: RobotModel, joint: int) -> RobotModel:
    """Return a model one of whose joints slides along the axis about which it turned."""
    placements, zeros = model.placements.copy(), model.theta0_rad.copy()
    placements[joint] = placements[joint] @ rotations_about_z(zeros[joint : joint + 1])[0]
    zeros[joint] = 0.0
    kinds = tuple(PRISMATIC if i == joint else kind for i, kind in enumerate(model.kinds))
    lower, upper = model.lower_rad.copy(), model.upper_rad.copy()
    lower[joint], upper[joint] = -_LONGEST_M, _LONGEST_M
    return replace(
        model,
        dh=None,
        placements=placements,
        theta0_rad=zeros,
        joint_types=kinds,
        lower_rad=lower,
        upper_rad=upper,
        combined_limits=(),
    )
