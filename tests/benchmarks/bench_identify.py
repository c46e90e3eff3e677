"""How fast and how exactly an arm is identified, against the same estimator as a loop over Pinocchio.

A simulated UR10 seen by a tracker: DH errors of 0.4 mm, 0.03 deg and 0.15 deg (offsets), base and tool unknown,
noise 0.05 mm, position only; 27 parameters that such measurements can tell apart. All programs start from the same
guess, which counts as work, and ends with the same arm. The loop is timed twice:

plain   as one writes it: for each posture `forwardKinematics`, `updateFramePlacements` and
        `computeFrameKinematicRegressor`, rows onto a list; Gauss-Newton until no parameter moves by a micrometre
        or microradian: three passes
lean    nothing in the loop but these calls and copies into arrays, one product for all postures, and our own rule
        for the end, which knows beforehand that the second step is the last: two passes

All take turns, so that they see the same load of the machine; processor time counts, the least of each. Accuracy
is the tip error on 1000 noise-free check postures over many arms, next to what the Cramer-Rao bound allows. Prints
a table and, last, one JSON line.
"""

import argparse
import json
import os
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, astuple, dataclass, fields
from typing import TypeAlias

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # before numpy: a second BLAS thread only waits

import numpy as np
import pinocchio as pin

from cellcal.calibration.arm.kinematics import RobotModel
from cellcal.calibration.geometry import Array
from cellcal.calibration.identification.base_parameters import base_subset
from cellcal.calibration.identification.estimator import (
    ArmFit,
    FitProblem,
    errors_m,
    estimate_arm,
    is_settled,
    place_columns,
)
from cellcal.calibration.identification.first_guess import first_guess
from cellcal.calibration.identification.layouts import make_layout
from cellcal.calibration.identification.observations import PointObservations
from cellcal.calibration.identification.parameters import GEOMETRY, ArmState, ParameterLayout, Priors
from tests.unit.helpers.simulated_arm import random_joints, tracker_points

_LOOSE = Priors(offset_rad=0.1, length_m=0.1, angle_rad=0.1)  # the bound knows no prior
_SIGMA_M = 5e-5
_CHECK_ROWS = 1000
_UNMOVED = 1e-6  # m, rad

Ended: TypeAlias = Callable[[Array, Array, Array], bool]
Equations: TypeAlias = Callable[[ArmState, ParameterLayout, PointObservations], tuple[Array, Array]]


@dataclass(frozen=True, slots=True)
class BenchmarkRow:
    """One row of the table."""

    rows: int
    parameters: int
    batched_ms: float
    loop_ms: float
    lean_loop_ms: float
    ratio: float
    lean_ratio: float
    tip_rmse_mm: float
    cramer_rao_mm: float
    accuracy_ratio: float  # over all seeds


def measure_size(rows: int, *, repeats: int, seeds: int) -> BenchmarkRow:
    """Time one size, and average its accuracy over seeds."""
    simulated = tracker_points("ur10", rows, seed=11, sigma_m=_SIGMA_M)
    model, observations = simulated.model, simulated.observations
    layout = base_layout(model)
    batched, plain, lean = _fastest_times_s(
        [
            lambda: _identify_arm(model, layout, observations),
            lambda: _solve_by_loop(model, layout, observations, _plain_equations, _is_negligible),
            lambda: _solve_by_loop(model, layout, observations, _lean_equations, is_settled),
        ],
        repeats,
    )
    squares = np.array([squared_errors(rows, seed, layout) for seed in range(seeds)])
    actual, bound = np.sqrt(squares.mean(axis=0))
    return BenchmarkRow(
        rows=rows,
        parameters=len(layout),
        batched_ms=batched * 1e3,
        loop_ms=plain * 1e3,
        lean_loop_ms=lean * 1e3,
        ratio=plain / batched,
        lean_ratio=lean / batched,
        tip_rmse_mm=actual * 1e3,
        cramer_rao_mm=bound * 1e3,
        accuracy_ratio=actual / bound,
    )


