"""Compensation: how many points a second, how exact, and how many left their branch without saying so."""

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from calibration.geometry import Array, log_rotation
from service.bench.contestants import OURS, PEERS, Answers, Contestant, run
from service.bench.results import Result, Topic, take_turns
from service.bench.simulated import Arms, arms, draw_joints

POINTS = 10_000
SMALLEST_SINGULAR = 0.08  # about two thirds of random postures: where every contestant can do well
BRANCH_RAD = 0.5
_CONTESTANTS = tuple(each for each in (OURS, *PEERS) if each.name not in ("figaroh", "pinocchio lean"))


def run_compensate(seed: int, rounds: int, interpreters: Mapping[str, Path]) -> Topic:
    """Give every contestant the same postures, `rounds` times in turn, and keep each one's best time."""
    both = arms(seed)
    rng = np.random.default_rng(seed)
    joints = draw_joints(rng, 3 * POINTS)
    smallest = np.linalg.svd(both.nominal.flange_jacobian(joints)[1], compute_uv=False)[:, -1]
    joints = joints[smallest > SMALLEST_SINGULAR][:POINTS]
    inputs = {**both.inputs(), "joints": joints}
    taken = take_turns(
        _CONTESTANTS,
        rounds,
        lambda each: run(each, "compensate", inputs, interpreters),
        lambda each, answers: judge(each, both, joints, answers),
    )
    question = f"{len(joints)} postures, smallest singular value above {SMALLEST_SINGULAR:g}, single-threaded"
    return Topic("compensate", question, *taken)


def judge(contestant: Contestant, both: Arms, joints: Array, answers: Answers) -> Result:
    """Judge answers by forward kinematics apart from all contestants; only what one claims counts as solved."""
    found, claimed = answers["joints"], answers["claimed"].astype(bool)
    start = joints[: len(found)]
    there, here = both.nominal.base_flange(start), both.real.base_flange(found)
    distance = np.linalg.norm(there[:, :3, 3] - here[:, :3, 3], axis=1)
    turn = np.linalg.norm(log_rotation(np.swapaxes(here[:, :3, :3], 1, 2) @ there[:, :3, :3]), axis=1)
    leapt = (np.abs(found - start) > BRANCH_RAD).any(axis=1)
    kept = claimed & ~leapt
    worst = float(distance[kept].max()) if kept.any() else float("inf")
    notes = {
        "solved_share": float(claimed.mean()),
        "leaps": float((claimed & leapt).sum()),
        "claimed_but_above_1e-5_mm": float((claimed & (distance > 1e-8)).sum()),
        "worst_angle_deg": float(np.degrees(turn[kept].max())) if kept.any() else float("inf"),
    }
    return Result(
        contestant.name, "all", len(found), float(answers["seconds"]), worst * 1e3, "mm worst", notes
    )
