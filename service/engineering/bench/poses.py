"""Pose selection: which 20 of 1000 candidates tell most about 27 parameters, how soon, and how much they tell."""

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from cellcal.calibration.geometry import Array
from cellcal.calibration.identification.base_parameters import base_subset
from cellcal.calibration.identification.estimator import FitProblem, place_columns
from cellcal.calibration.identification.first_guess import first_guess
from cellcal.calibration.identification.layouts import make_layout
from cellcal.calibration.identification.observations import PointObservations, Rows
from cellcal.calibration.identification.parameters import GEOMETRY, Priors
from cellcal.service.engineering.bench.contestants import (
    OURS,
    PEERS,
    AbsentContestant,
    Answers,
    Contestant,
    run_contestant,
)
from cellcal.service.engineering.bench.results import BenchResult, BenchTopic, take_turns
from cellcal.service.engineering.bench.simulated import draw_arms, draw_joints

CANDIDATES = 1000
CHOSEN = 20
_CONTESTANTS = tuple(each for each in (OURS, *PEERS) if each.name == "cellcal" or "figaroh" in each.name)


def run_poses(seed: int, rounds: int, interpreters: Mapping[str, Path]) -> BenchTopic:
    """Give every contestant the same rows, and judge each choice by the determinant of its information."""
    rng = np.random.default_rng(seed)
    blocks = _candidate_blocks(seed, draw_joints(rng, CANDIDATES))
    inputs = {"blocks": blocks, "chosen": np.array(CHOSEN)}

    def run_one(each: Contestant) -> Answers | AbsentContestant:
        return run_contestant(each, "poses", inputs, interpreters)

    def judge_one(each: Contestant, answers: Answers) -> BenchResult:
        return _judge_choice(each, blocks, answers, _random_choice_value(blocks, rng))

    taken = take_turns(_CONTESTANTS, rounds, run_one, judge_one)
    question = (
        f"{CHOSEN} of {CANDIDATES} candidates for {len(blocks)} parameters; determinant: larger is better"
    )
    return BenchTopic("poses", question, *taken, per_pose=False)


def _candidate_blocks(seed: int, joints: Array) -> Array:
    """Return how each candidate's position follows each of the parameters (p, 3, C), in metres and radians."""
    nominal = draw_arms(seed).nominal
    count = len(joints)
    places = nominal.tip_positions(joints, np.array([0.08, -0.05, 0.12]))
    observations = PointObservations(joints, places, np.ones(count), np.zeros(count, dtype=np.intp))
    state = first_guess(nominal, observations)[0]
    layout = make_layout(nominal, "point", 1, level=GEOMETRY, priors=Priors())
    layout = base_subset(layout, state, observations)
    return place_columns(layout, state, FitProblem.from_observations(state, observations))[0]


def _judge_choice(contestant: Contestant, blocks: Array, answers: Answers, by_chance: float) -> BenchResult:
    chosen = answers["indices"].astype(np.intp)
    is_complete = len(set(chosen.tolist())) == len(chosen) == CHOSEN
    reached = determinant_root(blocks, chosen) if is_complete else 0.0
    notes = {"over_random": reached / by_chance}
    seconds = float(answers["seconds"])
    return BenchResult(
        contestant.name, "27 parameters", CANDIDATES, seconds, reached, "determinant root", notes
    )


def determinant_root(blocks: Array, chosen: Rows) -> float:
    """Return the p-th root of the determinant of the information of some candidates."""
    rows = blocks[:, :, chosen].reshape(len(blocks), -1)
    sign, logarithm = np.linalg.slogdet(rows @ rows.T)
    return float(np.exp(logarithm / len(blocks))) if sign > 0 else 0.0


def _random_choice_value(blocks: Array, rng: np.random.Generator) -> float:
    drawn = [rng.choice(blocks.shape[2], CHOSEN, replace=False) for _ in range(50)]
    return float(np.mean([determinant_root(blocks, each) for each in drawn]))