def base_layout(model: RobotModel) -> ParameterLayout:
    """Return the 27 parameters that positions can tell apart."""
    probe = tracker_points("ur10", 200, seed=5).observations
    layout = make_layout(model, "point", 1, level=GEOMETRY, priors=_LOOSE)
    return base_subset(layout, first_guess(model, probe)[0], probe)


def _identify_arm(model: RobotModel, layout: ParameterLayout, observations: PointObservations) -> ArmFit:
    """Everything from joints and positions to parameters and covariance, the first guess included."""
    start = first_guess(model, observations)[0]
    return estimate_arm(layout, start, FitProblem.from_observations(start, observations), from_afar=True)


def squared_errors(rows: int, seed: int, layout: ParameterLayout) -> tuple[float, float]:
    """Return the mean squared tip error of one arm's fit at the check postures, and its Cramer-Rao bound [m^2]."""
    simulated = tracker_points("ur10", rows, seed=100 + seed, sigma_m=_SIGMA_M)
    fit = _identify_arm(simulated.model, layout, simulated.observations)
    joints = random_joints(simulated.model, np.random.default_rng(7), _CHECK_ROWS)
    truth = simulated.truth.seen_from(0).base_flange(joints)[:, :3, 3]
    check = PointObservations(joints, truth, np.ones(len(joints)), np.zeros(len(joints), dtype=np.intp))
    problem = FitProblem.from_observations(fit.state, check)
    columns, _ = place_columns(fit.layout, fit.state, problem)
    bound = np.einsum("pmn,pq,qmn->n", columns, fit.covariance, columns, optimize=True)
    return float(np.mean(errors_m(fit.state, problem) ** 2)), float(np.mean(bound))


def _fastest_times_s(contestants: Sequence[Callable[[], object]], repeats: int) -> list[float]:
    """Return the least processor time of each over several turns [s]: one thread's work, not its neighbours'."""
    least = [float("inf")] * len(contestants)
    for _ in range(repeats):
        for i, run in enumerate(contestants):
            run()  # the first after another's turn finds its memory cold
            started = time.thread_time()
            run()
            least[i] = min(least[i], time.thread_time() - started)
    return least


def _is_negligible(step: Array, spread: Array, prior: Array) -> bool:
    """Tell whether a step, in prior deviations, was too small to see: how one ends such a loop."""
    return bool(np.abs(step * prior).max() < _UNMOVED)


def _solve_by_loop(
    model: RobotModel,
    layout: ParameterLayout,
    observations: PointObservations,
    equations: Equations,
    ended: Ended,
) -> ArmState:
    """Solve the same problem from the same start to the same end, by full passes over the postures."""
    state = first_guess(model, observations)[0]
    inverse_prior = layout.prior_sigmas**-2.0
    for _ in range(10):
        information, gradient = equations(state, layout, observations)
        gradient = gradient - inverse_prior * layout.prior_deviations(state)
        covariance = np.linalg.inv(information + np.diag(inverse_prior))
        step = covariance @ gradient
        state = layout.apply_step(state, step)
        if ended(
            step / layout.prior_sigmas,
            np.sqrt(np.diag(covariance)) / layout.prior_sigmas,
            layout.prior_sigmas,
        ):
            break
    return state


def _plain_equations(
    state: ArmState, layout: ParameterLayout, observations: PointObservations
) -> tuple[Array, Array]:
    """Go through the postures as Pinocchio's own examples do: frames, regressor, rows onto a list."""
    _, twin, frame, angles = _pinocchio_twin(state, observations)
    data, tangent = twin.createData(), layout.tangent_rows(state, 0).T
    rows, residuals = [], []
    for angle, measured in zip(angles, observations.positions_m, strict=True):
        pin.forwardKinematics(twin, data, angle)
        pin.updateFramePlacements(twin, data)
        tip = data.oMf[frame]
        regressor = pin.computeFrameKinematicRegressor(twin, data, frame, pin.LOCAL_WORLD_ALIGNED)
        tool = np.hstack([tip.rotation, np.zeros((3, 3))])
        rows.append(np.hstack([regressor[:3], tool]) @ tangent)
        residuals.append(measured - tip.translation)
    design, residual = np.vstack(rows) / _SIGMA_M, np.concatenate(residuals) / _SIGMA_M
    return design.T @ design, design.T @ residual


