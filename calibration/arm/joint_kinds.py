"""What a joint is: it turns within limits, turns without end, or slides; and limits that several joints share."""

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from cellcal.calibration.errors import CalibrationError
from cellcal.calibration.geometry import Array

if TYPE_CHECKING:
    from cellcal.calibration.arm.robot_model import RobotModel

REVOLUTE, CONTINUOUS, PRISMATIC = "revolute", "continuous", "prismatic"
JOINT_TYPES = (REVOLUTE, CONTINUOUS, PRISMATIC)


@dataclass(frozen=True, slots=True)
class CombinedLimit:
    """``lower <= weights . q <= upper`` of the controller's joints: FANUC limits J2 + J3."""

    weights: tuple[float, ...]  # (n,)
    lower_rad: float
    upper_rad: float

    @property
    def name(self) -> str:
        """The joints as people write their sum, such as J2+J3."""
        parts = [
            f"{'-' if weight < 0 else '+'}{'' if abs(weight) == 1.0 else f'{abs(weight):g} '}J{i + 1}"
            for i, weight in enumerate(self.weights)
            if weight
        ]
        return "".join(parts).removeprefix("+")


def check_joint_types(
    name: str, types: tuple[str, ...], combined: tuple[CombinedLimit, ...], axes: int
) -> None:
    """Refuse types that are none, or not one a joint, and combined limits of other joints.

    Raises
    ------
    CalibrationError
        With what is wrong.
    """
    if len(types) != axes or any(kind not in JOINT_TYPES for kind in types):
        raise CalibrationError(
            f"{name}: joint types are {axes} of {', '.join(JOINT_TYPES)}, not {list(types)}"
        )
    for limit in combined:
        finite = np.isfinite([*limit.weights, limit.lower_rad, limit.upper_rad]).all()
        if len(limit.weights) != axes or not finite or not limit.lower_rad < limit.upper_rad:
            raise CalibrationError(
                f"{name}: a combined limit needs a weight for each of {axes} joints, and a lower end below the upper"
            )


def sliding_joints(types: tuple[str, ...]) -> NDArray[np.bool_] | None:
    """Return which joints are prismatic (n,), or None where none is."""
    if PRISMATIC not in types:
        return None
    return np.array([kind == PRISMATIC for kind in types])


def beyond_limits(model: "RobotModel", joints_rad: Array) -> Array:
    """Return by how much postures (N, n) break each limit, (N, n + c): not positive inside [rad, m].

    Behind the joints stand the combined limits.
    """
    joints = np.asarray(joints_rad, dtype=float)
    own: Array = np.maximum(model.lower_rad - joints, joints - model.upper_rad)
    if not model.combined_limits:
        return own
    sums = joints @ np.array([limit.weights for limit in model.combined_limits]).T
    lower = np.array([limit.lower_rad for limit in model.combined_limits])
    upper = np.array([limit.upper_rad for limit in model.combined_limits])
    return np.concatenate([own, np.maximum(lower - sums, sums - upper)], axis=1)


def rotations_about_z(angles_rad: Array) -> Array:
    """Return rigid transforms (N, 4, 4) that turn about z."""
    cos, sin = np.cos(angles_rad), np.sin(angles_rad)
    turned = np.zeros((len(angles_rad), 4, 4))
    turned[:, 0, 0] = turned[:, 1, 1] = cos
    turned[:, 0, 1], turned[:, 1, 0] = -sin, sin
    turned[:, 2, 2] = turned[:, 3, 3] = 1.0
    return turned


def joint_motions(positions: Array, sliding: NDArray[np.bool_] | None) -> Array:
    """Return the motions (n, 4, 4) of joints at their positions (n,) [rad, m]: turns about z, slides along z."""
    if sliding is None:
        return rotations_about_z(positions)
    moved = rotations_about_z(np.where(sliding, 0.0, positions))
    moved[:, 2, 3] = np.where(sliding, positions, 0.0)
    return moved


def shown_units(model: "RobotModel") -> tuple[Array, tuple[str, ...]]:
    """Return what joints are multiplied with for people to read, (n,), and the units: deg, or mm of a slide."""
    slides = [kind == PRISMATIC for kind in model.kinds]
    factors = np.where(slides, 1e3, np.degrees(1.0))
    return factors, tuple("mm" if slide else "deg" for slide in slides)


def joint_columns_of(model: "RobotModel") -> tuple[str, ...]:
    """Return how the columns of joints are called in files of ours: q1_deg, q2_mm."""
    return tuple(f"q{i + 1}_{unit}" for i, unit in enumerate(shown_units(model)[1]))


def drawn_range(model: "RobotModel") -> tuple[Array, Array]:
    """Return between what joints are drawn at random: their limits, and at most half a turn each way."""
    slides = np.array([kind == PRISMATIC for kind in model.kinds])
    low = np.where(slides, model.lower_rad, np.maximum(model.lower_rad, -np.pi))
    high = np.where(slides, model.upper_rad, np.minimum(model.upper_rad, np.pi))
    return low, high
