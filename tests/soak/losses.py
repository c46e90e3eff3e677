"""Campaigns over recoveries on the simulated twin of the procedure's walk: sag, backlash, coupling errors.

No sockets: `stories` runs the procedure itself, through drivers and sockets.
"""

from collections.abc import Iterable

import numpy as np
from rich.console import Console
from rich.progress import track

from tests.soak.campaign_figures import CampaignFigures
from tests.unit.helpers.walked_recovery import loss_of, recover_walking

SMALL = 0.04  # of the walk, where geometry is poor
TWIN = "the simulated twin of the procedure's walk"


def many(seeds: int) -> CampaignFigures:
    """Turn-only losses, every fifth with a length that is wrong by 8 mm: no wrong accept, 95 % accepted."""
    accepted = wrong = inexact = 0
    captures = []
    for seed in _seed_range("turn-only losses", seeds):
        loss, at = loss_of(seed, outlier=seed % 5 == 0)
        done = recover_walking(loss, at)
        accepted += done.recovery.accepted
        wrong += done.is_wrong()
        inexact += done.recovery.accepted and not done.is_exact()
        captures.append(done.captures + done.again)
    line = (
        f"many, {TWIN}: {wrong} wrong accepts and {inexact} not exact of {accepted} accepted, {accepted} of {seeds} "
        f"accepted (at least 95 %), captures median {int(np.median(captures))}, most {max(captures)}"
    )
    return CampaignFigures(line, wrong == inexact == 0 and accepted >= 0.95 * seeds)


def outlier(seeds: int) -> CampaignFigures:
    """One length wrong by 8 mm: not accepted as it is, named, and measured again it is accepted."""
    refused = named = exact = 0
    for seed in _seed_range("outlier of 8 mm", seeds):
        loss, at = loss_of(seed, outlier=True)
        found = loss.recover_turns()
        refused += not found.accepted
        named += found.suspect_capture == seed % len(at)
        exact += recover_walking(loss, at).is_exact()
    line = (
        f"outlier: {refused} of {seeds} refused, the wrong capture named at once in {named}, "
        f"accepted and exact once measured again in {exact}"
    )
    return CampaignFigures(line, refused == seeds and exact >= 0.95 * seeds)


def poor(seeds: int) -> CampaignFigures:
    """The walk in a small box: always refused, with the poses still needed."""
    refused = told_count = 0
    for seed in _seed_range("poor geometry", seeds):
        found = loss_of(seed, shrunk=SMALL)[0].recover_turns()
        refused += not found.accepted
        told_count += found.poses_needed > 0 and bool(found.reason)
    line = f"poor, {TWIN}: {refused} of {seeds} refused, reason and poses still needed told in {told_count}"
    return CampaignFigures(line, refused == told_count == seeds)


def exchanged(seeds: int) -> CampaignFigures:
    """One motor exchanged, its new zero anywhere in the turn, every third near a whole one: no wrong accept."""
    accepted = wrong = whole = 0
    for seed in _seed_range("one motor exchanged", seeds):
        rng = np.random.default_rng([seed, 6])
        near = seed % 3 == 0
        part = rng.choice([-1.0, 1.0]) * (rng.uniform(0.05, 0.15) if near else rng.uniform(0.1, 0.5))
        loss, at = loss_of(seed, fractions=np.eye(6)[seed % 6] * part)
        done = recover_walking(loss, at)
        accepted += done.recovery.accepted
        wrong += done.is_wrong()
        whole += done.recovery.accepted and done.recovery.mode == "turns"
    line = (
        f"exchanged: {wrong} wrong accepts of {accepted} accepted ({accepted} of {seeds}), "
        f"taken for whole turns within the stated blind zone in {whole}"
    )
    # J1 and J6 are not named without a report: a wire whose anchor or hook moved looks the same.
    return CampaignFigures(line, wrong == 0 and accepted >= 0.6 * seeds)


def _seed_range(what: str, count: int) -> Iterable[int]:
    return track(range(1, count + 1), description=what, console=Console(stderr=True))
