"""``cellcal mastering record``: a signed record from a controller's files, and no record where they disagree."""

import asyncio
import ftplib
import json
import subprocess
import sys
from collections.abc import Iterator
from datetime import datetime, timedelta
from pathlib import Path

import numpy as np
import pytest

from cellcal.drivers.errors import UnreachableError
from cellcal.drivers.fanuc.controller_files.controller_address import parse_address
from cellcal.drivers.fanuc.controller_files.ftp_source import (
    READING_COMMANDS,
    FtpLogin,
    FtpSource,
    ReadOnlyFtp,
)
from cellcal.fake_devices.fanuc_files.cabinet import FanucCabinet
from cellcal.fake_devices.fanuc_files.ftp_server import FanucFtpServer
from cellcal.procedures.recovery.record_seal import seal_of
from cellcal.service.cli.app import run_command_line
from cellcal.service.engineering.controller_files import stored_records
from cellcal.service.engineering.controller_files.stored_records import list_records
from cellcal.service.engineering.parameters.mastering_files import import_record, in_force
from cellcal.service.exit_codes import ExitCode
from tests.procedures.certified_runs import cell_config
from tests.wire.cutting_proxy import CuttingProxy
from tests.wire.fanuc_ftp import address_of, ftp_controllers, save_backup

ROOT = Path(__file__).parents[2]
WRITING = ("STOR", "STOU", "APPE", "DELE", "RNFR", "RNTO", "MKD", "RMD", "SITE", "REST", "PORT")


@pytest.fixture
def served() -> Iterator[FanucFtpServer]:
    with ftp_controllers(FanucCabinet()) as servers:
        yield servers[0]


def take_record(source: str, records: Path, *more: str) -> int:
    return run_command_line(["mastering", "record", source, "--records", str(records), *more])


def test_a_record_over_ftp_equals_the_controller(served: FanucFtpServer, tmp_path: Path) -> None:
    cabinet = served.cabinet
    assert take_record(address_of(served), tmp_path) == ExitCode.PASS
    (stored,) = list_records(tmp_path)
    record = stored.record
    assert record.counts_at_zero == tuple(cabinet.counts_at_zero)
    assert record.reference_counts == tuple(cabinet.pulses())
    assert np.degrees(record.reference_joints_rad) == pytest.approx(cabinet.joints_deg, abs=1e-4)
    assert (record.robot_serial, record.model) == (cabinet.f_number, "fanuc_r1000ia_80f")
    assert record.sha256 == seal_of(record)
    cabinet.joints_deg = [10.0, 25.0, -60.0, 100.0, -80.0, 170.0]  # the drive gives shown joints everywhere
    there = record.drive.to_joints(np.array(cabinet.pulses()), np.array(record.counts_at_zero))
    assert np.degrees(there) == pytest.approx(cabinet.joints_deg, abs=2e-4)


def test_a_record_is_imported_by_the_cell_of_its_robot(served: FanucFtpServer, tmp_path: Path) -> None:
    config = cell_config(tmp_path / "cell")
    served.cabinet.f_number, served.cabinet.robot = config.robots[0].serial, "M-6iB"
    assert config.robots[0].model == "fanuc_m6ib"
    assert take_record(address_of(served), tmp_path / "records") == ExitCode.PASS
    (stored,) = list_records(tmp_path / "records")
    import_record(config, stored.path, who="anna", expected_key=stored.public_key)
    assert in_force(config).record == stored.record


def test_nothing_is_ever_written(served: FanucFtpServer, tmp_path: Path) -> None:
    assert take_record(address_of(served), tmp_path) == ExitCode.PASS
    sent = {command.partition(" ")[0] for command in served.commands}
    assert sent <= READING_COMMANDS
    assert not READING_COMMANDS & set(WRITING)
    ftp = ReadOnlyFtp()
    ftp.connect("127.0.0.1", served.port, timeout=10)
    for verb in WRITING:
        with pytest.raises(AssertionError):
            ftp.putcmd(f"{verb} axis.dg")
    ftp.close()
    assert not {command.partition(" ")[0] for command in served.commands} & set(WRITING)


