"""Campaigns over whole stories: the real command, its own fake cell, its own process, one seed each."""

import asyncio
import json
import sys
from typing import Any

from rich.console import Console
from rich.progress import track

from tests.soak.campaign_figures import CampaignFigures

Story = dict[str, Any]
TIME_FACTOR = "1000"
AT_ONCE = 5  # a story waits more than it computes
MOST_ROBOT_TIME_S, MOST_CAPTURES = 600.0, 19


def turns(seeds: int) -> CampaignFigures:
    """Turn-only loss: all accepted fixes exact, at least 95 % accepted."""
    stories = tell_all("turns", seeds)
    accepted = [story for story in stories if story["verdict"] == "PASS"]
    exact = [story for story in accepted if all(_is_exact(joint) for joint in story["joints"])]
    captures = sorted(story["captures"] for story in accepted)
    line = (
        f"turns: {len(exact)} of {len(accepted)} accepted fixes exact, {len(accepted)} of {seeds} accepted "
        f"({len(accepted) / seeds:.1%}; at least 95 %), captures median {captures[len(captures) // 2]}, "
        f"most {captures[-1]}"
    )
    return CampaignFigures(line, len(exact) == len(accepted) and len(accepted) >= 0.95 * seeds)


def recovery_time(seeds: int) -> CampaignFigures:
    """Turn-only loss as fast as a robot is: under ten minutes by the world's clock, under 20 captures.

    Takes a quarter of an hour for five seeds; on a machine that has other things to do its waiting counts, too.
    """
    stories = tell_all("turns", seeds, time_factor="1")
    accepted = [story for story in stories if story["verdict"] == "PASS"]
    exact = [story for story in accepted if all(_is_exact(joint) for joint in story["joints"])]
    clock_s = [float(story["clock_s"]) for story in accepted] or [float("inf")]
    captures = [int(story["captures"]) for story in accepted] or [MOST_CAPTURES + 1]
    line = (
        f"recovery_time: {len(exact)} of {seeds} recoveries exact in real time, {min(clock_s) / 60:.1f} to "
        f"{max(clock_s) / 60:.1f} min of robot time by the world's clock (under {MOST_ROBOT_TIME_S / 60:.0f}), "
        f"{min(captures)} to {max(captures)} captures (at most {MOST_CAPTURES})"
    )
    fast = max(clock_s) < MOST_ROBOT_TIME_S and max(captures) <= MOST_CAPTURES
    return CampaignFigures(line, fast and len(exact) == seeds)


def motor(seeds: int) -> CampaignFigures:
    """One motor exchanged: its offset inside its stated U (k=2) in at least 93 %, the others exact."""
    stories = tell_all("motor:J3", seeds)
    accepted = [story for story in stories if story["verdict"] == "PASS"]
    inside = [story for story in accepted if _is_inside(story["joints"][2])]
    others = [
        story for story in accepted if all(_is_exact(j) for i, j in enumerate(story["joints"]) if i != 2)
    ]
    line = (
        f"motor: offset inside U in {len(inside)} of {seeds} seeds ({len(inside) / seeds:.1%}; at least 93 %), "
        f"other joints exact in {len(others)} of {len(accepted)} accepted"
    )
    return CampaignFigures(line, len(inside) >= 0.93 * seeds and len(others) == len(accepted))


def all_references(seeds: int) -> CampaignFigures:
    """Every reference lost: all offsets inside their stated U."""
    stories = [story for story in tell_all("all", seeds) if story["verdict"] == "PASS"]
    joints = [joint for story in stories for joint in story["joints"]]
    inside = sum(_is_inside(joint) for joint in joints)
    line = (
        f"all: {len(stories)} of {seeds} accepted, {inside} of {len(joints)} offsets inside U (at least 93 %)"
    )
    return CampaignFigures(line, inside >= 0.93 * len(joints) and len(stories) >= 0.9 * seeds)


def crash(seeds: int) -> CampaignFigures:
    """Geometry changed: refused, full calibration advised, nothing written."""
    stories = tell_all("crash", seeds)
    refused = [s for s in stories if s["verdict"] == "REFUSED"]
    advised = [s for s in refused if "full calibration" in s["reason"]]
    line = f"crash: {len(refused)} of {seeds} refused, full calibration advised in {len(advised)}"
    return CampaignFigures(line, len(refused) == seeds and len(advised) >= 0.95 * seeds)


def memory(seeds: int) -> CampaignFigures:
    """The controller forgot, or an old backup was loaded: what was right before is right again, exactly."""
    stories = [*tell_all("memory", seeds), *tell_all("backup", seeds)]
    accepted = [story for story in stories if story["verdict"] == "PASS"]
    exact = [story for story in accepted if all(_is_exact(joint) for joint in story["joints"])]
    line = (
        f"memory: {len(exact)} of {len(accepted)} accepted exact, {len(accepted)} of {len(stories)} accepted"
    )
    return CampaignFigures(line, len(exact) == len(accepted) and len(accepted) >= 0.95 * len(stories))


def swap(seeds: int) -> CampaignFigures:
    """Another arm under the same cabinet: never mastered."""
    stories = tell_all("swap", seeds)
    refused = [story for story in stories if story["verdict"] == "REFUSED"]
    line = f"swap: {len(refused)} of {seeds} refused"
    return CampaignFigures(line, len(refused) == seeds)


def tell_all(
    loss: str, seeds: int, *, time_factor: str = TIME_FACTOR, more: tuple[str, ...] = ()
) -> list[Story]:
    """Tell the story of one loss for seeds 1..n, a few at once; ``more`` are further words of the command."""
    return asyncio.run(_run_all(loss, seeds, ("--time-factor", time_factor, *more)))


async def _run_all(loss: str, seeds: int, more: tuple[str, ...]) -> list[Story]:
    room = asyncio.Semaphore(AT_ONCE)

    async def run_seed(seed: int) -> Story:
        async with room:
            return await _run_story(loss, seed, more)

    tasks = [asyncio.create_task(run_seed(seed)) for seed in range(1, seeds + 1)]
    console = Console(stderr=True)
    finished = asyncio.as_completed(tasks)
    for next_one in track(list(finished), description=f"{loss}, {seeds} seeds", console=console):
        await next_one
    return [task.result() for task in tasks]


async def _run_story(loss: str, seed: int, more: tuple[str, ...]) -> Story:
    command = ["-m", "cellcal", "demo", "--headless", "--json", "--loss", loss, "--seed", str(seed)]
    process = await asyncio.create_subprocess_exec(
        sys.executable, *command, *more,
        stdout=asyncio.subprocess.PIPE, stderr=asyncio.subprocess.PIPE,
    )  # fmt: skip
    out, err = await process.communicate()
    if not out.strip():
        last = err.decode(errors="replace").strip().splitlines()[-4:]
        sys.stderr.write(f"{loss}, seed {seed}: exit {process.returncode}: {' / '.join(last)}\n")
        return {"verdict": "BROKEN", "reason": " / ".join(last), "joints": [], "captures": 0}
    story: Story = json.loads(out)
    if story["verdict"] != "PASS" and loss not in ("crash", "swap"):
        sys.stderr.write(f"{loss}, seed {seed}: {story['verdict']}: {story['reason']}\n")
    return story


def _is_exact(joint: dict[str, Any]) -> bool:
    return joint["turns_restored"] == joint["turns_lost"] and joint["offset_error_rad"] == 0.0


def _is_inside(joint: dict[str, Any]) -> bool:
    return abs(joint["offset_error_rad"]) <= joint["offset_u_rad"]
