"""Programs on the command line: the door line cloned, moved, compensated, watched; bad input; sources untouched."""

import csv
import hashlib
import json
import re
import resource
import shutil
import sys
from pathlib import Path

import numpy as np
import pytest

from cellcal.calibration.arm.kinematics import load_model
from cellcal.calibration.geometry import homogeneous_matrix, inverse_transform
from cellcal.calibration.orientation import rotation_from
from cellcal.service.cli.app import run_command_line
from cellcal.service.exit_codes import ExitCode
from tests import example_projects
from tests.example_projects import FOLDER
from tests.unit.programs.diff_application import apply_diff

NUMBER = re.compile(rb"[ \t]*[+-]?(?:\d+\.?\d*|\.\d+)")


@pytest.fixture
def door_line_project(tmp_path: Path) -> Path:
    """The door line as it ships, in a place of its own."""
    return Path(shutil.copytree(FOLDER, tmp_path / "line"))


def hash_files(folder: Path) -> dict[str, str]:
    files = sorted(path for path in folder.rglob("*") if path.is_file())
    return {str(path.relative_to(folder)): hashlib.sha256(path.read_bytes()).hexdigest() for path in files}


def run_command(*words: object) -> int:
    return run_command_line(["program", *map(str, words)])


def project_paths(line: Path) -> tuple[Path, Path]:
    return line / "cell_1" / "project.toml", line / "cell_7" / "project.toml"


def join_lines(captured: str) -> str:
    return " ".join(captured.split())


def test_a_cloned_point_is_where_the_masters_is_at_the_fixture(
    door_line_project: Path, tmp_path: Path
) -> None:
    """The true arms, which no file holds, say so: both real tips are in one place of the fixture."""
    out, report = tmp_path / "out", tmp_path / "points.json"
    before = hash_files(door_line_project)
    assert (
        run_command("clone", *project_paths(door_line_project), "--out", out, "--json", report)
        == ExitCode.PASS
    )
    assert hash_files(door_line_project) == before
    points = [p for one in json.loads(report.read_text())["programs"] for p in one["points"]]
    assert len(points) == 40

    master, clone = example_projects.example_cells()
    misses, base_only = [], []
    for name in ("DOOR_SPOTS.LS", "HEM_SEAL.LS", "RACK_PICK.LS"):
        taught = example_projects.tips_at_fixture(
            master, (door_line_project / "cell_1" / "programs" / name).read_bytes()
        )
        cloned = example_projects.tips_at_fixture(clone, (out / name).read_bytes())
        shifted = example_projects.tips_at_fixture(
            clone, (door_line_project / "cell_1" / "programs" / name).read_bytes()
        )
        misses.append(np.linalg.norm((cloned - taught)[:, :3, 3], axis=1))
        base_only.append(np.linalg.norm((shifted - taught)[:, :3, 3], axis=1))
    missed = np.concatenate(misses)
    expected = np.array([point["expected_error_mm"] for point in points]) / 1e3
    assert missed.max() < 5e-4
    assert missed.mean() < 2.5e-4
    assert np.concatenate(base_only).mean() > 4 * missed.mean()
    assert (missed < expected).mean() > 0.8


