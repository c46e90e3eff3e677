"""Copies of FANUC positions in other user frames, searches, mixed logic, and heights set where the robot stands."""

import json
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from cellcal.service.cli.app import run_command_line
from cellcal.service.exit_codes import ExitCode

FRAMES = {1: (1000, 0, 300, 0, 0, 20), 2: (900, -200, 400, 10, -15, 40), 3: (1100, 50, 350, 0, 0, 20)}
PROJECT = """format = 1
name = "f"
[robot]
serial = "F1"
model = "fanuc_r2000ic_165f"
smallest_sigma = 0.001
[tools.1.entered]
position_mm = [0, 0, 200]
""" + "".join(
    f"[frames.{number}]\nposition_mm = {list(values[:3])}\nfanuc_wpr_deg = {list(values[3:])}\n"
    for number, values in FRAMES.items()
)
PLACES = {1: (300, 0, 300, 180, 0, 0), 2: (350, 80, 250, 180, 0, 10)}
ALONG, LIFTED = "10,20,0,0,0,0", "0,0,10,0,0,0"
ABOUT_Z, ABOUT_X = "0,0,0,0,0,5", "0,0,0,5,0,0"


def matrix_of(values: tuple[float, ...]) -> np.ndarray:
    matrix = np.eye(4)
    matrix[:3, :3] = Rotation.from_euler("xyz", values[3:], degrees=True).as_matrix()
    matrix[:3, 3] = values[:3]
    return matrix


def record(number: int, frame: int, values: tuple[float, ...]) -> str:
    x, y, z, w, p, r = (f"{value:9.3f}" for value in values)
    return (
        f"P[{number}]{{\n   GP1:\n\tUF : {frame}, UT : 1,\t\tCONFIG : 'N U T, 0, 0, 0',\n"
        f"\tX = {x}  mm,\tY = {y}  mm,\tZ = {z}  mm,\n\tW = {w} deg,\tP = {p} deg,\tR = {r} deg\n}};\n"
    )


def listing(*lines: str, frames: tuple[int, int] = (1, 1)) -> str:
    numbered = [
        f"{k:4d}:{line} ;\n" if line[1] == " " else f"{k:4d}:  {line} ;\n" for k, line in enumerate(lines, 1)
    ]
    records = [record(number, frames[number - 1], values) for number, values in PLACES.items()]
    return f"/PROG  Z\n/ATTR\n/MN\n{''.join(numbered)}/POS\n{''.join(records)}/END\n"


def move(tmp_path: Path, text: str, offset: str, *options: str) -> dict:
    (tmp_path / "project.toml").write_text(PROJECT, encoding="utf-8")
    (tmp_path / "Z.LS").write_text(text, encoding="ascii")
    words = ["program", "move", str(tmp_path / "Z.LS"), "--project", str(tmp_path / "project.toml")]
    words += [
        *options,
        f"--offset={offset}",
        "--out",
        str(tmp_path / "out"),
        "--json",
        str(tmp_path / "r.json"),
    ]
    code = run_command_line(words)
    return {**json.loads((tmp_path / "r.json").read_text())["programs"][0], "code": code}


START = ("UFRAME_NUM=1", "UTOOL_NUM=1")


@pytest.mark.parametrize("offset", [ALONG, ABOUT_Z])
@pytest.mark.parametrize(
    "lines",
    [
        (*START, "PR[10]=P[1]", "UFRAME_NUM=2", "L PR[10] 100mm/sec FINE"),
        (*START, "PR[9]=P[1]", "PR[10]=PR[9]", "UFRAME_NUM=2", "L PR[10] 100mm/sec FINE"),
        (*START, "L P[1] 100mm/sec FINE", "PR[10]=LPOS", "UFRAME_NUM=2", "L PR[10] 100mm/sec FINE"),
        (*START, "LBL[1]", "L PR[10] 100mm/sec FINE", "PR[10]=P[1]", "UFRAME_NUM=2", "JMP LBL[1]"),
    ],
)
def test_a_copy_in_another_frame_is_named_with_what_it_costs(
    tmp_path: Path, lines: tuple[str, ...], offset: str
) -> None:
    moved = move(tmp_path, listing(*lines), offset)
    assert moved["code"] == ExitCode.REFUSED
    (finding,) = [one for one in moved["findings"] if "user frame 2" in one["text"]]
    work = matrix_of(tuple(map(float, offset.split(","))))
    own, other, point = matrix_of(FRAMES[1]), matrix_of(FRAMES[2]), matrix_of(PLACES[1])
    belongs = work @ other @ point
    goes = other @ np.linalg.inv(own) @ work @ own @ point
    assert finding["point"] == "P[1]"
    assert finding["distance_mm"] == pytest.approx(np.linalg.norm((belongs - goes)[:3, 3]), abs=1e-3)


