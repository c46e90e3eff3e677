"""A program of one cell in another: where the real robot stands, what is left and why, what may be expected."""

import re
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from cellcal.calibration.geometry import Pose, homogeneous_matrix, inverse_transform
from cellcal.calibration.motion.cell_shapes import CellShape, PlaneObstacle, arm_shape
from cellcal.drivers.fanuc.program_files.ls_program import LsProgram, read_ls
from cellcal.drivers.fanuc.program_files.programs import BRAND
from cellcal.drivers.programs.errors import ProgramFileError
from cellcal.drivers.programs.positions import ProgramFrames
from cellcal.service.engineering.programs.clone import clone_programs
from cellcal.service.engineering.programs.project_poses import ProjectError
from cellcal.service.engineering.programs.result import LEFT
from tests.unit.helpers.cloned_cells import ENTERED_TOOL, MODEL, fanuc_listing, work_postures
from tests.unit.helpers.cloned_program import ClonedCells, changed_rows

RULE = BRAND.configurations


@pytest.fixture(scope="module")
def cloned_cells(tmp_path_factory: pytest.TempPathFactory) -> ClonedCells:
    return ClonedCells.make(3, tmp_path_factory.mktemp("cells"))


def test_cloned_points_stand_where_the_masters_robot_stood(cloned_cells: ClonedCells) -> None:
    result = cloned_cells.clone_program()

    missed = cloned_cells.missed_m(result.after.positions.frame_tip, np.arange(40))
    untouched = cloned_cells.missed_m(result.before.positions.frame_tip, np.arange(40))
    assert result.excluded_points == ()
    assert missed.mean() < 0.25e-3
    assert missed.max() < 0.5e-3
    assert untouched.mean() > 5e-3
    assert (missed <= result.expected_error_m).mean() > 0.9
    assert result.expected_error_m.max() < 0.4e-3


def test_base_shift_alone_misses_what_the_report_says(cloned_cells: ClonedCells) -> None:
    result = cloned_cells.clone_program()
    route = (
        cloned_cells.clone_project.alignment.base_fixture
        @ cloned_cells.master_project.alignment.base_fixture.inverse()
    )
    shift = (
        inverse_transform(cloned_cells.clone.base_frame) @ route.to_matrix() @ cloned_cells.master.base_frame
    )

    missed = cloned_cells.missed_m(shift @ result.before.positions.frame_tip, np.arange(40))

    assert np.abs(missed - result.uncorrected_m).max() < 0.25e-3
    assert missed.mean() > 0.5e-3


def test_a_cell_turned_about_its_robot_is_cloned_too(tmp_path) -> None:
    cells = ClonedCells.make(5, tmp_path, points=15, around=1.2)

    result = cells.clone_program()

    rows = changed_rows(result)
    assert len(rows) == 15
    assert cells.missed_m(result.after.positions.frame_tip, rows).max() < 0.5e-3


def test_cloning_to_the_same_cell_changes_nothing(cloned_cells: ClonedCells) -> None:
    master = cloned_cells.master_project

    result = clone_programs([cloned_cells.program], master, master, RULE)[0]

    assert result.status == ("unchanged",) * 40
    assert result.after.to_bytes() == cloned_cells.program.to_bytes()


def test_thirty_programs_together_are_as_each_alone(cloned_cells: ClonedCells) -> None:
    parts = []
    for i in range(5):
        some = cloned_cells.joints[8 * i : 8 * i + 8]
        parts.append(
            read_ls(f"P{i}.LS", fanuc_listing(f"P{i}", cloned_cells.master.recorded_tips(some), some))
        )

    together = clone_programs(parts, cloned_cells.master_project, cloned_cells.clone_project, RULE)
    alone = [
        clone_programs([part], cloned_cells.master_project, cloned_cells.clone_project, RULE)[0]
        for part in parts
    ]

    assert [r.after.to_bytes() for r in together] == [r.after.to_bytes() for r in alone]


def test_a_joint_beyond_its_limit_is_named_and_left(cloned_cells: ClonedCells) -> None:
    controller = cloned_cells.clone_project.controller
    upper = controller.upper_rad.copy()
    upper[1] = np.median(cloned_cells.joints[:, 1])
    tight = replace(cloned_cells.clone_project, controller=replace(controller, upper_rad=upper))

    result = clone_programs([cloned_cells.program], cloned_cells.master_project, tight, RULE)[0]

    left_rows = [i for i, status in enumerate(result.status) if status == LEFT]
    assert 10 < len(left_rows) < 30
    assert all(result.reason[i].startswith("joint 2 would pass its limit by") for i in left_rows)
    for i in left_rows:
        assert (result.after.positions.frame_tip[i] == result.before.positions.frame_tip[i]).all()
    assert not result.is_complete
    assert result.exit_code != 0
    others = changed_rows(result)
    assert cloned_cells.missed_m(result.after.positions.frame_tip, others).max() < 0.5e-3


