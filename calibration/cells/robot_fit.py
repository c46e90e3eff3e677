"""One arm of a fitted cell, as if it had been fitted alone: for tables, acceptance, descriptions and sets."""

import numpy as np

from cellcal.calibration.cells.estimate import CellFit
from cellcal.calibration.errors import CalibrationError
from cellcal.calibration.identification.estimator import ArmFit
from cellcal.calibration.identification.free_parameters import PLACE_ROLES, PartLayout
from cellcal.calibration.identification.layouts import make_layout
from cellcal.calibration.identification.observations import DevicePlacement
from cellcal.calibration.identification.parameters import GEOMETRY, ArmState
from cellcal.calibration.message import make_message


def fit_of_robot(fit: CellFit, robot: str) -> ArmFit:
    """Return a robot's arm with its share of the cell's covariance: what all series together leave of it.

    Base, tool and devices are left out: `calibration.cells.prediction` tells them.

    Raises
    ------
    CalibrationError
        The cell has no such robot.
    """
    names = [each.name for each in fit.layout.frames.cell.robots]
    if robot not in names:
        raise CalibrationError(
            make_message("the cell has no robot {robot!r}.", robot=robot),
            remedy=make_message("It has {names}.", names=", ".join(names)),
        )
    arm = fit.state.arms[names.index(robot)]
    state = ArmState(
        arm.nominal,
        arm.geometry,
        arm.terms,
        arm.coefficients,
        np.eye(4),
        (DevicePlacement(np.eye(4), np.zeros(3)),),
    )
    whole = make_layout(arm.nominal, "point", 1, level=GEOMETRY, terms=arm.terms)
    mark = f"{robot} " if len(names) > 1 else ""
    at = {parameter.name: i for i, parameter in enumerate(fit.layout.parameters)}
    free = [
        i for i, p in enumerate(whole.parameters) if p.role not in PLACE_ROLES and f"{mark}{p.name}" in at
    ]
    rows = [at[f"{mark}{whole.parameters[i].name}"] for i in free]
    numbers = np.array(free, dtype=np.intp)
    layout = PartLayout(
        tuple(whole.parameters[i] for i in free),
        whole.kind,
        whole.mountings,
        whole.geometry,
        whole.terms,
        whole=whole,
        free=numbers,
        means=whole.prior_deviations(state)[numbers] - fit.deviations[rows],
    )
    return ArmFit(
        state, layout, fit.covariance[np.ix_(rows, rows)], fit.deviations[rows], fit.cost, fit.iterations
    )
