"""URScript: frames that only functions outside of the script know, and blocks that stand in one line."""

from itertools import pairwise
from pathlib import Path

import pytest

from cellcal.drivers.program_registry import read_program
from cellcal.drivers.programs.errors import ProgramFileError
from cellcal.drivers.universal_robots.program_files.script_heads import head_at
from cellcal.drivers.universal_robots.program_files.script_lines import with_one_statement_a_line
from cellcal.drivers.universal_robots.program_files.script_origins import StepOrigins
from cellcal.service.exit_codes import ExitCode
from tests.programs.test_field_cases import TURNED, move_program

TAUGHT = "p[-0.544299,-0.276221,0.194454,1.607636,2.295913,0.875803]"
OTHER = "p[-0.444299,-0.176221,0.294454,1.607636,2.295913,0.875803]"
FRAME, INSIDE = "p[-0.4,-0.2,0.1,0,0,0.5]", "p[-0.05,-0.05,0.15,1.607636,2.295913,0.875803]"
STEP = "p[0,0,-0.1,0,0,0]"


def script(*lines: str, functions: str = "") -> str:
    begin = ("set_tcp(p[0,0,0,0,0,0])", "movej([0.3, -1.4, 1.9, -2.0, -1.57, 0.1])")
    body = "".join(f"  {line}\n" for line in (*begin, *lines))
    return f"{functions}def work():\n{body}end\n"


def moved_code(folder: Path, *lines: str, functions: str = "") -> int:
    text = script(*lines, functions=functions)
    return move_program(folder, "ur", "component_assignment.script", offset=TURNED, text=text).code


@pytest.mark.parametrize(
    "lines",
    [
        [f"movel(pose_trans(ext(),{INSIDE}))"],
        [f"movel(pose_trans(rpc.get_pose(),{INSIDE}))"],
        [f"q=pose_trans(ext(),{INSIDE})", "movel(q)"],
        ["f=ext()", f"q=pose_trans(f,{INSIDE})", "movel(q)"],
        ["f=ext()", "g=f", f"movel(pose_trans(g,{INSIDE}))"],
        [f"q=pose_trans(Plane_1,{INSIDE})", "movel(q)"],
        [f"f=pose_trans(Plane_1,{STEP})", f"q=pose_trans(f,{INSIDE})", "movel(q)"],
        [f"c={INSIDE}", "q=pose_trans(Plane_1,c)", "movel(q)"],
        [f"movel(pose_trans(frames[0],{INSIDE}))"],
        [f"movel(pose_trans(pose_inv({FRAME}),{INSIDE}))"],
        [f"movel(pose_trans(here(),{INSIDE}))"],
        ["f=here()", f"q=pose_trans(f,{INSIDE})", "movel(q)"],
        ["p=ext()", f"movel(pose_trans(p,{INSIDE}))"],
        ["f=g", "g=f", f"movel(pose_trans(f,{INSIDE}))"],
        [f"f=pose_trans(f,{STEP})", f"movel(pose_trans(f,{INSIDE}))"],
    ],
)
def test_a_pose_in_a_frame_that_only_others_know_is_named(tmp_path: Path, lines: list[str]) -> None:
    functions = "def here():\n  h=ext()\n  return h\nend\ndef other(p):\n  textmsg(p)\nend\n"
    assert moved_code(tmp_path, *lines, functions=functions) == ExitCode.REFUSED


@pytest.mark.parametrize(
    "lines",
    [
        [f"movel({TAUGHT})", f"movel(pose_trans(get_actual_tcp_pose(),{STEP}))"],
        [f"movel({TAUGHT})", "h=get_target_tcp_pose()", f"q=pose_trans(h,{STEP})", "movel(q)"],
        [f"a={TAUGHT}", "movel(a)", f"q=pose_trans(a,{STEP})", "movel(q)"],
        [f"a={TAUGHT}", "movel(a)", f"movel(pose_trans(pose_trans(a,{STEP}),{STEP}))"],
        [f"movel({TAUGHT})", f"movel(pose_trans(here(),{STEP}))"],
    ],
)
def test_steps_from_a_place_of_the_work_stay_as_they_are(tmp_path: Path, lines: list[str]) -> None:
    functions = "def here():\n  h=get_actual_tcp_pose()\n  return h\nend\n"
    assert moved_code(tmp_path, *lines, functions=functions) == ExitCode.PASS


