"""One program taught in one fake cell, cloned for another, and run there: what its points really miss."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from cellcal.drivers.fanuc.program_files.ls_program import LsProgram, read_ls
from cellcal.drivers.fanuc.program_files.programs import BRAND
from cellcal.service.engineering.programs.clone import clone_programs
from cellcal.service.engineering.programs.project import Project
from cellcal.service.engineering.programs.result import LEFT, ProgramResult
from tests.unit.helpers.cloned_cells import DrawnCell, fanuc_listing, work_postures


@dataclass(frozen=True, eq=False)
class ClonedCells:
    """A master and its clone, calibrated, and a program taught in the master's cell."""

    master: DrawnCell
    clone: DrawnCell
    master_project: Project
    clone_project: Project
    joints: np.ndarray
    program: LsProgram

    @classmethod
    def make(
        cls, seed: int, folder: Path, *, points: int = 40, poses: int = 100, around: float = 0.0
    ) -> "ClonedCells":
        """Draw two cells; ``around`` turns the clone's cell about its robot."""
        master, clone = DrawnCell("master", seed), DrawnCell("clone", seed + 1000, around=around)
        projects = (
            master.write_project(folder / "master", poses),
            clone.write_project(folder / "clone", poses, "../master/project.toml"),
        )
        joints = work_postures(master, points, seed)
        program = read_ls("WELD.LS", fanuc_listing("WELD", master.recorded_tips(joints), joints))
        return cls(master, clone, *projects, joints, program)

    def clone_program(self) -> ProgramResult:
        """Clone the program."""
        rule = BRAND.configurations
        return clone_programs([self.program], self.master_project, self.clone_project, rule)[0]

    def missed_m(self, frame_tip: np.ndarray, rows: np.ndarray) -> np.ndarray:
        """Return what programmed points miss at the clone's fixture when the clone's controller runs them."""
        near = self.joints[rows].copy()
        near[:, 0] += self.clone.around
        there = self.clone.tips_at_fixture(self.clone.commanded_joints(frame_tip[rows], near))
        here = self.master.tips_at_fixture(self.joints[rows])
        return np.linalg.norm(there[:, :3, 3] - here[:, :3, 3], axis=1)


def changed_rows(result: ProgramResult) -> np.ndarray:
    """Return the points that were not left."""
    return np.flatnonzero([status != LEFT for status in result.status])
