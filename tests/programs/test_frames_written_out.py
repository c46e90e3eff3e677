"""Frames and tools that programs set to numbers: each changed point goes with the work on each way to its move."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
from scipy.optimize import least_squares

from cellcal.calibration.arm.kinematics import RobotModel
from cellcal.calibration.compensation.compensate import ProgramDirection
from cellcal.drivers.program_registry import brand_named
from cellcal.service.engineering.programs.batches import read_batches
from cellcal.service.engineering.programs.clone import clone_transfer
from cellcal.service.engineering.programs.compensate import compensation_transfer
from cellcal.service.engineering.programs.files import find_programs
from cellcal.service.engineering.programs.move import move_transfer
from cellcal.service.engineering.programs.project import read_project
from cellcal.service.engineering.programs.result import LEFT, ProgramResult
from tests.programs.external.brands import BRANDS
from tests.programs.external.cells import HandCell
from tests.programs.external.hand_geometry import Array, apart, arm, flange_of, pose
from tests.programs.external.test_clones_and_compensation import CLONE_BASE, real_arm, write_project
from tests.programs.frames_written_out import ARMS, FRAMES, TOOLS, WRITERS, RandomProgram, read_targets

CHANGE = pose((0.006, -0.004, 0.003), (0.01, -0.02, 0.03))
WAYS = 200
PROJECT = 'format = 1\nname = "cell"\n[robot]\nserial = "S1"\nmodel = "{}"\nsmallest_sigma = 1e-6\nstarting_posture_deg = {}\n'


def read_both(brand: str, results: Sequence[ProgramResult]) -> tuple[dict[int, Array], dict[int, Array]]:
    """Return the tips of all moves as they were and as they are."""
    before, after = {}, {}
    for result in results:
        before |= read_targets(brand, result.before.to_bytes().decode())
        after |= read_targets(brand, (result.after or result.before).to_bytes().decode())
    return before, after


def moved_points(brand: str, seed: int, folder: Path) -> tuple[int, int, int]:
    """Move a random program; return how many points changed, how many could have, and all."""
    program = RandomProgram(seed)
    for name, text in WRITERS[brand](program, program.targets(brand)).items():
        (folder / name).write_text(text)
    (folder / "project.toml").write_text(PROJECT.format(ARMS[brand][0], list(ARMS[brand][1][2])))
    project = read_project(folder / "project.toml")
    files = find_programs([str(folder)]).sources
    read = [one.program for some in read_batches(files, lambda _: None, []) for one in some]
    results = list(move_transfer(project, CHANGE, brand_named(brand).configurations).transfer_programs(read))
    before, after = read_both(brand, results)
    seen = program.places_seen(WAYS)
    changed = [number for number in before if max(apart(before[number], after[number])) > 1e-5]
    # BAS(#BASE,0) of KUKA, the first line of the script; ABB's declaration, where no routine sets it otherwise
    begins_in_base = brand in ("kuka", "universal_robots") or (brand == "abb" and not program.sets("frame"))
    for number in changed:
        for frame, _ in seen.get(number, ()):
            assert frame >= 0 or begins_in_base, (brand, seed, number, "nothing said its frame")
            base = FRAMES[frame] if frame >= 0 else np.eye(4)
            distance, angle = apart(base @ after[number], CHANGE @ base @ before[number])
            assert distance < 1e-3, (brand, seed, number)
            assert angle < 1e-4, (brand, seed, number)
    left = sum(status == LEFT for result in results for status in result.status)
    if brand == "universal_robots":  # the poses of frames that are not certain are left, too
        assert len(changed) + left >= len(before), seed
    else:
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
    assert counts[0] > (0.2 if brand == "universal_robots" else 0.7) * counts[1]


@pytest.mark.parametrize("brand", sorted(WRITERS.keys() & BRANDS.keys()))
def test_corrected_and_cloned_points_keep_the_numbers_and_reach_the_work(brand: str, tmp_path: Path) -> None:
    """The controller computes with the numbers as they stand, in the clone's cell, too: the points in them change."""
    spelling, program = BRANDS[brand], RandomProgram(1235)
    nominal = arm(spelling.model)
    reals = real_arm(nominal, 1), real_arm(nominal, 2)
    fixture = pose((0.7, 0.2, 0.1), (0.1, 0.0, 0.3))
    cell = HandCell(spelling, ())
    projects = [
        write_project(cell, tmp_path / serial, real=real, serial=serial, fixture=base @ fixture)
        for serial, real, base in zip("AB", reals, (np.eye(4), CLONE_BASE), strict=True)
    ]
    folder = tmp_path / "programs"
    folder.mkdir()
    for name, text in WRITERS[brand](program, program.targets(brand)).items():
        (folder / name).write_text(text)
    batches = read_batches(find_programs([str(folder)]).sources, lambda _: None, [])
    read = [one.program for some in batches for one in some]
    rules = brand_named(brand).configurations
    ways = (
        (
            compensation_transfer(projects[0], ProgramDirection.UPLOAD, rules),
            (nominal, np.eye(4), reals[0]),
        ),
        (clone_transfer(projects[0], projects[1], rules), (reals[0], CLONE_BASE, reals[1])),
    )
    seen = program.places_seen(WAYS)
    for transfer, (first, carried, second) in ways:
        results = list(transfer.transfer_programs(read))
        before, after = read_both(brand, results)
        changed = [number for number in before if max(apart(before[number], after[number])) > 1e-4]
        assert len(seen.keys() & set(changed)) > 4
        for number in changed:
            if len(seen.get(number, ())) != 1:  # no way leads there
                continue
            ((frame, tool),) = seen[number]
            joints = [
                joints_at(
                    nominal, FRAMES[frame] @ tip @ np.linalg.inv(TOOLS[tool]), program.posture(brand, number)
                )
                for tip in (before[number], after[number])
            ]
            wanted = carried @ flange_of(first, joints[0]) @ TOOLS[tool]
            distance, angle = apart(flange_of(second, joints[1]) @ TOOLS[tool], wanted)
            assert distance < 2e-3
            assert angle < 2e-4


def joints_at(model: RobotModel, flange: Array, near: Array) -> Array:
    """Return the joints of a posture nearby at which a nominal arm has its flange somewhere."""

    def miss(joints: Array) -> Array:
        there = flange_of(model, joints)
        return np.concatenate([there[:3, 3] - flange[:3, 3], (there[:3, :3] - flange[:3, :3]).ravel()])

    found: Array = least_squares(miss, near, xtol=1e-15, ftol=1e-15, gtol=1e-15).x
    return found
