"""Going to poses and measuring there, one after the other: what every series on one arm does between two looks."""

from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np

from cellcal.calibration.arm.kinematics import load_model
from cellcal.calibration.geometry import Array
from cellcal.calibration.message import make_message
from cellcal.drivers.interfaces import Joints
from cellcal.procedures.arm.arm_bench import (
    ArmCapture,
    Bench,
    capture_arm,
    captures_agree,
    distance_m,
    noise_m,
)
from cellcal.procedures.cell import Cell
from cellcal.procedures.motion.speed_limit import SpeedLimit
from cellcal.procedures.refit import LEFT_OUT, MEASURED_AGAIN
from cellcal.procedures.run import Run
from cellcal.procedures.steps.measure_point import SAME_SIGMAS, PointCapture, StationMovedError, check_station
from cellcal.procedures.steps.motion import follow_way
from cellcal.procedures.verdict import SetAside

RETURN_SIGMA_M = 1.5e-4  # of an arm that comes back to a pose after a long series, its own warmth included
ON_THE_WAY_RAD = 0.02  # an approach from below leaves the way by one degree


@dataclass(slots=True)
class ArmVisits:
    """The progress of a series between steps; everything in it comes from findings."""

    run: Run
    bench: Bench
    pace: SpeedLimit
    samples: int
    here_rad: Joints
    taken: list[ArmCapture] = field(default_factory=list)
    sources: list[str] = field(default_factory=list)  # the step of each capture in force
    retaken: list[int] = field(default_factory=list)
    set_aside: list[SetAside] = field(default_factory=list)
    count: int = 0
    target: int = 0  # which point of the end-effector is measured; 0: the target on the flange
    first_rad: Joints | None = None  # the pose that was gone to first

    def valid_captures(self) -> tuple[ArmCapture, ...]:
        """Return the captures in force."""
        return tuple(self.taken)

    def list_unused(self, rejected: tuple[int, ...]) -> tuple[SetAside, ...]:
        """Return what was taken and not used; ``rejected`` are captures in force that the fit left out."""
        left_out = (SetAside(self.sources[k], LEFT_OUT) for k in rejected)
        return (*self.set_aside, *left_out)

    async def go_to_rest(self, way_rad: tuple[Joints, ...]) -> None:
        """Go where every pose has a free way to."""
        await self._go_along("go to rest", way_rad)

    async def visit_pose(self, way_rad: tuple[Joints, ...], again: int = -1) -> None:
        """Go along a way and measure at its end; ``again`` is the capture that is doubted, -1 for none."""
        self.count += 1
        source = f"capture {self.count}"
        self.first_rad = self.first_rad or way_rad[-1]
        found = await self._go_and_capture(f"go to pose {self.count}", source, f"pose {self.count}", way_rad)
        if again < 0:
            self.taken.append(found)
            self.sources.append(source)
            return
        self.retaken.append(again)
        if not captures_agree(self.taken[again], found, self.bench.sigma_m):
            self.set_aside.append(SetAside(self.sources[again], MEASURED_AGAIN))
            self.taken[again], self.sources[again] = found, source
        else:
            self.set_aside.append(SetAside(source, "measured again, and the same as before"))

    async def visit_point(self, number: int, way_rad: tuple[Joints, ...]) -> None:
        """Go along a way and measure the end-effector's point at its end; its captures have numbers of their own."""
        source, label = f"capture point {number}", f"point {self.target}, pose {number}"
        self.taken.append(await self._go_and_capture(f"go to point pose {number}", source, label, way_rad))
        self.sources.append(source)

    async def change_target(
        self, number: int, target: int, pace: SpeedLimit, way_rad: tuple[Joints, ...]
    ) -> None:
        """Go to where hook or target can be changed; from then on the other one is measured, at its own pace."""
        await self._go_along(f"go to change {number}", way_rad)
        self.target, self.pace = target, pace

    async def check_pose(self, kind: str, number: int, way_rad: tuple[Joints, ...]) -> ArmCapture:
        """Go along a way and measure at its end for a check; the capture takes part in no fit."""
        label = f"{kind} {number}"
        return await self._go_and_capture(f"go to {label}", f"capture {label}", label, way_rad)

    async def check_device(self, way_rad: tuple[Joints, ...]) -> float:
        """Measure the first pose once more at the end; return how far it then is [m].

        Raises
        ------
        StationMovedError
            Tripod, hook or base moved meanwhile: the captures cannot be put together.
        """
        again = await self.check_pose("station", 1, way_rad)
        return device_shift_m(self.bench, self.taken[0], again)

    async def _go_and_capture(
        self, move: str, step: str, label: str, way_rad: tuple[Joints, ...]
    ) -> ArmCapture:
        await self._go_along(move, way_rad)
        return await self.run.step(
            step, capture_arm, label, self.samples, self.bench.method, target=self.target
        )

    async def _go_along(self, move: str, way_rad: tuple[Joints, ...]) -> None:
        planned = (self.here_rad, *way_rad)
        wired = (
            self.bench.method == "wire" and not self.target
        )  # the gate knows the hook of the cell file only
        await self.run.move(move, go_on_along, planned, self.pace, wired=wired)
        self.here_rad = way_rad[-1]