@pytest.mark.parametrize(
    "fault",
    [
        {"wants_password": True},
        {"names_wrong_address": True},
        {"upper_case": True},
        {"one_segment": True},
        {"lists_nothing": True},
    ],
)
def test_other_servers_are_read_alike(served: FanucFtpServer, tmp_path: Path, fault) -> None:
    for name, value in fault.items():
        setattr(served.faults, name, value)
    assert take_record(address_of(served), tmp_path) == ExitCode.PASS
    assert list_records(tmp_path)[0].record.counts_at_zero == tuple(served.cabinet.counts_at_zero)


@pytest.mark.parametrize(
    ("fault", "words", "code"),
    [
        (
            {"refuses_login": True},
            ("login of 'anonymous' was refused", "SETUP > Host Comm"),
            ExitCode.UNREACHABLE,
        ),
        ({"missing": frozenset(["axis.dg"])}, ("there is no AXIS.DG", "lists it"), ExitCode.REFUSED),
        ({"missing": frozenset(["sysmast.va"])}, ("there is no SYSMAST.VA",), ExitCode.REFUSED),
        ({"cut_file": "axis.dg"}, ("axis.dg", "AXIS PULSE STATUS", "Read the file"), ExitCode.FILES_REFUSED),
        ({"cut_file": "sysmast.va"}, ("SYSMAST.VA",), ExitCode.FILES_REFUSED),
        ({"cut_file": "symotn.va"}, ("SYMOTN.VA",), ExitCode.FILES_REFUSED),
        ({"cut_file": "curpos.dg"}, ("CURPOS.DG shows 2 joints", "whole"), ExitCode.REFUSED),
        (
            {"drop_in_file": "symotn.va"},
            ("connection was lost while reading symotn.va",),
            ExitCode.UNREACHABLE,
        ),
    ],
)
def test_a_failure_names_device_cause_and_next_action(
    served: FanucFtpServer, tmp_path: Path, capsys, fault, words, code
) -> None:
    for name, value in fault.items():
        setattr(served.faults, name, value)
    assert take_record(address_of(served), tmp_path) == code
    text = " ".join(capsys.readouterr().err.split())
    for word in (address_of(served), "What to do:", *words):
        assert word in text
    assert not list(tmp_path.glob("*.json"))


def test_an_address_without_a_controller(tmp_path: Path, capsys) -> None:
    with ftp_controllers(FanucCabinet()) as (gone,):
        address = address_of(gone)
    assert take_record(address, tmp_path) == ExitCode.UNREACHABLE
    assert "no FTP server answers" in " ".join(capsys.readouterr().err.split())
    assert take_record("no/such/folder", tmp_path) == ExitCode.USAGE


def test_a_silent_controller_ends_at_its_deadline(served: FanucFtpServer) -> None:
    served.faults.slow_s = 30.0
    login = FtpLogin(timeout_s=0.2)
    with pytest.raises(UnreachableError, match="no FTP server answers"):  # noqa: SIM117  which of both refuses
        with FtpSource(parse_address(address_of(served)), login):
            pass


def lose_encoder(cabinet: FanucCabinet) -> None:
    cabinet.lose_position([3])


def break_cable(cabinet: FanucCabinet) -> None:
    cabinet.alarms.append(("SRVO-068", "DTERR alarm (Group:1 Axis:5)"))


def move_robot(cabinet: FanucCabinet) -> None:
    cabinet.moves_counts_each_reading = 1


def change_zero_without_calibrate(cabinet: FanucCabinet) -> None:
    cabinet.effective_zero = list(cabinet.counts_at_zero)
    cabinet.counts_at_zero[1] += 8000  # 0.03 deg


def master_others_only(cabinet: FanucCabinet) -> None:
    cabinet.axis_states[3] = 1


@pytest.mark.parametrize(
    ("happen", "words"),
    [
        (lose_encoder, ("not mastered", "$MASTER_DONE is FALSE")),
        (master_others_only, ("not mastered", "axis 4 was lost")),
        (break_cable, ("SRVO-068 on J5", "cable")),
        (move_robot, ("the robot moved", "J1 by 1 counts")),
        (change_zero_without_calibrate, ("not those that CURPOS.DG shows", "J2 by", "without CALIBRATE")),
    ],
)
def test_a_robot_that_is_not_healthy_or_not_still_gets_no_record(
    served: FanucFtpServer, tmp_path: Path, capsys, happen, words
) -> None:
    happen(served.cabinet)
    assert take_record(address_of(served), tmp_path) == ExitCode.REFUSED
    text = " ".join(capsys.readouterr().err.split())
    for word in (address_of(served), "What to do:", *words):
        assert word in text
    assert not list(tmp_path.glob("*.json"))


