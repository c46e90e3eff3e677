"""``cellcal mastering watch``: what happened to a controller since its record is named, and one robot stops no other."""

import json
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from cellcal.fake_devices.fanuc_files.cabinet import COUNTS_PER_TURN, FanucCabinet
from cellcal.fake_devices.fanuc_files.ftp_server import FanucFtpServer
from cellcal.service.cli.app import run_command_line
from cellcal.service.engineering.controller_files.file_changes import compare_safety
from cellcal.service.engineering.controller_files.stored_records import list_records
from cellcal.service.exit_codes import ExitCode
from tests.wire.fanuc_ftp import address_of, ftp_controllers
from tests.wire.test_fanuc_record import take_record

FRAME = (1000.0, -500.0, 250.0, 0.0, 0.0, 90.0)


@pytest.fixture
def served() -> Iterator[FanucFtpServer]:
    with ftp_controllers(FanucCabinet(frames={1: FRAME})) as servers:
        yield servers[0]


def watch_robots(records: Path, *more: str) -> int:
    return run_command_line(["mastering", "watch", *more, "--records", str(records)])


def watched(served: FanucFtpServer, records: Path, capsys) -> tuple[int, dict[str, str]]:
    """Return the exit code and the changes by their kind."""
    capsys.readouterr()
    code = watch_robots(records, address_of(served), "--json")
    (robot,) = json.loads(capsys.readouterr().out)["robots"]
    return code, {change["kind"]: change["text"] for change in robot["changes"]}


def test_nothing_happened(served: FanucFtpServer, tmp_path: Path, capsys) -> None:
    take_record(address_of(served), tmp_path)
    served.cabinet.let_time_pass(days=1)
    served.cabinet.joints_deg[0] = 12.0
    served.cabinet.moves_counts_each_reading = 500  # in production: no reason to wake a person
    served.cabinet.servo_on = True
    assert watched(served, tmp_path, capsys) == (ExitCode.PASS, {})


@pytest.mark.parametrize(
    ("held_deg", "is_no_change"),
    [
        ((-0.086, 0.112), True),
        ((-0.086, 0.5), False),
    ],  # the first as a public backup of an R-2000iC/210L shows
)
def test_a_robot_that_is_held_beside_its_angles_under_power(
    served: FanucFtpServer, tmp_path: Path, capsys, held_deg: tuple[float, float], is_no_change: bool
) -> None:
    take_record(address_of(served), tmp_path)
    served.cabinet.let_time_pass(days=1)
    served.cabinet.servo_on, served.cabinet.held_beside_deg = True, held_deg
    code, changes = watched(served, tmp_path, capsys)
    assert (code == ExitCode.PASS) is is_no_change
    assert ("contradiction" not in changes) is is_no_change
    watch_robots(tmp_path, address_of(served))
    assert ("the shown angles of J2 and J3" in " ".join(capsys.readouterr().err.split())) is is_no_change


def test_a_mastering_that_was_typed_is_a_contradiction_under_power_too(
    served: FanucFtpServer, tmp_path: Path, capsys
) -> None:
    cabinet = served.cabinet
    take_record(address_of(served), tmp_path)
    cabinet.let_time_pass(days=1)
    cabinet.servo_on, cabinet.held_beside_deg = True, (-0.086, 0.112)
    cabinet.effective_zero = list(cabinet.counts_at_zero)
    cabinet.counts_at_zero[1] += 8000
    code, changes = watched(served, tmp_path, capsys)
    assert code == ExitCode.OUT_OF_TOLERANCE
    assert changes.keys() == {"mastering", "contradiction"}


def test_programs_that_cannot_be_listed_are_not_said_to_be_gone(
    served: FanucFtpServer, tmp_path: Path, capsys
) -> None:
    take_record(address_of(served), tmp_path)
    served.faults.lists_nothing = True
    assert watched(served, tmp_path, capsys) == (ExitCode.REFUSED, {})
    assert watch_robots(tmp_path, address_of(served), "--no-programs") == ExitCode.PASS


def lose_position(cabinet: FanucCabinet) -> None:
    cabinet.lose_position([2, 3])