def test_a_table_in_the_way_is_named(cloned_cells: ClonedCells) -> None:
    flange_z = cloned_cells.clone.arm.believed_flange(cloned_cells.joints)[:, 2, 3]
    height = float(np.median(flange_z))
    table = PlaneObstacle("the table", (0.0, 0.0, height - 0.1), (0.0, 0.0, 1.0))
    shape = CellShape(arm_shape(MODEL, radius_m=0.05)[3:], (table,))

    result = clone_programs(
        [cloned_cells.program],
        cloned_cells.master_project,
        replace(cloned_cells.clone_project, shapes=shape),
        RULE,
    )[0]

    hit = [reason for reason in result.reason if "the table" in reason]
    assert 5 < len(hit) < 35
    assert sum(status == LEFT for status in result.status) == len(hit)


def test_points_near_a_singularity_are_left(cloned_cells: ClonedCells) -> None:
    careful = replace(cloned_cells.clone_project, smallest_sigma=1.0)

    result = clone_programs([cloned_cells.program], cloned_cells.master_project, careful, RULE)[0]

    assert {reason[:18] for reason in result.reason} == {"near a singularity"}
    assert result.after.to_bytes() == cloned_cells.program.to_bytes()


def test_a_fixture_out_of_reach_leaves_every_point(cloned_cells: ClonedCells) -> None:
    alignment = cloned_cells.clone_project.alignment
    far = Pose((4.0, 0.0, 0.0)) @ alignment.base_fixture
    away = replace(cloned_cells.clone_project, alignment=replace(alignment, base_fixture=far))

    result = clone_programs([cloned_cells.program], cloned_cells.master_project, away, RULE)[0]

    assert set(result.status) == {LEFT}
    assert all(reason.startswith("unreachable") for reason in result.reason)
    assert np.isnan(result.shift_m).all()


def test_unknown_tools_and_frames_are_named(cloned_cells: ClonedCells) -> None:
    text = cloned_cells.program.to_bytes().replace(b"UF : 1, UT : 1", b"UF : 1, UT : 3", 2)
    text = text[::-1].replace(b"UF : 1, UT : 1"[::-1], b"UF : 7, UT : 1"[::-1], 1)[::-1]

    result = clone_programs(
        [read_ls("A.LS", text)], cloned_cells.master_project, cloned_cells.clone_project, RULE
    )[0]

    assert result.reason[:2] == ("no tool 3 in master/project.toml: state it there as [tools.3]",) * 2
    assert result.reason[-1] == "no user frame 7 in master/project.toml: state it there as [frames.7]"
    assert set(result.status[2:-1]) == {"changed"}


def test_untaught_points_stay(cloned_cells: ClonedCells) -> None:
    text = re.sub(
        rb"(P\[2\]\{.*?)X = .*?\};",
        rb"\1X = ********  mm,\tY = ********  mm,\tZ = ********  mm,\r\n"
        rb"\tW = ******** deg,\tP = ******** deg,\tR = ******** deg\r\n};",
        cloned_cells.program.to_bytes(),
        count=1,
        flags=re.DOTALL,
    )

    result = clone_programs(
        [read_ls("A.LS", text)], cloned_cells.master_project, cloned_cells.clone_project, RULE
    )[0]

    assert result.reason[1] == "not taught"
    assert {status for i, status in enumerate(result.status) if i != 1} == {"changed"}


def test_a_program_of_another_robot_is_refused_whole(cloned_cells: ClonedCells) -> None:
    frame_tip = cloned_cells.master.recorded_tips(cloned_cells.joints)
    frame_tip[:, :3, 3] *= 6.0

    with pytest.raises(ProgramFileError, match="do not belong to the fanuc_m6ib"):
        clone_programs(
            [read_ls("A.LS", fanuc_listing("A", frame_tip, cloned_cells.joints))],
            cloned_cells.master_project,
            cloned_cells.clone_project,
            RULE,
        )


@pytest.mark.parametrize(("factor", "words"), [(1e-3, "too small"), (1e3, "too large")])
def test_another_unit_is_refused_with_the_cure(cloned_cells: ClonedCells, factor: float, words: str) -> None:
    frame_tip = cloned_cells.master.recorded_tips(cloned_cells.joints)
    frame_tip[:, :3, 3] *= factor

    with pytest.raises(ProgramFileError, match=words):
        clone_programs(
            [read_ls("A.LS", fanuc_listing("A", frame_tip, cloned_cells.joints))],
            cloned_cells.master_project,
            cloned_cells.clone_project,
            RULE,
        )


