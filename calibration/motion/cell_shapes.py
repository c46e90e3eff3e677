"""Shapes of an arm and of what stands in its cell: capsules along the links; boxes, spheres and planes."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from cellcal.calibration.arm.kinematics import RobotModel
from cellcal.calibration.errors import CalibrationError
from cellcal.calibration.geometry import Array, inverse_transform, is_rigid
from cellcal.calibration.message import make_message
from cellcal.calibration.motion.motion_check import WirePath

Place = tuple[float, float, float]

_LINK_RADIUS_SHARE = 0.05  # of the length of the stretched arm, where no thickness is given
_SHORTEST_M = 1e-3  # a shorter piece of skeleton is no link


@dataclass(frozen=True, slots=True)
class LinkCapsule:
    """A round bar with round ends on a link: 0 is the base, k moves with joint k, the last is the flange."""

    name: str
    link: int
    start_m: Place  # in the frame after placement P_link
    end_m: Place
    radius_m: float


@dataclass(frozen=True, slots=True)
class SphereObstacle:
    """A ball that stands in the cell."""

    name: str
    centre_in_base_m: Place
    radius_m: float


@dataclass(frozen=True, slots=True)
class PlaneObstacle:
    """A floor, wall or table: everything on the other side of the plane from its normal is solid."""

    name: str
    point_in_base_m: Place
    normal_in_base: Place


@dataclass(frozen=True, eq=False)
class BoxObstacle:
    """A box that stands in the cell."""

    name: str
    base_box: Array  # (4, 4): centre and axes
    size_m: Place  # whole edges


Obstacle = SphereObstacle | PlaneObstacle | BoxObstacle


@dataclass(frozen=True, eq=False)
class CellShape:
    """The known shapes of arm and cell, and the distances to keep."""

    arm: tuple[LinkCapsule, ...]
    obstacles: tuple[Obstacle, ...] = ()
    wire: WirePath | None = None
    margin_m: float = 0.02
    wire_margin_m: float = 0.05
    assumed: tuple[str, ...] = ()  # what was assumed when this was made, for people to read

    def __post_init__(self) -> None:
        sizes = [self.margin_m, self.wire_margin_m]
        for capsule in self.arm:
            sizes += [capsule.radius_m, *np.abs([*capsule.start_m, *capsule.end_m])]
        for item in self.obstacles:
            sizes += _obstacle_sizes(item)
        if not (np.isfinite(sizes).all() and min(sizes) >= 0):
            raise CalibrationError("shapes of arm and cell need finite places, and sizes not below zero")


def arm_shape(
    model: RobotModel, *, radius_m: float | None = None, tip_in_flange_m: Place | None = None
) -> tuple[LinkCapsule, ...]:
    """Return capsules along the skeleton of an arm: along z, then along x of each Denavit-Hartenberg row.

    Parameters
    ----------
    radius_m : float, optional
        Of every link; 5 % of the length of the stretched arm if unknown.
    tip_in_flange_m : (3,), optional
        Adds a bar from the flange to the tip, half as thick.
    """
    if radius_m is None:
        radius_m = _LINK_RADIUS_SHARE * float(np.linalg.norm(model.placements[1:, :3, 3], axis=1).sum())
    capsules = []
    for link in range(model.axis_count + 1):
        end = model.placements[link][:3, 3]
        corner = np.array([0.0, 0.0, end[2]])
        back = inverse_transform(model.placements[link])
        for start, stop in ((np.zeros(3), corner), (corner, end)):
            if np.linalg.norm(stop - start) >= _SHORTEST_M:
                ends = [_to_place(back[:3, :3] @ point + back[:3, 3]) for point in (start, stop)]
                capsules.append(LinkCapsule(_link_name(model, link), link, ends[0], ends[1], radius_m))
    if tip_in_flange_m is not None and np.linalg.norm(tip_in_flange_m) >= _SHORTEST_M:
        capsules.append(LinkCapsule("tool", model.axis_count, (0.0, 0.0, 0.0), tip_in_flange_m, radius_m / 2))
    return tuple(capsules)


def assumed_shape(
    model: RobotModel,
    obstacles: Sequence[Obstacle] = (),
    *,
    tip_in_flange_m: Place | None = None,
    wire: WirePath | None = None,
) -> CellShape:
    """Return the shape of a cell of whose arm only the kinematics are known."""
    arm = arm_shape(model, tip_in_flange_m=tip_in_flange_m)
    radius = max(capsule.radius_m for capsule in arm)
    words = make_message(
        "links are taken as {radius:.0f} mm round about the kinematic skeleton, no real shape is known",
        radius=radius * 1000.0,
    )
    return CellShape(arm, tuple(obstacles), wire, assumed=(words,))


def _obstacle_sizes(item: Obstacle) -> list[float]:
    """Return the numbers of an obstacle that must be finite and not below zero."""
    if isinstance(item, SphereObstacle):
        return [item.radius_m, *np.abs(item.centre_in_base_m)]
    if isinstance(item, PlaneObstacle):
        length = float(np.linalg.norm(item.normal_in_base))
        return [*np.abs(item.point_in_base_m), length if length > 0 else -1.0]
    return [*item.size_m, 0.0 if is_rigid(item.base_box) else -1.0]


def _link_name(model: RobotModel, link: int) -> str:
    return "base" if link == 0 else make_message("link {link}", link=link)


def _to_place(point: Array) -> Place:
    x, y, z = (float(value) for value in point)
    return x, y, z
