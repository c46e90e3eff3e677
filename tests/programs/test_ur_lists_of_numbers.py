"""Six numbers of a URScript that are no joints: speeds, flags, forces. What may be joints is still left and named."""

from pathlib import Path

import pytest

from cellcal.service.exit_codes import ExitCode
from tests.programs.test_field_cases import move_program

POSE = "p[-0.544299,-0.276221,0.194454,1.607636,2.295913,0.875803]"
START = "movej([0.3, -1.4, 1.9, -2.0, -1.57, 0.1])"
SIX = "v=[0.3,-1.4,1.9,-2.0,-1.57,0.1]"


def move_lines(folder: Path, *lines: str) -> tuple[int, list[str], list[str]]:
    text = "\n".join(["def calc():", "set_tcp(p[0,0,0,0,0,0])", START, f"movel({POSE})", *lines, "end", ""])
    moved = move_program(folder, "ur", "component_assignment.script", offset="5,0,5,0,0,3", text=text)
    left = [one["point"] for one in moved.report["points"] if one["reason"]]
    return moved.code, left, [one["point"] for one in moved.report["findings"]]


@pytest.mark.parametrize(
    "lines",
    [
        (SIX, f"movel({POSE}, v=v[0])"),
        (SIX, "d = v[2] - get_tcp_force()[2]", "if norm(v[2]) > 5:", "sleep(v[1])", "end"),
        ("v=[0,0,0,0,0,0]", "v[2] = 1"),
        ("v=[0,0,0,0,0,0]", "v[0] = read_input_float_register(1)", "textmsg(v)"),
        (SIX, "w=[1,2,3]", "x = w[v[1]]"),
    ],
)
def test_numbers_that_nothing_moves_to_are_no_joints(lines, tmp_path: Path) -> None:
    assert move_lines(tmp_path, *lines) == (ExitCode.PASS, [], [])


@pytest.mark.parametrize(
    ("lines", "left"),
    [
        ((SIX, "movej([v[0],v[1],v[2],v[3],v[4],v[5]+0.3])"), ["v"]),
        ((SIX, "x = p[v[0],v[1],v[2],v[3],v[4],v[5]]", "go(x)"), ["v"]),
        ((SIX, "go(v[0],\n  v[1])"), ["v"]),
        ((SIX, "v[5] = 0.2", "movej(v)"), ["v"]),
        ((SIX, "v[5] = 0.2", "w = v", "movej(w)"), ["v"]),
        ((SIX, "v[5] = 0.2", "all = [v, v]", "movej(all[0])"), ["v"]),
        ((SIX, "v[5] = 0.2", "go(v)"), ["v"]),
    ],
)
def test_numbers_that_may_be_joints_are_left(lines, left, tmp_path: Path) -> None:
    code, points, _ = move_lines(tmp_path, *lines)
    assert (code, points) == (ExitCode.REFUSED, left)
