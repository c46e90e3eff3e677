"""URScript as people write it: points at the top, frames given a name first, steps from where the robot stands."""

from pathlib import Path

import pytest

from cellcal.service.engineering.programs.files import find_programs, holds_unread_places
from cellcal.service.exit_codes import ExitCode
from tests.programs.test_field_cases import MovedProgram, move_program

SHIFTED, TURNED = "15,-12,8,0,0,0", "15,-12,8,1,-2,12"
HOME = "movej([0.3, -1.4, 1.9, -2.0, -1.57, 0.1])"
TOOL = "set_tcp(p[0, 0, 0.1, 0, 0, 0])"
PICK, PLACE = "p[-0.45,-0.20,0.25,0,3.1415,0]", "p[-0.40,-0.25,0.25,0,3.1415,0]"
PLANE = "plane = p[-0.5,-0.3,0.1,0,0,0.5]"
IN_PLANE = "p[0.05,0.05,0.1,0,3.1415,0]"


def move_script(folder: Path, *lines: str, offset: str = TURNED, joints: str = "keep") -> MovedProgram:
    """Move a script of these statements."""
    text = "\n  ".join(("def work():", *lines)) + "\nend\nwork()\n"
    return move_program(folder, "ur", "component_assignment.script", offset=offset, text=text, joints=joints)


def statuses_of(moved: MovedProgram) -> dict[str, str]:
    return {one["point"]: one["status"] for one in moved.report["points"]}


def test_points_declared_above_the_way_to_them_have_its_posture(tmp_path: Path) -> None:
    lines = (f"pick = {PICK}", f"place = {PLACE}", TOOL, HOME, "movel(pick)", "movel(place)")
    moved = move_script(tmp_path, *lines)
    assert moved.code == ExitCode.PASS
    assert statuses_of(moved) == {"pick": "changed", "place": "changed", "line 5": "unchanged"}


@pytest.mark.parametrize(
    "lines",
    [
        (f"over = pose_trans(plane, {IN_PLANE})", "movel(over)"),
        (f"over = pose_trans(plane, {IN_PLANE})  # above the part", "movej(get_inverse_kin(over))"),
        (f"at = {IN_PLANE}", "global over = pose_trans(plane, at)", "movel(over)"),
        (f"at = pose_trans(plane, {IN_PLANE})", "over = pose_trans(at, p[0,0,-0.05,0,0,0])", "movel(over)"),
    ],
    ids=["literal", "by joints", "variable", "step"],
)
def test_a_pose_that_is_brought_into_a_frame_and_gone_to_by_name_moves(
    tmp_path: Path, lines: tuple[str, ...]
) -> None:
    moved = move_script(tmp_path, PLANE, TOOL, HOME, *lines, f"movel(pose_trans(plane, {IN_PLANE}))")
    assert moved.code == ExitCode.PASS
    assert sorted(statuses_of(moved).values()) == ["changed", "changed", "unchanged"]
    assert moved.lines[1] == moved.before[1]  # the frame itself stays


def test_it_has_the_tool_of_the_move_and_not_of_the_line_that_computes_it(tmp_path: Path) -> None:
    other = "set_tcp(p[0, 0, 0.2, 0, 0, 0])"
    lines = (PLANE, TOOL, HOME, f"over = pose_trans(plane, {IN_PLANE})", other, "movel(over)")
    moved = move_script(tmp_path, *lines, f"movel(pose_trans(plane, {IN_PLANE}))")
    assert moved.code == ExitCode.PASS
    assert moved.lines[4].partition("pose_trans")[2] == moved.lines[7].partition("pose_trans")[2][:-1]


def test_a_frame_with_a_computed_pose_in_it_is_left_and_named(tmp_path: Path) -> None:
    lines = (PLANE, TOOL, HOME, "over = pose_trans(plane, p[0.02 * i,0.05,0.1,0,3.1415,0])", "movel(over)")
    moved = move_script(tmp_path, *lines)
    assert moved.code == ExitCode.REFUSED
    assert statuses_of(moved)["plane"] == "left"


