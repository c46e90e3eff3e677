"""An independent judge of joint moves: kinematics by Pinocchio, distances by Coal, nothing of our checks."""

from collections import Counter

import coal
import numpy as np
import pinocchio as pin

from cellcal.calibration.arm.kinematics import RobotModel
from cellcal.calibration.geometry import Array
from cellcal.calibration.motion.cell_shapes import LinkCapsule, SphereObstacle
from cellcal.drivers.interfaces import Joints
from cellcal.procedures.cell import GaugeSetup
from cellcal.procedures.surroundings import Surroundings

_STEP_RAD = 0.01
_CONTACT_M = 0.005  # what the gate keeps, less what may happen between two of its looks
_WIRE_M = 0.02
_WIRE_EVERY = 5
_ALWAYS, _MARGIN_M = 0.9, 0.02
_TRIALS = 200


class MoveOracle:
    """Says what is wrong with a move that was commanded. Shapes and limits are what the cell file says."""

    def __init__(self, model: RobotModel, surroundings: Surroundings, at: GaugeSetup, range_m: float) -> None:
        self._arm, self._at, self._range_m = model, at, range_m
        self._twin, self._shapes = _pinocchio_twin(model), pin.GeometryModel()
        self._bars = [self._add_bar(capsule) for capsule in surroundings.capsules]
        self._links = [capsule.link for capsule in surroundings.capsules]
        self._add_cell(surroundings)
        self._data = self._twin.createData()
        self._forget_what_always_touches()
        self._geometry = self._shapes.createData()
        for request in self._geometry.collisionRequests:
            request.security_margin = _CONTACT_M

    def find_complaints(self, start: Joints, target: Joints, speed_rad_s: float, cap_m_s: float) -> list[str]:
        """Return what this move breaks; nothing, if it may be gone."""
        if not np.isfinite([*start, *target, speed_rad_s]).all() or speed_rad_s <= 0:
            return ["not finite"]
        steps = int(np.ceil(np.abs(np.subtract(target, start)).max() / _STEP_RAD)) + 1
        way = np.linspace(start, target, steps + 1)
        found = []
        if (way < self._arm.lower_rad).any() or (way > self._arm.upper_rad).any():
            found.append("limits")
        hooks = np.array([self._hook_position(joints) for joints in way])
        lengths = np.linalg.norm(hooks - self._at.anchor_in_base_m, axis=1) / self._range_m
        if (
            lengths[1:].max() > max(0.97, lengths[0]) + 1e-6
            or lengths[1:].min() < min(0.03, lengths[0]) - 1e-6
        ):
            found.append("wire length")
        if self._fastest_speed_m_s(way, hooks, speed_rad_s) > 1.02 * cap_m_s:
            found.append("speed")
        if any(self._is_touching(joints) for joints in way[1:]):
            found.append("contact")
        if any(self._wire_near(joints) for joints in way[1::_WIRE_EVERY]):
            found.append("wire")
        return found

    def stands_free(self, joints: Joints) -> bool:
        """Whether an arm may begin here."""
        return not self._is_touching(np.array(joints)) and not self._wire_near(np.array(joints))

    def _place_bodies(self, joints: Array) -> None:
        angles = self._arm.joint_coupling @ joints + self._arm.theta0_rad
        pin.forwardKinematics(self._twin, self._data, angles)

    def _hook_position(self, joints: Array) -> Array:
        self._place_bodies(joints)
        flange = self._data.oMi[self._arm.axis_count] * pin.SE3(np.array(self._arm.placements[-1]))
        return np.asarray(flange.act(np.array(self._at.hook_in_flange_m)))

    def _fastest_speed_m_s(self, way: Array, hooks: Array, speed_rad_s: float) -> float:
        turned = np.abs(np.diff(way, axis=0)).max(axis=1)
        moved = np.linalg.norm(np.diff(hooks, axis=0), axis=1)
        return float((moved / np.maximum(turned, 1e-12) * speed_rad_s).max())

    def _is_touching(self, joints: Array) -> bool:
        self._place_bodies(joints)
        pin.updateGeometryPlacements(self._twin, self._data, self._shapes, self._geometry)
        return bool(pin.computeCollisions(self._shapes, self._geometry, True))

    def _wire_near(self, joints: Array) -> bool:
        hook, anchor = self._hook_position(joints), np.array(self._at.anchor_in_base_m)
        pin.updateGeometryPlacements(self._twin, self._data, self._shapes, self._geometry)
        wire, where = _capsule_between(anchor, hook, 1e-4)
        for bar, link in zip(self._bars, self._links, strict=True):
            if link < self._arm.axis_count:
                at, shape = self._geometry.oMg[bar], self._shapes.geometryObjects[bar].geometry
                placed = coal.Transform3s(at.rotation, at.translation)
                request, result = coal.DistanceRequest(), coal.DistanceResult()
                if coal.distance(wire, where, shape, placed, request, result) < _WIRE_M:
                    return True
        return False

    def _add_bar(self, capsule: LinkCapsule) -> int:
        shape, at = _capsule_between(np.array(capsule.start_m), np.array(capsule.end_m), capsule.radius_m)
        own = pin.SE3(np.array(at.getRotation()), np.array(at.getTranslation()))
        placed = pin.SE3(np.array(self._arm.placements[capsule.link])) * own
        name = f"{capsule.name} {self._shapes.ngeoms}"
        thing = pin.GeometryObject(name, capsule.link, placed, shape)
        return int(self._shapes.addGeometryObject(thing))

    def _add_cell(self, surroundings: Surroundings) -> None:
        things = [(b.name, pin.SE3(b.base_box.to_matrix()), coal.Box(*b.size_m)) for b in surroundings.blocks]
        things += [
            (ball.name, _ball_placement(ball), coal.Sphere(ball.radius_m)) for ball in surroundings.balls
        ]
        for plane in surroundings.planes:
            normal = np.array(plane.normal_in_base) / np.linalg.norm(plane.normal_in_base)
            solid = coal.Halfspace(normal, float(normal @ plane.point_in_base_m))
            things.append((plane.name, pin.SE3.Identity(), solid))
        apart = [
            (i, j) for j in range(len(self._bars)) for i in range(j) if self._links[j] - self._links[i] > 1
        ]
        for i, j in apart:
            self._shapes.addCollisionPair(pin.CollisionPair(self._bars[i], self._bars[j]))
        for name, placed, shape in things:
            thing = self._shapes.addGeometryObject(pin.GeometryObject(name, 0, placed, shape))
            lowest = 2 if isinstance(shape, coal.Halfspace) else 1
            moving = [bar for bar, link in zip(self._bars, self._links, strict=True) if link >= lowest]
            for bar in moving:
                self._shapes.addCollisionPair(pin.CollisionPair(bar, thing))

    def _forget_what_always_touches(self) -> None:
        """Leave out pairs of links that touch by construction, found by trying."""
        rng, geometry = np.random.default_rng(7), self._shapes.createData()
        low, high = np.maximum(self._arm.lower_rad, -np.pi), np.minimum(self._arm.upper_rad, np.pi)
        pairs = [pin.CollisionPair(p.first, p.second) for p in self._shapes.collisionPairs]
        own = [k for k, pair in enumerate(pairs) if max(pair.first, pair.second) < len(self._bars)]
        links = {k: (self._links[pairs[k].first], self._links[pairs[k].second]) for k in own}
        counts: Counter[tuple[int, int]] = Counter()
        for joints in rng.uniform(low, high, (_TRIALS, self._arm.axis_count)):
            self._place_bodies(joints)
            pin.updateGeometryPlacements(self._twin, self._data, self._shapes, geometry)
            near = [k for k in own if pin.computeDistance(self._shapes, geometry, k).min_distance < _MARGIN_M]
            counts.update({links[k] for k in near})
        for k in own:
            if counts[links[k]] > _ALWAYS * _TRIALS:
                self._shapes.removeCollisionPair(pairs[k])


def _pinocchio_twin(model: RobotModel) -> pin.Model:
    twin, parent = pin.Model(), 0
    for k, placement in enumerate(model.placements[:-1]):
        parent = twin.addJoint(parent, pin.JointModelRZ(), pin.SE3(np.array(placement)), f"J{k + 1}")
    return twin


def _ball_placement(ball: SphereObstacle) -> pin.SE3:
    return pin.SE3(np.eye(3), np.array(ball.centre_in_base_m))


def _capsule_between(start: Array, end: Array, radius_m: float) -> tuple[coal.Capsule, coal.Transform3s]:
    along = end - start
    length = float(np.linalg.norm(along))
    z = along / length
    x = np.cross(z, np.eye(3)[np.argmin(np.abs(z))])
    x /= np.linalg.norm(x)
    turn = np.column_stack([x, np.cross(z, x), z])
    return coal.Capsule(radius_m, length), coal.Transform3s(turn, (start + end) / 2)
