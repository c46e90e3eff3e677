"""What a technician's hands do in the fake cell when a page asks for it, by its words."""

import re
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from cellcal.calibration.arm.kinematics import load_model
from cellcal.calibration.geometry import Array, exp_rotation, homogeneous_matrix, log_rotation
from cellcal.service.demo.fake_cell_client import FakeCellClient

# What a technician knows of the work, in English: titles of steps, and what the button says that agrees.
TOUCHES: dict[str, str] = {
    "touch the pin": "touch",
    "touch, turned about x": "touch_about_x",
    "touch, turned about y": "touch_about_y",
    "move along x": "along_x",
    "move along y": "along_y",
    "move along z": "along_z",
    "touch the origin": "touch_origin",
    "touch a point on x": "touch_on_x",
    "touch a point on the y side": "touch_on_xy",
    "touch the origin again": "touch_origin_again",
    "touch another point on x": "touch_more_on_x",
    "touch another point of the plane": "touch_more_on_xy",
    "touch a point above": "touch_above",
    "the probe is mounted": "probe_at_corner",
}
NUMBERED_TOUCHES: dict[str, tuple[str, int]] = {  # the key of a place, and how far its number is ahead
    "touch in another attitude": ("touch_{}", 3),
    "touch point": ("touch_point_{}", 0),
}
STEP_TITLES = (
    *TOUCHES,
    *NUMBERED_TOUCHES,
    "the wire is hooked",
    "accept the plan",
    "the pin is fixed",
    "the pointer is mounted",
    "accept the result",
    "the wire stands",
    "move the wire",
    "the hook's adaptor is on",
    "the fixture has not moved",
    "the device is ready",
    "the saved counts",
    "new battery",
    "power cycle",
    "slow motion",
    "accept the correction",
    "accept the undo",
    "capture",
)
HOOKED, MOUNTED, ADAPTOR = "The wire is hooked in", "The wire is mounted", "The adaptor is fixed"
NEW_BATTERY, SWITCHED_ON = "New batteries are in", "It is switched on again"
AGREEMENTS = (
    HOOKED,
    MOUNTED,
    ADAPTOR,
    NEW_BATTERY,
    SWITCHED_ON,
    "It may move",
    "It may go on moving",
    "It may move that fast",
    "The pin is fixed",
    "The pointer is mounted",
    "The draw-wire stands there",
    "The probe is over the corner",
    "Nothing was moved",
    "The target is in place",
    "Use these counts",
    "Record this point",
    "Keep this result",
    "Write the tool",
    "Write the frame",
    "Write the mastering",
    "Take this value",
    "Done, go on",
)
_FIRST_NUMBER = re.compile(r"\d+")
_MOUTH = re.compile(r"x (-?\d+)\W+?y (-?\d+)\W+?z (-?\d+) mm")
MODEL = load_model("fanuc_m6ib")
STARTS = (
    (0.0, 0.3, -0.1, 0.0, -1.2, 0.0),
    (0.0, 0.3, -0.1, 1.2, -1.0, -1.2),
    (0.0, 0.3, -0.1, -1.2, -1.0, 1.2),
)
MISSED_M = 1e-4  # by how much a tip misses what it is to touch, per coordinate


@dataclass(frozen=True)
class ShownStep:
    """One question as it stands on a page, recognised by what it says."""

    title: str  # in English, without its number
    number: int  # behind the title; 0 where there is none
    answer: str  # what the button says that agrees, in English
    instruction: str  # as it is shown
    button: str  # as it is shown


class TechnicianActions:
    """Jogs the robot to where a touch wants it, hangs the wire where it is to hang, changes batteries.

    ``places`` maps keys of instructions to poses of the flange in the base, as the pendant shows them.
    """

    def __init__(self, fake_client: FakeCellClient, places: dict[str, Array]) -> None:
        self.fake_client, self.places = fake_client, places
        self._rng = np.random.default_rng(5)

    async def do_step(self, step: ShownStep, robot: str) -> None:
        """Do what a page asks for in words; what needs no hands is agreed to as it is."""
        wire = f"wire of {robot}"
        if place := self._place_of(step):
            await self.jog_to_touch(place, robot)
        elif step.answer == NEW_BATTERY:
            await self.fake_client.inject_fault("new_battery", device=robot)
        elif step.answer == SWITCHED_ON:
            await self.fake_client.inject_fault("power_cycle", device=robot)
        elif step.answer == MOUNTED:
            await self._mount_wire(_first_number(step.instruction), step.instruction, wire)
        elif step.answer == HOOKED and step.title == "move the wire":
            await self.fake_client.inject_fault(
                "hook_wire", target=_first_number(step.instruction), device=wire
            )
        elif step.answer in (HOOKED, ADAPTOR):  # an end-effector's hole may have had it
            await self.fake_client.inject_fault("wire_home", device=wire)

    @staticmethod
    def _place_of(step: ShownStep) -> str | None:
        if step.title in NUMBERED_TOUCHES:
            key, ahead = NUMBERED_TOUCHES[step.title]
            return key.format(step.number + ahead)
        return TOUCHES.get(step.title)

    async def jog_to_touch(self, place: str, robot: str) -> None:
        """Jog the arm to a place, but for a small error."""
        await self.fake_client.inject_fault(
            "hand_moves", joints=self._joints_near(self.places[place]), device=robot
        )

    async def _mount_wire(self, point: int, instruction: str, wire: str) -> None:
        mouth = _MOUTH.search(instruction)
        assert mouth is not None, f"the page does not say where the mouth looks: {instruction}"
        mouth_at_m = [int(value) * 1e-3 for value in mouth.groups()]
        await self.fake_client.inject_fault("mount_wire", point=point, device=wire, mouth_at_m=mouth_at_m)

    async def read_display(self, robot: str) -> str:
        """Read the instrument that has no wire to this computer, and write down what it shows, in millimetres."""
        reading_m = (await self.fake_client.read_truth())["gauges"][f"wire of {robot}"]["reading_m"]
        return f"{1e3 * reading_m:.2f}".replace(".", ",")

    def _joints_near(self, base_flange: Array) -> list[float]:
        missed = base_flange.copy()
        missed[:3, 3] += self._rng.normal(scale=MISSED_M, size=3)
        return joints_for(missed)


def _first_number(instruction: str) -> int:
    found = _FIRST_NUMBER.search(instruction)
    assert found is not None, f"the page does not say which point: {instruction}"
    return int(found[0])


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
