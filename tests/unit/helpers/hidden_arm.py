"""A real arm of any kind behind a nominal one: hidden errors of every frame and zero, measured by a tracker."""

from dataclasses import dataclass

import numpy as np

from cellcal.calibration.arm.joint_kinds import PRISMATIC, beyond_limits, drawn_range
from cellcal.calibration.arm.kinematics import RobotModel, load_model
from cellcal.calibration.geometry import exp_rotation, homogeneous_matrix
from cellcal.calibration.identification.identify import IdentificationOptions, identify_arm
from cellcal.calibration.identification.observations import PointObservations
from cellcal.calibration.identification.reading_prediction import predict_readings

NOISE_M = 5e-5  # of a coordinate
_LENGTH_M, _ANGLE_RAD = 4e-4, 5e-4
_ZERO_RAD, _ZERO_M = 2e-3, 5e-4
_TIP_IN_FLANGE_M = np.array([0.05, 0.06, 0.12])


@dataclass(frozen=True, eq=False)
class HiddenArm:
    """One arm with its errors, its place in a tracker's frame, and the tracker's noise."""

    nominal: RobotModel
    seed: int = 1
    geometry: float = 1.0  # times the usual errors of frames

    def slides(self) -> np.ndarray:
        return np.array([kind == PRISMATIC for kind in self.nominal.kinds])

    def zeros(self) -> np.ndarray:
        """Return what is to be added to the joints shown (n,) [rad, m]."""
        drawn = np.random.default_rng([self.seed, 1]).normal(size=self.nominal.axis_count)
        return drawn * np.where(self.slides(), _ZERO_M, _ZERO_RAD)

    def tips(self, joints: np.ndarray) -> np.ndarray:
        """Return where the target really is in the tracker's frame (N, 3) [m]."""
        dice = np.random.default_rng([self.seed, 2])
        sizes = np.array([_LENGTH_M] * 3 + [_ANGLE_RAD] * 3) * self.geometry
        arm = self.nominal.with_twists(dice.normal(size=(self.nominal.axis_count + 1, 6)) * sizes)
        base_world = homogeneous_matrix(exp_rotation(dice.normal(size=3)), np.array([2.5, 0.7, 0.3]))
        return (
            arm.tip_positions(joints + self.zeros(), _TIP_IN_FLANGE_M) @ base_world[:3, :3].T
            + base_world[:3, 3]
        )

    def postures(self, count: int, salt: int = 3) -> np.ndarray:
        """Return postures within all limits (count, n)."""
        dice, found = np.random.default_rng([self.seed, salt]), np.zeros((0, self.nominal.axis_count))
        low, high = drawn_range(self.nominal)
        while len(found) < count:
            drawn = dice.uniform(0.85 * low, 0.85 * high, (4 * count, self.nominal.axis_count))
            drawn = drawn[(beyond_limits(self.nominal, drawn) <= 0).all(axis=1)]
            found = np.vstack([found, drawn])
        return found[:count]

    def measured(self, joints: np.ndarray, salt: int = 4) -> np.ndarray:
        """Return what the tracker says (N, 3) [m]."""
        noise = np.random.default_rng([self.seed, salt]).normal(size=(len(joints), 3)) * NOISE_M
        return self.tips(joints) + noise


@dataclass(frozen=True)
class Calibrated:
    """What a calibration from some points is worth at postures that it has not seen."""

    before: float  # RMS distance of the nominal arm, base and tool fitted, in deviations of the noise
    held_out: float  # the same of the identified arm
    covered: float  # share of readings within the radius that is stated to hold 95 %
    zeros: dict[str, float]  # identified zeros: off the hidden one, in stated deviations


def calibrate(
    robot: str, *, seed: int = 1, points: int = 40, geometry: float = 1.0, level: int | None = None
) -> Calibrated:
    """Hide errors in an arm, identify it from points, and look at 200 further postures."""
    model = load_model(robot)
    hidden = HiddenArm(model, seed, geometry)
    joints = hidden.postures(points)
    once, sigma = np.zeros(points, dtype=np.intp), np.full(points, NOISE_M)
    observations = PointObservations(joints, hidden.measured(joints), sigma, once)
    found = identify_arm(model, observations, options=IdentificationOptions(level=level, judge=False))
    further = hidden.postures(200, 5)
    readings, predicted = hidden.measured(further, 6), predict_readings(found, further)
    nominal = found.frames.seen_from(0).base_flange(further)[:, :3, 3]
    away = np.linalg.norm(readings - predicted.positions_m, axis=1)
    noise = NOISE_M * np.sqrt(3.0)
    return Calibrated(
        float(np.sqrt(np.mean(np.sum((readings - nominal) ** 2, axis=1)))) / noise,
        float(np.sqrt(np.mean(away**2))) / noise,
        float((away <= predicted.expanded_m).mean()),
        _zeros(found, hidden),
    )


def _zeros(found, hidden):
    """Return how far identified zeros that nothing hides are from those hidden, in their stated deviations."""
    fit, concealed = found.robust.fit, {item.parameter for item in found.not_identified}
    expected_zeros = hidden.nominal.joint_coupling @ hidden.zeros()
    sigma = np.sqrt(np.diag(fit.covariance))
    return {
        p.name: float((fit.deviations[i] - expected_zeros[p.joint]) / sigma[i])
        for i, p in enumerate(fit.layout.parameters)
        if p.role == "offset" and p.name not in concealed
    }