@pytest.mark.parametrize("offset", [ALONG, ABOUT_Z])
def test_where_the_robot_began_is_named_in_another_frame(tmp_path: Path, offset: str) -> None:
    begun = (*START, "PR[9]=LPOS", "L PR[9] 100mm/sec FINE", "PR[8]=LPOS")
    assert move(tmp_path, listing(*begun, "L PR[8] 100mm/sec FINE"), offset)["code"] == ExitCode.PASS
    other = tmp_path / "other"
    other.mkdir()
    moved = move(other, listing(*begun, "UFRAME_NUM=2", "L PR[8] 100mm/sec FINE"), offset)
    assert moved["code"] == ExitCode.REFUSED
    assert {one["point"] for one in moved["findings"]} == {"PR[8]"}


def test_a_copy_in_a_parallel_frame_costs_nothing_where_the_work_does_not_turn(tmp_path: Path) -> None:
    lines = (*START, "PR[10]=P[1]", "UFRAME_NUM=3", "L PR[10] 100mm/sec FINE")
    assert move(tmp_path, listing(*lines), ALONG)["code"] == ExitCode.PASS


@pytest.mark.parametrize(("number", "is_finding"), [("1", True), ("2", True), ("3", False)])
def test_a_copy_across_the_frame_that_alone_moves_is_named_with_what_it_costs(
    tmp_path: Path, number: str, is_finding: bool
) -> None:
    lines = (*START, "PR[10]=P[1]", "UFRAME_NUM=2", "L PR[10] 100mm/sec FINE")
    report = move(tmp_path, listing(*lines), "3,-2,5,0,0,5", "--frame", number)
    findings = [(one["point"], one["distance_mm"]) for one in report["findings"]]
    own, other, work_frame = (matrix_of(FRAMES[each]) for each in (1, 2, int(number)))
    change = work_frame @ matrix_of((3, -2, 5, 0, 0, 5)) @ np.linalg.inv(work_frame)
    place = matrix_of(PLACES[1])
    new_place = np.linalg.inv(own) @ change @ own @ place if number == "1" else place
    goal = change @ other @ place if number == "2" else other @ place
    miss = float(np.linalg.norm((other @ new_place - goal)[:3, 3]))
    assert findings == ([("P[1]", pytest.approx(miss, abs=1e-3))] if is_finding else [])
    assert report["code"] == (ExitCode.REFUSED if is_finding else ExitCode.PASS)


def test_each_copy_counts_in_the_frame_that_holds_there(tmp_path: Path) -> None:
    one = ("UFRAME_NUM=1", "PR[10]=P[1]", "L PR[10] 100mm/sec FINE")
    other = ("UFRAME_NUM=2", "PR[10]=P[2]", "L PR[10] 100mm/sec FINE")
    text = listing("LBL[1]", *one, *other, "JMP LBL[1]", frames=(1, 2))
    moved = move(tmp_path, text, ABOUT_Z)
    assert (moved["code"], moved["findings"]) == (ExitCode.PASS, [])


@pytest.mark.parametrize(
    ("line", "offset", "counts"),
    [
        ("PR[10,3]=(PR[10,3]+50)", LIFTED, False),
        ("PR[10,3]=((PR[10,3]+50))", ABOUT_Z, False),
        ("PR[10,3]=(R[1]+PR[10,3])", ABOUT_Z, False),
        ("IF (R[1]=1),PR[10,3]=(PR[10,3]+50)", LIFTED, False),
        ("IF (PR[10,3]=1),PR[10,1]=(PR[10,1]+50)", ABOUT_Z, True),
        ("PR[10,3]=(PR[10,3]+50)*2", LIFTED, True),
        ("PR[10,3]=(R[1]-PR[10,3])", LIFTED, True),
        ("PR[10,3]=(R[1]*PR[10,3])", LIFTED, True),
        ("PR[10,1]=(PR[10,1]+50)", ABOUT_Z, True),
        ("IF (DI[1]),DO[2]=(ON)", ABOUT_Z, False),
    ],
)
def test_brackets_of_mixed_logic_change_nothing(tmp_path: Path, line: str, offset: str, counts: bool) -> None:
    moved = move(tmp_path, listing(*START, "PR[10]=P[1]", line, "L PR[10] 100mm/sec FINE"), offset)
    assert moved["code"] == (ExitCode.REFUSED if counts else ExitCode.PASS), moved["findings"]


