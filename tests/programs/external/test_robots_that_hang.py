"""Programs of a robot that hangs: its work objects are in the world, and the arm begins below the ceiling."""

from pathlib import Path

import numpy as np

from cellcal.drivers.program_registry import brand_named
from cellcal.service.engineering.programs.clone import clone_transfer
from tests.programs.external.brands import BRANDS
from tests.programs.external.cells import TOOL, HandCell
from tests.programs.external.hand_geometry import arm, flange_of, pose
from tests.programs.external.test_clones_and_compensation import (
    CLONE_BASE,
    assert_near,
    joints_of,
    real_arm,
    write_project,
)
from tests.programs.test_world_frames import HANGING, HANGS, configuration, read_below


def test_a_clone_of_a_hanging_robot_reaches_the_same_place_of_the_work(tmp_path: Path) -> None:
    """The tips are computed from the base by hand; what files hold is in the world."""
    spelling = BRANDS["abb"]
    cell = HandCell(spelling, (), np.linalg.inv(HANGS))
    nominal, fixture = arm(spelling.model), pose((0.3, 0.2, 0.5), (0.1, 0.0, 0.3))
    reals = real_arm(nominal, 1), real_arm(nominal, 2)
    master = write_project(cell, tmp_path / "a", real=reals[0], serial="A", fixture=fixture)
    clone = write_project(cell, tmp_path / "b", real=reals[1], serial="B", fixture=CLONE_BASE @ fixture)
    text = spelling.write(cell.points([{}]), "wobj0")
    files = {"SYSPAR/MOC.cfg": configuration(f'ROB_1" {HANGING}'), "RAPID/TASK1/PROGMOD/rail.mod": text}
    (program,) = read_below(tmp_path / "backup", "RAPID", files).values()
    result = clone_transfer(master, clone, brand_named("abb").configurations).transfer_programs([program])[0]
    assert not result.excluded_points
    points = zip(spelling.read(text), spelling.read(result.after.to_bytes().decode()), strict=True)
    for pair in points:
        places = []
        for real, point in zip(reals, pair, strict=True):
            assert point.tip is not None
            flange = np.linalg.inv(HANGS) @ point.tip @ np.linalg.inv(TOOL)
            joints = joints_of(nominal, flange, np.radians(spelling.postures))
            places.append(flange_of(real, joints) @ TOOL)
        assert_near(CLONE_BASE @ places[0], places[1])