def test_after_the_clock_was_set_back_no_record_is_stored_that_would_not_count(
    served: FanucFtpServer, tmp_path: Path, capsys, monkeypatch: pytest.MonkeyPatch
) -> None:
    class SetBack(datetime):
        @classmethod
        def now(cls, tz=None) -> datetime:
            return datetime.now(tz) - timedelta(hours=1)

    assert take_record(address_of(served), tmp_path) == ExitCode.PASS
    monkeypatch.setattr(stored_records, "datetime", SetBack)
    assert take_record(address_of(served), tmp_path) == ExitCode.USAGE
    assert "Set the clock" in capsys.readouterr().err
    assert len(list_records(tmp_path)) == 1


def test_a_motor_that_flickers_by_a_count_is_read_again(served: FanucFtpServer, tmp_path: Path) -> None:
    served.cabinet.moves_counts_each_reading, served.cabinet.stands_after_readings = 1, 2
    assert take_record(address_of(served), tmp_path) == ExitCode.PASS
    assert served.transfers.count("axis.dg") == 4
    assert list_records(tmp_path)[0].record.reference_counts == tuple(served.cabinet.pulses())


@pytest.mark.parametrize(("robot", "code"), [("R-1000iA/80F", ExitCode.PASS), ("X-1/2", ExitCode.REFUSED)])
def test_while_j2_stands_at_zero_the_model_says_how_j3_is_counted(
    served: FanucFtpServer, tmp_path: Path, capsys, robot: str, code: ExitCode
) -> None:
    cabinet = served.cabinet
    cabinet.states_coupling, cabinet.robot, cabinet.joints_deg[1] = False, robot, 0.0
    assert take_record(address_of(served), tmp_path) == code
    if code != ExitCode.PASS:
        assert "cannot be seen while J2 stands at zero" in " ".join(capsys.readouterr().err.split())
        return
    (stored,) = list_records(tmp_path)
    cabinet.joints_deg[1] = 30.0
    there = stored.record.drive.to_joints(np.array(cabinet.pulses()), np.array(cabinet.counts_at_zero))
    assert np.degrees(there) == pytest.approx(cabinet.joints_deg, abs=2e-4)


def test_every_motion_group_that_turns_gets_a_record(served: FanucFtpServer, tmp_path: Path, capsys) -> None:
    served.cabinet.positioner_counts, served.cabinet.positioner_at = [70_000], -33.5
    assert take_record(address_of(served), tmp_path) == ExitCode.PASS
    screen = " ".join(capsys.readouterr().err.split())
    assert ("group 2" in screen, "not in this record" in screen) == (True, False)
    by_group = {each.controller.group: each.record for each in list_records(tmp_path)}
    counts = {group: record.counts_at_zero for group, record in by_group.items()}
    assert counts == {1: tuple(served.cabinet.counts_at_zero), 2: (70_000,)}
    assert np.degrees(by_group[2].reference_joints_rad) == pytest.approx([-33.5], abs=1e-4)
    assert (by_group[1].model, by_group[2].model) == ("fanuc_r1000ia_80f", "unknown")  # no arm's name for it
    assert take_record(address_of(served), tmp_path, "--model", "fanuc_r1000ia_80f") == ExitCode.USAGE
    assert take_record(address_of(served), tmp_path / "two", "--group", "2") == ExitCode.PASS
    assert [each.controller.group for each in list_records(tmp_path / "two")] == [2]


def test_a_group_that_is_not_mastered_is_named_and_the_other_recorded(
    served: FanucFtpServer, tmp_path: Path, capsys
) -> None:
    served.cabinet.positioner_counts, served.cabinet.positioner_mastered = [70_000], False
    assert take_record(address_of(served), tmp_path) == ExitCode.REFUSED
    assert "NO record: " in (screen := " ".join(capsys.readouterr().err.split()))
    assert "group 2 was not mastered" in screen
    assert [each.controller.group for each in list_records(tmp_path)] == [1]