def test_what_a_clone_needs_is_asked_for(cloned_cells: ClonedCells) -> None:
    master, clone = cloned_cells.master_project, cloned_cells.clone_project
    assert clone.alignment is not None
    other = replace(clone.alignment, fixture="another table")
    bent = replace(clone.alignment, points_in_fixture_m=((0.0, 0.0, 0.0), (1.0, 0.0, 0.0), (0.0, 1.0, 0.0)))

    for wrong, words in (
        (replace(clone, alignment=None), "no alignment"),
        (replace(clone, identified=None), "no parameters"),
        (replace(clone, alignment=other), "two fixtures"),
        (replace(clone, alignment=bent), "different points"),
    ):
        with pytest.raises(ProjectError, match=words):
            clone_programs([cloned_cells.program], master, wrong, RULE)


def test_without_correlations_no_accuracy_is_foretold(cloned_cells: ClonedCells) -> None:
    assert cloned_cells.clone_project.identified is not None
    bare = replace(
        cloned_cells.clone_project,
        identified=replace(cloned_cells.clone_project.identified, covariance=None, layout=None),
    )

    result = clone_programs([cloned_cells.program], cloned_cells.master_project, bare, RULE)[0]

    assert np.isnan(result.expected_error_m).all()
    assert any("no accuracy can be foretold" in warning for warning in result.warnings)


def test_turn_numbers_are_derived_anew_where_an_axis_crosses_half_a_turn(cloned_cells: ClonedCells) -> None:
    joints = work_postures(cloned_cells.master, 12, 77)
    joints[:, 5] = np.pi - 1e-4  # the clone's sixth axis ends beyond, its turn number is the next
    controller = replace(
        cloned_cells.master_project.controller, upper_rad=np.full(6, 6.0), lower_rad=np.full(6, -6.0)
    )
    wide = [
        replace(p, controller=controller) for p in (cloned_cells.master_project, cloned_cells.clone_project)
    ]
    program = read_ls("A.LS", fanuc_listing("A", cloned_cells.master.recorded_tips(joints), joints))

    result = clone_programs([program], wide[0], wide[1], RULE)[0]

    after = result.after.positions
    assert result.excluded_points == ()
    changed = [a != b for a, b in zip(after.configurations, program.positions.configurations, strict=True)]
    assert any(changed)
    flange = cloned_cells.clone.base_frame @ after.frame_tip @ inverse_transform(ENTERED_TOOL)
    for i in np.flatnonzero(changed):
        posture = cloned_cells.clone.commanded_joints(after.frame_tip[i : i + 1], joints[i : i + 1])
        assert posture[0, 5] > np.pi
        assert RULE.matches_postures(MODEL, posture, [after.configurations[i]]).all()
        assert np.abs(MODEL.base_flange(posture)[0] - flange[i]).max() < 1e-6


def test_a_file_that_holds_another_arms_kinematics_is_refused(cloned_cells: ClonedCells) -> None:
    other = MODEL.with_dh_errors(1e-3 * np.ones((6, 5)))
    program = SimpleNamespace(
        name="A",
        brand="fanuc",
        positions=cloned_cells.program.positions,
        remarks=(),
        frames=ProgramFrames(kinematics=other),
    )

    with pytest.raises(ProgramFileError, match=r"mm away .* calibration\.conf"):
        clone_programs([program], cloned_cells.master_project, cloned_cells.clone_project, RULE)
    calibrated_project = replace(cloned_cells.master_project, factory_known=True)
    with pytest.raises(ProgramFileError, match="it was taught on"):
        clone_programs([program], calibrated_project, cloned_cells.clone_project, RULE)


@pytest.mark.parametrize(("away_m", "carried"), [(0.0, True), (1e-3, False)])
def test_what_other_files_of_the_masters_cell_declare_counts_there_and_not_in_the_clone(
    cloned_cells: ClonedCells, away_m: float, carried: bool
) -> None:
    """A backup holds the master's frames: they must be the master project's, and are never the clone's."""
    (name, base_frame), *_ = cloned_cells.master_project.frames.items()
    shift = homogeneous_matrix(np.eye(3), np.array([5e-3, 0.0, 0.0]))
    clone = replace(
        cloned_cells.clone_project, frames={name: shift @ cloned_cells.clone_project.frames[name]}
    )
    base_pose = Pose.from_matrix(base_frame)
    base_pose = replace(base_pose, position_m=(base_pose.position_m[0] + away_m, *base_pose.position_m[1:]))

    class BackupProgram(LsProgram):
        frames = ProgramFrames(cell_base_frame={name: base_pose})

    program = BackupProgram("A.LS", cloned_cells.program.to_bytes())
    result = clone_programs([program], cloned_cells.master_project, clone, RULE)[0]

    assert set(result.status) == ({"changed"} if carried else {LEFT})
    assert carried or all("brings its own user frame" in why for why in result.reason)
    without = replace(clone, frames={})
    result_without = (
        clone_programs([program], cloned_cells.master_project, without, RULE)[0] if carried else result
    )
    assert set(result_without.status) == {LEFT}
