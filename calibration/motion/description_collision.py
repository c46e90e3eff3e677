"""Collision checks with the real shapes of a robot description, by Pinocchio and Coal (the extra ``planning``).

The same verbs as `calibration.motion.collision`, whose capsules need nothing but a model: this one sees shoulders
beside the skeleton, grippers and meshes, if the description has them.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from types import ModuleType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cellcal.calibration.arm.joint_kinds import drawn_range
from cellcal.calibration.arm.urdf import UrdfArm
from cellcal.calibration.errors import CalibrationError, CellError
from cellcal.calibration.geometry import Array
from cellcal.calibration.message import make_message
from cellcal.calibration.motion.cell_shapes import BoxObstacle, Obstacle, PlaneObstacle, SphereObstacle

_ALWAYS = 0.9  # of random postures: a pair that touches so often is touching by construction
_TRIALS = 200


@dataclass(frozen=True, eq=False)
class DescriptionCheck:
    """Checks postures of the arm of a description; joints are those of its chain, in order."""

    arm: UrdfArm
    not_checked: tuple[str, ...]
    _pinocchio: ModuleType
    _model: Any
    _shapes: Any
    _at: tuple[int, ...]  # place of each joint of the chain in a velocity of the whole description
    _joint_matrix: Array
    _margin_m: float

    @classmethod
    def from_description(
        cls,
        arm: UrdfArm,
        obstacles: Sequence[Obstacle] = (),
        *,
        mesh_folders: Sequence[str] = (),
        joint_matrix: Array | None = None,
        margin_m: float = 0.02,
    ) -> "DescriptionCheck":
        """Load the collision shapes, and leave out pairs that touch by construction.

        Parameters
        ----------
        arm : UrdfArm
            Its root link is the base in which the obstacles stand; joints beside its chain stay at zero.
        mesh_folders : sequence of str
            Where ``package://`` starts.
        joint_matrix : (n, n), optional
            Turns controller joints into those of the description, for arms that couple joints.

        Raises
        ------
        CellError
            Pinocchio is not installed.
        CalibrationError
            No shapes in the description, or a mesh that cannot be found.
        """
        pin, coal = _import_libraries()
        model = pin.buildModelFromXML(arm.text)
        try:
            shapes = pin.buildGeomFromUrdfString(
                model, arm.text, pin.GeometryType.COLLISION, None, list(mesh_folders)
            )
        except ValueError as refused:
            raise CalibrationError(
                make_message("the shapes of the description cannot be loaded: {refused}", refused=refused),
                remedy="Name the folder in which package:// starts.",
            ) from refused
        own = shapes.ngeoms
        if not own:
            raise CalibrationError("the description has no collision shapes")
        for item in obstacles:
            shape, placement = _coal_shape(pin, coal, item)
            shapes.addGeometryObject(pin.GeometryObject(item.name, 0, placement, shape))
        for pair in _collidable_pairs(pin, model, shapes, own):
            shapes.addCollisionPair(pair)
        at = tuple(int(model.idx_vs[model.getJointId(name)]) for name in arm.model.joint_names)
        matrix = np.eye(len(at)) if joint_matrix is None else np.asarray(joint_matrix, dtype=float)
        check = cls(arm, (), pin, model, shapes, at, matrix, margin_m)
        words = [*check._exclude_touching_pairs(), "links that share a joint are not checked"]
        if not obstacles:
            words.append("no obstacles known: path not checked for collisions with the cell")
        words.append("cables, hoses, people and the draw-wire are not known")
        return cls(arm, tuple(words), pin, model, shapes, at, matrix, margin_m)

    def is_free(self, joints_rad: Array) -> NDArray[np.bool_]:
        """Return (N,): which postures keep the margin. Numbers that are not finite are not free."""
        joints = np.atleast_2d(np.asarray(joints_rad, dtype=float))
        free: NDArray[np.bool_] = np.isfinite(joints).all(axis=1)
        data, geometry = self._model.createData(), self._geometry_data()
        for row in np.flatnonzero(free):
            posture = self._configuration_of(joints[row])
            free[row] = not self._pinocchio.computeCollisions(
                self._model, data, self._shapes, geometry, posture, True
            )
        return free

    def _configuration_of(self, joints: Array) -> Array:
        turn = np.zeros(self._model.nv)
        turn[list(self._at)] = self._joint_matrix @ joints
        neutral = self._pinocchio.neutral(self._model)
        return np.asarray(self._pinocchio.integrate(self._model, neutral, turn), dtype=np.float64)

    def _geometry_data(self) -> Any:
        geometry = self._pinocchio.GeometryData(self._shapes)
        for request in geometry.collisionRequests:
            request.security_margin = self._margin_m
        return geometry

    def _exclude_touching_pairs(self) -> list[str]:
        generator = np.random.default_rng(1)
        low, high = drawn_range(self.arm.model)
        data, geometry, shapes = self._model.createData(), self._geometry_data(), self._shapes
        touched = np.zeros(len(shapes.collisionPairs))
        for joints in generator.uniform(low, high, (_TRIALS, len(low))):
            self._pinocchio.computeCollisions(
                self._model, data, shapes, geometry, self._configuration_of(joints), False
            )
            touched += [result.isCollision() for result in geometry.collisionResults]
        always = [
            pair
            for pair, often in zip(shapes.collisionPairs, touched, strict=True)
            if often > _ALWAYS * _TRIALS
        ]
        names = [tuple(shapes.geometryObjects[i].name for i in (pair.first, pair.second)) for pair in always]
        for pair in always:
            shapes.removeCollisionPair(pair)
        return [
            make_message(
                "touching by construction, so not checked: {one_shape} and {other_shape}",
                one_shape=one,
                other_shape=other,
            )
            for one, other in names
        ]


def _collidable_pairs(pin: ModuleType, model: Any, shapes: Any, own: int) -> list[Any]:
    """Return the pairs that can collide: not on one link, not on neighbours, not two things that stand still."""
    joint = [item.parentJoint for item in shapes.geometryObjects]
    pairs = []
    for second in range(len(joint)):
        for first in range(min(second, own)):
            together = joint[first] == joint[second]
            neighbours = second < own and (
                model.parents[joint[first]] == joint[second] or model.parents[joint[second]] == joint[first]
            )
            if not together and not neighbours:
                pairs.append(pin.CollisionPair(first, second))
    return pairs


def _coal_shape(pin: ModuleType, coal: ModuleType, item: Obstacle) -> tuple[Any, Any]:
    if isinstance(item, SphereObstacle):
        return coal.Sphere(item.radius_m), pin.SE3(np.eye(3), np.array(item.centre_in_base_m))
    if isinstance(item, BoxObstacle):
        return coal.Box(*item.size_m), pin.SE3(item.base_box[:3, :3], item.base_box[:3, 3])
    return _half_space(coal, item), pin.SE3.Identity()


def _half_space(coal: ModuleType, plane: PlaneObstacle) -> Any:
    normal = np.array(plane.normal_in_base) / np.linalg.norm(plane.normal_in_base)
    return coal.Halfspace(normal, float(normal @ np.array(plane.point_in_base_m)))


def _import_libraries() -> tuple[ModuleType, ModuleType]:
    try:
        import coal  # noqa: PLC0415  # optional: the extra "planning"
        import pinocchio  # noqa: PLC0415  # optional: the extra "planning"
    except ImportError as missing:
        raise CellError(
            "collision shapes of a description need Pinocchio and Coal, which are not installed.",
            remedy="Install the extra: pip install 'cellcal[planning]'.",
            code="missing_extra",
        ) from missing
    return pinocchio, coal
