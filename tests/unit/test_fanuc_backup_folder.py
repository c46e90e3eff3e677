"""What is given in place of an address and is no backup of a FANUC controller is named for what it is."""

from pathlib import Path

import pytest

from cellcal.fake_devices.fanuc_files.cabinet import FanucCabinet
from cellcal.service.cli.app import run_command_line
from cellcal.service.exit_codes import ExitCode
from tests.wire.fanuc_ftp import save_backup


def try_to_record(source: Path, records: Path, capsys, *more: str) -> tuple[int, str]:
    capsys.readouterr()
    code = run_command_line(["mastering", "record", str(source), "--records", str(records), *more])
    return code, " ".join(capsys.readouterr().err.split())


def test_an_archive_is_not_taken_for_a_host_name(tmp_path: Path, capsys) -> None:
    archive = tmp_path / "whole.zip"
    archive.write_bytes(b"PK")
    code, output = try_to_record(archive, tmp_path, capsys)
    assert code == ExitCode.USAGE
    assert "is a file, and a backup is a folder" in output
    assert "Unpack it" in output


def test_a_folder_above_the_backup_is_refused_and_the_right_one_is_named(tmp_path: Path, capsys) -> None:
    save_backup(FanucCabinet(), tmp_path / "robots" / "MD")
    code, output = try_to_record(tmp_path / "robots", tmp_path, capsys)
    assert code == ExitCode.USAGE
    assert "Give one of them:" in output
    assert "MD" in output


@pytest.mark.parametrize(
    ("name", "maker"),
    [
        ("SYSPAR", "ABB"),
        ("KRC", "KUKA"),
        ("ALL.PRM", "Yaskawa"),
        ("CMOSBK.BIN", "Yaskawa"),
        ("calibration.conf", "Universal Robots"),
    ],
)
def test_another_maker_s_backup_is_named(tmp_path: Path, capsys, name: str, maker: str) -> None:
    folder = tmp_path / "backup"
    (folder / name).mkdir(parents=True)
    if "." in name:
        (folder / name).rmdir()
        (folder / name).write_text("x")
    code, output = try_to_record(folder, tmp_path, capsys)
    assert code == ExitCode.USAGE
    assert f"is a backup of {maker}, and not of FANUC" in output
    assert "position_record" in output


def test_a_group_that_is_not_there_is_answered_with_those_that_are(tmp_path: Path, capsys) -> None:
    folder = save_backup(FanucCabinet(), tmp_path / "backup")
    code, output = try_to_record(folder, tmp_path, capsys, "--group", "2")
    assert code == ExitCode.USAGE
    assert "group 1 with 6 axes" in output
    assert "--group" in output.split("What to do")[1]


def test_a_robot_under_power_that_shows_other_angles_is_read_with_drives_off(tmp_path: Path, capsys) -> None:
    cabinet = FanucCabinet(servo_on=True)
    cabinet.effective_zero = [
        count + 30_000 * (axis == 1) for axis, count in enumerate(cabinet.counts_at_zero)
    ]
    code, output = try_to_record(save_backup(cabinet, tmp_path / "backup"), tmp_path, capsys)
    assert code == ExitCode.REFUSED
    assert "Switch the drives off" in output
