"""Recoveries whose wire is not as recorded: an anchor or hook that moved, heat, another zero or scale.

Nothing false may be written: not a new reference of a motor that is as it was, and not a wrong whole turn.
On the simulated twin of the procedure's walk, without sockets.
"""

from collections import Counter
from collections.abc import Callable

import numpy as np
from rich.console import Console
from rich.progress import track

from tests.soak.campaign_figures import CampaignFigures
from tests.unit.helpers.recovery_cases import lose_turns
from tests.unit.helpers.walked_recovery import (
    COUPLING_ERROR,
    STARTS,
    WalkedRecovery,
    first_walk,
    recover_walking,
)
from tests.unit.helpers.wire_world import WireWorld

_STEEL_PER_K = 12e-6


def _draw_direction(rng: np.random.Generator) -> np.ndarray:
    axis = rng.normal(size=3)
    return np.asarray(axis / np.linalg.norm(axis))


def _move_anchor(world: WireWorld, rng: np.random.Generator) -> None:
    world.anchor = world.anchor + _draw_direction(rng) * rng.uniform(0.0003, 0.003)


def _move_anchor_around_j1(world: WireWorld, rng: np.random.Generator) -> None:
    """Move the anchor the way that a turn of J1 would: the change that is hardest to tell from a new motor."""
    around = np.cross([0.0, 0.0, 1.0], world.anchor)
    moved = around / np.linalg.norm(around) * rng.choice([-1.0, 1.0]) * rng.uniform(0.0003, 0.003)
    world.anchor = world.anchor + moved + rng.normal(0, 0.0001, 3)


def _move_hook(world: WireWorld, rng: np.random.Generator) -> None:
    world.hook = world.hook + _draw_direction(rng) * rng.uniform(0.0003, 0.003)


def _warm_up(world: WireWorld, rng: np.random.Generator) -> None:
    """Warm the arm and the wire by up to 30 K, not alike."""
    world.rows[:, 1:3] *= 1.0 + _STEEL_PER_K * rng.uniform(5.0, 30.0)
    world.scale *= 1.0 + _STEEL_PER_K * rng.uniform(0.0, 30.0)
    world.give = world.give * rng.uniform(1.0, 1.1)


def _change_zero(world: WireWorld, rng: np.random.Generator) -> None:
    world.zero += rng.choice([-1.0, 1.0]) * rng.uniform(0.0003, 0.003)


def _change_scale(world: WireWorld, rng: np.random.Generator) -> None:
    world.scale *= 1.0 + rng.choice([-1.0, 1.0]) * rng.uniform(0.0002, 0.001)


def _change_nothing(world: WireWorld, rng: np.random.Generator) -> None:
    """Leave the wire as it was: what must still be accepted."""


CHANGES: dict[str, Callable[[WireWorld, np.random.Generator], None]] = {
    "nothing": _change_nothing,
    "anchor": _move_anchor,
    "anchor around J1": _move_anchor_around_j1,
    "hook": _move_hook,
    "heat": _warm_up,
    "zero": _change_zero,
    "scale": _change_scale,
}


def recover_changed(change: str, seed: int) -> WalkedRecovery:
    """Lose whole turns, change the wire, and recover as the procedure does."""
    at = first_walk(seed % STARTS)
    loss = lose_turns(seed, poses=at, coupling_error=COUPLING_ERROR)
    CHANGES[change](loss.world, np.random.default_rng([seed, 23]))
    loss.captures = loss.capture_poses(at)
    return recover_walking(loss, at)


def is_wrong(done: WalkedRecovery) -> bool:
    """Tell whether something was accepted that is not what happened: only whole turns were lost."""
    return done.recovery.accepted and not done.is_exact()


def changed_wires(seeds: int) -> CampaignFigures:
    """All kinds of changes, ``seeds`` worlds in all: none accepted wrongly, 95 % accepted where nothing changed."""
    accepted, wrong, tried = Counter[str](), Counter[str](), Counter[str]()
    names = list(CHANGES)
    for seed in track(range(1, seeds + 1), description="changed wires", console=Console(stderr=True)):
        change = names[seed % len(names)]
        done = recover_changed(change, seed)
        tried[change] += 1
        accepted[change] += done.recovery.accepted
        wrong[change] += is_wrong(done)
    parts = ", ".join(f"{name} {accepted[name]}/{tried[name]}" for name in names)
    total = sum(wrong.values())
    line = f"changed_wires: {total} of {seeds} accepted wrongly {dict(wrong)}; accepted: {parts}"
    return CampaignFigures(line, total == 0 and accepted["nothing"] >= 0.95 * tried["nothing"])
