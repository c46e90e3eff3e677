"""Identification from measurements of a real robot: all programs fit the same rows, and are judged on the others."""

from collections.abc import Mapping
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path

import numpy as np

from cellcal.calibration.arm.kinematics import RobotModel, load_model
from cellcal.calibration.geometry import Array
from cellcal.calibration.identification.estimator import FitProblem, estimate_arm
from cellcal.calibration.identification.first_guess import first_guess
from cellcal.calibration.identification.layouts import make_layout
from cellcal.calibration.identification.observations import PointObservations, Rows
from cellcal.calibration.identification.parameters import FRAMES
from cellcal.service.engineering.bench.contestants import (
    OURS,
    PEERS,
    AbsentContestant,
    Answers,
    BenchError,
    Contestant,
    run_contestant,
)
from cellcal.service.engineering.bench.results import BenchResult, BenchTopic, take_turns
from cellcal.service.engineering.bench.simulated import model_inputs
from cellcal.service.engineering.measured.measurements import ReadOptions, read_measurements

TRAIN_ROWS = 600
SHIPPED = {"series B": "series_b.tsv", "series C": "series_c.tsv"}
_SHIPPED_ROBOT = "ur10"
_SIGMA_M = 1e-4  # weighs nothing: all rows are alike
_MOST_ROWS = {"pybotics": 100}  # finite differences of a Python loop: a minute for these
_FEWEST = 60

# "cellcal" fits what the peers fit: the geometry, no more; so that times compare like with like.
_BEFORE = Contestant("base and tool only", "own.py", "this package", ours=True, variant="_before")
_CHOSEN = Contestant("cellcal, level chosen", "own.py", "this package", ours=True, variant="_chosen")
CONTESTANTS = (_BEFORE, OURS, _CHOSEN, *(each for each in PEERS if each.name != "roboticstoolbox"))


@dataclass(frozen=True, eq=False)
class MeasuredSeries:
    """Rows of one series in the order of measuring."""

    name: str
    model: RobotModel
    joints_rad: Array  # (N, n)
    positions_m: Array  # (N, 3)


def load_shipped() -> tuple[MeasuredSeries, ...]:
    """Return the measurements that come with the package."""
    model, found = load_model(_SHIPPED_ROBOT), []
    for name, file in SHIPPED.items():
        text = files("cellcal.service.engineering.bench.data").joinpath(file).read_text(encoding="utf-8")
        rows = np.array([line.split("\t") for line in text.splitlines()[1:]], dtype=float)
        found.append(MeasuredSeries(f"UR10, {name}", model, rows[:, :-3], rows[:, -3:]))
    return tuple(found)


def read_series(path: Path, robot: str) -> MeasuredSeries:
    """Read positions from any file that ``cellcal identify`` reads.

    Raises
    ------
    BenchError
        No robot named, or lengths rather than positions, which no peer fits.
    """
    if not robot:
        raise BenchError(f"{path} needs a robot.", remedy="Give `--robot`; `cellcal models` lists them.")
    model = load_model(robot)
    observations = read_measurements(path, model, ReadOptions()).observations
    if not isinstance(observations, PointObservations):
        raise BenchError(
            f"{path} holds {observations.kind}s, which no peer fits.", remedy="Give positions or poses."
        )
    if len(observations) < _FEWEST:
        raise BenchError(
            f"{len(observations)} rows are too few to compare.", remedy=f"Give {_FEWEST} or more."
        )
    return MeasuredSeries(path.name, model, observations.joints_rad, observations.positions_m)


def run_real(
    seed: int, rounds: int, interpreters: Mapping[str, Path], series: tuple[MeasuredSeries, ...] = ()
) -> BenchTopic:
    """Draw the rows to fit, the same for all, and judge each program on the others."""
    results: list[BenchResult] = []
    absent: dict[str, AbsentContestant] = {}
    for measured in series or load_shipped():
        train, held_out = split_rows(len(measured.joints_rad), seed)
        inputs = _build_inputs(measured, train, held_out)

        def run_one(
            each: Contestant, case_inputs: Mapping[str, Array] = inputs
        ) -> Answers | AbsentContestant:
            most = _MOST_ROWS.get(each.name, len(case_inputs["joints"]))
            fewer = {"joints": case_inputs["joints"][:most], "positions": case_inputs["positions"][:most]}
            inputs: dict[str, Array] = {**case_inputs, **fewer}
            return run_contestant(each, "identify", inputs, interpreters)

        def judge_one(each: Contestant, answers: Answers, truth: Array = measured.positions_m[held_out],
                      name: str = measured.name, rows: int = len(train)) -> BenchResult:  # fmt: skip
            return judge_predictions(each, answers, truth, name, min(rows, _MOST_ROWS.get(each.name, rows)))

        able = [each for each in CONTESTANTS if each.name not in absent]
        found, missing = take_turns(able, rounds, run_one, judge_one)
        results += found
        absent.update({each.contestant.name: each for each in missing})
    question = "a real robot and a laser tracker, positions only; mean error on the rows that were not fitted"
    return BenchTopic("real", question, tuple(results), tuple(absent.values()), per_pose=False)


def split_rows(count: int, seed: int) -> tuple[Rows, Rows]:
    """Return rows to fit, drawn at random, and all others: 600, of short series three in five."""
    order = np.random.default_rng(seed).permutation(count)
    fitted = min(TRAIN_ROWS, count * 3 // 5)
    return np.sort(order[:fitted]), np.sort(order[fitted:])


def judge_predictions(
    contestant: Contestant, answers: Answers, truth: Array, case: str, rows: int
) -> BenchResult:
    """Judge predicted places (H, 3) of the held-out rows."""
    predicted = answers["check_positions"]
    complete = predicted.shape == truth.shape and bool(np.isfinite(predicted).all())
    distance = np.linalg.norm(predicted - truth, axis=1) * 1e3 if complete else np.full(len(truth), np.inf)
    notes: dict[str, float] = {
        "rmse_mm": float(np.sqrt((distance**2).mean())),
        "p95_mm": float(np.percentile(distance, 95)) if complete else float("inf"),
        "held_out_rows": float(len(truth)),
        **{key: float(answers[key]) for key in ("level", "parameters") if key in answers},
    }
    mean = float(distance.mean())
    return BenchResult(contestant.name, case, rows, float(answers["seconds"]), mean, "mm mean", notes)


def _build_inputs(measured: MeasuredSeries, train: Rows, held_out: Rows) -> dict[str, Array]:
    """Return what each program is given; those that need a start get base and tool fitted to the nominal robot."""
    joints, positions = measured.joints_rad[train], measured.positions_m[train]
    count = len(train)
    observations = PointObservations(
        joints, positions, np.full(count, _SIGMA_M), np.zeros(count, dtype=np.intp)
    )
    layout = make_layout(measured.model, "point", 1, level=FRAMES)
    start = first_guess(measured.model, observations)[0]
    placed = estimate_arm(layout, start, FitProblem.from_observations(start, observations)).state
    return {
        **model_inputs(measured.model, "nominal"),
        "joints": joints,
        "positions": positions,
        "check_joints": measured.joints_rad[held_out],
        "sigma_m": np.array(_SIGMA_M),
        "device_base_start": placed.devices[0].device_base,
        "target_start": placed.flange_tool[:3, 3],
    }
