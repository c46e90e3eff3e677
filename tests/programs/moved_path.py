"""A program is moved, both are executed by an independent interpreter, and the paths of the tip are compared.

Every motion of the new program ends where the work's move takes the old one; or a position that it depends on is
named, as left or as a finding, and the exit code is 4.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from cellcal.service.engineering.programs.result import ProgramResult
from cellcal.service.exit_codes import ExitCode

FAR_M, FAR_RAD = 5e-5, 5e-4  # numbers of a file are rounded to 1e-6 m and 2e-5 rad; shifts make more of it
GEOMETRY = (
    "unreachable", "no posture", "no joints inside", "joint ", "near a singularity", "the wrist would flip",
    "the arm would change its posture", "it would need another RCONF",
)  # fmt: skip


@dataclass
class PathTally:
    """What a campaign found."""

    programs: int = 0
    motions: int = 0
    moved: int = 0  # motions that end where they should
    named: int = 0  # motions that do not, and are named
    wrong: list[str] = field(default_factory=list)
    needless: list[str] = field(default_factory=list)  # places that are left without need

    def add_tally(self, other: "PathTally") -> None:
        """Take the figures of another part."""
        self.programs += other.programs
        self.motions += other.motions
        self.moved += other.moved
        self.named += other.named
        self.wrong += other.wrong
        self.needless += other.needless


def compare_paths(
    seed: int, result: ProgramResult, paths: tuple[Sequence, Sequence], change: np.ndarray, plain: set[str]
) -> PathTally:
    """Compare two executed programs; ``plain`` are positions that nothing but a geometric reason may leave."""
    before, after = paths
    tally = PathTally(programs=1, motions=len(before))
    excluded_points = dict(result.excluded_points)
    named = {*excluded_points, *(finding.point for finding in result.findings)}
    if len(before) != len(after):
        tally.wrong.append(f"seed {seed}: {len(before)} motions became {len(after)}")
    for old, new in zip(before, after, strict=False):
        expected_tip = change @ old.base_tip
        apart = float(np.linalg.norm(expected_tip[:3, 3] - new.base_tip[:3, 3]))
        trace = float(np.trace(expected_tip[:3, :3].T @ new.base_tip[:3, :3]))
        turned = float(np.arccos(np.clip((trace - 1) / 2, -1, 1)))
        if apart < FAR_M and turned < FAR_RAD:
            tally.moved += 1
        elif named & set(old.names) and result.exit_code is ExitCode.REFUSED:
            tally.named += 1
        else:
            tally.wrong.append(f"seed {seed}: {old.line!r} of {old.names} misses by {apart * 1e3:.3f} mm")
    tally.needless += [
        f"seed {seed}: {name} is left: {excluded_points[name]}"
        for name in sorted(plain & excluded_points.keys())
        if not excluded_points[name].startswith(GEOMETRY)
    ]
    return tally