@pytest.mark.parametrize(
    ("lines", "count"),
    [
        ([f"a={TAUGHT}", "if True: movel(a) end"], 1),
        ([f"if x > 1: movel({TAUGHT}) else: movel({OTHER}) end"], 2),
        ([f"while True: if x: movel({TAUGHT}) elif y: sync() else: movel({OTHER}) end end"], 2),
        (["while not is_steady(): sync() end", f"movel({TAUGHT})"], 1),
        (["if x:", f"  movel({TAUGHT}) end", f"movel({OTHER})"], 2),
        ([f"if x: y=1 end movel({TAUGHT})"], 1),
        ([f"movel({TAUGHT})  # if x: at the end", 'textmsg("if x: y end", "wait: end")'], 1),
    ],
)
def test_blocks_in_one_line_are_read_and_their_points_move(
    tmp_path: Path, lines: list[str], count: int
) -> None:
    text = script(*lines)
    moved = move_program(tmp_path, "ur", "component_assignment.script", offset=TURNED, text=text)
    assert moved.code == ExitCode.PASS
    changed = [one for one in moved.report["points"] if one["status"] == "changed"]
    assert len(changed) == count
    assert all(str(one["line"]) in one["point"] or one["point"] == "a" for one in changed)
    assert [len(line.split()) for line in moved.lines] == [len(line.split()) for line in moved.before]


@pytest.mark.parametrize(
    ("lines", "functions"),
    [
        ([f"global f={FRAME}", "run T()", f"movel(pose_trans(f,{INSIDE}))"], f"thread T(): f={OTHER} end\n"),
        ([f"global f={FRAME}", "T()", f"movel(pose_trans(f,{INSIDE}))"], f"def T(): f={OTHER} end\n"),
        ([f"f={FRAME}", f"if x: f={OTHER} end", f"movel(pose_trans(f,{INSIDE}))"], ""),
        ([f"if x: set_tcp({OTHER}) end", f"movel({TAUGHT})"], ""),
        (
            [f"f={FRAME}", "T()", f"movel(pose_trans(f,{INSIDE}))"],
            f"def T(a=g(h(1)), b=[1, 2]):\n  global f={OTHER}\nend\n",
        ),
    ],
)
def test_what_a_block_in_one_line_sets_counts(tmp_path: Path, lines: list[str], functions: str) -> None:
    text = script(*lines, functions=functions)
    moved = move_program(tmp_path, "ur", "component_assignment.script", offset=TURNED, text=text)
    assert moved.code == ExitCode.REFUSED
    assert not [one for one in moved.report["points"] if one["status"] == "changed"]


def test_an_error_below_a_block_in_one_line_tells_its_own_line() -> None:
    with pytest.raises(ProgramFileError) as refused:
        read_program("a.script", script("if True: x=1 end", "movel(p[1,2,3)").encode())
    assert (refused.value.line, refused.value.column) == (5, 16)


def test_many_frames_of_others_are_read_in_one_pass() -> None:
    count = 3000
    lines = [f"movel(pose_trans(f{i},{INSIDE}))\n  f{i}=ext{i}()" for i in range(count)]
    searched = read_program("a.script", script(*lines).encode())
    assert len(searched.positions.barred) == count


def test_long_lines_and_many_copies_are_read_in_one_pass() -> None:
    line = "while x: " + "a b " * 300_000
    assert with_one_statement_a_line(line) == line.replace(": ", ":\n", 1)
    copies = "".join(f"  {to}={of}\n" for to, of in pairwise("abcdefgh") for _ in range(100))
    text = f"def w():\n{copies}  h=get_actual_tcp_pose()\nend\n"
    assert StepOrigins(text, frozenset(), frozenset()).is_place("a,")


def test_a_place_that_goes_on_from_itself_is_one_where_it_begins_at_one() -> None:
    text = f"h=get_actual_tcp_pose()\nh=pose_trans(h,{STEP})\nf=pose_trans(f,{STEP})\n"
    origins = StepOrigins(text, frozenset(), frozenset())
    assert origins.is_place("h,")
    assert not origins.is_place("f,")


@pytest.mark.parametrize(
    ("head", "parameters"),
    [
        ("def f():", ("",)),
        ("  thread T(a, b):", ("a", "b")),
        ('def f(a=p[1,2,3,4,5,6], b=g(h(1), 2), c=")"):', ("a", "b", "c")),
        ("def f(a,\n  b):", ("a", "b")),
        ("def f(a, (b", None),
    ],
)
def test_parameters_of_a_function_with_brackets_in_their_defaults(
    head: str, parameters: tuple[str, ...] | None
) -> None:
    found = head_at(head, 0)
    assert (found and found.parameters) == parameters
