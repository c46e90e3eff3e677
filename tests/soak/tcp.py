"""Campaign over tools taught by hand: how far the tip found is from the true one, and whether U says so."""

import asyncio
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np
from rich.console import Console
from rich.progress import track

from calibration.geometry import Pose, exp_rotation, homogeneous
from calibration.points.touch_design import planned_attitudes
from procedures.run import Run
from procedures.six_point_tcp import ToolSetup, six_point_tcp
from tests.procedures.cells import TIP, Scene, touching
from tests.procedures.ledgers import MemoryLedger
from tests.soak.figures import Figures

SIGMA_M, MOST_RAD, WOBBLE_RAD = 0.0002, np.radians(60.0), np.radians(4.0)
MOST_MEDIAN_M, LEAST_INSIDE, MOST_INSIDE = 0.00025, 0.935, 0.97
PIN = np.array([0.7, 0.1, 0.3])
SQUARE = np.diag([1.0, -1.0, -1.0])
SIX = {"min_touches": 6, "max_touches": 6, "rms_limit_m": 0.05}
UNTIL_ENOUGH = {"max_touches": 20, "rms_limit_m": 0.05}


@dataclass(frozen=True)
class Taught:
    """One tool: how far its tip is off, what was stated, and how it came about."""

    error_m: float
    u_m: float
    touches: int
    fixed_plan: int
    again: int

    @property
    def inside(self) -> bool:
        """Whether the true tip is within U of the one found."""
        return self.error_m <= self.u_m


def teach(seed: int, settings: dict[str, Any]) -> Taught:
    """Teach one tool whose technician follows the advice within a few degrees and misses the pin by chance."""
    made = touching(method="four_point", touch_sigma_m=SIGMA_M, **settings)
    random = np.random.default_rng(seed)
    attitudes = planned_attitudes(settings["max_touches"], MOST_RAD - 2.0 * WOBBLE_RAD)
    for number, planned in enumerate(attitudes, 1):
        for key in ("touch" if number == 1 else f"touch_{number}", f"touch_anew_{number}"):
            made.hands.does[key] = _hands(made, planned, random)
    setup: ToolSetup = asyncio.run(six_point_tcp(Run(made.cell, MemoryLedger()), made.spec))
    error_m = float(np.linalg.norm(np.array(setup.tip.tip_in_flange_m) - TIP))
    fixed = setup.fixed_plan_touches
    assert fixed is not None
    return Taught(error_m, setup.tip.tip_u_in_space_m, setup.touches, fixed, len(setup.set_aside))


def _hands(made: Scene, planned: np.ndarray, random: np.random.Generator) -> Callable[[], None]:
    def touch() -> None:
        wobble = random.normal(size=3)
        wobble *= random.uniform(0.0, WOBBLE_RAD) / np.linalg.norm(wobble)
        rotation = SQUARE @ planned @ exp_rotation(wobble)
        place = PIN + random.normal(scale=SIGMA_M, size=3)
        made.arm.taught = Pose.from_matrix(homogeneous(rotation, place - rotation @ np.array(TIP)))

    return touch


def tcp(seeds: int) -> Figures:
    """Six attitudes to 60 degrees, 0.2 mm of touch noise; then as many as class B takes."""
    six = [teach(seed, SIX) for seed in _seeds("tools, six touches", seeds)]
    many = [teach(seed, UNTIL_ENOUGH) for seed in _seeds("tools, until enough", max(seeds // 4, 1))]
    median, inside = float(np.median([one.error_m for one in six])), _inside(six)
    taken, planned = _mean(many, "touches"), _mean(many, "fixed_plan")
    line = (
        f"tcp: six attitudes to 60 deg, {seeds} runs: error median {median * 1e3:.3f} mm (at most 0.25), inside U "
        f"{inside:.1%} (93.5 to 97 %), touched again {_mean(six, 'again'):.3f} a run; until class B holds: "
        f"{taken:.1f} touches, fixed plan {planned:.0f}, inside U {_inside(many):.1%} of {len(many)}"
    )
    reached = median <= MOST_MEDIAN_M and LEAST_INSIDE <= inside <= MOST_INSIDE
    return Figures(line, reached and _inside(many) >= LEAST_INSIDE)


def _inside(runs: list[Taught]) -> float:
    return float(np.mean([one.inside for one in runs]))


def _mean(runs: list[Taught], name: str) -> float:
    return float(
        np.mean([{"touches": r.touches, "fixed_plan": r.fixed_plan, "again": r.again}[name] for r in runs])
    )


def _seeds(what: str, count: int) -> Iterable[int]:
    return track(range(1, count + 1), description=what, console=Console(stderr=True))