def forget_silently(cabinet: FanucCabinet) -> None:
    cabinet.axis_states[4] = 0


def break_cable(cabinet: FanucCabinet) -> None:
    cabinet.alarms.append(("SRVO-068", "DTERR alarm (Group:1 Axis:5)"))


def let_battery_run_low(cabinet: FanucCabinet) -> None:
    cabinet.alarms.append(("SRVO-065", "BLAL alarm (Group:1 Axis:5)"))


def master_anew(cabinet: FanucCabinet) -> None:
    cabinet.counts_at_zero[2] += COUNTS_PER_TURN


def shift_zero(cabinet: FanucCabinet) -> None:
    cabinet.counts_at_zero[0] -= 1234


def move_frame(cabinet: FanucCabinet) -> None:
    cabinet.frames[1] = (1000.0, -500.0, 251.5, 0.0, 0.0, 90.0)


def change_tool(cabinet: FanucCabinet) -> None:
    cabinet.tools[1] = (-275.0, 0.0, 281.0, -180.0, -90.0, 0.0)


def edit_program(cabinet: FanucCabinet) -> None:
    cabinet.programs["MAIN"] = "CALL PLACE"
    cabinet.programs["NEW"] = "R[1]=1"
    del cabinet.programs["PICK"]


def exchange_controller(cabinet: FanucCabinet) -> None:
    cabinet.f_number = "F999999"


def write_zero_without_calibrate(cabinet: FanucCabinet) -> None:
    cabinet.effective_zero = list(cabinet.counts_at_zero)
    cabinet.counts_at_zero[1] += 8000


def update_software(cabinet: FanucCabinet) -> None:
    cabinet.software = "V9.40P/90"


@pytest.mark.parametrize(
    ("happen", "expected"),
    [
        (lose_position, {"loss": "$EACHMST_DON"}),
        (forget_silently, {"loss": "axis 5 was lost"}),
        (break_cable, {"loss": "SRVO-068 on J5"}),
        (
            let_battery_run_low,
            {"low battery": "SRVO-065 on J5: the encoder battery is low. Change the battery"},
        ),
        (master_anew, {"mastering": "J3 by +524288 counts (-2.697 deg, +1 turns of the motor)"}),
        (shift_zero, {"mastering": "J1 by -1234 counts (-0.006 deg)"}),
        (move_frame, {"frame": "frame 1: Z 250.000 to 251.500"}),
        (change_tool, {"tool": "tool 1: Z 280.000 to 281.000"}),
        (edit_program, {"program": "gone: PICK"}),
        (exchange_controller, {"other robot": "F999999 answers"}),
        (write_zero_without_calibrate, {"mastering": "J2 by +8000", "contradiction": "CURPOS.DG shows"}),
        (update_software, {"software": "V9.40P/90"}),
    ],
)
def test_what_happened_is_named_with_its_difference(
    served: FanucFtpServer,
    tmp_path: Path,
    capsys,
    happen: Callable[[FanucCabinet], None],
    expected: dict[str, str],
) -> None:
    take_record(address_of(served), tmp_path)
    served.cabinet.let_time_pass(days=1)
    happen(served.cabinet)
    code, changes = watched(served, tmp_path, capsys)
    assert code == ExitCode.OUT_OF_TOLERANCE
    assert changes.keys() == expected.keys()
    for kind, words in expected.items():
        assert words in changes[kind]


def test_an_old_backup_is_known_by_its_record(served: FanucFtpServer, tmp_path: Path, capsys) -> None:
    cabinet, before = served.cabinet, list(served.cabinet.counts_at_zero)
    take_record(address_of(served), tmp_path)
    cabinet.let_time_pass(days=30)
    cabinet.counts_at_zero[5] += 4000
    take_record(address_of(served), tmp_path)
    cabinet.let_time_pass(days=1)
    cabinet.counts_at_zero = before
    code, changes = watched(served, tmp_path, capsys)
    assert code == ExitCode.OUT_OF_TOLERANCE
    assert "the mastering is that of" in changes["old backup"]
    assert "J6 by -4000 counts" in changes["old backup"]


