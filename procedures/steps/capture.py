"""Steps that measure a length while everything stands still."""

import asyncio
import math
import statistics
from dataclasses import dataclass

from cellcal.calibration.mastering.counts import WireCapture
from cellcal.calibration.message import make_message
from cellcal.drivers.interfaces import Counts, Joints
from cellcal.procedures.cell import Cell
from cellcal.procedures.motion.active_frames import check_same_frames
from cellcal.procedures.motors import motor_store
from cellcal.procedures.run import ProcedureError
from cellcal.procedures.steps.mastering import length_gauge

TRIES = 3
SPREAD_SIGMAS = 6.0


class NotAtRestError(ProcedureError):
    """The arm or the wire moves while it is measured."""

    code = "procedure.not_at_rest"


@dataclass(frozen=True, slots=True)
class StillCapture:
    """One length with the counts it belongs to, and every single reading, to be evaluated again."""

    wire: WireCapture
    counts_after: Counts
    joints_rad: Joints  # as the controller believes them
    readings_m: tuple[float, ...]
    raw: tuple[int, ...]


async def capture_still(
    cell: Cell, label: str, samples: int, tolerance_counts: int, settled_from: str = "record"
) -> StillCapture:
    """Let arm and wire settle, average several readings, and hold that nothing moved meanwhile."""
    for _ in range(TRIES):
        await asyncio.sleep(cell.limits.settle_s)
        found = await _read_still(cell, label, samples, settled_from)
        if _is_at_rest(found, tolerance_counts, length_gauge(cell).capabilities.sigma_m):
            await check_same_frames(cell)
            return found
    raise NotAtRestError(
        make_message(
            "{label}: counts went from {counts} to {counts_after}, lengths spread by {readings_mm:.2f} mm",
            label=label,
            counts=found.wire.counts,
            counts_after=found.counts_after,
            readings_mm=(max(found.readings_m) - min(found.readings_m)) * 1000.0,
        ),
        remedy="Let the arm come to rest, see that the wire hangs free, then resume.",
    )


async def _read_still(cell: Cell, label: str, samples: int, settled_from: str) -> StillCapture:
    store, gauge = motor_store(cell), length_gauge(cell)
    before = await store.encoder_counts()
    readings = [await gauge.read_distance() for _ in range(samples)]
    joints = await cell.robot.read_joints()
    after = await store.encoder_counts()
    values = tuple(reading.value_m for reading in readings)
    spread = statistics.stdev(values) / math.sqrt(samples) if samples > 1 else 0.0
    # averaging does not help against what a gauge gets wrong every time
    sigma = math.hypot(max(reading.sigma_m for reading in readings), spread)
    wire = WireCapture(tuple(before), statistics.fmean(values), sigma, settled_from, label)
    return StillCapture(wire, tuple(after), joints.joints_rad, values, tuple(r.raw for r in readings))


def _is_at_rest(found: StillCapture, tolerance_counts: int, sigma_m: float) -> bool:
    moved = max(abs(a - b) for a, b in zip(found.wire.counts, found.counts_after, strict=True))
    spread = max(found.readings_m) - min(found.readings_m)
    return moved <= tolerance_counts and spread <= SPREAD_SIGMAS * sigma_m
