"""Compensation: how many points a second, how exact, and how many left their branch without saying so."""

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from cellcal.calibration.geometry import Array, log_rotation
from cellcal.service.engineering.bench.contestants import (
    OURS,
    PEERS,
    AbsentContestant,
    Answers,
    Contestant,
    run_contestant,
)
from cellcal.service.engineering.bench.results import BenchResult, BenchTopic, take_turns
from cellcal.service.engineering.bench.simulated import SimulatedArms, draw_arms, draw_joints

POINTS = 10_000
SMALLEST_SINGULAR = 0.08  # about two thirds of random postures: where every contestant can do well
BRANCH_RAD = 0.5
_CONTESTANTS = tuple(each for each in (OURS, *PEERS) if each.name not in ("figaroh", "pinocchio lean"))


def run_compensate(seed: int, rounds: int, interpreters: Mapping[str, Path]) -> BenchTopic:
    """Give every contestant the same postures, `rounds` times in turn, and keep each one's best time."""
    both = draw_arms(seed)
    results: list[BenchResult] = []
    absent: dict[str, AbsentContestant] = {}
    for case, joints in _draw_cases(both, seed).items():
        inputs = {**both.to_inputs(), "joints": joints}

        def run_one(
            each: Contestant, case_inputs: Mapping[str, Array] = inputs
        ) -> Answers | AbsentContestant:
            return run_contestant(each, "compensate", case_inputs, interpreters)

        def judge_one(
            each: Contestant, answers: Answers, start: Array = joints, name: str = case
        ) -> BenchResult:
            return judge_answers(each, both, start, answers, name)

        able = [each for each in _CONTESTANTS if each.name not in absent]
        found, missing = take_turns(able, rounds, run_one, judge_one)
        results += found
        absent.update({each.contestant.name: each for each in missing})
    question = (
        f"{POINTS} postures of a simulated {both.nominal.title}, to below 1e-5 mm; regular: smallest singular "
        f"value above {SMALLEST_SINGULAR:g}; random: as they come"
    )
    return BenchTopic("compensate", question, tuple(results), tuple(absent.values()))


def _draw_cases(both: SimulatedArms, seed: int) -> dict[str, Array]:
    joints = draw_joints(np.random.default_rng(seed), 3 * POINTS)
    smallest = np.linalg.svd(both.nominal.flange_jacobian(joints)[1], compute_uv=False)[:, -1]
    return {"regular": joints[smallest > SMALLEST_SINGULAR][:POINTS], "random": joints[:POINTS]}


def judge_answers(
    contestant: Contestant, both: SimulatedArms, joints: Array, answers: Answers, case: str = "regular"
) -> BenchResult:
    """Judge answers by forward kinematics apart from all contestants; only what one claims counts as solved."""
    found, claimed = answers["joints"], answers["claimed"].astype(bool)
    start = joints[: len(found)]
    there, here = both.nominal.base_flange(start), both.real.base_flange(found)
    distance = np.linalg.norm(there[:, :3, 3] - here[:, :3, 3], axis=1)
    turn = np.linalg.norm(log_rotation(np.swapaxes(here[:, :3, :3], 1, 2) @ there[:, :3, :3]), axis=1)
    changed_branch = (np.abs(found - start) > BRANCH_RAD).any(axis=1)
    solved = claimed & ~changed_branch
    worst = float(distance[solved].max()) if solved.any() else float("inf")
    notes = {
        "solved_share": float(claimed.mean()),
        "leaps": float((claimed & changed_branch).sum()),
        "claimed_but_above_1e-5_mm": float((claimed & (distance > 1e-8)).sum()),
        "worst_angle_deg": float(np.degrees(turn[solved].max())) if solved.any() else float("inf"),
    }
    return BenchResult(
        contestant.name, case, len(found), float(answers["seconds"]), worst * 1e3, "mm worst", notes
    )
