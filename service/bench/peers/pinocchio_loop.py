"""pinocchio, used as its examples do: one posture at a time, with its C++ kinematics, Jacobian and logarithm."""

from importlib import import_module
from typing import Any

import numpy as np

_TOLERANCE = 1e-8
_DAMPING = 1e-12
_MOST_STEPS = 20
_LONGEST_RAD = 0.3


def compensate(inputs: dict[str, Any], measure: Any) -> dict[str, Any]:
    """Newton with the same damping, cap and tolerance as ours, verified by the last forward kinematics."""
    pin = import_module("pinocchio")
    nominal, real = (_Arm(pin, inputs[f"{name}_placements"]) for name in ("nominal", "real"))
    joints = inputs["joints"]

    def solve() -> tuple[Any, Any]:
        found, claimed = joints.copy(), np.zeros(len(joints), dtype=bool)
        for i in range(len(joints)):
            claimed[i] = _follow(pin, real, nominal.place(joints[i]), found[i])
        return found, claimed

    seconds, (found, claimed) = measure(solve)
    return {"joints": found, "seconds": seconds, "claimed": claimed}


class _Arm:
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

    def place(self, joints: Any) -> Any:
        self.pin.framesForwardKinematics(self.model, self.data, joints)
        return self.data.oMf[self.flange].copy()


def _follow(pin: Any, arm: _Arm, target: Any, joints: Any) -> bool:
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