def test_reports_tell_the_same_and_the_diff_makes_the_clone_of_the_master(
    door_line_project: Path, tmp_path: Path, capsys
) -> None:
    out = tmp_path / "out"
    reports = [
        word for kind in ("json", "csv", "html", "diff") for word in (f"--{kind}", tmp_path / f"r.{kind}")
    ]
    assert run_command("clone", *project_paths(door_line_project), "--out", out, *reports) == ExitCode.PASS
    shown = join_lines(capsys.readouterr().out)
    assert "3 programs, 40 points: 40 changed, 0 unchanged, 0 left as they were." in shown
    document = json.loads((tmp_path / "r.json").read_text())
    with (tmp_path / "r.csv").open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    points = [point for one in document["programs"] for point in one["points"]]
    assert [float(row["shift_mm"]) for row in rows] == [point["shift_mm"] for point in points]
    assert document["largest_shift_mm"] == pytest.approx(max(p["shift_mm"] for p in points), rel=1e-6)
    page = (tmp_path / "r.html").read_text()
    assert page.count("<circle cx") == 4 * 40
    assert not re.search(r"(?:src|href)\s*=|url\(|<script|@import", page)

    each = re.split(rb"(?m)^(?=--- )", (tmp_path / "r.diff").read_bytes())[1:]
    assert len(each) == 3
    for diff in each:
        name = Path(diff.split(b"\n")[1].decode()).name
        taught = (door_line_project / "cell_1" / "programs" / name).read_bytes()
        assert apply_diff(taught, diff) == (out / name).read_bytes()
    removed, added = ([], [])
    for changed in (tmp_path / "r.diff").read_bytes().split(b"\n"):
        if changed.startswith((b"---", b"+++")):
            continue
        (removed if changed.startswith(b"-") else added if changed.startswith(b"+") else []).append(
            changed[1:]
        )
    assert len(removed) == len(added) > 40
    assert [NUMBER.sub(b"#", one) for one in removed] == [NUMBER.sub(b"#", one) for one in added]


def test_status_says_which_cell_runs_what(door_line_project: Path, capsys) -> None:
    master, clone = project_paths(door_line_project)
    programs = clone.parent / "programs"

    def cell_states() -> dict[str, str]:
        assert run_command("status", door_line_project, "--json") in (ExitCode.PASS, ExitCode.REFUSED)
        found = json.loads(capsys.readouterr().out)["programs"]
        return {one["program"]: one["state"] for one in found}

    assert set(cell_states().values()) == {"not there"}
    assert run_command("clone", master, clone, "--out", programs) == ExitCode.PASS
    capsys.readouterr()
    assert run_command("status", clone) == ExitCode.PASS
    assert "all as in the master" in capsys.readouterr().out
    taught = master.parent / "programs" / "RACK_PICK.LS"
    taught.write_bytes(taught.read_bytes().replace(b"600.000  mm", b"601.000  mm"))
    edited = programs / "HEM_SEAL.LS"
    edited.write_bytes(edited.read_bytes().replace(b"Z =    ", b"Z =   1", 1))
    saved = programs / "DOOR_SPOTS.LS"
    saved.write_bytes(saved.read_bytes().replace(b"26-02-27", b"26-03-01"))
    assert cell_states() == {
        "DOOR_SPOTS.LS": "current",
        "HEM_SEAL.LS": "points edited",
        "RACK_PICK.LS": "old version",
    }
    assert run_command("status", clone) == ExitCode.REFUSED
    shown = join_lines(capsys.readouterr().out)
    assert "2 not as in the master" in shown
    assert "DOOR_SPOTS.LS in door line, cell 7: its points are the clone's" in shown
    clone.write_text(
        clone.read_text().replace("sigma_mm = 0.03", "sigma_mm = 0.04").replace("-0.18", "-0.19")
    )
    assert cell_states()["DOOR_SPOTS.LS"] == "cell has changed"
    (programs / "cellcal_clones.json").unlink()
    assert set(cell_states().values()) == {"no record"}
    assert run_command("status", master) == ExitCode.FILES_REFUSED


def test_a_move_and_its_opposite_give_the_points_back(
    door_line_project: Path, tmp_path: Path, capsys
) -> None:
    master, _ = project_paths(door_line_project)
    there = homogeneous_matrix(
        rotation_from("fanuc_wpr", np.deg2rad([0.0, 0.0, 1.5])), np.array([0.012, 0.0, -0.0035])
    )
    x, y, z = inverse_transform(there)[:3, 3] * 1e3
    back = f"--offset={x:.9f},{y:.9f},{z:.9f},0,0,-1.5"
    out, again = tmp_path / "moved", tmp_path / "back"
    offset = "--offset=12,0,-3.5,0,0,1.5"
    assert (
        run_command("move", "--project", master, "--offset", "-1,0,0", "--out", tmp_path / "by_base")
        == ExitCode.PASS
    )
    assert run_command("move", "--project", master, offset, "--frame", 2, "--out", out) == ExitCode.PASS
    assert "Never do both" in join_lines(capsys.readouterr().err)
    assert run_command("move", out, "--project", master, back, "--frame", 2, "--out", again) == ExitCode.PASS
    for path in again.glob("*.LS"):
        old, new = (
            [float(n) for n in re.findall(rb"[XYZ] = *(-?[\d.]+) *mm", file.read_bytes())]
            for file in (master.parent / "programs" / path.name, path)
        )
        assert np.abs(np.array(old) - new).max() < 0.06  # 0.0005 deg of rounding at a metre, twice
    unclear = ("move", "--project", master, "--out", out)
    for words in ((), ("--offset=1,2",), ("--offset=a,b,c",), ("--from", master), (offset, "--frame", "9")):
        assert run_command(*unclear, *words) == ExitCode.USAGE


