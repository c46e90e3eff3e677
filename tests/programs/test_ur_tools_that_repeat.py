"""Tools of URScript that a loop, a function called again or a thread leaves in force above the ``set_tcp`` before it."""

from pathlib import Path

import pytest

from cellcal.service.exit_codes import ExitCode
from tests.programs.test_field_cases import MovedProgram, move_program

SHORT, LONG = "set_tcp(p[0, 0, 0.1, 0, 0, 0])", "set_tcp(p[0, 0, 0.15, 0, 0, 0])"
HOME = "movej([0.3, -1.4, 1.9, -2.0, -1.57, 0.1])"
MOVE, OTHER = "movel(p[-0.45,-0.20,0.25,0,3.1415,0])", "movel(p[-0.40,-0.25,0.25,0,3.1415,0])"
PICK = "pick = p[-0.45,-0.20,0.25,0,3.1415,0]"
DIFFERENT = "the program goes to it with different tools"
ON_THE_WAY = "which tool the program has there depends on the way that it takes"


def move_script(folder: Path, before: tuple[str, ...], lines: tuple[str, ...]) -> MovedProgram:
    """Move a script of these definitions, and these statements behind a first tool."""
    main = "\n  ".join(("def work():", SHORT, HOME, *lines))
    text = "\n".join((*before, main, "end", "work()", ""))
    return move_program(
        folder, "ur", "component_assignment.script", offset="15,-12,8,0,0,0", text=text, joints="keep"
    )


def reasons_of(moved: MovedProgram) -> dict[str, str]:
    return {one["point"]: one["reason"] for one in moved.report["points"] if one["status"] == "left"}


@pytest.mark.parametrize(
    ("before", "lines", "expected"),
    [
        ((), ("while True:", MOVE, LONG, "end"), DIFFERENT),
        ((), ("while True:", "if get_standard_digital_in(1):", MOVE, "end", LONG, "end"), DIFFERENT),
        (("def go():", MOVE, LONG, "end"), ("go()", "go()"), DIFFERENT),
        (("def go():", MOVE, LONG, "end"), ("while True:", "go()", "end"), DIFFERENT),
        (("def other():", LONG, "end"), ("while True:", MOVE, "other()", "end"), DIFFERENT),
        (("def inner():", LONG, "end", "def outer():", "inner()", "end"), ("outer()", MOVE), ON_THE_WAY),
        (("thread t():", LONG, "end"), ("run t()", MOVE), ON_THE_WAY),
        ((), (PICK, "movel(pick)", "next = pick  # the next one", LONG, "movel(next)"), DIFFERENT),
        ((), (PICK, "movel(pick)", "local a = pick", "b = a", LONG, "movel(b)"), DIFFERENT),
        (("def go(x):", "movel(x)", "end"), (PICK, "movel(pick)", LONG, "go(pick)"), DIFFERENT),
    ],
)
def test_a_move_that_comes_again_with_another_tool_is_left(
    before: tuple[str, ...], lines: tuple[str, ...], expected: str, tmp_path: Path
) -> None:
    moved = move_script(tmp_path, before, lines)
    assert moved.code == ExitCode.REFUSED
    assert expected in reasons_of(moved).values()


@pytest.mark.parametrize(
    "lines",
    [
        ("while True:", SHORT, MOVE, LONG, OTHER, "end"),  # each pass begins with its own
        (PICK, "movel(pick)", "next = pick", "movel(next)", LONG, OTHER),
        (
            PICK,
            "movel(pick)",
            "next = pick",
            "movel(next)",
            LONG,
            "next = p[-0.4,-0.25,0.25,0,3.1415,0]",
            OTHER,
        ),
        ("while True:", MOVE, SHORT, "end"),  # the same tool again
        ("while True:", "if get_standard_digital_in(1):", SHORT, MOVE, "else:", LONG, OTHER, "end", "end"),
        ("while get_standard_digital_in(1):", "sync()", "end", MOVE, LONG, OTHER),
    ],
)
def test_a_move_that_always_comes_with_its_tool_goes_along(lines: tuple[str, ...], tmp_path: Path) -> None:
    moved = move_script(tmp_path, (), lines)
    assert reasons_of(moved) == {}
    assert moved.code == ExitCode.PASS
