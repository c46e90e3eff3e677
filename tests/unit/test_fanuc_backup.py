"""Backups of a FANUC controller: read whole, held against themselves, and changed in the asked numbers only."""

import re
from pathlib import Path

import numpy as np
import pytest

from cellcal.calibration.geometry import Pose
from cellcal.drivers.fanuc.program_files.va_backup import read_backup
from cellcal.drivers.fanuc.program_files.va_edits import (
    changed_files,
    count_edits,
    edit_instructions,
    frame_edits,
)
from cellcal.drivers.fanuc.program_files.va_text import MAX_LINE_BYTES, VaFile
from cellcal.drivers.programs.errors import ProgramFileError
from tests.programs.file_damage import mutate_file
from tests.unit.helpers.fanuc_va import RATIOS, VariablesController

FRAME = (884.0, -3329.79, -133.19, 134.85, 0.37, 87.78)
TOOL = (10.0, -0.25, 300.5, 0.0, -90.0, 45.0)


@pytest.fixture
def fake_controller() -> VariablesController:
    return VariablesController(frames={1: FRAME, 9: (0.001, 0.0, 0.0, 0.0, 0.0, 0.0)}, tools={2: TOOL})


@pytest.mark.parametrize("ending", ["\r\n", "\n"])
@pytest.mark.parametrize("lower", [True, False])
def test_frames_tools_and_registers_are_read(
    fake_controller, tmp_path: Path, ending: str, lower: bool
) -> None:
    fake_controller.ending = ending
    backup = read_backup(fake_controller.save_variables(tmp_path, lower=lower))
    frame = backup.user_frames[1, 1]
    w, p, r = np.radians(FRAME[3:])
    about_x = np.array([[1, 0, 0], [0, np.cos(w), -np.sin(w)], [0, np.sin(w), np.cos(w)]])
    about_y = np.array([[np.cos(p), 0, np.sin(p)], [0, 1, 0], [-np.sin(p), 0, np.cos(p)]])
    about_z = np.array([[np.cos(r), -np.sin(r), 0], [np.sin(r), np.cos(r), 0], [0, 0, 1]])
    assert np.allclose(frame.rotation_matrix(), about_z @ about_y @ about_x, atol=1e-12)  # fixed axes x, y, z
    assert frame.position_m == pytest.approx((0.884, -3.32979, -0.13319), abs=1e-12)
    assert backup.tool_poses[1, 2].position_m == pytest.approx((0.01, -0.00025, 0.3005), abs=1e-12)
    assert (backup.selected_frames[1], backup.selected_tools[2]) == (0, 1)
    frame_values = backup.group_frames()
    assert frame_values.base_frame["9"].position_m == pytest.approx((1e-6, 0, 0))
    assert frame_values.flange_tip["0"] == Pose((0.0, 0.0, 0.0))
    home, pose, empty = (backup.registers[1, n] for n in (1, 2, 3))
    assert home.comment == "Höhe"
    assert home.to_joints() == pytest.approx(np.radians((45.0, -45.0, 60.0, -175.0, 90.0, 180.0)))
    assert pose.to_pose() is not None
    assert np.isnan(pose.external_axes()).all()  # the controller shows stars
    assert backup.registers[1, 4].external_axes() == pytest.approx((0.040492,))
    assert not empty.is_initialised
    assert empty.comment == "Home2"
    assert empty.to_pose() is None
    assert empty.to_joints() is None
    assert backup.registers[2, 1].to_joints() == pytest.approx((0.2,))  # a linear group, in mm
    assert not backup.missing_files