def test_files_that_are_older_than_the_record(served: FanucFtpServer, tmp_path: Path, capsys) -> None:
    old = FanucCabinet(frames={1: FRAME})
    old.let_time_pass(days=-3)
    take_record(address_of(served), tmp_path)
    served.cabinet.stale = old
    code, changes = watched(served, tmp_path, capsys)
    assert code == ExitCode.OUT_OF_TOLERANCE
    assert "older than those of the record" in changes["clock"]


def test_a_record_that_was_changed_by_hand_is_not_compared_with(
    served: FanucFtpServer, tmp_path: Path, capsys
) -> None:
    take_record(address_of(served), tmp_path)
    (stored,) = list_records(tmp_path)
    count = str(served.cabinet.counts_at_zero[1]).encode()
    stored.path.write_bytes(stored.path.read_bytes().replace(count, count[:-1] + b"0"))
    assert watch_robots(tmp_path, address_of(served)) == ExitCode.SIGNATURE
    assert "is not used" in " ".join(capsys.readouterr().err.split())


def test_records_without_their_key_are_not_signed_anew(
    served: FanucFtpServer, tmp_path: Path, capsys
) -> None:
    take_record(address_of(served), tmp_path)
    (tmp_path / "signing_key.pem").unlink()
    assert watch_robots(tmp_path, address_of(served)) == ExitCode.SIGNATURE
    assert "not the key that signed them" in " ".join(capsys.readouterr().err.split())
    assert not (tmp_path / "signing_key.pem").exists()


def test_a_robot_without_a_record_is_named(served: FanucFtpServer, tmp_path: Path, capsys) -> None:
    assert watch_robots(tmp_path, address_of(served)) == ExitCode.REFUSED
    assert f"cellcal mastering record {address_of(served)}" in " ".join(capsys.readouterr().err.split())
    assert watch_robots(tmp_path) == ExitCode.USAGE


def test_controllers_that_share_a_number_are_not_mixed_up(tmp_path: Path, capsys) -> None:
    cabinets = [FanucCabinet(f_number="F00000"), FanucCabinet(f_number="F00000")]
    cabinets[1].counts_at_zero[3] += 777
    with ftp_controllers(*cabinets, FanucCabinet(f_number="F00000")) as (first, second, third):
        for server in (first, second):
            assert take_record(address_of(server), tmp_path) == ExitCode.PASS
        for server in (first, second):
            assert watched(server, tmp_path, capsys) == (ExitCode.PASS, {})
        assert (
            watch_robots(tmp_path, address_of(third)) == ExitCode.REFUSED
        )  # whose record it would be is not known
        cabinets[1].counts_at_zero[3] -= 777
        assert "J4 by -777" in watched(second, tmp_path, capsys)[1]["mastering"]


def test_a_robot_that_has_another_address_is_known_by_its_number(tmp_path: Path, capsys) -> None:
    cabinet = FanucCabinet()
    with ftp_controllers(cabinet, cabinet) as (first, second):
        take_record(address_of(first), tmp_path)
        assert watched(second, tmp_path, capsys) == (ExitCode.PASS, {})


@pytest.mark.parametrize(
    ("numbers", "own_axes", "is_named"),
    [
        (("F100001", "F100002"), (), True),
        (("F100001", "F100002"), (0, 4), True),  # two axes were mastered since
        (("F100001", "F100002"), (0, 1, 2, 3), False),
        (("F00000", "F00000"), (), False),  # numbers that were never set: it may be the same arm
    ],
)
def test_a_mastering_that_another_robot_has_as_well_is_named(
    tmp_path: Path, capsys, numbers: tuple[str, str], own_axes: tuple[int, ...], is_named: bool
) -> None:
    cabinets = [FanucCabinet(f_number=number) for number in numbers]
    for axis in own_axes:
        cabinets[1].counts_at_zero[axis] += 4321
    with ftp_controllers(*cabinets) as servers:
        for server in servers:
            capsys.readouterr()
            assert take_record(address_of(server), tmp_path, "--json") == ExitCode.PASS
        (second,) = json.loads(capsys.readouterr().out)["records"]
        assert any(numbers[0] in finding for finding in second["findings"]) is is_named
        code, changes = watched(servers[1], tmp_path, capsys)
    assert (code, "copied mastering" in changes) == (
        ExitCode.OUT_OF_TOLERANCE if is_named else ExitCode.PASS,
        is_named,
    )
    if is_named:
        assert all(
            f"J{axis + 1}" not in changes["copied mastering"].partition(" have ")[0] for axis in own_axes
        )


