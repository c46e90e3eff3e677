"""Two faults of the joints at once that no single reading has: an order or rows apart, and a sign or an order."""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from cellcal.calibration.arm.kinematics import RobotModel
from cellcal.calibration.identification.misfit_error import MisfitCause
from cellcal.calibration.identification.misfit_fit import fit_quickly
from cellcal.calibration.identification.misfit_hypotheses import (
    FileNames,
    JointInterpretation,
    lagging_readings,
    order_readings,
    sign_readings,
    turning_joints,
)
from cellcal.calibration.identification.misfit_joint_columns import fit_best_readings
from cellcal.calibration.identification.observations import Observations, PointObservations, Rows
from cellcal.calibration.message import join_messages, make_message

_MOST_FITTED = 4


def double_causes(
    model: RobotModel, series: Observations, rows: Rows, names: FileNames, limit_m: float
) -> tuple[MisfitCause, ...]:
    """Return the two faults with which the rows leave no more than the limit [m], and least."""
    some = series.select_rows(rows)
    if not isinstance(some, PointObservations) or not np.isfinite(limit_m):
        return ()
    readings = [
        *_signs_in_other_order(model, some, names),
        *_rows_apart_and_more(model, series, rows, names),
    ]
    return fit_best_readings(model, some, readings, fit_quickly, limit_m, most=_MOST_FITTED)


def _signs_in_other_order(
    model: RobotModel, some: PointObservations, names: FileNames
) -> Iterator[JointInterpretation]:
    """Return two joints that changed places, and one sign; the columns of the second cure say both."""
    for order in order_readings(some.joints_rad, names, turning_joints(model)):
        if order.parts > 1:
            continue
        positions = [names.as_typed(names.joints).index(column) for column in order.columns]
        ordered = replace(names, joints=tuple(names.joints[at] for at in positions))
        for sign in sign_readings(model, order.joints_rad, ordered, most=1):
            yield replace(sign, says=_both(order, sign))


def _rows_apart_and_more(
    model: RobotModel, series: Observations, rows: Rows, names: FileNames
) -> Iterator[JointInterpretation]:
    for apart in lagging_readings(series.joints_rad, rows):
        signs = sign_readings(model, apart.joints_rad, names, most=1)
        orders = order_readings(apart.joints_rad, names, turning_joints(model))
        for other in (*signs, *(order for order in orders if order.parts == 1)):
            yield replace(other, says=_both(apart, other), cure=join_messages(" ", (apart.cure, other.cure)))


def _both(first: JointInterpretation, second: JointInterpretation) -> str:
    return make_message("{says}, and {and_says}", says=first.says, and_says=second.says)