def test_mastering_agrees_with_itself(fake_controller, tmp_path: Path) -> None:
    reference = [0.1, -0.7, 0.3, 1.5, -1.0, 2.5]
    fake_controller.reference_rad = reference
    mastering = read_backup(fake_controller.save_variables(tmp_path)).mastering[1]
    assert mastering.drives is not None
    train = mastering.drives.to_drive_train()
    assert train.counts_per_turn == (2**19,) * 6
    assert mastering.counts_at_zero == tuple(fake_controller.counts)
    assert mastering.drives.fixture_deg[1] == pytest.approx(24.6528)
    assert 1 / np.array(mastering.drives.gear_ratio) == pytest.approx(RATIOS, rel=1e-6)
    assert mastering.reference_holds
    there = train.to_joints(np.array(fake_controller.counts_at(reference)), np.array(fake_controller.counts))
    assert there == pytest.approx(reference, abs=2e-6)  # coupling of the wrist included
    assert mastering.findings == ()


def test_a_reference_older_than_the_mastering_is_reported_by_axis(fake_controller, tmp_path: Path) -> None:
    fake_controller.reference_rad = [0.2] * 6
    fake_controller.reference_counts = fake_controller.counts_at([0.2] * 6)
    fake_controller.reference_counts[1] += 2**19
    fake_controller.reference_counts[4] -= 40
    mastering = read_backup(fake_controller.save_variables(tmp_path)).mastering[1]
    assert mastering.stale_axes() == (2, 5)
    assert not mastering.reference_holds
    assert "reference of axis 2, 5 is from before the last mastering" in mastering.findings[0]


def test_published_counts_hold(tmp_path: Path) -> None:
    """Axes 3 and 4 of a public backup hold a reference of their mastering, the others an older one."""
    controller = VariablesController(counts=[797302, 92536, 1407020, 26190247, 542389, -10719859])
    controller.reference_rad = [0.0, 0.0, 5.162435e-06, 4.108911e-06, 0.0, 0.0]
    controller.reference_counts = [-22005620, -12078932, 1407164, 26190317, -26439675, -14455404]
    controller.ratios = (229.091, 290.25, 334.286, 204.165, 197.353, 122.14)
    mastering = read_backup(controller.save_variables(tmp_path)).mastering[1]
    assert 3 not in mastering.stale_axes()
    assert set(mastering.stale_axes()) >= {1, 2, 5, 6}


def test_what_was_not_mastered_is_reported(fake_controller, tmp_path: Path) -> None:
    fake_controller.mastered, fake_controller.states = False, [2, 0, 1, 2, 7, 2]
    findings_text = " ".join(read_backup(fake_controller.save_variables(tmp_path)).list_findings())
    for words in (
        "$MASTER_DONE is FALSE",
        "axis 2 was lost",
        "axis 3 was lost, only axes coupled",
        "axis 5 was in an unknown state ($EACHMST_DON is 7)",
    ):
        assert words in findings_text


def test_drives_that_contradict_each_other_are_not_believed(fake_controller, tmp_path: Path) -> None:
    folder = fake_controller.save_variables(tmp_path)
    text = (folder / "SYMOTN.VA").read_bytes()
    scale = re.search(rb"\[3\] = (3\.9\d+e\+05)", text)
    assert scale is not None
    (folder / "SYMOTN.VA").write_bytes(text.replace(scale[1], b"3.934730e+06"))
    mastering = read_backup(folder).mastering[1]
    assert mastering.drives is None
    assert "axis 3" in mastering.findings[0]
    assert "not 524288" in mastering.findings[0]


def test_a_rail_is_left_out_of_the_arm(fake_controller, tmp_path: Path) -> None:
    fake_controller.rail = True
    mastering = read_backup(fake_controller.save_variables(tmp_path)).mastering[1]
    assert mastering.drives is not None
    assert len(mastering.drives.gear_ratio) == len(mastering.counts_at_zero) == 6
    assert "what follows axis 6 is left out" in mastering.findings[0]