def test_an_alarm_of_another_group_refuses_no_record(served: FanucFtpServer, tmp_path: Path, capsys) -> None:
    served.cabinet.positioner_counts = [70_000]
    served.cabinet.alarms.append(("SRVO-068", "DTERR alarm (Grupo:2 Eje:1)"))
    assert take_record(address_of(served), tmp_path) == ExitCode.REFUSED
    assert "SRVO-068 on J1 of group 2" in " ".join(capsys.readouterr().err.split())
    assert [each.controller.group for each in list_records(tmp_path)] == [1]


def test_a_low_battery_is_noted_and_recorded(served: FanucFtpServer, tmp_path: Path, capsys) -> None:
    served.cabinet.alarms.append(("SRVO-065", "BLAL alarm (Group:1 Axis:2)"))
    assert take_record(address_of(served), tmp_path) == ExitCode.PASS
    assert "SRVO-065 on J2: the encoder battery is low" in " ".join(capsys.readouterr().err.split())


@pytest.mark.parametrize("upper", [True, False])
@pytest.mark.parametrize("ending", ["\n", "\r\n"])
@pytest.mark.parametrize("states_coupling", [True, False])
@pytest.mark.parametrize("coupled", [True, False])
def test_a_backup_in_a_folder_is_read_in_any_form(
    tmp_path: Path, capsys, upper, ending, states_coupling, coupled
) -> None:
    cabinet = FanucCabinet(third_follows_second=coupled, states_coupling=states_coupling)
    folder = save_backup(cabinet, tmp_path / "backup", upper=upper, ending=ending)
    assert take_record(str(folder), tmp_path / "records", "--json") == ExitCode.PASS
    (document,) = json.loads(capsys.readouterr().out)["records"]
    assert [row["master_count"] for row in document["axes"]] == cabinet.counts_at_zero
    assert [row["machine_pulse"] for row in document["axes"]] == cabinet.pulses()
    assert [np.degrees(row["angle_rad"]) for row in document["axes"]] == pytest.approx(
        cabinet.joints_deg, abs=1e-4
    )
    assert any("whether the robot stood still" in line for line in document["not_checked"])


def test_a_backup_that_lacks_files_says_what_was_not_checked(tmp_path: Path, capsys) -> None:
    folder = save_backup(FanucCabinet(), tmp_path / "backup")
    for name in ("curpos.dg", "erract.ls", "sysframe.va"):
        (folder / name).unlink()
    assert take_record(str(folder), tmp_path / "records") == ExitCode.PASS
    text = " ".join(capsys.readouterr().err.split())
    for words in ("NOT checked: the angles", "there is no ERRACT.LS", "there is no SYSFRAME.VA"):
        assert words in text


def test_a_backup_without_present_counts_is_recorded_without_them(tmp_path: Path, capsys) -> None:
    cabinet = FanucCabinet(positioner_counts=[70_000], gun_mm_per_turn=5.0)  # as backups of V8.20 are
    folder = save_backup(cabinet, tmp_path / "backup")
    for name in ("curpos.dg", "axis.dg"):
        (folder / name).unlink()
    assert take_record(str(folder), tmp_path / "records") == ExitCode.PASS
    screen = " ".join(capsys.readouterr().err.split())
    assert "NOT checked: where the robot stood, and the angles from its counts: there is no AXIS.DG" in screen
    assert "NOT checked: where axis 1 of group 2 stands" in screen
    (stored,) = list_records(tmp_path / "records")
    assert stored.record.counts_at_zero == tuple(cabinet.counts_at_zero)
    assert stored.record.reference_counts == stored.record.reference_joints_rad == ()
    moved = cabinet.pulses()
    there = stored.record.drive.to_joints(np.array(moved), np.array(cabinet.counts_at_zero))
    assert np.degrees(there) == pytest.approx(cabinet.joints_deg, abs=2e-4)
    cabinet.states_coupling, cabinet.robot = False, "X-1/2"
    folder = save_backup(cabinet, tmp_path / "other")
    for name in ("curpos.dg", "axis.dg"):
        (folder / name).unlink()
    assert take_record(str(folder), tmp_path / "records") == ExitCode.REFUSED


