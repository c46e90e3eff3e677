"""Calibrations of every robot of the catalogue find what was hidden; the story of the demo on many of them."""

import sys
import zlib

import numpy as np
from rich.console import Console
from rich.progress import track

from cellcal.calibration.arm.robot_models.catalogue_index import usable_names
from tests.soak.campaign_figures import CampaignFigures
from tests.soak.stories import tell_all
from tests.unit.helpers.hidden_arm import Calibrated, calibrate

_POINTS = 40
_WITHIN = (
    1.3  # times the noise, of readings that no fit has seen: the median; arms of eight axes need more points
)
_COVERED = 0.93  # of readings within the radius that is stated to hold 95 %
_FAR = 5.0  # deviations of a zero: of two thousand, none by chance
STORIES = ("kuka_kr10_r1100_2", "abb_irb1600_6_12", "staubli_tx2_90l", "yaskawa_gp25", "fanuc_r2000ic_210f")


def catalogue_arms(count: int) -> CampaignFigures:
    """Hide errors in every robot, identify it from 40 points, and look at 200 further ones; zeros alone as well."""
    names = sorted(usable_names())
    some = names[:: max(len(names) // count, 1)][:count]
    found, zeros = [], []
    for name in track(some, description="arms", console=Console(stderr=True)):
        seed = zlib.crc32(name.encode()) % 1000
        found.append(calibrate(name, seed=seed, points=_POINTS))
        zeros.append(calibrate(name, seed=seed, points=_POINTS, geometry=0.0, level=1))
        _tell_if_poor(name, found[-1], zeros[-1])
    held_out = float(np.median([each.held_out for each in found]))
    covered = float(np.mean([each.covered for each in found]))
    deviations = [value for each in zeros for value in each.zeros.values()]
    worst = float(np.abs(deviations).max())
    line = (
        f"catalogue_arms: {len(found)} arms, unseen readings off by {held_out:.3f} times the noise (median; at most "
        f"{_WITHIN}), {covered:.1%} within the stated 95 % radius, {len(deviations)} zeros off by "
        f"{np.sqrt(np.mean(np.square(deviations))):.2f} deviations (RMS), {worst:.1f} at most"
    )
    return CampaignFigures(line, held_out <= _WITHIN and covered >= _COVERED and worst < _FAR)


def _tell_if_poor(name: str, found: Calibrated, zeros: Calibrated) -> None:
    worst = max((abs(value) for value in zeros.zeros.values()), default=0.0)
    if found.held_out > _WITHIN or found.covered < 0.9 or worst > 4.0:
        sys.stdout.write(
            f"  {name}: {found.held_out:.3f} times the noise, {found.covered:.1%} covered, "
            f"worst zero {worst:.1f} deviations\n"
        )


def demo_robots(seeds: int) -> CampaignFigures:
    """Tell the demo's story on robots of five makers: every accepted recovery is exact."""
    exact, refused = 0, 0
    for robot in STORIES:
        stories = tell_all("turns", seeds, more=("--robot", robot))
        accepted = [story for story in stories if story["verdict"] == "PASS"]
        right = [s for s in accepted if all(j["turns_restored"] == j["turns_lost"] for j in s["joints"])]
        sys.stdout.write(f"  {robot}: {len(right)} of {len(accepted)} accepted exact, of {seeds}\n")
        exact, refused = exact + len(right), refused + len(accepted)
    line = f"demo_robots: {exact} of {refused} accepted fixes exact, {refused} of {seeds * len(STORIES)} accepted"
    return CampaignFigures(line, exact == refused and refused >= 0.8 * seeds * len(STORIES))