def test_changed_files_differ_in_the_asked_numbers_only(fake_controller, tmp_path: Path) -> None:
    backup = read_backup(fake_controller.save_variables(tmp_path))
    moved = Pose((0.0004, -3.32979, 12.5)) @ Pose((0.0, 0.0, 0.0), backup.user_frames[1, 1].quaternion)
    counts = [*fake_controller.counts[:5], -7]
    edits = (*frame_edits(backup, frames={(1, 1): moved}, tools={}), *count_edits(backup, 1, counts))
    assert [edit.variable for edit in edits] == [
        *("$MNUFRAME[1,1].X", "$MNUFRAME[1,1].Z", "$DMR_GRP[1].$MASTER_COUN[6]")
    ]
    assert [edit.new for edit in edits] == [".400", "12500.000", "-7"]
    changed = changed_files(backup, edits)
    assert set(changed) == {"SYSFRAME.VA", "SYSMAST.VA"}
    assert changed["SYSFRAME.VA"] == (tmp_path / "SYSFRAME.VA").read_bytes().replace(
        b"X:   884.000", b"X:   .400"
    ).replace(b"Z:  -133.190", b"Z:  12500.000")
    assert changed["SYSMAST.VA"] == (tmp_path / "SYSMAST.VA").read_bytes().replace(b"-46902634", b"-7")
    again = tmp_path / "again"
    fake_controller.save_variables(again)
    for name, data in changed.items():
        (again / name).write_bytes(data)
    assert np.allclose(read_backup(again).user_frames[1, 1].to_matrix(), moved.to_matrix(), atol=2e-5)
    assert read_backup(again).mastering[1].counts_at_zero == tuple(counts)
    instructions = edit_instructions(edits)
    assert instructions[0].startswith("1. MENU > SETUP > Frames")
    assert "from 884.000 mm to .400 mm" in instructions[0]
    assert "CALIBRATE" in instructions[4]
    assert len(instructions) == 6


def test_the_same_values_need_no_edit(fake_controller, tmp_path: Path) -> None:
    backup = read_backup(fake_controller.save_variables(tmp_path))
    assert frame_edits(backup, frames=backup.user_frames, tools=backup.tool_poses) == ()
    assert count_edits(backup, 1, fake_controller.counts) == ()


def test_what_cannot_be_written_is_refused(fake_controller, tmp_path: Path) -> None:
    backup = read_backup(fake_controller.save_variables(tmp_path))
    with pytest.raises(ProgramFileError, match="never set"):
        frame_edits(backup, frames={(1, 44): Pose((0.0, 0.0, 0.0))}, tools={})
    with pytest.raises(ProgramFileError, match="metres"):
        frame_edits(backup, frames={}, tools={(1, 2): Pose((400.0, 0.0, 0.0))})
    with pytest.raises(ProgramFileError, match="32 bits"):
        count_edits(backup, 1, [2**31, 0, 0, 0, 0, 0])
    with pytest.raises(ProgramFileError, match="has 6 axes"):
        count_edits(backup, 1, [1, 2, 3])


@pytest.mark.parametrize(
    ("name", "old", "new", "words"),
    [
        ("SYSFRAME.VA", b"  W:   134.850", b"  W:   134.85O", "is not understood"),
        ("SYSFRAME.VA", b"    [1,2] = ", b"    [1,1] = ", "a second time"),
        ("SYSFRAME.VA", b"    [1,2] = ", b"    [7,2] = ", "outside of"),
        ("SYSFRAME.VA", b"  X:   884.000   Y", b"  X:   884.000   X", "is not understood"),
        ("POSREG.VA", b" 'Home2' Uninitialized", b" 'Home2' Uninitialised", "is not understood"),
        ("POSREG.VA", b"  J4 =  -175.000 deg", b"  J4 =  -175.000 rad", "is not understood"),
        ("SYSMAST.VA", b"[1] = 135258", b"[1] = 13525800000", "no whole number of 32 bits"),
        ("SYSMAST.VA", b"[1] = 135258", b"[1] = 1_3", "no whole number of 32 bits"),
        ("SYSMAST.VA", b"BOOLEAN = TRUE", b"BOOLEAN = true", "neither TRUE nor FALSE"),
        ("SYSMAST.VA", b"[2] = 17407548", b"[2] = Uninitialized", "not initialised on an axis"),
        ("SYSMAST.VA", b"ARRAY[2] OF DMR", b"ARRAY[2 OF DMR", "heading"),
        ("SYMOTN.VA", b"[2] = 4.2", b"[2] = 4.2e999", "no number"),
        ("SYMOTN.VA", b"[2] = 4.2", b"[2] =\x00 4.2", "is no text"),
    ],
)
def test_damage_is_named_with_file_line_and_cure(
    fake_controller, tmp_path: Path, name: str, old: bytes, new: bytes, words: str
) -> None:
    path = fake_controller.save_variables(tmp_path) / name
    data = path.read_bytes()
    assert old in data
    path.write_bytes(data.replace(old, new, 1))
    with pytest.raises(ProgramFileError, match=words) as error_info:
        read_backup(tmp_path)
    assert error_info.value.file == name
    assert error_info.value.line > 0
    assert error_info.value.remedy


