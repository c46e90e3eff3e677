"""The length of a draw-wire between a fixed anchor and a hook on the flange, and what blurs it."""

from dataclasses import dataclass, replace

import numpy as np

from cellcal.calibration.arm.kinematics import RobotModel
from cellcal.calibration.errors import CalibrationError
from cellcal.calibration.geometry import Array
from cellcal.calibration.metres import MOST_OF_TOOL_M, refuse_not_metres

FRAME_PARAMETERS = 8  # anchor x y z, hook x y z, zero, scale; geometry errors follow


@dataclass(frozen=True, slots=True)
class WirePrior:
    """Knowledge before measuring: nominal places, and how far off anything may be (one deviation).

    The first group are parameters that a record estimates. The second group is what no parameter describes;
    it enters the covariance of every length, shared between captures whose poses or lengths are alike.
    """

    anchor_in_base_m: tuple[float, float, float]
    hook_in_flange_m: tuple[float, float, float]
    zero_m: float = 0.0
    sigma_anchor_m: float = 0.010
    sigma_hook_m: float = 0.002
    sigma_zero_m: float = 0.010
    sigma_scale: float = 0.001
    sigma_length_m: float = 0.0005  # of each link length and offset
    sigma_angle_rad: float = 0.0005236  # 0.03 deg, of each link angle

    sigma_unmodelled_m: float = 0.00015  # anything else, alike within about 3 deg of every joint
    sigma_linearity_m: float = 0.00015  # of the wire sensor, smooth over the length
    sigma_exit_m: float = 0.0002  # of a wire bent around the lip of its exit, smooth over its direction
    sigma_flex_rad: float = 0.00015  # joints and links under gravity, smooth over the postures
    sigma_ripple_rad: float = 0.00012  # gear harmonics: alike within about a degree
    sigma_repeat_rad: float = 0.00003  # a joint coming to rest from the usual side
    sigma_backlash_rad: float = 0.00035  # a joint that may rest on either tooth flank
    sigma_session_m: float = 0.0001  # hook and zero, hung in again on another day

    def __post_init__(self) -> None:
        sigmas = [float(getattr(self, name)) for name in _SIGMAS]
        if not np.isfinite([*self.anchor_in_base_m, *self.hook_in_flange_m, self.zero_m, *sigmas]).all():
            raise CalibrationError("the places and deviations of a wire must be finite")
        refuse_not_metres(self.anchor_in_base_m, "anchor of the wire")
        refuse_not_metres(self.hook_in_flange_m, "hook of the wire", MOST_OF_TOOL_M)
        if min(sigmas) < 0 or min(sigmas[:6]) == 0:
            raise CalibrationError("the deviations of a wire must be above zero")

    def scale_disturbances(self, factor: float) -> "WirePrior":
        """Return the prior with all that no parameter describes larger by a factor; noise stays."""
        return replace(
            self,
            sigma_unmodelled_m=factor * self.sigma_unmodelled_m,
            sigma_linearity_m=factor * self.sigma_linearity_m,
            sigma_exit_m=factor * self.sigma_exit_m,
            sigma_flex_rad=factor * self.sigma_flex_rad,
            sigma_ripple_rad=factor * self.sigma_ripple_rad,
        )


_SIGMAS = (
    "sigma_anchor_m",
    "sigma_hook_m",
    "sigma_zero_m",
    "sigma_scale",
    "sigma_length_m",
    "sigma_angle_rad",
    "sigma_unmodelled_m",
    "sigma_linearity_m",
    "sigma_exit_m",
    "sigma_flex_rad",
    "sigma_ripple_rad",
    "sigma_repeat_rad",
    "sigma_backlash_rad",
    "sigma_session_m",
)

# Over which distance a disturbance stays alike: joint-space (Euclidean) in rad, wire length in m, its direction.
_FLEX_RANGE_RAD, _RIPPLE_RANGE_RAD, _LOCAL_RANGE_RAD, _LINEARITY_RANGE_M = 0.6, 0.02, 0.05, 0.25
_EXIT_RANGE = 0.5  # between unit vectors


@dataclass(frozen=True, eq=False, slots=True)
class WirePoses:
    """Poses at which lengths are or will be taken: joints (N, n) [rad], sensor noise (N,) [m], flank (N,)."""

    joints_rad: Array
    sigma_m: Array
    either_flank: Array  # (N,) 1.0 where the joints may rest on either tooth flank, else 0.0

    @classmethod
    def from_record_side(cls, joints_rad: Array, sigma_m: float | Array) -> "WirePoses":
        """Build for captures that all come to rest from the record's side."""
        joints = np.asarray(joints_rad, dtype=float)
        return cls(
            joints, np.broadcast_to(np.asarray(sigma_m, dtype=float), len(joints)), np.zeros(len(joints))
        )


@dataclass(frozen=True, eq=False, slots=True)
class WireTerms:
    """Modelled lengths (N,) [m] with derivatives by joint (N, n) and by parameter (N, p), and directions (N, 3)."""

    poses: WirePoses
    lengths: Array
    by_joint: Array
    by_parameter: Array
    directions: Array  # of the wire, from its exit

    def noise_variance(self, prior: WirePrior) -> Array:
        """Return (N,): the variance of what is drawn anew at every capture [m^2]."""
        flank = prior.sigma_repeat_rad**2 + self.poses.either_flank * prior.sigma_backlash_rad**2
        variance: Array = self.poses.sigma_m**2 + np.sum(self.by_joint**2, axis=1) * flank
        return variance