@pytest.mark.parametrize("function", ["get_actual_tcp_pose", "get_target_tcp_pose"])
def test_a_step_from_where_the_robot_stands_costs_nothing_in_a_shift(tmp_path: Path, function: str) -> None:
    step = f"movel(pose_add({function}(), p[0, 0, 0.1, 0, 0, 0]))"
    moved = move_script(tmp_path, TOOL, HOME, f"movel({PICK})", step, offset=SHIFTED)
    assert moved.code == ExitCode.PASS
    assert not moved.list_findings()


def test_it_costs_what_a_turn_makes_of_it(tmp_path: Path) -> None:
    step = "movel(pose_add(get_actual_tcp_pose(), p[0.1, 0, 0, 0, 0, 0]))"
    moved = move_script(tmp_path, TOOL, HOME, f"movel({PICK})", step, offset="0,0,0,0,0,90")
    assert moved.code == ExitCode.REFUSED
    ((line, _, distance),) = moved.list_findings()
    assert (line, distance) == (5, pytest.approx(141.42, abs=0.01))


def test_joints_of_a_pose_over_several_lines_are_no_finding(tmp_path: Path) -> None:
    lines = ("q = get_inverse_kin(p[-0.45,-0.20,", "    0.25,0,3.1415,0])", "movej(q)")
    moved = move_script(tmp_path, TOOL, HOME, *lines)
    assert moved.code == ExitCode.PASS
    assert not moved.list_findings()


HINTS = "[0.2, -1.57, 1.57, -1.57, -1.57, 0]"  # near the joints at PICK, and not these
FAR = "[1.8, -1.57, 1.57, -1.57, -1.57, 0]"


@pytest.mark.parametrize("joints", ["keep", "move"])
@pytest.mark.parametrize(
    "lines",
    [
        (f"movej(get_inverse_kin({PICK}, qnear={HINTS}))",),
        (f"pick = {PICK}", f"near = {HINTS}", "movej(get_inverse_kin(pick, qnear=near))", "movel(pick)"),
        (f"near = {HINTS}", f"pick = {PICK}", "movej(get_inverse_kin(pick, qnear=near), a=1.4)"),
    ],
    ids=["written", "by name", "joints first"],
)
def test_joints_that_choose_the_posture_of_one_pose_are_written_with_it(
    tmp_path: Path, lines: tuple[str, ...], joints: str
) -> None:
    moved = move_script(tmp_path, TOOL, *lines, offset="15,-12,8,0,0,60", joints=joints)
    assert moved.code == ExitCode.PASS
    assert list(statuses_of(moved).values()) == ["changed"]
    again = move_script(tmp_path / "again", *moved.lines[1:-2], offset="0,0,0,0,0,0.001")
    assert again.code == ExitCode.PASS  # the joints written are those of the pose written
    assert HINTS not in "".join(moved.lines)


def test_joints_too_far_from_their_pose_leave_it(tmp_path: Path) -> None:
    moved = move_script(tmp_path, TOOL, f"movej(get_inverse_kin({PICK}, qnear={FAR}))")
    assert moved.code == ExitCode.REFUSED
    assert "within 45 deg" in moved.report["points"][0]["reason"]
    assert moved.lines == moved.before


def test_joints_that_choose_the_posture_of_several_places_never_stay_silently(tmp_path: Path) -> None:
    lines = (f"near = {HINTS}", f"pick = {PICK}", f"place = {PLACE}", TOOL, HOME)
    moves = [f"movej(get_inverse_kin({name}, qnear=near))" for name in ("pick", "place")]
    moved = move_script(tmp_path, *lines, *moves)
    assert moved.code == ExitCode.REFUSED
    assert statuses_of(moved)["near"] == "left"
    assert move_script(tmp_path / "all", *lines, *moves, joints="move").code == ExitCode.PASS


def test_a_recorded_pair_that_contradicts_is_still_left(tmp_path: Path) -> None:
    pair = (f"W_1_p={PICK}", f"W_1_q={HINTS}", "movej(get_inverse_kin(W_1_p, qnear=W_1_q))")
    moved = move_script(tmp_path, TOOL, HOME, *pair, f"movel({PLACE})")
    assert moved.code == ExitCode.REFUSED
    assert statuses_of(moved)["W_1"] == "left"