def test_files_of_two_backups_make_no_record(tmp_path: Path, capsys) -> None:
    older, folder = FanucCabinet(), save_backup(FanucCabinet(), tmp_path / "backup")
    older.let_time_pass(days=-300)
    (folder / "curpos.dg").write_bytes((save_backup(older, tmp_path / "older") / "curpos.dg").read_bytes())
    assert take_record(str(folder), tmp_path / "records") == ExitCode.REFUSED
    assert "were not written together" in " ".join(capsys.readouterr().err.split())


@pytest.fixture(params=["plain", "devices"])
def foreign_server(request, tmp_path: Path) -> Iterator[tuple[int, Path]]:
    """An FTP server that is not ours, over a folder with a backup: read only, anonymous."""
    folder = save_backup(FanucCabinet(), tmp_path / "served")
    command = [sys.executable, "-W", "ignore", "-m", "tests.wire.foreign_ftp", str(folder), request.param]
    with subprocess.Popen(
        command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, cwd=ROOT
    ) as server:
        assert server.stdin is not None
        assert server.stdout is not None
        try:
            yield int(server.stdout.readline()), folder
        finally:
            server.stdin.close()


def test_a_server_that_is_not_ours_is_read(foreign_server: tuple[int, Path], tmp_path: Path) -> None:
    port, folder = foreign_server
    before = {path.name: path.read_bytes() for path in folder.iterdir()}
    assert take_record(f"127.0.0.1:{port}", tmp_path / "records") == ExitCode.PASS
    assert list_records(tmp_path / "records")[0].record.counts_at_zero == tuple(FanucCabinet().counts_at_zero)
    assert {path.name: path.read_bytes() for path in folder.iterdir()} == before


def test_a_client_that_is_not_ours_reads_the_fake(served: FanucFtpServer) -> None:
    cabinet = served.cabinet
    cabinet.alarms.append(("SRVO-065", "BLAL alarm (Group:1 Axis:5)"))
    ftp = ftplib.FTP()
    ftp.connect("127.0.0.1", served.port, timeout=10)
    assert ftp.login().startswith("230")
    ftp.cwd("MD:")
    for name in ("axis.dg", "AXIS.DG", "md:\\Axis.dg"):
        lines: list[str] = []
        ftp.retrlines(f"RETR {name}", lines.append)
        assert any("Machine     Motion" in line for line in lines)

    def text_of(name: str) -> str:
        found: list[str] = []
        ftp.retrlines(f"RETR {name}", found.append)
        return "\n".join(found)

    assert cabinet.software in text_of("version.dg")  # the state
    assert all(f"{joint:.2f}" in text_of("curpos.dg") for joint in cabinet.joints_deg)
    assert f"{cabinet.tools[1][2]:.3f}" in text_of("sysframe.va")
    assert "SRVO-065 BLAL alarm (Group:1 Axis:5)" in text_of("erract.ls")  # of motion this link has none
    assert {"sysmast.va", "main.ls"} <= set(ftp.nlst())
    with pytest.raises(ftplib.error_perm, match="550"):
        ftp.voidcmd("STOR main.ls")
    with pytest.raises(ftplib.error_perm, match="550"):
        ftp.delete("main.ls")
    ftp.quit()


@pytest.mark.parametrize("octets", range(3, 480, 54))
async def test_a_link_cut_anywhere_leaves_no_record_and_says_what_to_do(
    served: FanucFtpServer, tmp_path: Path, capsys: pytest.CaptureFixture[str], octets: int
) -> None:
    async with CuttingProxy("127.0.0.1", served.port, octets) as proxy:
        code = await asyncio.to_thread(take_record, f"127.0.0.1:{proxy.port}", tmp_path)
        assert proxy.was_cut
    said = " ".join(capsys.readouterr().err.split())
    assert code == ExitCode.UNREACHABLE
    assert not list_records(tmp_path)
    assert "the FTP connection was lost while" in said
    assert "What to do: Read it once more" in said
