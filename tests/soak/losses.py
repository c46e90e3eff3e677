"""Campaigns over the mathematics of turn recovery, on a simulated world of its own: hundreds of losses a minute."""

from collections.abc import Iterable

from rich.console import Console
from rich.progress import track

from tests.soak.figures import Figures
from tests.unit.helpers.recovery_cases import kit, lose

OUTLIER_M = 0.008
BOX_POSES = 6


def outlier(seeds: int) -> Figures:
    """One length wrong by 8 mm: never accepted, the capture is named, and measured again it is accepted."""
    refused = named = exact = 0
    for seed in _seeds("outlier of 8 mm", seeds):
        loss = lose(seed, 16)
        whole, wrong = list(loss.captures), seed % 16
        capture = whole[wrong]
        loss.captures[wrong] = type(capture)(capture.counts, capture.length_m + OUTLIER_M, capture.sigma_m)
        found = loss.recover()
        refused += not found.accepted
        named += found.suspect_capture == wrong
        loss.captures = whole
        again = loss.recover()
        exact += again.accepted and tuple(again.turns) == tuple(int(turn) for turn in loss.true_turns)
    line = (
        f"outlier: {refused} of {seeds} refused, the wrong capture named in {named}, "
        f"accepted and exact once measured again in {exact}"
    )
    return Figures(line, refused == seeds and named >= 0.95 * seeds and exact >= 0.95 * seeds)


def poor(seeds: int) -> Figures:
    """A few poses in a small box: always refused, with the poses still needed."""
    refused = told = 0
    for seed in _seeds("poor geometry", seeds):
        near = kit()[:1] + 0.05 * (kit()[:BOX_POSES] - kit()[:1])
        found = lose(seed, poses=near).recover()
        refused += not found.accepted
        told += found.poses_needed > 0 and bool(found.reason)
    line = f"poor: {refused} of {seeds} refused, reason and poses still needed told in {told}"
    return Figures(line, refused == told == seeds)


def many(seeds: int) -> Figures:
    """Turn-only losses: accepted fixes are exact."""
    accepted = exact = 0
    for seed in _seeds("turn-only losses", seeds):
        loss = lose(seed, 16)
        found = loss.recover()
        accepted += found.accepted
        exact += found.accepted and found.turns == tuple(int(turn) for turn in loss.true_turns)
    line = f"many: {exact} of {accepted} accepted fixes exact, {accepted} of {seeds} accepted (at least 95 %)"
    return Figures(line, exact == accepted and accepted >= 0.95 * seeds)


def _seeds(what: str, count: int) -> Iterable[int]:
    return track(range(1, count + 1), description=what, console=Console(stderr=True))
