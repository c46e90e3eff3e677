"""A rail, and groups without a record: the watch sees what happens to their mastering."""

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import pytest

from cellcal.drivers.fanuc.controller_files.axis_report import AxisReport, read_axis_report
from cellcal.drivers.fanuc.controller_files.ftp_source import FtpLogin
from cellcal.fake_devices.fanuc_files.cabinet import COUNTS_PER_TURN, FanucCabinet
from cellcal.fake_devices.fanuc_files.ftp_server import FanucFtpServer
from cellcal.fake_devices.fanuc_files.report_texts import axis_text
from cellcal.service.engineering.controller_files.nightly_watch import (
    WatchState,
    compare_with_records,
    read_controller,
)
from cellcal.service.engineering.controller_files.record_from_files import make_records
from cellcal.service.engineering.controller_files.stored_records import list_records
from cellcal.service.exit_codes import ExitCode
from tests.wire.fanuc_ftp import address_of, ftp_controllers
from tests.wire.test_fanuc_record import take_record
from tests.wire.test_fanuc_watch import watched

RAIL_COUNT = 60_956_492
UNCHANGED: tuple[int, dict[str, str]] = (ExitCode.PASS, {})


@pytest.fixture
def on_rail() -> Iterator[FanucFtpServer]:
    with ftp_controllers(FanucCabinet(rail_count_at_zero=RAIL_COUNT)) as servers:
        yield servers[0]


@pytest.fixture
def with_positioner() -> Iterator[FanucFtpServer]:
    with ftp_controllers(FanucCabinet(positioner_counts=[70_000])) as servers:
        yield servers[0]


def test_a_robot_on_a_rail_is_recorded_and_the_rail_is_named(
    on_rail: FanucFtpServer, tmp_path: Path, capsys
) -> None:
    assert take_record(address_of(on_rail), tmp_path) == ExitCode.PASS
    screen = " ".join(capsys.readouterr().err.split())
    assert f"the watch compares their master counts alone: axis 7 of group 1 ({RAIL_COUNT})" in screen
    assert len(list_records(tmp_path)[0].record.counts_at_zero) == 6
    assert watched(on_rail, tmp_path, capsys) == UNCHANGED


def test_a_servo_gun_is_named_with_its_place_and_watched(
    with_positioner: FanucFtpServer, tmp_path: Path, capsys
) -> None:
    cabinet = with_positioner.cabinet
    cabinet.gun_mm_per_turn, cabinet.positioner_at = 5.0, -50.0  # as in a backup of an M-900iB/700
    assert take_record(address_of(with_positioner), tmp_path) == ExitCode.PASS
    screen = " ".join(capsys.readouterr().err.split())
    assert (
        "Checked: axis 1 of group 2 stands at -50.00 mm by its count, and CURPOS.DG shows -50.00 mm" in screen
    )
    assert "axis 1 of group 2 (70000)" in screen
    assert [each.controller.group for each in list_records(tmp_path)] == [1]
    assert watched(with_positioner, tmp_path, capsys) == UNCHANGED
    cabinet.positioner_mastered = False
    assert watched(with_positioner, tmp_path, capsys)[1]["loss"] == "axis 1 of group 2 is no longer mastered"


def test_a_rail_that_stands_elsewhere_than_shown_is_noted(
    on_rail: FanucFtpServer, tmp_path: Path, capsys
) -> None:
    assert take_record(address_of(on_rail), tmp_path) == ExitCode.PASS
    assert "Checked: axis 7 of group 1 stands at -1444.07 mm" in " ".join(capsys.readouterr().err.split())
    shown = address_of(on_rail)
    files = read_controller(shown, FtpLogin())
    assert files.position is not None
    (group,) = files.position.groups
    elsewhere = replace(group, joints_deg=(*group.joints_deg[:6], -1444.0))
    moved = replace(files, position=replace(files.position, groups=(elsewhere,)))
    (done,) = make_records(moved).records
    assert any(
        "stands at -1444.07 mm by its count, and CURPOS.DG shows -1444.00" in each for each in done.findings
    )