def wire_terms(model: RobotModel, parameters: Array, poses: WirePoses) -> WireTerms:
    r"""Compute ``z + s |a - T(q, g) h|`` and its derivatives.

    Parameters
    ----------
    model : RobotModel
        Nominal model; the geometry errors among the parameters are applied to it.
    parameters : (p,)
        Anchor, hook, zero, scale, geometry errors, as documented in ``WireReference``.
    seen : WireSeen
        N poses.

    Returns
    -------
    WireTerms
        Lengths [m] and derivatives [m/rad], [m/unit].

    Raises
    ------
    CalibrationError
        The hook is at the anchor, where a length has no direction.
    """
    hook, zero, scale = parameters[3:6], parameters[6], parameters[7]
    real = with_geometry(model, parameters[FRAME_PARAMETERS:])
    tips, jacobian = real.tip_jacobian(poses.joints_rad, hook)
    away = tips - parameters[:3]
    distance = np.linalg.norm(away, axis=1)
    if not (distance > 1e-3).all():
        raise CalibrationError("the hook is at the anchor of the wire: no direction")
    direction = away / distance[:, None]
    ones = np.ones((len(distance), 1))
    rotations = real.base_flange(poses.joints_rad)[:, :3, :3]
    by_hook = np.einsum("ni,nij->nj", direction, rotations)
    by_geometry = np.einsum("ni,nip->np", direction, _hook_regressor(real, poses.joints_rad, hook))
    frames = [-scale * direction, scale * by_hook, ones, distance[:, None]]
    by_joint = scale * np.einsum("ni,nij->nj", direction, jacobian)
    by_parameter = np.hstack([*frames, scale * by_geometry])
    return WireTerms(poses, zero + scale * distance, by_joint, by_parameter, direction)


def with_geometry(model: RobotModel, errors: Array) -> RobotModel:
    """Return the model with geometry errors, flat: DH errors where it has a DH table, else twists."""
    if model.dh is None:
        return model.with_twists(errors.reshape(-1, 6))
    return model.with_dh_errors(errors.reshape(-1, 5))


def _hook_regressor(model: RobotModel, joints_rad: Array, hook: Array) -> Array:
    table = model.placement_regressor if model.dh is None else model.dh_regressor
    regressor = table(joints_rad, hook)[1]
    postures, axes, *columns = regressor.shape
    return regressor.reshape(postures, axes, int(np.prod(columns)))  # -1 is not told for no posture at all


def disturbance_covariance(prior: WirePrior, a: WireTerms, b: WireTerms) -> Array:
    r"""Return (N, M) [m^2]: how the unmodelled parts of two groups of lengths vary together.

    Gaussian kernels: joint errors (flexing over 0.6 rad, gear ripple over 0.02 rad) carried to the length by
    the Jacobians, the linearity of the sensor over 0.25 m of length, the lip of the exit over half a radian of the
    wire's direction, and a local rest over 0.05 rad. Captures
    at the poses of the record therefore share their disturbances with it, and captures elsewhere do not.
    """
    gaps = a.poses.joints_rad[:, None, :] - b.poses.joints_rad[None, :, :]
    apart = a.lengths[:, None] - b.lengths[None, :]
    covariance = _disturbance_covariance(prior, gaps, apart, a.by_joint @ b.by_joint.T)
    return covariance + _exit_covariance(prior, a.directions @ b.directions.T)


def disturbance_of_sets(prior: WirePrior, terms: WireTerms, size: int) -> Array:
    """Return (B, K, K) [m^2]: the same inside B sets of K = ``size`` lengths each."""
    joints = terms.poses.joints_rad.reshape(-1, size, terms.poses.joints_rad.shape[1])
    lengths, by_joint = terms.lengths.reshape(-1, size), terms.by_joint.reshape(joints.shape)
    gaps = joints[:, :, None, :] - joints[:, None, :, :]
    apart = lengths[:, :, None] - lengths[:, None, :]
    directions = terms.directions.reshape(-1, size, 3)
    covariance = _disturbance_covariance(prior, gaps, apart, by_joint @ np.swapaxes(by_joint, 1, 2))
    return covariance + _exit_covariance(prior, directions @ np.swapaxes(directions, 1, 2))


def _disturbance_covariance(prior: WirePrior, gaps: Array, apart: Array, lever: Array) -> Array:
    square = np.einsum("...j,...j->...", gaps, gaps)
    joint_part = prior.sigma_flex_rad**2 * np.exp(-square / (2 * _FLEX_RANGE_RAD**2))
    joint_part = joint_part + prior.sigma_ripple_rad**2 * np.exp(-square / (2 * _RIPPLE_RANGE_RAD**2))
    covariance: Array = lever * joint_part
    covariance += prior.sigma_linearity_m**2 * np.exp(-(apart**2) / (2 * _LINEARITY_RANGE_M**2))
    covariance += prior.sigma_unmodelled_m**2 * np.exp(-square / (2 * _LOCAL_RANGE_RAD**2))
    return covariance


def _exit_covariance(prior: WirePrior, cosines: Array) -> Array:
    """Return how bends at the exit vary together [m^2], from the cosines between the wires' directions."""
    covariance: Array = prior.sigma_exit_m**2 * np.exp((cosines - 1.0) / _EXIT_RANGE**2)
    return covariance
