"""A digit that was spoilt on the way makes a valid count: only another reading tells, and it is told."""

import json
import re
from collections.abc import Callable
from pathlib import Path

import pytest

from cellcal.fake_devices.fanuc_files.cabinet import FanucCabinet
from cellcal.fake_devices.fanuc_files.ftp_server import FanucFtpServer
from cellcal.service.engineering.controller_files.stored_records import list_records
from cellcal.service.exit_codes import ExitCode
from tests.wire.fanuc_ftp import address_of, ftp_controllers
from tests.wire.test_fanuc_record import take_record
from tests.wire.test_fanuc_watch import watch_robots


def spoil_last_digit(content: bytes) -> bytes:
    """Change the last digit of the count at zero of axis 3: by a few counts, far below what shown angles tell."""
    head, name, rest = content.partition(b"$MASTER_COUN")
    return (
        head
        + name
        + re.sub(rb"(\[3\] = -?\d*)(\d)", lambda m: m[1] + (b"4" if m[2] != b"4" else b"6"), rest, count=1)
    )


def spoil_serial(content: bytes) -> bytes:
    """Change the number of the controller in a report."""
    return content.replace(FanucCabinet().f_number.encode(), b"F000001")


@pytest.fixture
def spoil(monkeypatch: pytest.MonkeyPatch) -> Callable[[dict[str, Callable[[bytes], bytes]]], None]:
    """Return what damages the next transfer of each named file, and no later one."""
    sound = FanucFtpServer.file_bytes

    def damage(faults: dict[str, Callable[[bytes], bytes]]) -> None:
        left = dict(faults)

        def file_bytes(server: FanucFtpServer, name: str) -> bytes | None:
            content = sound(server, name)
            fault = left.pop(name.lower(), None)
            return content if fault is None or content is None else fault(content)

        monkeypatch.setattr(FanucFtpServer, "file_bytes", file_bytes)

    return damage


def test_a_spoilt_count_at_zero_is_not_recorded(tmp_path: Path, capsys, spoil) -> None:
    with ftp_controllers(FanucCabinet()) as (served,):
        spoil({"sysmast.va": spoil_last_digit})
        assert take_record(address_of(served), tmp_path) == ExitCode.REFUSED
        assert not list_records(tmp_path)
        assert "$MASTER_COUN of group 1, axis 3 is" in capsys.readouterr().err
        assert take_record(address_of(served), tmp_path) == ExitCode.PASS


@pytest.mark.parametrize(
    "faults",
    [
        {"sysmast.va": spoil_last_digit},
        dict.fromkeys(("axis.dg", "curpos.dg", "version.dg"), spoil_serial),
    ],
)
def test_one_spoilt_reading_is_no_change_of_the_robot(tmp_path: Path, capsys, spoil, faults) -> None:
    with ftp_controllers(FanucCabinet()) as (served,):
        take_record(address_of(served), tmp_path)
        spoil(faults)
        assert watch_robots(tmp_path, address_of(served)) == ExitCode.UNREACHABLE
        assert "two readings, one right after the other, contradict" in capsys.readouterr().err
        assert watch_robots(tmp_path, address_of(served)) == ExitCode.PASS


def test_another_controller_at_the_address_is_the_headline(tmp_path: Path, capsys) -> None:
    with ftp_controllers(FanucCabinet()) as (served,):
        take_record(address_of(served), tmp_path)
        served.cabinet.f_number, served.cabinet.robot = "F999999", "M-10iA/12"
        capsys.readouterr()
        assert watch_robots(tmp_path, address_of(served), "--json") == ExitCode.OUT_OF_TOLERANCE
        out, err = capsys.readouterr()
        assert json.loads(out)["robots"][0]["state"] == "another robot"
        assert "ANOTHER ROBOT" in err
        assert "F999999 answers (M-10iA/12)" in err