def test_pulses_of_a_rail_are_not_taken_for_those_of_the_next_group() -> None:
    text = axis_text(FanucCabinet(rail_count_at_zero=RAIL_COUNT, positioner_counts=[70_000]))
    both = read_axis_report(text.encode())
    arm, positioner = both.pulses
    one_table = AxisReport(both.heading, ((*arm, *positioner),), both.servo_ready)
    assert one_table.split_by_groups((7, 1)) == (arm, positioner)
    assert one_table.split_by_groups((6, 1)) == ()


def test_a_rail_that_was_mastered_anew_is_reported(on_rail: FanucFtpServer, tmp_path: Path, capsys) -> None:
    take_record(address_of(on_rail), tmp_path)
    on_rail.cabinet.rail_count_at_zero = RAIL_COUNT - COUNTS_PER_TURN
    code, changes = watched(on_rail, tmp_path, capsys)
    assert code == ExitCode.OUT_OF_TOLERANCE
    assert "axis 7 of group 1" in changes["mastering"]
    assert "-524288 counts" in changes["mastering"]


def test_a_record_from_before_rails_were_stored_says_that_they_are_not_compared(
    on_rail: FanucFtpServer, tmp_path: Path
) -> None:
    address = address_of(on_rail)
    take_record(address, tmp_path)
    (stored,) = list_records(tmp_path)
    old = replace(stored, controller=stored.controller.model_copy(update={"other_axes": None}))
    files = read_controller(address, FtpLogin())
    found = compare_with_records(address, files, [old])
    assert (found.state, found.not_compared) == (WatchState.UNCHANGED, ("axis 7 of group 1",))
    assert "Record again" in found.sentence
    assert compare_with_records(address, files, [stored]).not_compared == ()


def test_a_rail_that_lost_its_mastering_is_a_loss(on_rail: FanucFtpServer, tmp_path: Path, capsys) -> None:
    take_record(address_of(on_rail), tmp_path)
    on_rail.cabinet.rail_state = 0
    assert watched(on_rail, tmp_path, capsys)[1] == {"loss": "axis 7 of group 1 is no longer mastered"}


def test_a_rail_that_is_not_mastered_is_noted_in_the_record(
    on_rail: FanucFtpServer, tmp_path: Path, capsys
) -> None:
    on_rail.cabinet.rail_state = 0
    assert take_record(address_of(on_rail), tmp_path) == ExitCode.PASS
    assert "group 1, axis 7 was lost" in " ".join(capsys.readouterr().err.split())
    assert watched(on_rail, tmp_path, capsys) == UNCHANGED


def test_a_group_without_a_record_is_watched(with_positioner: FanucFtpServer, tmp_path: Path, capsys) -> None:
    take_record(address_of(with_positioner), tmp_path, "--group", "1")
    assert watched(with_positioner, tmp_path, capsys) == UNCHANGED
    with_positioner.cabinet.positioner_counts = [70_001]
    assert "axis 1 of group 2" in watched(with_positioner, tmp_path, capsys)[1]["mastering"]
    with_positioner.cabinet.positioner_counts = [70_000]
    with_positioner.cabinet.positioner_mastered = False
    assert watched(with_positioner, tmp_path, capsys)[1]["loss"] == "axis 1 of group 2 is no longer mastered"


def test_a_group_with_its_own_record_is_named_once(
    with_positioner: FanucFtpServer, tmp_path: Path, capsys
) -> None:
    for group in ("1", "2"):
        take_record(address_of(with_positioner), tmp_path, "--group", group)
    with_positioner.cabinet.positioner_counts = [70_001]
    mastering = watched(with_positioner, tmp_path, capsys)[1]["mastering"]
    assert "J1 by +1 counts" in mastering
    assert "group 2" not in mastering
