"""Identification: from joints and tracked positions to an arm; how fast, and how right where nothing was measured."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from cellcal.calibration.arm.kinematics import RobotModel
from cellcal.calibration.geometry import Array, exp_twist
from cellcal.service.engineering.bench.contestants import (
    OURS,
    PEERS,
    AbsentContestant,
    Answers,
    Contestant,
    run_contestant,
)
from cellcal.service.engineering.bench.results import BenchResult, BenchTopic, take_turns
from cellcal.service.engineering.bench.simulated import device_and_target, draw_arms, draw_joints

ROWS = (100, 1000, 10_000)
NOISE_M = 5e-5
CHECK_ROWS = 1000
DRAWS = 400  # of the noise: leaves 0.7 % to chance
# How far contestants that want a start are put from the truth: a tracker's place as one would measure it by hand.
_START_OFF = (0.02, -0.01, 0.015, 0.01, -0.02, 0.015)
_MOST_ROWS = {"pybotics": 100}  # finite differences of a Python loop: a minute for these, hours for 10 000
_CONTESTANTS = tuple(each for each in (OURS, *PEERS) if each.name != "roboticstoolbox")


@dataclass(frozen=True, eq=False)
class IdentificationCase:
    """The input of each program, and the criteria by which it is judged."""

    inputs: dict[str, Array]
    often: dict[str, Array]  # what many draws need besides
    truth: Array  # (CHECK_ROWS, 3)
    bound_m: float


def run_identify(seed: int, rounds: int, interpreters: Mapping[str, Path]) -> BenchTopic:
    """Give every contestant the same rows, in three sizes, and judge all at the same unseen postures."""
    results: list[BenchResult] = []
    absent: dict[str, AbsentContestant] = {}
    for rows in ROWS:
        case = case_of(seed, rows)
        able = [
            each
            for each in _CONTESTANTS
            if each.name not in absent and rows <= _MOST_ROWS.get(each.name, rows)
        ]

        def run_one(each: Contestant, inputs: dict[str, Array] = case.inputs) -> Answers | AbsentContestant:
            return run_contestant(each, "identify", inputs, interpreters)

        def judge_one(each: Contestant, answers: Answers, judged: IdentificationCase = case) -> BenchResult:
            return _judge_answers(each, judged, answers)

        found, missing = take_turns(able, rounds, run_one, judge_one)
        results += [over_many_draws(each, case) if each.contestant == OURS.name else each for each in found]
        absent.update({each.contestant.name: each for each in missing})
    question = f"position only, noise {NOISE_M * 1e3:g} mm; error on {CHECK_ROWS} noise-free unseen postures"
    return BenchTopic("identify", question, tuple(results), tuple(absent.values()), per_pose=False)


def case_of(seed: int, rows: int) -> IdentificationCase:
    """Draw an arm, postures and noise, and work out the bound."""
    both, rng = draw_arms(seed), np.random.default_rng([seed, rows])
    device_base, target = device_and_target(rng)
    joints, check = draw_joints(rng, rows), draw_joints(rng, CHECK_ROWS)
    places = [
        both.real.tip_positions(each, target) @ device_base[:3, :3].T + device_base[:3, 3]
        for each in (joints, check)
    ]
    inputs = {
        **both.to_inputs(),
        "joints": joints,
        "positions": places[0] + rng.normal(scale=NOISE_M, size=places[0].shape),
        "check_joints": check,
        "sigma_m": np.array(NOISE_M),
        "device_base_start": device_base @ exp_twist(np.array(_START_OFF)),
        "target_start": target + np.array([5e-3, -5e-3, 5e-3]),
    }
    often = {"places": places[0], "check_places": places[1], "draws": np.array(DRAWS), "seed": np.array(seed)}
    return IdentificationCase(inputs, often, places[1], _cramer_rao(both.real, joints, check, target))


def _cramer_rao(real: RobotModel, joints: Array, check: Array, target: Array) -> float:
    """Return the rms position error that no unbiased estimator beats on average, at the check postures [m]."""
    columns = [
        real.placement_regressor(each, target)[1].reshape(3 * len(each), -1) for each in (joints, check)
    ]
    # Right twists of all placements, the last one's turns moving no target at the tip's own place: a complete,
    # redundant set. What data cannot tell, predictions do not need, so the pseudo-inverse is the right one.
    information = columns[0].T @ columns[0] / NOISE_M**2
    covariance = np.linalg.pinv(information, rcond=1e-11, hermitian=True)
    variance = np.einsum("ij,jk,ik->i", columns[1], covariance, columns[1], optimize=True)
    return float(np.sqrt(variance.reshape(-1, 3).sum(axis=1).mean()))


def over_many_draws(result: BenchResult, case: IdentificationCase) -> BenchResult:
    """Say how near to the bound the fit comes on average: one draw of the noise is off by a tenth by chance."""
    answers = run_contestant(OURS, "identify_often", {**case.inputs, **case.often}, {})
    if isinstance(answers, AbsentContestant):
        return result
    ratio = float(np.sqrt(answers["squares"].mean())) / case.bound_m
    return replace(result, notes={f"over_cramer_rao_{len(answers['squares'])}_draws": ratio, **result.notes})


def _judge_answers(contestant: Contestant, case: IdentificationCase, answers: Answers) -> BenchResult:
    distance = np.linalg.norm(answers["check_positions"] - case.truth, axis=1)
    error = float(np.sqrt((distance**2).mean()))
    notes = {
        "over_cramer_rao": error / case.bound_m,
        "worst_mm": float(distance.max()) * 1e3,
        **{key: float(answers[key]) for key in ("parameters",) if key in answers},
    }
    rows = len(case.inputs["joints"])
    return BenchResult(
        contestant.name, f"{rows} rows", rows, float(answers["seconds"]), error * 1e3, "mm rms", notes
    )
