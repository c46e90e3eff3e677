"""A look that lacks a file with which the record was made names what it did not compare, and is not "unchanged"."""

import json
from collections.abc import Iterator
from pathlib import Path

import pytest

from cellcal.drivers.fanuc.controller_files.controller_address import parse_address
from cellcal.drivers.fanuc.controller_files.ftp_source import FtpLogin, FtpSource
from cellcal.fake_devices.fanuc_files.cabinet import FanucCabinet
from cellcal.fake_devices.fanuc_files.ftp_server import FanucFtpServer
from cellcal.service.engineering.controller_files.nightly_watch import (
    compare_with_records,
    read_controller,
)
from cellcal.service.exit_codes import ExitCode
from tests.wire.fanuc_ftp import address_of, ftp_controllers, save_backup
from tests.wire.test_fanuc_record import take_record
from tests.wire.test_fanuc_watch import watch_robots, watched


@pytest.fixture
def server() -> Iterator[FanucFtpServer]:
    with ftp_controllers(FanucCabinet()) as servers:
        yield servers[0]


def look(server: FanucFtpServer, records: Path, capsys) -> tuple[int, str, list[str]]:
    """Return the exit code, the state and what was not compared."""
    capsys.readouterr()
    code = watch_robots(records, address_of(server), "--json")
    (robot,) = json.loads(capsys.readouterr().out)["robots"]
    return code, robot["state"], robot["not_compared"]


@pytest.mark.parametrize(
    ("name", "part"),
    [
        ("erract.ls", "alarms (no ERRACT.LS)"),
        ("axis.dg", "present counts (no AXIS.DG)"),
        ("curpos.dg", "shown angles (no CURPOS.DG)"),
        ("version.dg", "software (no VERSION.DG)"),
        ("dcsvrfy.dg", "safety settings (DCS) (no DCSVRFY.DG)"),
        ("symotn.va", "gears and scales (no SYMOTN.VA)"),
        ("sysframe.va", "frames and tools (no SYSFRAME.VA)"),
    ],
)
def test_a_file_that_is_missing_one_night_is_told(
    server: FanucFtpServer, tmp_path: Path, capsys, name: str, part: str
) -> None:
    take_record(address_of(server), tmp_path)
    server.faults.missing = frozenset([name])
    assert look(server, tmp_path, capsys) == (ExitCode.REFUSED, "not compared", [part])
    server.cabinet.counts_at_zero[2] += 1
    assert look(server, tmp_path, capsys)[:2] == (ExitCode.OUT_OF_TOLERANCE, "changed")


def test_a_version_report_that_is_cut_tells_no_other_software(
    server: FanucFtpServer, tmp_path: Path, capsys, monkeypatch: pytest.MonkeyPatch
) -> None:
    take_record(address_of(server), tmp_path)
    whole = FtpSource.read_file
    cut_at = 0

    def read_cut(source: FtpSource, name: str) -> bytes | None:
        content = whole(source, name)
        return content[:cut_at] if content is not None and name.lower() == "version.dg" else content

    with FtpSource(parse_address(address_of(server)), FtpLogin()) as source:
        content = source.read_file("version.dg")
    assert content is not None
    monkeypatch.setattr(FtpSource, "read_file", read_cut)
    number = content.index(b"Software Edition No.: ") + len(b"Software Edition No.: ")
    for cut_at in (number - 30, number, number + 4, number + 6):  # noqa: B007  read by the closure
        assert look(server, tmp_path, capsys) == (
            ExitCode.REFUSED,
            "not compared",
            ["software edition (not in VERSION.DG: it is not whole)"],
        )


def test_without_the_mastering_nothing_was_read(server: FanucFtpServer, tmp_path: Path, capsys) -> None:
    take_record(address_of(server), tmp_path)
    server.faults.missing = frozenset(["sysmast.va"])
    assert look(server, tmp_path, capsys)[:2] == (ExitCode.UNREACHABLE, "not read")
    watch_robots(tmp_path, address_of(server))
    assert "there is no SYSMAST.VA" in " ".join(capsys.readouterr().err.split())


def test_an_f_number_that_no_file_tells_is_not_compared(
    server: FanucFtpServer, tmp_path: Path, capsys
) -> None:
    take_record(address_of(server), tmp_path)
    server.cabinet.f_number = ""
    code, state, parts = look(server, tmp_path, capsys)
    assert (code, state, parts) == (
        ExitCode.REFUSED,
        "not compared",
        ["which controller it is (no F number)"],
    )


def test_what_a_backup_never_held_is_not_missed(tmp_path: Path) -> None:
    backup, records = tmp_path / "backup", tmp_path / "records"
    backup.mkdir()
    save_backup(FanucCabinet(), backup)
    for name in ("axis.dg", "erract.ls", "dcsvrfy.dg"):
        (backup / name).unlink(missing_ok=True)
    assert take_record(str(backup), records) == ExitCode.PASS
    assert watch_robots(records, str(backup)) == ExitCode.PASS


def test_other_gears_are_told_although_the_counts_are_those_of_the_record(
    server: FanucFtpServer, tmp_path: Path, capsys
) -> None:
    take_record(address_of(server), tmp_path)
    cabinet = server.cabinet
    cabinet.ratios = [*cabinet.ratios[:3], cabinet.ratios[3] * 1.02, *cabinet.ratios[4:]]
    cabinet.joints_deg = [0.0] * 6  # where the angles agree with any gears
    code, changes = watched(server, tmp_path, capsys)
    assert code == ExitCode.OUT_OF_TOLERANCE
    assert "of J4 differ from the record" in changes["drives"]


def test_a_controller_that_gives_no_file_at_all_is_not_called_new(server: FanucFtpServer) -> None:
    server.faults.missing = frozenset(server.list_names())
    address = address_of(server)
    found = compare_with_records(address, read_controller(address, FtpLogin()), ())
    assert found.state == "not read"
    assert "none of its files can be read" in found.sentence


def test_files_of_two_controllers_are_no_new_robot(tmp_path: Path) -> None:
    folder = save_backup(FanucCabinet(), tmp_path / "backup")
    save_backup(FanucCabinet(f_number="F999999"), tmp_path / "other")
    (folder / "version.dg").write_bytes((tmp_path / "other" / "version.dg").read_bytes())
    found = compare_with_records(str(folder), read_controller(str(folder), FtpLogin()), ())
    assert found.state == "not read"
    assert "of different controllers: F123456, F999999" in found.sentence


def test_names_of_a_listing_that_a_terminal_would_obey_are_no_files(
    server: FanucFtpServer, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(server, "list_names", lambda: ["axis.dg", "\x1b[2J.ls"])
    with FtpSource(parse_address(address_of(server))) as source:
        assert source.list_names() == ("axis.dg",)