def test_programs_of_polyscope_x_in_a_folder_are_named_as_not_read(tmp_path: Path) -> None:
    (tmp_path / "a.script").write_text("def a():\nend\n")
    (tmp_path / "b.urpx").write_text("{}")
    found = find_programs([str(tmp_path)])
    assert [path.name for path in found.passed_over if holds_unread_places(path)] == ["b.urpx"]


REST = "[0.35, -1.45, 1.85, -2.0, -1.5, 0.2]"


@pytest.mark.parametrize(
    "lines",
    [
        (f"rest = {REST}", "q = rest", "movej(q)"),
        (f"rest = {REST}", "q = rest", "global k = q", "movej(k)"),
        (f"optimovej({REST})", f"optimovel({PLACE})", f"p1 = {PICK}", "optimovel(p1, a=0.5, v=0.5)"),
        (f"rest = {REST}", "optimovej(rest)"),
    ],
)
def test_joints_and_places_of_every_move_go_along_or_are_named(
    tmp_path: Path, lines: tuple[str, ...]
) -> None:
    moved = move_script(tmp_path, TOOL, HOME, *lines, joints="move")
    copied = "= rest" in "".join(lines)
    assert set(statuses_of(moved).values()) == ({"changed", "left"} if copied else {"changed"})
    assert len(statuses_of(moved)) == (4 if "optimovel" in lines[1] else 2)
    assert moved.code == (ExitCode.REFUSED if copied else ExitCode.PASS)


@pytest.mark.parametrize(
    ("lines", "name"),
    [
        (("go_to_station([0.2, -1.5, 1.8, -1.9, -1.5, 0.2])",), "line 4"),
        (("station = [0.2, -1.5, 1.8, -1.9, -1.5, 0.2]", "go_to_station(station, 0.5)"), "station"),
    ],
    ids=["written", "by name"],
)
def test_joints_given_to_a_function_of_another_file_are_left_and_named(
    tmp_path: Path, lines: tuple[str, ...], name: str
) -> None:
    moved = move_script(tmp_path, TOOL, HOME, *lines)
    assert moved.code == ExitCode.REFUSED
    assert statuses_of(moved)[name] == "left"


def test_numbers_of_the_controllers_own_functions_are_no_joints(tmp_path: Path) -> None:
    lines = (
        "set_target_payload(1.2, [0, 0, 0.05], [0.01, 0.01, 0.01, 0, 0, 0])",
        "reset_revolution_counter([0, 0, 0, 0, 0, 1])",
        "textmsg([0.2, -1.5, 1.8, -1.9, -1.5, 0.2])",
    )
    assert set(statuses_of(move_script(tmp_path, TOOL, HOME, *lines))) == {"line 3"}


@pytest.mark.parametrize("offset", [SHIFTED, TURNED])
@pytest.mark.parametrize(
    ("lines", "is_finding"),
    [
        (("movel(pose_trans(seen, p[0,0,-0.1,0,0,0]))",), True),
        (("over = pose_trans(seen, p[0,0,-0.1,0,0,0])", "movel(over)"), True),
        (("step = p[0,0,height,0,0,0]", "over = pose_trans(pick, step)", "movel(over)"), False),
        (("here = get_actual_tcp_pose()", "movel(pose_trans(here, p[0,0,-0.1,0,0,0]))"), False),
    ],
)
def test_a_place_seen_from_a_computed_one_is_told(
    tmp_path: Path, lines: tuple[str, ...], is_finding: bool, offset: str
) -> None:
    reading = "seen = p[read_input_float_register(0),-0.2,0.25,0,3.1415,0]"
    moved = move_script(
        tmp_path, f"pick = {PICK}", "height = -0.1", reading, TOOL, HOME, "movel(pick)", *lines, offset=offset
    )
    assert moved.code == (ExitCode.REFUSED if is_finding else ExitCode.PASS)
    assert {one["point"] for one in moved.report["findings"]} == ({"seen"} if is_finding else set())
