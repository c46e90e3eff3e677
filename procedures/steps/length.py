"""Steps that measure a length at the joints the controller shows: for every robot, with or without encoder counts."""

import asyncio
import math
import statistics
from dataclasses import dataclass

from cellcal.calibration.message import make_message
from cellcal.drivers.interfaces import Joints
from cellcal.procedures.cell import Cell
from cellcal.procedures.motion.active_frames import check_same_frames
from cellcal.procedures.steps.capture import SPREAD_SIGMAS, TRIES, NotAtRestError
from cellcal.procedures.steps.mastering import length_gauge
from cellcal.procedures.steps.teach import is_still


@dataclass(frozen=True, slots=True)
class LengthCapture:
    """One length with the joints it belongs to, and every single reading, to be evaluated again."""

    label: str
    joints_rad: Joints
    length_m: float
    sigma_m: float  # of the mean: noise only, what the wire gets wrong every time is the fit's business
    readings_m: tuple[float, ...]
    raw: tuple[int, ...]
    target: int = (
        0  # which of the end-effector's points had the hook, counted from 1; 0: its place on the flange
    )


async def capture_length(cell: Cell, label: str, samples: int) -> LengthCapture:
    """Let arm and wire settle, average several readings, and hold that nothing moved meanwhile."""
    gauge = length_gauge(cell)
    for _ in range(TRIES):
        await asyncio.sleep(cell.limits.settle_s)
        before = await cell.robot.read_joints()
        readings = [await gauge.read_distance() for _ in range(samples)]
        after = await cell.robot.read_joints()
        values = tuple(reading.value_m for reading in readings)
        spread = max(values) - min(values)
        if is_still(before, after) and spread <= SPREAD_SIGMAS * gauge.capabilities.sigma_m:
            await check_same_frames(cell)
            noise = max(gauge.capabilities.sigma_m / 2.0, statistics.stdev(values) if samples > 1 else 0.0)
            sigma = math.hypot(noise / math.sqrt(samples), gauge.capabilities.resolution_m)
            raw = tuple(reading.raw for reading in readings)
            return LengthCapture(label, after.joints_rad, statistics.fmean(values), sigma, values, raw)
    raise NotAtRestError(
        make_message(
            "{label}: the arm moves, or the lengths spread by {spread:.2f} mm",
            label=label,
            spread=spread * 1000.0,
        ),
        remedy="Let the arm come to rest, see that the wire hangs free, then resume.",
    )
