"""What a technician's hands do in the fake cell when a page asks for it, by the key of what is asked."""

import re
from collections.abc import Sequence
from typing import Any

import numpy as np

from cellcal.calibration.arm.kinematics import load_model
from cellcal.calibration.geometry import Array, exp_rotation, homogeneous_matrix, log_rotation
from cellcal.service.demo.fake_cell_client import FakeCellClient

_MOUNT, _HOOK = re.compile(r"mount_wire_(\d+)"), re.compile(r"hook_wire_(\d+)")
_MOUTH = re.compile(r"towards x (-?\d+), y (-?\d+), z (-?\d+) mm")
MODEL = load_model("fanuc_m6ib")
STARTS = (
    (0.0, 0.3, -0.1, 0.0, -1.2, 0.0),
    (0.0, 0.3, -0.1, 1.2, -1.0, -1.2),
    (0.0, 0.3, -0.1, -1.2, -1.0, 1.2),
)
MISSED_M = 1e-4  # by how much a tip misses what it is to touch, per coordinate


class TechnicianActions:
    """Jogs the robot to where a touch wants it, hangs the wire where it is to hang, changes batteries.

    ``places`` maps keys of instructions to poses of the flange in the base, as the pendant shows them.
    """

    def __init__(self, fake_client: FakeCellClient, places: dict[str, Array]) -> None:
        self.fake_client, self.places = fake_client, places
        self._rng = np.random.default_rng(5)

    async def do_action(self, prompt: dict[str, Any], robot: str) -> None:
        """Do what is asked; keys that need no hands are agreed to as they are."""
        key, wire = str(prompt["key"]), f"wire of {robot}"
        if key in self.places:
            await self.fake_client.inject_fault(
                "hand_moves", joints=self._jog_to(self.places[key]), device=robot
            )
        elif key in ("new_battery", "power_cycle"):
            await self.fake_client.inject_fault(key, device=robot)
        elif key in (
            "hook_stays_on",
            "wire_is_hooked",
            "hook_wire_back",
        ):  # an end-effector's hole may have had it
            await self.fake_client.inject_fault("wire_home", device=wire)
        elif mount := _MOUNT.fullmatch(key):
            mouth = _MOUTH.search(str(prompt["text"]))
            mouth_settings = (
                {} if mouth is None else {"mouth_at_m": [int(value) * 1e-3 for value in mouth.groups()]}
            )
            await self.fake_client.inject_fault(
                "mount_wire", point=int(mount[1]), device=wire, **mouth_settings
            )
        elif hook := _HOOK.fullmatch(key):
            await self.fake_client.inject_fault("hook_wire", target=int(hook[1]), device=wire)

    async def read_display(self, prompt: dict[str, Any]) -> str:
        """Read the instrument that has no wire to this computer, and write down what it shows, in millimetres."""
        name = str(prompt["key"]).removeprefix("reading:")
        reading_m = (await self.fake_client.read_truth())["gauges"][name]["reading_m"]
        return f"{1e3 * reading_m:.2f}".replace(".", ",")

    def _jog_to(self, base_flange: Array) -> list[float]:
        missed = base_flange.copy()
        missed[:3, 3] += self._rng.normal(scale=MISSED_M, size=3)
        return joints_for(missed)


def joints_for(base_flange: Array) -> list[float]:
    """Return joints (6,) [rad] that put the flange there, by Newton's method from a few postures."""
    for start in STARTS:
        joints = np.array(start)
        for _ in range(200):
            poses, jacobian = MODEL.flange_jacobian(joints[None])
            pose = poses[0]
            turn = pose[:3, :3] @ log_rotation(pose[:3, :3].T @ base_flange[:3, :3])
            error = np.concatenate([base_flange[:3, 3] - pose[:3, 3], turn])
            if np.abs(error).max() < 1e-7 and _within_limits(joints):
                return [float(angle) for angle in joints]
            step = np.linalg.lstsq(jacobian[0], error, rcond=1e-4)[0]
            joints = joints + step * min(1.0, 0.2 / max(float(np.abs(step).max()), 1e-12))
            joints[3:] = (joints[3:] + np.pi) % (2 * np.pi) - np.pi
    raise AssertionError(f"the arm does not reach {base_flange.round(3).tolist()}")


def _within_limits(joints: Array) -> bool:
    return bool(np.all((MODEL.lower_rad < joints) & (joints < MODEL.upper_rad)))


def flange_at(tip_in_base_m: Sequence[float], attitude: Array, tip_in_flange_m: Sequence[float]) -> Array:
    """Return the flange (4, 4) whose tip is at a place, in an attitude (3, 3) of the flange."""
    return homogeneous_matrix(attitude, np.asarray(tip_in_base_m) - attitude @ np.asarray(tip_in_flange_m))


def rotation_about(about: Sequence[float], angle_rad: float) -> Array:
    """Return a rotation (3, 3)."""
    return exp_rotation(np.asarray(about, dtype=float) * angle_rad)
