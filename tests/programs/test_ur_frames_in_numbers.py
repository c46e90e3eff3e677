"""Frames that a URScript sets to numbers one after the other, as RoboDK writes them."""

import pytest

from cellcal.drivers.program_registry import read_program
from cellcal.drivers.programs.positions import CARTESIAN

HEAD = "def Prog1():\n  global ref_frame = p[0,0,0,0,0,0]\n"
MOVE = "  movel(pose_trans(ref_frame,p[0.1, 0.1, 0.2, 3.141593, 0.0, 0.0]),1.2,0.25,0,0.000)\n"
FIRST, SECOND = (f"  ref_frame = p[{x}, -0.2, 0.1, 0.0, 0.0, 0.5]\n" for x in (0.4, 0.3))


def places(*lines: str) -> list[float]:
    """Return where the frames of the poses that moves go to are along x [m]."""
    program = read_program("r.script", (HEAD + "".join(lines) + "end\nProg1()\n").encode())
    positions = program.positions
    return [
        program.frames.base_frame[positions.user_frames[row] or ""].position_m[0]
        for row, kind in enumerate(positions.kinds)
        if kind == CARTESIAN and row not in positions.barred
    ]


def test_each_pose_stands_in_the_numbers_above_its_move() -> None:
    assert places(FIRST, MOVE, "  if x:\n", MOVE, "  end\n", SECOND, MOVE) == [0.4, 0.4, 0.3]
    assert places(FIRST, MOVE, FIRST, MOVE) == [0.4, 0.4]
    assert places("  while x:\n", FIRST, MOVE, "  end\n") == [0.4]


@pytest.mark.parametrize(
    "lines",
    [
        (FIRST, "  if x:\n", SECOND, "  end\n", MOVE),
        (FIRST, "  while x:\n", MOVE, SECOND, "  end\n"),
        ("  def other():\n", SECOND, "  end\n", FIRST, "  other()\n", MOVE),
        ("  thread other():\n    sync()\n  end\n", FIRST, MOVE),
        (FIRST, "  ref_frame[0] = 0.5\n", MOVE),
        (FIRST, "  ref_frame = get_target_tcp_pose()\n", MOVE),
        (FIRST, "  movel(ref_frame, 1.2, 0.25)\n", MOVE),
    ],
    ids=["branch", "loop", "function", "thread", "element", "computed", "gone_to"],
)
def test_where_it_is_not_certain_no_pose_stands_in_it(lines: tuple[str, ...]) -> None:
    assert 0.4 not in places(*lines)
    assert 0.3 not in places(*lines)


CALLED = "  def other():\n{}  end\n"


@pytest.mark.parametrize(
    ("lines", "found"),
    [
        ((CALLED.format(SECOND + MOVE), FIRST, MOVE, "  other()\n", FIRST, MOVE), [0.3, 0.4, 0.4]),
        ((CALLED.format(SECOND + MOVE), FIRST, MOVE, "  other()\n", MOVE), [0.3, 0.4]),
        ((CALLED.format(SECOND), FIRST, "  if other():\n", MOVE, "  end\n", MOVE), []),
        ((CALLED.format(SECOND + "  if x:\n    other()\n  end\n" + MOVE + FIRST), FIRST, MOVE), [0.4]),
        ((CALLED.format(SECOND), CALLED.format("  other()\n").replace("def other", "def far"), FIRST, "  far()\n", MOVE), []),
        (("  def other(a = norm(1)):\n", SECOND, "  end\n", FIRST, "  other()\n", MOVE), []),
        ((FIRST, "  interpreter_mode()\n", MOVE, SECOND), []),
        ((CALLED.format("  sync()\n"), FIRST, "  other()\n", MOVE, SECOND, MOVE), [0.4, 0.3]),
        ((CALLED.format(SECOND), FIRST, "  while x:\n", MOVE, "    other()\n  end\n"), []),
        ((CALLED.format(SECOND), FIRST, "  while x:\n  ", FIRST, MOVE, "    other()\n  end\n"), [0.4]),
    ],
    ids=["each", "called", "condition", "itself", "through", "default", "from_outside", "harmless", "loop", "set_in_loop"],
)  # fmt: skip
def test_frames_that_several_functions_set(lines: tuple[str, ...], found: list[float]) -> None:
    assert places(*lines) == found


def test_a_pose_in_a_frame_that_is_not_certain_is_named_with_the_true_reason() -> None:
    body = (CALLED.format(SECOND), FIRST, "  other()\n", MOVE)
    program = read_program("r.script", (HEAD + "".join(body) + "end\nProg1()\n").encode())
    barred = {program.positions.names[row]: why for row, why in program.positions.barred.items()}
    assert "set while the program runs" in barred["line 8"]