def test_compensation_puts_the_real_tip_where_the_program_says(
    door_line_project: Path, tmp_path: Path
) -> None:
    master, _ = project_paths(door_line_project)
    out = tmp_path / "out"
    assert run_command("compensate", "--project", master, "--out", out) == ExitCode.PASS
    cell = example_projects.example_cells()[0]
    for path in out.glob("*.LS"):
        meant = cell.entered_frame @ example_projects.poses_of(
            (master.parent / "programs" / path.name).read_bytes()
        )
        real = cell.base_fixture @ example_projects.tips_at_fixture(cell, path.read_bytes())
        assert np.linalg.norm((real - meant)[:, :3, 3], axis=1).max() < 4e-4
    taught = tmp_path / "taught"
    assert run_command("compensate", out, "--project", master, "--download", "--out", taught) == ExitCode.PASS
    for path in taught.glob("*.LS"):
        old, new = (
            example_projects.poses_of(file.read_bytes())[:, :3, 3]
            for file in (master.parent / "programs" / path.name, path)
        )
        assert np.abs(old - new).max() < 2e-5


def test_inspect_shows_and_prints_again(door_line_project: Path, tmp_path: Path, capsys) -> None:
    master, _ = project_paths(door_line_project)
    again = tmp_path / "again"
    assert run_command("inspect", "--project", master, "--roundtrip", again, "--json") == ExitCode.PASS
    document = json.loads(capsys.readouterr().out)
    assert document["point_count"] == 40
    assert all(one["identical"] for one in document["programs"])
    for path in again.glob("*.LS"):
        assert path.read_bytes() == (master.parent / "programs" / path.name).read_bytes()
    point = document["programs"][0]["points"][0]
    assert (point["reach"], point["user_frame"], point["tool"]) == ("reached", "2", "1")
    assert point["miss_mm"] > point["known_within_mm"] > 0
    assert (
        run_command("inspect", master.parent / "programs", "--robot", load_model("fanuc_r2000ic_165f").name)
        == 0
    )
    shown = capsys.readouterr().out
    assert "2?" in shown
    assert run_command("inspect", master.parent, "--robot", "unnamed") == ExitCode.USAGE
    assert "Known:" in join_lines(capsys.readouterr().err)


def test_a_point_out_of_reach_is_named_and_left(door_line_project: Path, tmp_path: Path, capsys) -> None:
    program = door_line_project / "cell_1" / "programs" / "RACK_PICK.LS"
    program.write_bytes(program.read_bytes().replace(b"Z =   450.000", b"Z =  9450.000"))
    out = tmp_path / "out"
    assert (
        run_command("clone", *project_paths(door_line_project), "--out", out, "--html", tmp_path / "r.html")
        == ExitCode.REFUSED
    )
    shown = join_lines(capsys.readouterr().out)
    assert "1 left as they were" in shown
    assert "unreachable" in shown
    written = (out / "RACK_PICK.LS").read_bytes()
    assert b"X =   600.000  mm,\tY =   450.000  mm,\tZ =  9450.000" in written
    assert b"Z =   300.000" not in written
    page = (tmp_path / "r.html").read_text()
    assert page.count('<td class="bad">unreachable') == 1


