"""Identification from measurements of a real robot: everybody fits the same rows, and is judged on the others."""

from collections.abc import Mapping
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path

import numpy as np

from cellcal.calibration.arm.kinematics import RobotModel, load_model
from cellcal.calibration.geometry import Array
from cellcal.calibration.identification.estimator import Problem, estimate
from cellcal.calibration.identification.first_guess import first_guess
from cellcal.calibration.identification.observations import PointObservations, Rows
from cellcal.calibration.identification.parameters import FRAMES, make_layout
from cellcal.service.engineering.bench.contestants import (
    OURS,
    PEERS,
    Absent,
    Answers,
    BenchError,
    Contestant,
    run,
)
from cellcal.service.engineering.bench.results import Result, Topic, take_turns
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
class Measured:
    """Rows of one series in the order of measuring."""

    name: str
    model: RobotModel
    joints_rad: Array  # (N, n)
    positions_m: Array  # (N, 3)


def shipped() -> tuple[Measured, ...]:
    """Return the measurements that come with the package."""
    model, found = load_model(_SHIPPED_ROBOT), []
    for name, file in SHIPPED.items():
        text = files("cellcal.service.engineering.bench.data").joinpath(file).read_text(encoding="utf-8")
        rows = np.array([line.split("\t") for line in text.splitlines()[1:]], dtype=float)
        found.append(Measured(f"UR10, {name}", model, rows[:, :-3], rows[:, -3:]))
    return tuple(found)


def read(path: Path, robot: str) -> Measured:
    """Read positions from any file that ``cellcal identify`` reads.

    Raises
    ------
    BenchError
        No robot named, or lengths rather than positions, which no peer fits.
    """
    if not robot:
        raise BenchError(f"{path} needs a robot.", remedy="Give `--robot`; `cellcal models` lists them.")
    model = load_model(robot)
    seen = read_measurements(path, model, ReadOptions()).observations
    if not isinstance(seen, PointObservations):
        raise BenchError(f"{path} holds {seen.kind}s, which no peer fits.", remedy="Give positions or poses.")
    if len(seen) < _FEWEST:
        raise BenchError(f"{len(seen)} rows are too few to compare.", remedy=f"Give {_FEWEST} or more.")
    return Measured(path.name, model, seen.joints_rad, seen.positions_m)


def run_real(
    seed: int, rounds: int, interpreters: Mapping[str, Path], series: tuple[Measured, ...] = ()
) -> Topic:
    """Draw the rows to fit, the same for all, and judge everybody on the others."""
    results: list[Result] = []
    absent: dict[str, Absent] = {}
    for measured in series or shipped():
        train, held = split(len(measured.joints_rad), seed)
        inputs = _inputs(measured, train, held)

        def run_one(each: Contestant, given: Mapping[str, Array] = inputs) -> Answers | Absent:
            most = _MOST_ROWS.get(each.name, len(given["joints"]))
            fewer = {"joints": given["joints"][:most], "positions": given["positions"][:most]}
            inputs: dict[str, Array] = {**given, **fewer}
            return run(each, "identify", inputs, interpreters)

        def judge_one(each: Contestant, answers: Answers, truth: Array = measured.positions_m[held],
                      name: str = measured.name, rows: int = len(train)) -> Result:  # fmt: skip
            return judge(each, answers, truth, name, min(rows, _MOST_ROWS.get(each.name, rows)))

        able = [each for each in CONTESTANTS if each.name not in absent]
        found, missing = take_turns(able, rounds, run_one, judge_one)
        results += found
        absent.update({each.contestant.name: each for each in missing})
    question = "a real robot and a laser tracker, positions only; mean error on the rows that were not fitted"
    return Topic("real", question, tuple(results), tuple(absent.values()), per_pose=False)


def split(count: int, seed: int) -> tuple[Rows, Rows]:
    """Return rows to fit, drawn at random, and all others: 600, of short series three in five."""
    order = np.random.default_rng(seed).permutation(count)
    fitted = min(TRAIN_ROWS, count * 3 // 5)
    return np.sort(order[:fitted]), np.sort(order[fitted:])


def judge(contestant: Contestant, answers: Answers, truth: Array, case: str, rows: int) -> Result:
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
    return Result(contestant.name, case, rows, float(answers["seconds"]), mean, "mm mean", notes)


def _inputs(measured: Measured, train: Rows, held: Rows) -> dict[str, Array]:
    """Return what everybody is given; those who want a start get base and tool fitted to the nominal robot."""
    joints, positions = measured.joints_rad[train], measured.positions_m[train]
    count = len(train)
    seen = PointObservations(joints, positions, np.full(count, _SIGMA_M), np.zeros(count, dtype=np.intp))
    layout = make_layout(measured.model, "point", 1, level=FRAMES)
    start = first_guess(measured.model, seen)[0]
    placed = estimate(layout, start, Problem.of(start, seen)).state
    return {
        **model_inputs(measured.model, "nominal"),
        "joints": joints,
        "positions": positions,
        "check_joints": measured.joints_rad[held],
        "sigma_m": np.array(_SIGMA_M),
        "device_base_start": placed.devices[0].device_base,
        "target_start": placed.flange_tool[:3, 3],
    }
