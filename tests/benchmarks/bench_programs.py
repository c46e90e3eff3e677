"""How long a line of programs takes to clone: ``python -m tests.benchmarks.bench_programs --points 4000``."""

import argparse
import resource
import sys
import tempfile
import time
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from cellcal.drivers.fanuc.program_files.programs import BRAND
from cellcal.drivers.programs.positions import PositionChange, Positions, ProgramFrames
from cellcal.service.engineering.programs.clone import clone_transfer
from tests.unit.helpers.cloned_cells import MODEL, DrawnCell, work_postures

_DRAWN = 20_000  # different postures


@dataclass(frozen=True, eq=False)
class InMemoryProgram:
    """A program without a file: what is measured is the engine, not a reader."""

    positions: Positions
    brand: str = "fanuc"
    name: str = "KEPT"
    remarks: tuple = ()
    frames: ProgramFrames = ProgramFrames()  # noqa: RUF009  frozen and empty

    def to_bytes(self) -> bytes:
        return b""

    def with_changes(self, change: PositionChange) -> "InMemoryProgram":
        poses = self.positions.frame_tip.copy()
        poses[change.rows] = change.frame_tip
        return InMemoryProgram(replace(self.positions, frame_tip=poses))


def program_of_points(frame_tip: np.ndarray, texts: tuple[str, ...]) -> InMemoryProgram:
    """Return taught points as a program."""
    n = len(frame_tip)
    one = ("1",) * n
    joints, none = np.full((n, 6), np.nan), np.zeros((n, 0))
    numbers = np.arange(n), np.ones(n, dtype=np.int64)
    names = tuple(f"P[{i}]" for i in range(n))
    rounded = np.full(n, 1e-6), np.full(n, 2e-5)
    return InMemoryProgram(
        Positions(names, ("cartesian",) * n, *numbers, frame_tip, joints, none, one, one, texts, *rounded)
    )


def main() -> None:
    """Print seconds, and memory beside that of the points themselves."""
    options = argparse.ArgumentParser(description=__doc__)
    options.add_argument("--points", type=int, default=1200, help="of all programs together")
    options.add_argument("--each", type=int, default=40, help="points of a program")
    chosen = options.parse_args()
    count, each = chosen.points, chosen.each
    with tempfile.TemporaryDirectory() as folder:
        master, clone = DrawnCell("master", 1), DrawnCell("clone", 1001)
        carrier = clone_transfer(
            master.write_project(Path(folder) / "m"),
            clone.write_project(Path(folder) / "c"),
            BRAND.configurations,
        )
    joints = work_postures(master, min(count, _DRAWN), 1)
    texts = BRAND.configurations.write_configurations(MODEL, joints, ["N U T, 0, 0, 0"] * len(joints))
    times = -(-count // len(joints))
    poses, words = np.tile(master.recorded_tips(joints), (times, 1, 1))[:count], (texts * times)[:count]
    programs = [program_of_points(poses[i : i + each], words[i : i + each]) for i in range(0, count, each)]
    began, used = time.perf_counter(), time.process_time()
    results = carrier.transfer_programs(programs)
    wall, cpu = time.perf_counter() - began, time.process_time() - used
    left_count = sum(result.status_counts["left"] for result in results)
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e3
    sys.stdout.write(
        f"{len(programs)} programs, {count} points: {wall:.2f} s, {cpu:.2f} s of the processor, at most "
        f"{peak:.0f} MB with everything, {left_count} left\n"
    )


if __name__ == "__main__":
    main()
