"""cellcal itself, as one contestant among the others: through its public functions."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cellcal.calibration.arm.joint_terms import term_values
from cellcal.calibration.arm.kinematics import DhTable, RobotModel
from cellcal.calibration.compensation.compensate import compensate as solve
from cellcal.calibration.identification.base_parameters import base_subset
from cellcal.calibration.identification.estimator import FitProblem, estimate_arm
from cellcal.calibration.identification.first_guess import first_guess
from cellcal.calibration.identification.identify import identify_arm as choose_and_identify
from cellcal.calibration.identification.layouts import make_layout
from cellcal.calibration.identification.observations import PointObservations
from cellcal.calibration.identification.parameters import FRAMES, GEOMETRY, ParameterLayout, Priors
from cellcal.calibration.identification.selection import IdentificationOptions
from cellcal.calibration.poses.optimal_design import DesignTask, choose_blocks

_LOOSE = Priors(offset_rad=0.1, length_m=0.1, angle_rad=0.1)  # so that data decide, as for the peers


def compensate(inputs: Mapping[str, NDArray[np.float64]], measure: Any) -> dict[str, object]:
    """Compensate all postures: targets, damping, status and verification included."""
    real, nominal = _build_model(inputs["real_dh"]), _build_model(inputs["nominal_dh"])
    joints = inputs["joints"]
    seconds, done = measure(lambda: solve(real, nominal, joints))
    return {"joints": done.joints_rad, "seconds": seconds, "claimed": done.has_converged}


def identify(inputs: Mapping[str, NDArray[np.float64]], measure: Any) -> dict[str, object]:
    """Identify from joints and positions to parameters and covariance, the first guess included."""
    nominal = _build_model(inputs["nominal_dh"])
    observations = _point_observations(inputs["joints"], inputs["positions"], float(inputs["sigma_m"]))
    layout = _parameter_layout(
        nominal, _point_observations(inputs["check_joints"][:200], inputs["check_joints"][:200, :3], 1.0)
    )

    def run_identification() -> Any:
        start = first_guess(nominal, observations)[0]
        return estimate_arm(layout, start, FitProblem.from_observations(start, observations), from_afar=True)

    seconds, fit = measure(run_identification)
    places = fit.state.seen_from(0).base_flange(inputs["check_joints"])[:, :3, 3]
    return {"seconds": seconds, "check_positions": places, "parameters": len(layout)}


def identify_often(inputs: Mapping[str, NDArray[np.float64]], measure: Any) -> dict[str, object]:
    """Identify from many draws of the noise, for the mean square error at the check postures [m^2]."""
    nominal, sigma = _build_model(inputs["nominal_dh"]), float(inputs["sigma_m"])
    layout = _parameter_layout(
        nominal, _point_observations(inputs["check_joints"][:200], inputs["check_joints"][:200, :3], 1.0)
    )
    squares = []
    for draw in range(int(inputs["draws"])):
        noise = np.random.default_rng([int(inputs["seed"]), draw]).normal(
            scale=sigma, size=inputs["places"].shape
        )
        observations = _point_observations(inputs["joints"], inputs["places"] + noise, sigma)
        start = first_guess(nominal, observations)[0]
        fit = estimate_arm(layout, start, FitProblem.from_observations(start, observations), from_afar=True)
        places = fit.state.seen_from(0).base_flange(inputs["check_joints"])[:, :3, 3]
        squares.append(float(((places - inputs["check_places"]) ** 2).sum(axis=1).mean()))
    return {"squares": np.array(squares)}


def identify_before(inputs: Mapping[str, NDArray[np.float64]], measure: Any) -> dict[str, object]:
    """Fit base and tool to the nominal arm: what the others have to beat."""
    nominal = _build_model(inputs["nominal_dh"])
    observations = _point_observations(inputs["joints"], inputs["positions"], float(inputs["sigma_m"]))
    layout = make_layout(nominal, "point", 1, level=FRAMES)

    def run_identification() -> Any:
        start = first_guess(nominal, observations)[0]
        return estimate_arm(layout, start, FitProblem.from_observations(start, observations), from_afar=True)

    seconds, fit = measure(run_identification)
    places = fit.state.seen_from(0).base_flange(inputs["check_joints"])[:, :3, 3]
    return {"seconds": seconds, "check_positions": places, "parameters": len(layout), "level": FRAMES}


def identify_chosen(inputs: Mapping[str, NDArray[np.float64]], measure: Any) -> dict[str, object]:
    """Let the program choose the level by cross-validation over the rows given, robustly, with its own priors."""
    nominal = _build_model(inputs["nominal_dh"])
    observations = _point_observations(inputs["joints"], inputs["positions"], float(inputs["sigma_m"]))
    seconds, found = measure(
        lambda: choose_and_identify(nominal, observations, options=IdentificationOptions(judge=False))
    )
    state, check = found.state, inputs["check_joints"]
    joints = state.moved_joints(check, term_values(nominal, check, state.terms))
    places = state.seen_from(0).base_flange(joints)[:, :3, 3]
    unknowns = len(found.robust.fit.layout)
    return {"seconds": seconds, "check_positions": places, "parameters": unknowns, "level": found.level}


def poses(inputs: Mapping[str, NDArray[np.float64]], measure: Any) -> dict[str, object]:
    """Choose by block exchange from three starts."""
    blocks = np.ascontiguousarray(inputs["blocks"])
    task = DesignTask(blocks, 1e-9 * np.eye(len(blocks)))
    seconds, choice = measure(lambda: choose_blocks(task, int(inputs["chosen"]), starts=3))
    return {"seconds": seconds, "indices": np.array(choice.indices)}


def _parameter_layout(nominal: RobotModel, probe: PointObservations) -> ParameterLayout:
    """Return the parameters that positions can tell apart: 27 of a UR10."""
    layout = make_layout(nominal, "point", 1, level=GEOMETRY, priors=_LOOSE)
    return base_subset(layout, first_guess(nominal, probe)[0], probe)


def _point_observations(joints: Any, positions: Any, sigma_m: float) -> PointObservations:
    count = len(joints)
    return PointObservations(joints, positions, np.full(count, sigma_m), np.zeros(count, dtype=np.intp))


def _build_model(rows: Any) -> RobotModel:
    turn = np.full(len(rows), 2 * np.pi)
    return RobotModel.from_dh(DhTable.from_rows(rows), name="arm", lower_rad=-turn, upper_rad=turn)
