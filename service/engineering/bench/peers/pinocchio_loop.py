"""pinocchio, used as its examples do: one posture at a time, with its C++ kinematics, Jacobian and logarithm."""

from collections.abc import Mapping
from importlib import import_module
from typing import Any

import numpy as np
from numpy.typing import NDArray

_TOLERANCE = 1e-8
_DAMPING = 1e-12
_MOST_STEPS = 20
_LONGEST_RAD = 0.3
_LOOSE = 1e-9  # of the normal matrix: a prior of metres and radians, for noise of hundredths of a mm
_IDENTIFIED = 1e-6  # m, rad: below every measurement


def compensate(inputs: Mapping[str, NDArray[np.float64]], measure: Any) -> dict[str, object]:
    """Newton with the same damping, cap and tolerance as ours, verified by the last forward kinematics."""
    pin = import_module("pinocchio")
    nominal, real = (_PinocchioArm(pin, inputs[f"{name}_placements"]) for name in ("nominal", "real"))
    joints = inputs["joints"]

    def solve_postures() -> tuple[Any, Any]:
        found, claimed = joints.copy(), np.zeros(len(joints), dtype=bool)
        for i in range(len(joints)):
            claimed[i] = _solve_posture(pin, real, nominal.flange_placement(joints[i]), found[i])
        return found, claimed

    seconds, (found, claimed) = measure(solve_postures)
    return {"joints": found, "seconds": seconds, "claimed": claimed}


class _PinocchioArm:
    """A pinocchio model of turning joints between placements, with one frame at the flange."""

    def __init__(self, pin: Any, placements: Any) -> None:
        self.pin, self.model = pin, pin.Model()
        joint = 0
        for k in range(len(placements) - 1):
            place = pin.SE3(placements[k][:3, :3], placements[k][:3, 3])
            joint = self.model.addJoint(joint, pin.JointModelRZ(), place, f"joint_{k + 1}")
        last = pin.SE3(placements[-1][:3, :3], placements[-1][:3, 3])
        frame = pin.Frame("flange", joint, 0, last, pin.FrameType.OP_FRAME)
        self.flange = self.model.addFrame(frame, False)
        self.data = self.model.createData()

    def flange_placement(self, joints: Any) -> Any:
        self.pin.framesForwardKinematics(self.model, self.data, joints)
        return self.data.oMf[self.flange].copy()


def _solve_posture(pin: Any, arm: _PinocchioArm, target: Any, joints: Any) -> bool:
    """Step ``joints`` in place until the flange is at the target."""
    model, data, flange, identity = arm.model, arm.data, arm.flange, np.eye(6)
    for _ in range(_MOST_STEPS):
        pin.computeJointJacobians(model, data, joints)
        place = pin.updateFramePlacement(model, data, flange)
        error = pin.log6(place.actInv(target)).vector
        if error[:3] @ error[:3] <= _TOLERANCE**2 and error[3:] @ error[3:] <= _TOLERANCE**2:
            return True
        jacobian = pin.getFrameJacobian(model, data, flange, pin.ReferenceFrame.LOCAL)
        normal = jacobian @ jacobian.T + (0.01 * (error @ error) + _DAMPING) * identity
        step = jacobian.T @ np.linalg.solve(normal, error)
        longest = np.abs(step).max()
        joints += step if longest <= _LONGEST_RAD else step * (_LONGEST_RAD / longest)
    return False


def identify(inputs: Mapping[str, NDArray[np.float64]], measure: Any) -> dict[str, object]:
    """Gauss-Newton as one writes it: frames, regressor and residual of each posture onto lists."""
    return _fit_placements(inputs, measure, _plain_equations)


def identify_lean(inputs: Mapping[str, NDArray[np.float64]], measure: Any) -> dict[str, object]:
    """Do the same, with nothing in the loop but calls of pinocchio and copies into arrays."""
    return _fit_placements(inputs, measure, _lean_equations)


def _fit_placements(
    inputs: Mapping[str, NDArray[np.float64]], measure: Any, equations: Any
) -> dict[str, object]:
    """Fit twists of all placements and the tool, held by a prior so loose that it decides only what data cannot."""
    pin = import_module("pinocchio")
    joints, measured = inputs["joints"], inputs["positions"]
    start = inputs["nominal_placements"].copy()
    start[0] = inputs["device_base_start"] @ start[0]
    start[-1, :3, 3] += start[-1, :3, :3] @ inputs["target_start"]

    def solve_fit() -> Any:
        placements = start.copy()
        for _ in range(_MOST_STEPS):
            arm = _PinocchioArm(pin, placements)
            design, residual = equations(pin, arm, joints, measured)
            step = np.linalg.solve(design.T @ design + _LOOSE * np.eye(design.shape[1]), design.T @ residual)
            for k, twist in enumerate(step.reshape(-1, 6)):
                placements[k] = placements[k] @ pin.exp6(twist).homogeneous
            if np.abs(step).max() < _IDENTIFIED:
                break
        return placements

    seconds, placements = measure(solve_fit)
    arm = _PinocchioArm(pin, placements)
    places = [arm.flange_placement(check).translation for check in inputs["check_joints"]]
    return {"seconds": seconds, "check_positions": np.array(places)}


def _plain_equations(pin: Any, arm: _PinocchioArm, joints: Any, measured: Any) -> Any:
    rows, residuals = [], []
    for posture, place in zip(joints, measured, strict=True):
        pin.forwardKinematics(arm.model, arm.data, posture)
        pin.updateFramePlacements(arm.model, arm.data)
        tip = arm.data.oMf[arm.flange]
        regressor = pin.computeFrameKinematicRegressor(arm.model, arm.data, arm.flange, _aligned_joint(pin))
        rows.append(np.hstack([regressor[:3], tip.rotation, np.zeros((3, 3))]))
        residuals.append(place - tip.translation)
    return np.vstack(rows), np.concatenate(residuals)


def _lean_equations(pin: Any, arm: _PinocchioArm, joints: Any, measured: Any) -> Any:
    count = len(joints)
    model, data, flange, axes = arm.model, arm.data, arm.flange, _aligned_joint(pin)
    design, places = np.zeros((count, 3, 6 * (model.nv + 1))), np.empty((count, 3))
    width = 6 * model.nv
    for i in range(count):
        pin.forwardKinematics(model, data, joints[i])
        tip = pin.updateFramePlacement(model, data, flange)
        design[i, :, :width] = pin.computeFrameKinematicRegressor(model, data, flange, axes)[:3]
        design[i, :, width : width + 3] = tip.rotation
        places[i] = tip.translation
    return design.reshape(3 * count, -1), (measured - places).reshape(-1)


def _aligned_joint(pin: Any) -> Any:
    return pin.ReferenceFrame.LOCAL_WORLD_ALIGNED