def device_shift_m(bench: Bench, first: ArmCapture, again: ArmCapture) -> float:
    """Return how far two captures of one pose are apart [m]; refuse more than arm and device scatter.

    A person does not bring the arm to quite the same joints: what these differ by is left to the arm.
    """
    model, joints = load_model(bench.model), np.array([first.joints_rad, again.joints_rad])
    tips = model.tip_positions(joints, np.array(bench.target_in_flange_m))
    sigma_m = float(np.hypot(RETURN_SIGMA_M, np.linalg.norm(tips[1] - tips[0])))
    if isinstance(first, PointCapture) and isinstance(again, PointCapture):
        return check_station(first, again, sigma_m)
    distance = distance_m(first, again)
    if distance > SAME_SIGMAS * float(np.hypot(sigma_m, np.hypot(noise_m(first), noise_m(again)))):
        raise StationMovedError(
            make_message(
                "{again_label}: the wire is {distance:.3f} mm longer or shorter than in {first_label}",
                again_label=again.label,
                distance=distance * 1000.0,
                first_label=first.label,
            ),
            remedy="Hook, anchor or robot base has moved, or the hall's temperature. Begin the series anew.",
        )
    return distance


async def go_on_along(
    cell: Cell, planned_rad: tuple[Joints, ...], pace: SpeedLimit, *, wired: bool
) -> Joints:
    """Go along a planned way from the posture it begins at; one that was begun is gone on with where the arm stands.

    Back to its beginning, or straight to a corner that lies behind, no way was checked.
    """
    here = (await cell.robot.read_joints()).joints_rad
    way = remaining_corners(planned_rad, here)
    return await follow_way(cell, way, pace.joint_speed_rad_s, wired=wired, pace=pace)


def remaining_corners(planned_rad: tuple[Joints, ...], here_rad: Joints) -> tuple[Joints, ...]:
    """Return the corners that are left of a way for an arm that stands on it; all of them if it stands elsewhere."""
    legs = pairwise(np.array(planned_rad))
    gaps = [_line_gap(start, end, np.array(here_rad)) for start, end in legs]
    on = [k for k, gap in enumerate(gaps) if gap <= ON_THE_WAY_RAD]
    return planned_rad[1 + (max(on) if on else 0) :]


def _line_gap(start_rad: Array, end_rad: Array, here_rad: Array) -> float:
    """Return how far a posture is from a straight joint move, in the joint that is off most [rad]."""
    way = end_rad - start_rad
    length = float(way @ way)
    share = min(max(float((here_rad - start_rad) @ way) / length, 0.0), 1.0) if length > 0 else 0.0
    return float(np.abs(start_rad + share * way - here_rad).max())