def test_a_file_that_ends_too_early_is_refused_not_filled_up(fake_controller, tmp_path: Path) -> None:
    path = fake_controller.save_variables(tmp_path) / "SYSFRAME.VA"
    data = path.read_bytes()
    for end in (data.index(b"[1,2]"), data.index(b"$MNUTOOL") + 40, data.index(b"W:   134.850")):
        path.write_bytes(data[:end])
        with pytest.raises(ProgramFileError):
            read_backup(tmp_path)


def test_folders_that_hold_no_backup(tmp_path: Path) -> None:
    with pytest.raises(ProgramFileError, match=r"none of SYSFRAME\.VA"):
        read_backup(tmp_path)
    with pytest.raises(ProgramFileError, match="cannot be read"):
        read_backup(tmp_path / "nowhere")
    (tmp_path / "SYSFRAME.VA").mkdir()
    with pytest.raises(ProgramFileError, match="cannot be read"):
        read_backup(tmp_path)
    (tmp_path / "posreg.va").write_text("hello\n")
    (tmp_path / "POSREG.VA").write_text("hello\n")
    with pytest.raises(ProgramFileError, match="same file to a controller"):
        read_backup(tmp_path)


def test_huge_lines_and_files_are_bounded(fake_controller, tmp_path: Path, monkeypatch) -> None:
    data = fake_controller.sysmast_text().encode()
    with pytest.raises(ProgramFileError, match="characters"):
        VaFile.from_bytes("a.va", data + b" " * (MAX_LINE_BYTES + 1))
    monkeypatch.setattr("cellcal.drivers.fanuc.program_files.va_text.MAX_FILE_BYTES", len(data) - 1)
    with pytest.raises(ProgramFileError, match="more than a controller writes"):
        VaFile.from_bytes("a.va", data)


def test_what_a_web_server_wraps_around_is_passed_over(fake_controller, tmp_path: Path) -> None:
    path = fake_controller.save_variables(tmp_path) / "SYSMAST.VA"
    path.write_bytes(b"<HTML><BODY>\r\n<PRE>\r\n" + path.read_bytes() + b"</PRE></BODY>\r\n</HTML>\r\n")
    assert read_backup(tmp_path).mastering[1].mastered


@pytest.mark.parametrize("name", ["SYSFRAME.VA", "POSREG.VA", "SYSMAST.VA", "SYMOTN.VA"])
def test_damaged_at_random(fake_controller, tmp_path: Path, name: str) -> None:
    """Read, or refused with a sentence; never anything else."""
    path = fake_controller.save_variables(tmp_path) / name
    whole, refused = path.read_bytes(), 0
    for seed in range(100):
        path.write_bytes(mutate_file(whole, seed))
        try:
            read_backup(tmp_path)
        except ProgramFileError:
            refused += 1
    assert refused > 20
