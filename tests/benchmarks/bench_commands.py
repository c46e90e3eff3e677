"""How long commands take, whole: ``python -m tests.benchmarks.bench_commands [FILE ROBOT ...]``.

Wall and processor time of a command with everything it starts, the least of a few runs: versions, lists, and
identifications of the series that ships with the tests and of 10 000 simulated rows; further files may be named.
"""

import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from tests.unit.helpers.simulated_arm import tracker_points

_SERIES_B = Path(__file__).parents[1] / "data" / "ipa_ur10" / "series_b_joint_configurations.csv"
_SIMULATED_ROWS = 10_000


def write_simulated(folder: Path) -> Path:
    """Write positions of a simulated UR10 as an instrument would."""
    rows = tracker_points("ur10", _SIMULATED_ROWS, seed=11).observations
    path = folder / "simulated.csv"
    head = ",".join([*(f"q{k}_deg" for k in range(1, 7)), "x_mm", "y_mm", "z_mm"])
    table = np.hstack([np.rad2deg(rows.joints_rad), 1e3 * rows.positions_m])
    np.savetxt(path, table, fmt="%.5f", delimiter=",", header=head, comments="")
    return path


def time_command(arguments: Sequence[str], runs: int) -> tuple[float, float]:
    """Return the least wall and processor time [s] of a command."""
    least_wall = least_cpu = float("inf")
    for _ in range(runs):
        before, began = os.times(), time.perf_counter()
        subprocess.run([sys.executable, "-m", "cellcal", *arguments], stdout=subprocess.DEVNULL, check=True)
        wall, after = time.perf_counter() - began, os.times()
        used = after.children_user + after.children_system - before.children_user - before.children_system
        least_wall, least_cpu = min(least_wall, wall), min(least_cpu, used)
    return least_wall, least_cpu


def main() -> None:
    """Print a line a command."""
    words = sys.argv[1:]
    with tempfile.TemporaryDirectory() as folder:
        commands = [
            (["--version"], 5),
            (["--help"], 5),
            (["procedures"], 5),
            (["identify", str(_SERIES_B), "--robot", "ur10", "--train-rows", "600"], 3),
            (["identify", str(write_simulated(Path(folder))), "--robot", "ur10"], 3),
            *(
                (["identify", path, "--robot", robot], 3)
                for path, robot in zip(words[::2], words[1::2], strict=True)
            ),
        ]
        sys.stdout.write(f"load {os.getloadavg()[0]:.1f}, {os.cpu_count()} processors\n")
        for arguments, runs in commands:
            wall_s, cpu_s = time_command(arguments, runs)
            shown = " ".join(Path(word).name if "/" in word else word for word in arguments)
            sys.stdout.write(f"{wall_s:7.2f} s wall {cpu_s:7.2f} s of the processors  cellcal {shown}\n")
            sys.stdout.flush()


if __name__ == "__main__":
    main()