def test_what_is_bad_is_refused_by_name_and_the_rest_goes_on(
    door_line_project: Path, tmp_path: Path, capsys
) -> None:
    master, clone = project_paths(door_line_project)
    programs = master.parent / "programs"
    bad = {
        "EMPTY.LS": (b"", "the file is empty"),
        "TEXT.LS": (b"\xff\xfe\x00no program", "EMPTY"),
        "CUT.LS": ((programs / "HEM_SEAL.LS").read_bytes()[:-700], "CUT"),
        "HUGE.LS": (b"/PROG HUGE\n/MN\n" + b"x" * 3_000_000, "HUGE"),
        "METRES.LS": (
            re.sub(rb"(\d+)\.000  mm", rb".\g<1>  mm", (programs / "RACK_PICK.LS").read_bytes()),
            "METRES",
        ),
        "FOREIGN.src": (b"DEF FOREIGN( )\nEND\n", "FOREIGN"),
    }
    folder = tmp_path / "bad"
    folder.mkdir()
    for name, (data, _) in bad.items():
        (folder / name).write_bytes(data)
    twin = tmp_path / "twin"
    twin.mkdir()
    shutil.copy(programs / "HEM_SEAL.LS", twin)
    before = hash_files(tmp_path)
    named = [programs / "RACK_PICK.LS", programs / "HEM_SEAL.LS", *(folder / name for name in bad)]
    also = [twin / "HEM_SEAL.LS", tmp_path / "nothing.ls", f"{tmp_path}/*.nix", "/dev/zero"]
    out = tmp_path / "out"
    report = tmp_path / "r.json"
    code = run_command("clone", master, clone, *named, *also, "--out", out, "--json", report)
    shown = join_lines(capsys.readouterr().out)
    assert code == ExitCode.FILES_REFUSED
    document = json.loads(report.read_text())
    assert [one["program"] for one in document["programs"]] == ["RACK_PICK"]
    refused = {Path(one["file"]).name: one for one in document["refused"]}
    assert set(bad) | {"HEM_SEAL.LS", "nothing.ls", "*.nix", "zero"} == set(refused)
    for name, one in refused.items():
        assert one["remedy"], name
        assert one["message"].count("\n") == 0
        assert name in shown.replace(" ", ""), name  # a long path is broken at the edge of the screen
    assert {name: digest for name, digest in hash_files(tmp_path).items() if name in before} == before
    assert sorted(path.name for path in out.iterdir()) == ["RACK_PICK.LS", "cellcal_clones.json"]


def test_nothing_is_written_over(door_line_project: Path, tmp_path: Path, capsys) -> None:
    master, clone = project_paths(door_line_project)
    programs = master.parent / "programs"
    before = hash_files(door_line_project)
    assert run_command("clone", master, clone, "--out", programs, "--replace") == ExitCode.FILES_REFUSED
    assert "a source is never written over" in join_lines(capsys.readouterr().out)
    linked = tmp_path / "linked"
    linked.mkdir()
    (linked / "RACK_PICK.LS").symlink_to(programs / "RACK_PICK.LS")
    (linked / "HEM_SEAL.LS").hardlink_to(programs / "HEM_SEAL.LS")
    assert run_command("clone", master, clone, "--out", linked, "--replace") == ExitCode.FILES_REFUSED
    for report in ("--json", "--csv", "--html", "--diff"):
        words = ("--out", tmp_path / "no", report, programs / "HEM_SEAL.LS", "--replace")
        assert run_command("clone", master, clone, *words) == ExitCode.USAGE
    assert hash_files(door_line_project) == before
    out = tmp_path / "out"
    assert run_command("clone", master, clone, "--out", out) == ExitCode.PASS
    first = hash_files(out)
    assert run_command("clone", master, clone, "--out", out) == ExitCode.FILES_REFUSED
    assert "is there already" in join_lines(capsys.readouterr().out)
    assert hash_files(out) == first
    assert run_command("clone", master, clone, "--out", out, "--replace") == ExitCode.PASS
    assert [p for p in out.iterdir() if p.name.startswith(".")] == []