def _lean_equations(
    state: ArmState, layout: ParameterLayout, observations: PointObservations
) -> tuple[Array, Array]:
    """Do nothing in the loop but call Pinocchio and copy what it says."""
    chain, twin, frame, angles = _pinocchio_twin(state, observations)
    data, count, joints = twin.createData(), len(observations), 6 * chain.axis_count
    design, residual = np.zeros((count, 3, joints + 6)), np.empty((count, 3))
    for i in range(count):
        pin.forwardKinematics(twin, data, angles[i])
        pin.updateFramePlacement(twin, data, frame)
        regressor = pin.computeFrameKinematicRegressor(twin, data, frame, pin.LOCAL_WORLD_ALIGNED)
        tip = data.oMf[frame]
        design[i, :, :joints] = regressor[:3]
        design[i, :, joints : joints + 3] = tip.rotation
        residual[i] = tip.translation
    residual = (observations.positions_m - residual).reshape(-1) / _SIGMA_M
    flat = design.reshape(3 * count, -1) @ layout.tangent_rows(state, 0).T / _SIGMA_M
    return flat.T @ flat, flat.T @ residual


def _pinocchio_twin(
    state: ArmState, observations: PointObservations
) -> tuple[RobotModel, pin.Model, int, Array]:
    chain = state.seen_from(0)
    twin, parent = pin.Model(), 0
    for name, placement in zip(chain.joint_names, chain.placements[:-1], strict=True):
        parent = twin.addJoint(parent, pin.JointModelRZ(), pin.SE3(np.array(placement)), name)
    tip = pin.SE3(np.array(chain.placements[-1]))
    frame = twin.addFrame(pin.Frame("tip", parent, tip, pin.FrameType.OP_FRAME))
    return chain, twin, frame, observations.joints_rad @ chain.joint_coupling.T + chain.theta0_rad


def compare_solutions(rows: int = 1000) -> float:
    """Return how far the loop's arm and ours are apart [m]: both solve the same problem, ours by fewer rows first."""
    simulated = tracker_points("ur10", rows, seed=11, sigma_m=_SIGMA_M)
    model, observations = simulated.model, simulated.observations
    layout = base_layout(model)
    ours = _identify_arm(model, layout, observations).state
    theirs = _solve_by_loop(model, layout, observations, _plain_equations, _is_negligible)
    joints = random_joints(model, np.random.default_rng(0), 50)
    apart = [state.seen_from(0).base_flange(joints)[:, :3, 3] for state in (ours, theirs)]
    return float(np.abs(apart[0] - apart[1]).max())


def main() -> None:
    """Print the table and the JSON line."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--rows", type=int, nargs="+", default=[100, 1000, 10000])
    parser.add_argument("--seeds", type=int, default=40)
    parser.add_argument("--repeats", type=int, default=15)
    options = parser.parse_args()
    print(f"the two solutions differ by {compare_solutions() * 1e9:.2f} nm")
    columns = [field.name for field in fields(BenchmarkRow)]
    print(" ".join(f"{name:>14}" for name in columns))
    found = [measure_size(rows, repeats=options.repeats, seeds=options.seeds) for rows in options.rows]
    for row in found:
        print(
            " ".join(
                f"{value:14.4g}" if isinstance(value, float) else f"{value:14d}" for value in astuple(row)
            )
        )
    print(json.dumps({"identify": [asdict(row) for row in found]}))


if __name__ == "__main__":
    main()
