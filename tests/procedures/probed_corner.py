"""An ideal arm with a touch probe at a corner of three planes, and a technician who brings the probe over it.

The arm comes to rest at the contact and stands there while its joints are looked at: what a touch finds does not
depend on when it was looked at, and a run can be repeated to the last digit.
"""

import asyncio
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from cellcal.calibration.arm.kinematics import RobotModel
from cellcal.calibration.geometry import Pose, exp_rotation, homogeneous_matrix
from cellcal.calibration.points.three_two_one import FACES, Corner, outward_in_frame
from cellcal.drivers.interfaces import (
    Condition,
    ContactEdge,
    ContactReading,
    Identity,
    JointReading,
    ProbeCapabilities,
    Readiness,
)
from cellcal.procedures.cell import ProbeSetup
from cellcal.procedures.motion.probe_line import joints_for_tip
from tests.procedures.ideal_devices import IdealArm

TIP = (0.010, -0.020, 0.160)
RADIUS_M = 0.0015
HOME = (0.1, 0.17, -0.44, 0.26, -1.05, 0.35)
_PRESSED_M = 1e-6  # how far the ideal contact closes behind the surface
_PIECES, _ROUNDS = 24, 4  # of a move, looked at for the contact closer and closer
_LOOKS = 4  # at the arm's joints before the contact, and again after it
Array = np.ndarray


@dataclass
class CornerContact:
    """A corner in the base, and the ball at the flange that can touch it."""

    base_frame: Array  # (4, 4)
    corner: Corner
    tip_in_flange_m: tuple[float, float, float] = TIP
    faces: Sequence[str] = FACES  # those that are there
    lean: dict[str, Array] = field(default_factory=dict)  # other normals, seen from the frame

    def clearance_m(self, centre_m: Array) -> float:
        """Return how far the ball is from the material."""
        local = self.base_frame[:3, :3].T @ (centre_m - self.base_frame[:3, 3])
        heights = [local @ self.lean.get(name, outward_in_frame(name, self.corner)) for name in self.faces]  # type: ignore[arg-type]
        if not heights:
            return 1.0
        return float((max if self.corner == "outside" else min)(heights)) - RADIUS_M


@dataclass
class ProbingArm(IdealArm):
    """An arm that is stopped by what its probe touches."""

    feeler: CornerContact | None = None
    read_count: int = 0
    touched_at_s: float | None = None
    pressed: asyncio.Event = field(default_factory=asyncio.Event)
    contacts: int = 0

    def clearance_m(self) -> float:
        assert self.feeler is not None
        tip = self.model.tip_positions(self.true_joints[None], np.array(self.feeler.tip_in_flange_m))[0]
        return self.feeler.clearance_m(tip)

    async def read_joints(self) -> JointReading:
        found = await super().read_joints()
        self.read_count += 1
        return found

    async def _travel_by(self, delta: Array, name: str) -> None:
        start, self.moves, self.moving = self.true_joints, [*self.moves, name], True
        share = self._free_share(start, delta)
        try:
            await asyncio.sleep(0)
            self.write_program(start + delta * share / 2)
            if self.midway is not None:
                self.midway(len(self.moves))
            await asyncio.sleep(0)
            self.write_program(start + delta * share)
            if share < 1.0:
                await self._stand_at_the_contact()
        finally:
            self.moving = False
            self.pressed.clear()

    async def _stand_at_the_contact(self) -> None:
        """Observe, touch, observe again; then the probe reports, and the mover stops the arm."""
        self.moving = False
        await self._looked_at()
        self.touched_at_s = asyncio.get_running_loop().time()
        self.contacts += 1
        await self._looked_at()
        self.pressed.set()
        await asyncio.Event().wait()

    async def _looked_at(self) -> None:
        look_count = self.read_count
        while self.read_count < look_count + _LOOKS:
            await asyncio.sleep(0.001)

    def _free_share(self, start: Array, delta: Array) -> float:
        """Return which share of a move is made before the contact closes; 1 where it does not, or opens."""
        assert self.feeler is not None
        low, high = 0.0, 1.0
        for _ in range(_ROUNDS):
            shares = np.linspace(low, high, _PIECES)
            tips = self.model.tip_positions(
                start + shares[:, None] * delta, np.array(self.feeler.tip_in_flange_m)
            )
            off = [self.feeler.clearance_m(tip) + _PRESSED_M for tip in tips]
            closed = [each <= 0.0 for each in off]
            if closed[0] and off[1] < off[0]:
                return low  # it was brought to the contact, and no farther, by the move before
            if closed[0] or not any(closed):
                return 1.0
            first = closed.index(True)
            low, high = float(shares[first - 1]), float(shares[first])
        return high


@dataclass
class IdealProbe:
    """A probe without delay."""

    arm: ProbingArm
    name: str = "probe"
    serial: str = "P-1"
    stuck_closed: bool = False

    @property
    def capabilities(self) -> ProbeCapabilities:
        return ProbeCapabilities(RADIUS_M, 0.0, 3e-6, 0.006, 0.0, 0.001, 0.002)

    async def identify(self) -> Identity:
        await asyncio.sleep(0)
        return Identity("ideal", "probe", self.serial, "1.0")

    async def read_condition(self) -> Condition:
        await asyncio.sleep(0)
        return Condition(Readiness.READY)

    async def read_contact(self) -> ContactReading:
        await asyncio.sleep(0)
        closed = self.stuck_closed or self.arm.clearance_m() < 0.0
        return ContactReading(closed, asyncio.get_running_loop().time(), int(closed))

    async def wait_for_touch(self) -> ContactEdge:
        await self.arm.pressed.wait()
        assert self.arm.touched_at_s is not None
        return ContactEdge(self.arm.touched_at_s, self.arm.touched_at_s, 0, True, (0, 1))


def with_probe(cell: Any, arm: ProbingArm, tip_sigma_m: float) -> Any:
    """Return a cell whose robot carries the probe."""
    return replace(cell, probe=IdealProbe(arm), probe_setup=ProbeSetup(TIP, tip_sigma_m))


def corner_below(
    model: RobotModel, tip_m: Sequence[float] = TIP, home_rad: Sequence[float] = HOME, height_m: float = 0.06
) -> Array:
    """Return a corner (4, 4) below the tip at home, its z looking back along the stylus."""
    flange = model.base_flange(np.array([home_rad]))[0]
    z = -flange[:3, 2]
    x = np.cross([0.0, 1.0, 0.0], z)
    x = x / np.linalg.norm(x)
    tip = flange[:3, :3] @ np.array(tip_m) + flange[:3, 3]
    corner = tip - height_m * z - 0.05 * x - 0.05 * np.cross(z, x)
    return homogeneous_matrix(np.column_stack([x, np.cross(z, x), z]), corner)


def pose_offset(frame: Array, shift_m: Sequence[float], turn_rad: Sequence[float]) -> Pose:
    """Return a frame as drawn, a little off."""
    return Pose.from_matrix(frame @ homogeneous_matrix(exp_rotation(np.array(turn_rad)), np.array(shift_m)))


def home_at(arm: IdealArm, frame: Array, local_m: Sequence[float]) -> None:
    """Bring the tip to a place of the frame, in the attitude of home."""
    place = frame[:3, :3] @ np.array(local_m) + frame[:3, 3]
    arm.write_program(np.array(joints_for_tip(arm.model, TIP, HOME, place)))