@pytest.mark.parametrize(
    ("more", "offset", "counts"),
    [
        ((), ALONG, False),
        ((), ABOUT_Z, False),
        (("PR[5,1]=PR[5,1]+30",), ALONG, False),
        (("PR[5,1]=PR[5,1]+30",), ABOUT_Z, True),
    ],
)
def test_where_a_search_stops_the_robot_goes_along(
    tmp_path: Path, more: tuple[str, ...], offset: str, counts: bool
) -> None:
    stops = ("L P[1] 100mm/sec FINE", "L P[2] 10mm/sec FINE Skip,LBL[9],PR[5]=LPOS")
    lines = (*START, "SKIP CONDITION DI[1]=ON", *stops, *more, "L PR[5] 100mm/sec FINE", "LBL[9]")
    moved = move(tmp_path, listing(*lines), offset)
    assert moved["code"] == (ExitCode.REFUSED if counts else ExitCode.PASS), moved["findings"]
    assert {one["point"] for one in moved["findings"]} == ({"P[2]"} if counts else set())


def test_a_touch_search_goes_along_axes_that_do_not_turn_with_the_work(tmp_path: Path) -> None:
    lines = (*START, "Search Start[1] PR[7]", "L P[1] 5cm/min FINE Search[-X]", "Search End")
    assert move(tmp_path, listing(*lines), ALONG)["code"] == ExitCode.PASS
    turned = tmp_path / "turned"
    turned.mkdir()
    moved = move(turned, listing(*lines), ABOUT_Z)
    assert moved["code"] == ExitCode.REFUSED
    assert [(one["point"], one["what"]) for one in moved["findings"]] == [("P[1]", "Search[-X]")]


@pytest.mark.parametrize(("offset", "counts"), [(ALONG, False), (ABOUT_Z, False), (ABOUT_X, True)])
def test_a_register_that_was_made_zero_is_no_position(tmp_path: Path, offset: str, counts: bool) -> None:
    zero = ("L P[1] 100mm/sec FINE", "PR[9]=LPOS-LPOS", "PR[9,3]=50")
    moved = move(tmp_path, listing(*START, *zero, "L P[1] 100mm/sec FINE Offset,PR[9]"), offset)
    assert moved["code"] == (ExitCode.REFUSED if counts else ExitCode.PASS), moved["findings"]
    assert len(moved["findings"]) == counts


def test_an_offset_along_a_frame_is_read_beside_one_along_the_tool(tmp_path: Path) -> None:
    amount = ("PR[1,1]=0", "PR[1,2]=0", "PR[1,3]=5")
    motion = "L P[1] 100mm/sec FINE Offset,PR[1] Tool_Offset,PR[2]"
    assert move(tmp_path, listing(*START, *amount, motion), ABOUT_Z)["code"] == ExitCode.PASS


@pytest.mark.parametrize(
    ("offset", "counts"), [(ALONG, False), (ABOUT_Z, False), (LIFTED, True), (ABOUT_X, True)]
)
def test_a_height_that_is_set_where_the_robot_stands_counts_where_heights_change(
    tmp_path: Path, offset: str, counts: bool
) -> None:
    lines = (*START, "PR[10]=LPOS", "PR[10,3]=500", "L PR[10] 100mm/sec FINE", "L P[1] 100mm/sec FINE")
    moved = move(tmp_path, listing(*lines), offset)
    assert moved["code"] == (ExitCode.REFUSED if counts else ExitCode.PASS), moved["findings"]


@pytest.mark.parametrize(
    ("called", "code"),
    [("UFRAME_NUM=2", ExitCode.REFUSED), ("UFRAME_NUM=1", ExitCode.PASS), ("CALL DEEP", ExitCode.REFUSED)],
    ids=["another frame", "the same", "a program that it calls"],
)
def test_a_frame_that_a_called_program_leaves_counts_for_a_copy(
    tmp_path: Path, called: str, code: ExitCode
) -> None:
    lines = ("UFRAME_NUM=1", "UTOOL_NUM=1", "PR[1]=P[1]", "CALL SUB", "L PR[1] 100mm/sec FINE")
    folder = tmp_path / "programs"
    folder.mkdir()
    for name, text in (("Z", listing(*lines)), ("SUB", listing(called)), ("DEEP", listing("UFRAME_NUM=2"))):
        (folder / f"{name}.LS").write_text(text.replace("/PROG  Z", f"/PROG  {name}"), encoding="ascii")
    (tmp_path / "project.toml").write_text(PROJECT, encoding="utf-8")
    words = ["program", "move", str(folder), "--project", str(tmp_path / "project.toml"), "--frame", "1"]
    words += [f"--offset={ABOUT_Z}", "--out", str(tmp_path / "out"), "--json", str(tmp_path / "r.json")]
    assert run_command_line(words) == code
    programs = {one["program"]: one for one in json.loads((tmp_path / "r.json").read_text())["programs"]}
    named = any("in user frame 2" in str(one) for one in programs["Z"]["findings"])
    assert named == (code == ExitCode.REFUSED)