@pytest.mark.parametrize("many", [20, pytest.param(100, marks=pytest.mark.soak)])
def test_many_controllers_in_one_night(tmp_path: Path, capsys, many: int) -> None:
    cabinets = [FanucCabinet(f_number=f"F{100_000 + n}", robot_name=f"R{n:03d}") for n in range(many)]
    for n, cabinet in enumerate(cabinets):
        cabinet.counts_at_zero = [count + 1013 * n for count in cabinet.counts_at_zero]
    with ftp_controllers(*cabinets) as servers:
        for server in servers:
            assert take_record(address_of(server), tmp_path, "--no-programs") == ExitCode.PASS
        cabinets[7].lose_position([1])
        servers[8].faults.refuses_login = True
        servers[9].faults.drop_in_file = "sysmast.va"
        cabinets[10].frames[4] = FRAME
        addresses = tmp_path / "robots.txt"
        lines = [f"{address_of(server)}  # {server.cabinet.robot_name}" for server in servers]
        addresses.write_text("\n".join(["# the hall", *lines, "127.0.0.1:1"]), encoding="utf-8")
        capsys.readouterr()
        assert watch_robots(tmp_path, "--file", str(addresses), "--json") == ExitCode.OUT_OF_TOLERANCE
    output = capsys.readouterr()
    assert len(output.err.strip().splitlines()) == many + 1  # a line for each
    states = [robot["state"] for robot in json.loads(output.out)["robots"]]
    assert states[7:11] == ["position lost", "not read", "not read", "changed"]
    assert states[many] == "not read"
    assert states[:7] + states[11:many] == ["unchanged"] * (many - 4)
    written = {command.partition(" ")[0] for server in servers for command in server.commands}
    assert written <= {"USER", "PASS", "TYPE", "CWD", "PASV", "NLST", "RETR", "QUIT"}


def test_a_changed_safety_setting_is_reported(served: FanucFtpServer, tmp_path: Path, capsys) -> None:
    take_record(address_of(served), tmp_path)
    served.cabinet.safety_signature -= 5
    code, changes = watched(served, tmp_path, capsys)
    assert (code, list(changes)) == (ExitCode.OUT_OF_TOLERANCE, ["DCS"])
    assert "signature of Pos./Speed 1945160182 is 1945160177 now" in changes["DCS"]
    assert "tools and frames" in changes["DCS"]


def test_settings_of_safety_that_are_not_read_are_named(
    served: FanucFtpServer, tmp_path: Path, capsys
) -> None:
    served.faults.missing = frozenset(["dcsvrfy.dg"])
    assert take_record(address_of(served), tmp_path) == ExitCode.PASS
    assert "NOT checked: the safety settings (DCS)" in " ".join(capsys.readouterr().err.split())
    served.faults.missing = frozenset()
    assert watched(served, tmp_path, capsys) == (ExitCode.PASS, {})


def test_older_software_has_one_signature_for_all_but_the_position_check() -> None:
    files = {"Total": 3, "Base": 1, "Pos./Speed": 2, "I/O connect": 5}
    changed = compare_safety(files, {**files, "Total": 9, "Base": 7})
    assert [each.text for each in changed] == ["signature of Base 1 is 7 now"]
    parts = {**files, "Mastering": 10, "Robot": 11, "Other": 12}
    changed = compare_safety(parts, {**parts, "Total": 9, "Base": 7, "Mastering": 13})
    assert [each.text for each in changed] == ["signature of Mastering 10 is 13 now"]
    assert compare_safety(None, files) == compare_safety(files, {}) == []
