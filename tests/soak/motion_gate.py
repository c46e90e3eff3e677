"""Random targets against the gate: what comes through is judged by an oracle that shares nothing with it."""

import asyncio
import math
from collections import Counter
from dataclasses import dataclass, field

import numpy as np

from cellcal.calibration.arm.kinematics import load_model
from cellcal.calibration.errors import CellError
from cellcal.calibration.geometry import Array, Pose
from cellcal.calibration.motion.cell_shapes import PlaneObstacle, SphereObstacle, arm_shape
from cellcal.drivers.interfaces import Joints
from cellcal.procedures.cell import Cell, GaugeSetup, MotionCaps, MotionLevel
from cellcal.procedures.motion.motion_gate import MotionCare, move_along
from cellcal.procedures.surroundings import BoxBlock, Surroundings
from tests.procedures.ideal_devices import IdealArm, IdealWire, ScriptedTechnician
from tests.soak.campaign_figures import CampaignFigures
from tests.soak.gate_oracle import MoveOracle

MODEL = load_model("fanuc_m6ib")
HOME = (0.2, 0.1, -0.3, 0.4, 0.5, -0.6)
AT = GaugeSetup((0.9, -0.7, -0.45), (0.06, 0.05, 0.12))
KNOWN = Surroundings(
    blocks=(BoxBlock("table", Pose((0.9, 0.5, -0.4)), (0.5, 0.4, 0.3)),),
    balls=(SphereObstacle("lamp", (0.5, -0.6, 1.1), 0.15),),
    planes=(PlaneObstacle("floor", (0.0, 0.0, -0.7), (0.0, 0.0, 1.0)),),
    capsules=arm_shape(MODEL, radius_m=0.07, tip_in_flange_m=(0.06, 0.05, 0.12)),
)
_CAP_M_S = 0.25
_BAD = (math.nan, math.inf, -math.inf, 1e300, -1e12)


@dataclass
class RecordingArm(IdealArm):
    """An arm that writes down what it is told."""

    commands: list[tuple[Joints, Joints, float]] = field(default_factory=list)

    async def move_joints(self, target_rad: Joints, *, speed_rad_s: float) -> None:
        """Note the command, and be there."""
        here = (await self.read_joints()).joints_rad
        self.commands.append((here, target_rad, speed_rad_s))
        if np.isfinite(target_rad).all():
            self.write_program(np.array(target_rad))


def gate(trials: int) -> CampaignFigures:
    """Random targets: not finite, beyond limits, unreachable for the wire, colliding, and honest ones; 0 escapes."""
    found = asyncio.run(_run_trials(trials))
    escapes = sum(count for name, count in found.items() if name.startswith("escaped"))
    summary = ", ".join(f"{name} {count}" for name, count in sorted(found.items()))
    line = f"gate: {trials} random targets, {found['commanded']} commanded, {escapes} escapes ({summary})"
    return CampaignFigures(line, escapes == 0 and found["commanded"] > 0.02 * trials)


async def _run_trials(trials: int) -> Counter[str]:
    arm, rng, found = RecordingArm(model=MODEL), np.random.default_rng(11), Counter[str]()
    oracle = MoveOracle(MODEL, KNOWN, AT, IdealWire(arm).capabilities.range_m)
    cell = Cell(
        "campaign",
        arm,
        ScriptedTechnician(),
        jogs=arm,
        mastering=arm,
        gauge=IdealWire(arm),
        gauge_setup=AT,
        model=MODEL,
        limits=MotionCaps(settle_s=0.0),
        level=MotionLevel.COMMANDED,
        surroundings=KNOWN,
    )
    arm.write_program(np.array(HOME))
    assert oracle.stands_free(HOME)
    for _ in range(trials):
        kind, target, speed = _draw_target(rng, arm.true_joints)
        arm.commands.clear()
        try:
            await move_along(cell, [target], speed, care=MotionCare.WIRED)
            found["commanded"] += 1
        except CellError:
            found[f"refused {kind}"] += 1
        for start, goal, rate in arm.commands:
            for complaint in oracle.find_complaints(start, goal, rate, _CAP_M_S):
                found[f"escaped {complaint}"] += 1
    return found


def _draw_target(rng: np.random.Generator, here: Array) -> tuple[str, Joints, float]:
    """Return what kind of target was drawn, the target, and a speed."""
    low, high = MODEL.lower_rad, MODEL.upper_rad
    target, speed = rng.uniform(low, high), float(rng.uniform(0.01, 3.0))
    kind = str(
        rng.choice(["bad number", "limit", "anywhere", "near", "bad speed"], p=[0.15, 0.15, 0.25, 0.4, 0.05])
    )
    axis = int(rng.integers(6))
    if kind == "bad number":
        target[axis] = rng.choice(_BAD)
    elif kind == "limit":
        target = here.copy()
        edge = rng.choice([low[axis], high[axis]])
        target[axis] = edge + rng.normal(0.0, 0.05)
    elif kind == "near":
        target = here + rng.normal(0.0, 0.25, 6)
    elif kind == "bad speed":
        target, speed = (
            here + rng.normal(0.0, 0.1, 6),
            float(rng.choice([math.nan, -0.1, 0.0, math.inf, -math.inf])),
        )
    return kind, tuple(float(q) for q in target), speed
