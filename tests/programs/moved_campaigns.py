"""Generated programs of FANUC and Yaskawa, moved and executed before and after: `tests.programs.moved_path`."""

from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

from cellcal.drivers.fanuc.program_files.programs import BRAND as FANUC
from cellcal.drivers.programs.brands import ProgramBrand
from cellcal.drivers.yaskawa.program_files.programs import BRAND as YASKAWA
from cellcal.service.engineering.programs.move import move_transfer
from cellcal.service.engineering.programs.project import Project, read_project
from tests.programs import fanuc_motion, jobs_to_move, listings_to_move, yaskawa_motion
from tests.programs.moved_path import PathTally, compare_paths

Execute = Callable[[str], list[Any]]


def fanuc_moved(seeds: Iterable[int], folder: Path) -> PathTally:
    """Move generated listings and compare their paths."""
    cell, total = _project_of(folder, listings_to_move.PROJECT), PathTally()
    for seed in seeds:
        case = listings_to_move.generate_listing(seed)
        total.add_tally(
            _compare_moved(
                seed,
                cell,
                FANUC,
                case,
                lambda text, its=case: fanuc_motion.FanucInterpreter(text, its.controller).run(),
            )
        )
    return total


def yaskawa_moved(seeds: Iterable[int], folder: Path) -> PathTally:
    """Move generated jobs and compare their paths."""
    cell, total = _project_of(folder, jobs_to_move.PROJECT), PathTally()
    frames = jobs_to_move.FRAMES
    for seed in seeds:
        case = jobs_to_move.generate_job(seed)
        total.add_tally(
            _compare_moved(
                seed,
                cell,
                YASKAWA,
                case,
                lambda text, its=case: yaskawa_motion.YaskawaInterpreter(text, frames, its.variables).run(),
            )
        )
    return total


def _project_of(folder: Path, text: str) -> Project:
    file = folder / "project.toml"
    file.write_text(text, encoding="utf-8")
    return read_project(file)


def _compare_moved(seed: int, cell: Project, brand: ProgramBrand, case: Any, execute: Execute) -> PathTally:
    program = brand.read(f"m{seed}{brand.suffixes[0]}", case.text.encode("cp437"))
    result = move_transfer(cell, case.change, brand.configurations, joints="keep").transfer_programs(
        [program]
    )[0]
    after = result.after.to_bytes().decode("cp437")
    return compare_paths(seed, result, (execute(case.text), execute(after)), case.change, case.plain)