@pytest.mark.parametrize(("frame", "points"), [("1", ["PR[5]"]), ("2", ["PR[5]", "PR[6]"]), ("3", [])])
def test_a_register_is_named_in_each_frame_that_moves_and_in_no_other(
    tmp_path: Path, frame: str, points: list[str]
) -> None:
    lines = [*START, "CALL GRIP", "L P[1] 100mm/sec FINE", "L PR[5] 100mm/sec FINE", "CALL GRIP"]
    lines += ["UFRAME_NUM=2", "L PR[5] 9mm/sec FINE", "L PR[6] 100mm/sec FINE"]
    moved = move(tmp_path, listing(*lines), ALONG, "--frame", frame)
    assert [each["point"] for each in moved["findings"]] == points


def move_all(tmp_path: Path, offset: str, **listings: str) -> dict:
    """Move listings together; return the exit code and what the findings name."""
    (tmp_path / "project.toml").write_text(PROJECT, encoding="utf-8")
    for name, text in listings.items():
        (tmp_path / f"{name}.LS").write_text(text.replace("/PROG  Z", f"/PROG  {name}"), encoding="ascii")
    files = [str(tmp_path / f"{name}.LS") for name in listings]
    words = ["program", "move", *files, "--project", str(tmp_path / "project.toml"), f"--offset={offset}"]
    code = run_command_line(
        [*words, "--replace", "--out", str(tmp_path / "out"), "--json", str(tmp_path / "r.json")]
    )
    programs = json.loads((tmp_path / "r.json").read_text())["programs"]
    return {
        "code": code,
        "found": [(one["point"], one["what"]) for each in programs for one in each["findings"]],
    }


COPY = ("PR[5]=P[1]", "L PR[5] 100mm/sec FINE")


@pytest.mark.parametrize(
    ("caller", "called", "found"),
    [
        (("UFRAME_NUM=2", "CALL B"), COPY, [("P[1]", "PR[5]")]),
        (("UFRAME_NUM=1", "CALL B"), COPY, []),
        (("UFRAME_NUM=2", "CALL B"), ("UFRAME_NUM=1", *COPY), []),
        (("UFRAME_NUM=2", "CALL B"), ("L P[2] 100mm/sec FINE", *COPY), []),  # the controller would stop there
        (("UFRAME_NUM=R[1]", "CALL B"), COPY, [("P[1]", "PR[5]")]),
        (("UFRAME_NUM=2", "CALL B", "UFRAME_NUM=1", "CALL B"), ("PR[5]=LPOS", COPY[1]), []),
    ],
)
def test_a_called_program_goes_to_its_copies_in_the_frame_of_its_caller(
    tmp_path: Path, caller: tuple[str, ...], called: tuple[str, ...], found: list[tuple[str, str]]
) -> None:
    moved = move_all(tmp_path, ABOUT_Z, A=listing(*caller), B=listing(*called))
    assert moved["found"] == found
    assert moved["code"] == (ExitCode.REFUSED if found else ExitCode.PASS)


@pytest.mark.parametrize(
    ("line", "turned"),
    [("L PR[3] 100mm/sec FINE INC", ("PR[3]", "INC")), ("J PR[R[2]] 100% FINE INC", ("PR[R[...]]", "INC"))],
)
def test_an_increment_in_a_register_keeps_its_axes(
    tmp_path: Path, line: str, turned: tuple[str, str]
) -> None:
    text = listing("UFRAME_NUM=1", "L P[1] 100mm/sec FINE", line, "L P[2] 100mm/sec FINE")
    assert move_all(tmp_path, ABOUT_Z, A=text) == {"code": ExitCode.REFUSED, "found": [turned]}
    assert move_all(tmp_path, ALONG, A=text) == {"code": ExitCode.PASS, "found": []}


@pytest.mark.parametrize(
    "lines", [("L LPR[2] 100mm/sec FINE",), ("LPR[1]=LPOS", "LPR[1,3]=LPR[1,3]+50", "L LPR[1] 9mm/sec FINE")]
)
def test_a_register_of_the_program_alone_is_a_place_that_is_not_known(
    tmp_path: Path, lines: tuple[str, ...]
) -> None:
    text = listing("UFRAME_NUM=1", "L P[1] 100mm/sec FINE", *lines, "L P[2] 100mm/sec FINE")
    assert move_all(tmp_path, ABOUT_Z, A=text) == {
        "code": ExitCode.REFUSED,
        "found": [("PR[R[...]]", "PR[...]")],
    }
