"""Healthy records and losses of the hidden world, in the words of the mathematics."""

from dataclasses import dataclass
from functools import cache

import numpy as np

from cellcal.calibration.arm.kinematics import load_model
from cellcal.calibration.mastering.counts import DriveTrain, MasteringRecord, WireCapture
from cellcal.calibration.mastering.pose_design import kit_poses
from cellcal.calibration.mastering.turn_recovery import recover_turns
from cellcal.calibration.motion.motion_check import MotionLimits, WirePath
from cellcal.calibration.wires.model import WirePrior
from cellcal.calibration.wires.reference import fit_wire_reference
from tests.unit.helpers.wire_world import ANCHOR, COUNTS_PER_TURN, HOOK, WireWorld, interaction_matrix

SIGMA_M = 0.0002
MODEL = load_model("fanuc_m6ib")
DRIVE = DriveTrain(tuple(tuple(row) for row in interaction_matrix().tolist()), (COUNTS_PER_TURN,) * 6)
PRIOR = WirePrior(tuple(ANCHOR.tolist()), tuple(HOOK.tolist()))
LIMITS = MotionLimits(
    joint_margin_rad=0.2,
    box_low_m=(-1.2, -1.2, -0.4),
    box_high_m=(1.5, 1.5, 1.6),
    wire=WirePath(PRIOR.anchor_in_base_m, PRIOR.hook_in_flange_m, 3.0, lowest_fraction=0.06),
)


@cache
def record_poses():
    return kit_poses(MODEL, DRIVE, PRIOR, LIMITS, 30)


def healthy_record(world):
    counts, lengths = world.encoder_counts(record_poses()), world.measure_lengths(record_poses())
    wire = fit_wire_reference(MODEL, DRIVE.to_joints(counts, world.zero_counts), lengths, SIGMA_M, PRIOR)
    captures = tuple(
        WireCapture(tuple(c), float(y), SIGMA_M) for c, y in zip(counts.tolist(), lengths, strict=True)
    )
    return MasteringRecord(
        robot_serial="F-104711",
        model="fanuc_m6ib",
        epoch=1,
        drive=DRIVE,
        counts_at_zero=tuple(world.zero_counts.tolist()),
        reference_joints_rad=tuple(record_poses()[0].tolist()),
        reference_counts=captures[0].counts,
        captures=captures,
        wire=wire,
        prior=PRIOR,
        taken_by="test",
        sha256="",
    )


@dataclass
class SimulatedLoss:
    """A robot after its loss: what the test knows, and what the controller and the gauge show."""

    world: WireWorld
    record: MasteringRecord
    true_turns: np.ndarray
    provisional: tuple[int, ...]
    captures: list

    def recover_turns(self, **options):
        return recover_turns(MODEL, self.record, self.captures, provisional_turns=self.provisional, **options)

    def capture_poses(self, poses, *, either_flank=False):
        """Measure at about these poses: the controller believes the provisional turns."""
        real = poses + (self.true_turns - np.array(self.provisional)) @ DRIVE.radians_per_turn().T
        lengths = self.world.measure_lengths(real, either_flank=either_flank)
        read = np.rint(self.world.encoder_counts(real) - COUNTS_PER_TURN * self.true_turns).astype(int)
        side = "either" if either_flank else "record"
        pairs = zip(read.tolist(), lengths, strict=True)
        return [WireCapture(tuple(c), float(y), SIGMA_M, side) for c, y in pairs]

    def joint_error_rad(self, recovery):
        return DRIVE.radians_per_turn() @ (np.array(recovery.offset_turns) - self.true_turns)


def lose_turns(
    seed, captures=16, *, fractions=None, crash=None, poses=None, either_flank=False, coupling_error=0.0
):
    """Take a healthy record, lose tens of turns per motor, and capture at some poses of the kit."""
    rng = np.random.default_rng([seed, 1])
    world = WireWorld(seed, crash=crash, coupling_error=coupling_error)
    record = healthy_record(world)
    world.next_day()
    whole = rng.integers(-40, 41, 6)
    provisional = tuple((whole + rng.integers(-2, 3, 6)).tolist())
    turns = whole + (np.zeros(6) if fractions is None else np.asarray(fractions))
    loss = SimulatedLoss(world, record, turns, provisional, [])
    at = record_poses()[rng.permutation(30)[:captures]] if poses is None else poses
    loss.captures = loss.capture_poses(at, either_flank=either_flank)
    return loss
