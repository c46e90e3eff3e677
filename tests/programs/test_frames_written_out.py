"""Frames and tools that programs set to numbers: each changed point goes with the work on each way to its move."""

from pathlib import Path

import numpy as np
import pytest

from cellcal.drivers.program_registry import brand_named
from cellcal.service.engineering.programs.batches import read_batches
from cellcal.service.engineering.programs.files import find_programs
from cellcal.service.engineering.programs.move import move_transfer
from cellcal.service.engineering.programs.project import read_project
from cellcal.service.engineering.programs.result import LEFT
from tests.programs.external.brands import BRANDS
from tests.programs.external.hand_geometry import apart, pose
from tests.programs.frames_written_out import FRAMES, WRITERS, RandomProgram, read_targets

CHANGE = pose((0.006, -0.004, 0.003), (0.01, -0.02, 0.03))
WAYS = 200
PROJECT = 'format = 1\nname = "cell"\n[robot]\nserial = "S1"\nmodel = "{}"\nsmallest_sigma = 1e-6\n'


def moved_points(brand: str, seed: int, folder: Path) -> tuple[int, int, int]:
    """Move a random program; return how many points changed, how many could have, and all."""
    program = RandomProgram(seed)
    for name, text in WRITERS[brand](program, program.targets(brand)).items():
        (folder / name).write_text(text)
    (folder / "project.toml").write_text(PROJECT.format(BRANDS[brand].model))
    project = read_project(folder / "project.toml")
    files = find_programs([str(folder)]).sources
    read = [one.program for some in read_batches(files, lambda _: None, []) for one in some]
    results = list(move_transfer(project, CHANGE, brand_named(brand).configurations).transfer_programs(read))
    before, after = ({}, {})
    for result in results:
        before |= read_targets(brand, result.before.to_bytes().decode())
        after |= read_targets(brand, (result.after or result.before).to_bytes().decode())
    seen = program.places_seen(WAYS)
    changed = [number for number in before if max(apart(before[number], after[number])) > 1e-5]
    # BAS(#BASE,0) of KUKA; ABB's declaration, where no routine sets it otherwise
    begins_in_base = brand == "kuka" or (brand == "abb" and not program.sets("frame"))
    for number in changed:
        for frame, _ in seen.get(number, ()):
            assert frame >= 0 or begins_in_base, (brand, seed, number, "nothing said its frame")
            base = FRAMES[frame] if frame >= 0 else np.eye(4)
            distance, angle = apart(base @ after[number], CHANGE @ base @ before[number])
            assert distance < 1e-3, (brand, seed, number)
            assert angle < 1e-4, (brand, seed, number)
    left = sum(status == LEFT for result in results for status in result.status)
    assert len(changed) + left == len(before), (brand, seed)
    certain = [number for number, some in seen.items() if len(some) == 1 and -1 not in next(iter(some))]
    return len(changed), len(certain), len(before)


@pytest.mark.parametrize("brand", sorted(WRITERS))
def test_no_point_is_changed_but_with_the_work_on_every_way(brand: str, tmp_path: Path) -> None:
    counts = np.zeros(3, dtype=int)
    for seed in range(12):
        folder = tmp_path / str(seed)
        folder.mkdir()
        counts += moved_points(brand, seed, folder)
    assert counts[0] > 0.7 * counts[1]
