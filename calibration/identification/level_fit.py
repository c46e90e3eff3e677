"""One level of an arm's parameters, fitted robustly: which joint terms it has, and its fit."""

from dataclasses import dataclass

import numpy as np

from cellcal.calibration.arm.joint_terms import (
    JointTerm,
    gear_terms,
    gravity_terms,
    harmonic_terms,
    wrist_gravity_terms,
)
from cellcal.calibration.arm.kinematics import RobotModel
from cellcal.calibration.geometry import Array
from cellcal.calibration.identification.earlier_posterior import EarlierPosterior, decorrelate_layout
from cellcal.calibration.identification.estimator import FitProblem
from cellcal.calibration.identification.free_parameters import (
    RIPPLE_ORDERS,
    PartLayout,
    StartingPoint,
    prepare_fit,
)
from cellcal.calibration.identification.layouts import make_layout, with_further
from cellcal.calibration.identification.observations import Observations
from cellcal.calibration.identification.parameters import (
    GEAR,
    GEOMETRY,
    GRAVITY,
    RIPPLE,
    ArmState,
    ParameterLayout,
    Priors,
)
from cellcal.calibration.identification.robust import RobustFit, fit_robustly

_DISTINCT_ANGLES = 20  # of a joint, before its ripple or gear ratio may be asked for
_DISTINCT_PLACES = 3  # of a joint that slides, before its scale may be asked for
_ANGLES_PER_PERIOD = 5  # distinct ones, or a wave is read into gaps
_ROWS_FOR_SHORT_WAVES = 150
_ANGLE_STEP_RAD = 2e-3


def terms_of_level(model: RobotModel, joints_rad: Array, level: int) -> tuple[JointTerm, ...]:
    """Return the joint terms that a level has; a joint's ripple and gear ratio need twenty distinct angles.

    Fewer rows than 150 carry one and two waves a turn of each joint, no shorter ones. The scale of a joint that
    slides is geometry: a rack or belt is off by more than tooth counts are, and no wave passes for it.
    """
    if level < GEOMETRY:
        return ()
    distinct = [len(np.unique(np.round(angle / _ANGLE_STEP_RAD))) for angle in joints_rad.T]
    slides = np.zeros(model.axis_count, dtype=bool) if model.sliding is None else model.sliding
    ratios = gear_terms(model)
    scales = [term for term in ratios if slides[term.source] and distinct[term.source] >= _DISTINCT_PLACES]
    if level < GRAVITY:
        return tuple(scales)
    sag = (*scales, *gravity_terms(model))
    if level < RIPPLE:
        return sag
    orders = RIPPLE_ORDERS if len(joints_rad) >= _ROWS_FOR_SHORT_WAVES else RIPPLE_ORDERS[:2]
    ripple = (
        term
        for term in harmonic_terms(model, orders)
        if distinct[term.joint] >= max(_DISTINCT_ANGLES, _ANGLES_PER_PERIOD * term.order)
    )
    terms = (*sag, *wrist_gravity_terms(model), *ripple)
    if level < GEAR:
        return terms
    # After ripple: without it a ratio passes for the long waves of a gear, and is believed wrongly.
    turning = (term for term in ratios if not slides[term.source])
    return (*terms, *(term for term in turning if distinct[term.source] >= _DISTINCT_ANGLES))


@dataclass(frozen=True, slots=True)
class LevelTask:
    """The inputs of the fit of a level."""

    model: RobotModel
    places: ArmState  # of devices and tool, as any state of the same arm has them
    level: int
    priors: Priors
    start: StartingPoint

    def prepare(self, observations: Observations) -> tuple[ParameterLayout, ArmState]:
        """Return the unknowns that these rows carry, and the state at which their fit starts."""
        places, priors, start = self.places, self.priors, self.start
        terms = terms_of_level(self.model, observations.joints_rad, self.level)
        layout = make_layout(
            self.model, observations.kind, len(places.devices), level=self.level, terms=terms, priors=priors
        )
        layout = with_further(layout, len(places.further), priors)
        layout, state = prepare_fit(layout, terms, self.model, places, start, priors)
        if start.covariance is not None and not start.free and isinstance(layout, PartLayout):
            layout = decorrelate_layout(layout, EarlierPosterior(start.names, start.covariance))
        return layout, state

    def fit(self, observations: Observations) -> RobustFit:
        """Fit the level robustly."""
        layout, state = self.prepare(observations)
        return fit_robustly(layout, state, FitProblem.from_observations(state, observations))


def fit_level(
    model: RobotModel,
    observations: Observations,
    places: ArmState,
    level: int,
    priors: Priors,
    start: StartingPoint | None = None,
) -> RobustFit:
    """Fit one level robustly, from the places of devices and tool that any state of the same arm has."""
    return LevelTask(model, places, level, priors, start or StartingPoint()).fit(observations)
