"""The kinematics that a PolyScope program keeps with every waypoint: standard DH of the arm it was taught on.

``deltaTheta``, ``a``, ``d``, ``alpha`` as written are the whole chain, Rz(q + deltaTheta) Tz(d) Tx(a) Rx(alpha); d of
hundreds of metres that cancel are usual. Proved with a public waypoint of a UR10e and the pose that PolyScope printed
for it. Only the status LINEARIZED means that the numbers are this arm's.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache, lru_cache

import numpy as np
from numpy.typing import NDArray

from cellcal.calibration.arm.kinematics import DhTable, RobotModel, load_model, model_names
from cellcal.calibration.arm.ur_factory import factory_model, to_well_conditioned
from cellcal.calibration.compensation.bounded_steps import BoundedSearch
from cellcal.calibration.compensation.compensate import CompensationLimits
from cellcal.calibration.compensation.pose_gap import TargetPoses, TipArm
from cellcal.calibration.errors import CalibrationError
from cellcal.calibration.geometry import Array, inverse_transform, log_rotation

LINEARIZED_STATUS = "LINEARIZED"
REACHED_M, REACHED_RAD = 1e-9, 1e-9
_CLOSE = CompensationLimits(position_m=1e-8, angle_rad=1e-8)
_ANY = "ur10e"  # any e-Series arm says which axes are nearly parallel


@dataclass(frozen=True)
class DhChain:
    """The numbers of one ``Kinematics`` element, which compare and hash."""

    rows: tuple[tuple[float, ...], ...]  # six of theta, d, a, alpha

    @classmethod
    def from_columns(
        cls, theta: Sequence[float], a: Sequence[float], d: Sequence[float], alpha: Sequence[float]
    ) -> "DhChain":
        return cls(tuple(zip(theta, d, a, alpha, strict=True)))

    def to_model(self) -> RobotModel:
        """Return the arm, every length near its nominal value; of a known type where one fits."""
        return _fit_model(self)


@cache
def _nominal_arms() -> tuple[RobotModel, ...]:
    return tuple(load_model(name) for name in model_names() if name.startswith("ur"))


@lru_cache(maxsize=256)
def _fit_model(chain: DhChain) -> RobotModel:
    table = DhTable.from_rows(np.array(chain.rows))
    best: tuple[float, RobotModel] | None = None
    for nominal in _nominal_arms():
        try:
            model = factory_model(nominal, table, name=f"{nominal.name}_of_file")
        except CalibrationError:
            continue
        if nominal.dh is not None and model.dh is not None:
            apart = float(np.abs(model.dh.to_rows() - nominal.dh.to_rows())[:, 1:3].max())
            best = (apart, model) if best is None or apart < best[0] else best
    return best[1] if best is not None else _unknown_arm(table)


def _unknown_arm(table: DhTable) -> RobotModel:
    nominal = load_model(_ANY).dh
    conditioned = table if nominal is None else to_well_conditioned(table, nominal)
    limit = np.full(6, 2 * np.pi)
    return RobotModel.from_dh(conditioned, name="ur_of_file", lower_rad=-limit, upper_rad=limit)


def joints_for(model: RobotModel, base_flange: Array, start: Array) -> tuple[Array, NDArray[np.bool_]]:
    """Return joints (N, 6) that bring the flange to poses (N, 4, 4), and whether each is reached (N,).

    Each search begins at its own posture, and stays on its branch as long as the pose allows.
    """
    target = TargetPoses(base_flange[:, :3, :3].transpose(2, 1, 0), base_flange[:, :3, 3].T)
    box = tuple(np.repeat(side[:, None], len(start), axis=1) for side in (model.lower_rad, model.upper_rad))
    inside = np.clip(start.T, *box)
    search = BoundedSearch.start_inside(TipArm(model), target, inside, (box[0], box[1]))
    search.approach_poses(_CLOSE)
    joints = search.joints.T.copy()
    for _ in range(3):
        at, jacobian = model.flange_jacobian(joints)
        step = np.linalg.pinv(jacobian, rcond=1e-8) @ _pose_gap(at, base_flange)[..., None]
        joints += np.clip(step[..., 0], -1e-3, 1e-3)
    gap = _pose_gap(model.base_flange(joints), base_flange)
    reached = (np.linalg.norm(gap[:, :3], axis=1) <= REACHED_M) & (
        np.linalg.norm(gap[:, 3:], axis=1) <= REACHED_RAD
    )
    inside_box = ((joints >= model.lower_rad) & (joints <= model.upper_rad)).all(axis=1)
    return joints, np.asarray(reached & inside_box, dtype=bool)


def pose_distances(one: Array, other: Array) -> tuple[Array, Array]:
    """Return how far poses (N, 4, 4) are from others: (N,) [m] and (N,) [rad]."""
    gap = _pose_gap(one, other)
    return np.linalg.norm(gap[:, :3], axis=1), np.linalg.norm(gap[:, 3:], axis=1)


def _pose_gap(at: Array, target: Array) -> Array:
    turn = log_rotation(target[:, :3, :3] @ inverse_transform(at)[:, :3, :3])
    return np.concatenate([target[:, :3, 3] - at[:, :3, 3], turn], axis=1)
