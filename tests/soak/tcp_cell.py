"""Campaign over tools taught by hand on an arm with all its hidden errors, behind the real driver and sockets."""

import asyncio
import tempfile
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.progress import track

from cellcal.calibration.points.touch_design import planned_attitudes
from cellcal.fake_devices.arm import SimulatedArm
from cellcal.fake_devices.fixture import own_flange
from cellcal.procedures.run import RefusalError, Run
from cellcal.procedures.six_point_tcp import six_point_tcp
from tests.procedures.ideal_devices import ScriptedTechnician
from tests.procedures.memory_ledgers import MemoryLedger
from tests.procedures.procedure_scenes import TIP
from tests.soak.calibrated_cell import CalibrationBench, cell_behind_sockets
from tests.soak.campaign_figures import CampaignFigures
from tests.soak.tcp import (
    LEAST_INSIDE,
    MOST_RAD,
    SIGMA_M,
    SIX,
    UNTIL_ENOUGH,
    WOBBLE_RAD,
    TaughtTool,
    attitude_at,
    claimed_tools,
    compare_with_truth,
    describe_refusals,
    share_inside,
    touch_keys,
)
from tests.stories.technician_actions import joints_for

PINS_M = ((0.85, 0.05, -0.1), (0.75, 0.3, 0.1), (0.9, -0.3, -0.2))
AWAY_RAD = 0.03  # from how far a person comes to the pin: backlash is left on whichever flank that makes
_STEP_RAD, _STEPS, _CLOSE_M = 1e-6, 12, 3e-5


async def teach_in_cell(seed: int, folder: Path, settings: dict[str, Any]) -> TaughtTool | None:
    """Teach one tool whose true tip is brought to the pin; None where the touches contradict each other."""
    async with cell_behind_sockets(folder, seed) as bench:
        technician = _JoggingTechnician(bench, seed)
        attitudes = planned_attitudes(settings["max_touches"], MOST_RAD - 2.0 * WOBBLE_RAD)
        for number, planned in enumerate(attitudes, 1):
            for key in touch_keys(number):
                technician.does[key] = technician.touch_pin(planned)
        tool_settings = {"tool_number": 3, "method": "four_point", "touch_sigma_m": SIGMA_M} | settings
        spec = bench.build_spec("six_point_tcp", **tool_settings)
        cell = replace(bench.cell, operator=technician)
        try:
            setup = await six_point_tcp(Run(cell, MemoryLedger()), spec)
        except RefusalError:
            return None
        return compare_with_truth(spec, setup, technician.true_tip_m())


class _JoggingTechnician(ScriptedTechnician):
    """Jogs until the true tip is at the pin, whatever sag, backlash and link errors make of the joints shown."""

    def __init__(self, bench: CalibrationBench, seed: int) -> None:
        super().__init__()
        self._arm: SimulatedArm = bench.fake.world.arms["fanuc"]
        self._pin_m = np.array(PINS_M[seed % len(PINS_M)])
        self._rng = np.random.default_rng([seed, 11])

    def touch_pin(self, planned: np.ndarray) -> Callable[[], None]:
        """Return hands that touch the pin in about this attitude."""
        return lambda: self._creep_to(attitude_at(planned, self._rng, self._pin_m))

    def true_tip_m(self) -> np.ndarray:
        """Return the tip seen from the flange that the arm's last axis and its zero define."""
        tip: np.ndarray = own_flange(self._arm) @ np.array([*TIP, 1.0])
        return tip[:3]

    def _creep_to(self, goal: np.ndarray) -> None:
        arm, near = self._arm, np.array(joints_for(goal))
        arm.put_joints(near + self._rng.uniform(-AWAY_RAD, AWAY_RAD, len(near)))
        arm.put_joints(near)
        for _ in range(_STEPS):
            remaining = _flange_difference(goal, arm.base_flange())
            if np.linalg.norm(remaining[:3]) < _CLOSE_M:
                return
            arm.put_joints(arm.joints_rad + np.linalg.solve(self._jog_directions(), remaining))
        raise AssertionError(f"the tip does not come to the pin: {remaining}")

    def _jog_directions(self) -> np.ndarray:
        arm, joints = self._arm, self._arm.joints_rad
        ends = [arm.flange_at([joints + step, joints - step]) for step in _STEP_RAD * np.eye(len(joints))]
        return np.array([_flange_difference(ahead, behind) / (2.0 * _STEP_RAD) for ahead, behind in ends]).T


def _flange_difference(there: np.ndarray, here: np.ndarray) -> np.ndarray:
    """Return the way of the tip [m] and the rotation vector [rad] (6,) between two flanges that are near."""
    turn = there[:3, :3] @ here[:3, :3].T
    skew = 0.5 * (turn - turn.T)
    way = (there - here) @ np.array([*TIP, 1.0])
    return np.array([*way[:3], skew[2, 1], skew[0, 2], skew[1, 0]])


def tcp_cell(seeds: int) -> CampaignFigures:
    """Six attitudes to 60 degrees, 0.2 mm of touch noise, the world with all it hides; then until it is enough.

    What the arm's own errors do is stated as in the default settings.
    """
    with tempfile.TemporaryDirectory() as folder:
        six = [_run_seed(seed, folder, SIX) for seed in _progress("tools in a cell, six touches", seeds)]
        many = [
            _run_seed(seed, folder, UNTIL_ENOUGH)
            for seed in _progress("tools in a cell, until enough", seeds)
        ]
    line = (
        f"tcp_cell: {_describe_runs('six attitudes to 60 deg', six)}; {_describe_runs('until enough', many)}"
    )
    return CampaignFigures(
        line, min(share_inside(claimed_tools(six)), share_inside(claimed_tools(many))) >= LEAST_INSIDE
    )


def _run_seed(seed: int, folder: str, settings: dict[str, Any]) -> TaughtTool | None:
    return asyncio.run(teach_in_cell(seed, Path(folder), settings))


def _describe_runs(what: str, runs: list[TaughtTool | None]) -> str:
    told_of = claimed_tools(runs)
    errors, u = np.array([(one.error_m, one.u_m) for one in told_of]).T * 1e3
    touches = float(np.mean([one.touches for one in told_of]))
    return (
        f"{what}: error median {np.median(errors):.3f} and 95 % {np.quantile(errors, 0.95):.3f} mm, U median "
        f"{np.median(u):.3f} mm, inside U {share_inside(told_of):.1%} of {len(told_of)} (at least 93.5 %), "
        f"{touches:.1f} touches, {describe_refusals(runs)}"
    )


def _progress(what: str, count: int) -> Any:
    return track(range(1, count + 1), description=what, console=Console(stderr=True))
