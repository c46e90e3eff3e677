"""Places that a script computes from where the robot stands."""

from pathlib import Path

import pytest

from cellcal.service.exit_codes import ExitCode
from tests.programs.test_field_cases import TURNED, move_program

HOME = "movej([0.3, -1.4, 1.9, -2.0, -1.57, 0.1], a=1.4, v=1.05)"
WORK = "movel(p[-0.544299,-0.276221,0.194454,1.607636,2.295913,0.875803], a=1.2, v=0.25)"
STEP = "movel(pose_trans({}, p[0,0,-0.1,0,0,0]), a=1.2, v=0.25)"
UP = f"def up():\n  {STEP.format('get_actual_tcp_pose()')}\nend\n"
PLANE = "p[0.1,0.2,0.3,0,0,0.5]"


def findings_of(folder: Path, *lines: str, before: str = "", joints: str = "keep") -> list[str]:
    """Return the points of which something is said; the exit code agrees."""
    body = "\n".join(f"  {line}" for line in ("set_tcp(p[0,0,0,0,0,0])", *lines))
    text = f"{before}def work():\n{body}\nend\n"
    moved = move_program(folder, "ur", "component_assignment.script", offset=TURNED, text=text, joints=joints)
    assert moved.code == (ExitCode.REFUSED if moved.report["findings"] else ExitCode.PASS)
    assert not [one for one in moved.report["points"] if one["status"] == "left"]
    return [one["text"] for one in moved.report["findings"]]


@pytest.mark.parametrize(
    "lines",
    [
        (HOME, STEP.format("get_actual_tcp_pose()"), WORK),
        (HOME, STEP.format("get_target_tcp_pose()"), WORK),
        (HOME, STEP.format("get_forward_kin()"), WORK),
        (HOME, "here = get_actual_tcp_pose()", STEP.format("here"), WORK),
        (
            HOME,
            "q1 = [0.3, -1.4, 1.9, -2.0, -1.57, 0.1]",
            STEP.format("get_forward_kin(q1)"),
            "movej(q1)",
            WORK,
        ),
        (HOME, "up()", WORK),
        (HOME, WORK, HOME, "up()"),
    ],
)
def test_a_step_from_joint_angles_that_stay_is_a_finding(lines: tuple[str, ...], tmp_path: Path) -> None:
    (finding,) = findings_of(tmp_path, *lines, before=UP if "up()" in lines else "")
    assert "stays" in finding
    assert not findings_of(tmp_path / "moved", *lines, before=UP if "up()" in lines else "", joints="move")


@pytest.mark.parametrize(
    "lines",
    [
        (HOME, WORK, STEP.format("get_actual_tcp_pose()")),
        (HOME, WORK, "up()"),
        (HOME, "here = get_actual_tcp_pose()", WORK, "movel(here)"),
        (HOME, f"# {STEP.format('get_actual_tcp_pose()')}", WORK),
    ],
)
def test_a_step_from_what_moves_is_none(lines: tuple[str, ...], tmp_path: Path) -> None:
    assert not findings_of(tmp_path, *lines, before=UP if "up()" in lines else "")


@pytest.mark.parametrize(
    "lines",
    [
        (HOME, WORK, f"movel(pose_trans({PLANE}, get_actual_tcp_pose()))"),
        (HOME, WORK, f"plane = {PLANE}", "here = get_actual_tcp_pose()", "movel(pose_trans(plane, here))"),
    ],
)
def test_a_place_of_the_base_that_is_taken_in_a_plane_is_a_finding(
    lines: tuple[str, ...], tmp_path: Path
) -> None:
    (finding,) = findings_of(tmp_path, *lines)
    assert "takes where the robot stands" in finding


INTO_PLANE = "movel(pose_trans(plane, {}))"
HERE = "def here():\n  at = get_actual_tcp_pose()\n  return at\nend\ndef there():\n  return here()\nend\n"
GO = f"def go(x):\n  movel(pose_trans({PLANE}, x))\nend\ndef pass_on(y):\n  go(y)\nend\n"


@pytest.mark.parametrize(
    ("lines", "before"),
    [
        (("here = get_actual_tcp_pose()", "copy = here", "last = copy", INTO_PLANE.format("last")), ""),
        (("ps = [get_actual_tcp_pose()]", INTO_PLANE.format("ps[0]")), ""),
        (("here = get_forward_kin()", "pass_on(here)"), GO),
        (("go(get_actual_tcp_pose())",), GO),
        ((INTO_PLANE.format("here()"),), HERE),
        (("at = there()", "copy = at", INTO_PLANE.format("copy")), HERE),
        (("go(there())",), HERE + GO),
    ],
)
def test_a_place_of_the_base_is_followed_into_a_frame(
    lines: tuple[str, ...], before: str, tmp_path: Path
) -> None:
    planes = () if GO in before else (f"plane = {PLANE}",)
    findings = findings_of(tmp_path, HOME, WORK, *planes, *lines, before=before)
    assert [one for one in findings if "user frame base" in one]


def test_a_pose_of_a_frame_whose_copy_is_gone_to_without_it_is_left(tmp_path: Path) -> None:
    inside = "a = p[0.05,0.05,0.1,0,3.1415,0]"
    lines = (HOME, "plane = p[-0.5,-0.3,0.1,0,0,0.5]", inside, "b = a", INTO_PLANE.format("a"), "movel(b)")
    text = "def work():\n  set_tcp(p[0,0,0,0,0,0])\n" + "".join(f"  {line}\n" for line in lines) + "end\n"
    moved = move_program(
        tmp_path, "ur", "component_assignment.script", offset=TURNED, text=text, joints="keep"
    )
    assert moved.code == ExitCode.REFUSED
    assert {one["point"]: one["status"] for one in moved.report["points"]}["a"] == "left"