def test_a_second_run_does_not_take_what_the_first_wrote(door_line_project: Path) -> None:
    master, clone = project_paths(door_line_project)
    out = master.parent / "programs" / "cloned"
    for _ in range(2):
        assert (
            run_command("clone", master, clone, master.parent / "programs", "--out", out, "--replace")
            == ExitCode.PASS
        )
    assert sorted(path.name for path in out.rglob("*.LS")) == ["DOOR_SPOTS.LS", "HEM_SEAL.LS", "RACK_PICK.LS"]


def test_a_report_on_standard_output_is_alone_there(
    door_line_project: Path, tmp_path: Path, capfdbinary
) -> None:
    master, clone = project_paths(door_line_project)
    assert run_command("clone", master, clone, "--out", tmp_path / "a", "--json", "-") == ExitCode.PASS
    captured = capfdbinary.readouterr()
    assert json.loads(captured.out)["point_count"] == 40
    assert b"40 changed" in captured.err
    assert run_command("clone", master, clone, "--out", tmp_path / "b", "--diff", "-") == ExitCode.PASS
    assert capfdbinary.readouterr().out.startswith(b"--- ")
    assert (
        run_command("clone", master, clone, "--out", tmp_path / "c", "--diff", "-", "--csv", "-")
        == ExitCode.USAGE
    )
    assert (
        run_command("clone", master, clone, "--out", tmp_path / "c", "--diff", "--csv", "x") == ExitCode.USAGE
    )


def test_the_examples_that_ship_are_what_their_maker_makes(tmp_path: Path, monkeypatch) -> None:
    monkeypatch.setattr(example_projects, "FOLDER", tmp_path / "made")
    example_projects.main()
    assert hash_files(tmp_path / "made") == hash_files(FOLDER)


def test_a_full_disk_is_reported_and_leaves_nothing_half_written(
    door_line_project: Path, tmp_path: Path, capsys, monkeypatch
) -> None:
    # A module that is imported here first would be cached cut short, for every test after this one.
    monkeypatch.setattr(sys, "dont_write_bytecode", True)
    master, _ = project_paths(door_line_project)
    out, report, before = tmp_path / "out", tmp_path / "points.json", hash_files(door_line_project)
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (1000, hard))
    try:
        code = run_command("move", "--project", master, "--offset", "1,0,0", "--out", out, "--json", report)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    message = join_lines(capsys.readouterr().err)
    assert code != ExitCode.PASS
    assert "cannot be written" in message
    assert "Make room" in message
    assert "Traceback" not in message
    assert hash_files(door_line_project) == before
    assert [
        path for path in tmp_path.rglob("*") if path.is_file() and door_line_project not in path.parents
    ] == []


KUKA_DATA = """DEFDAT TUER\r
DECL E6POS XP1={X 228.2,Y -175.1,Z 419.3,A -176.6,B 5.5,C -172.7,S 2,T 2}\r
DECL FDAT FP1={TOOL_NO 1,BASE_NO 2,IPO_FRAME #TCP}\r
ENDDAT\r
"""


def test_the_two_files_of_a_kuka_program_are_distinguished(tmp_path: Path, capsys) -> None:
    (tmp_path / "TUER.dat").write_text(KUKA_DATA, newline="")
    (tmp_path / "TUER.src").write_text("DEF TUER()\r\nPTP XP1:OFFS\r\nEND\r\n", newline="")
    assert run_command("inspect", tmp_path) == ExitCode.PASS
    shown = join_lines(capsys.readouterr().out)
    assert "TUER (TUER.dat) (line 2): XP1 is moved with an external tool" in shown
    assert "TUER (TUER.src) (line 2): The operator ':'" in shown


def test_where_nothing_is_written_no_output_folder_is_reported(
    door_line_project: Path, tmp_path: Path, capsys
) -> None:
    master, _ = project_paths(door_line_project)
    file = tmp_path / "A.LS"
    file.write_bytes(b"/PROG A\n")
    code = run_command("move", file, "--project", master, "--offset", "1,0,0", "--out", tmp_path / "out")
    assert code == ExitCode.FILES_REFUSED
    assert "written" not in capsys.readouterr().err
