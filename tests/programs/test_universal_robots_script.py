"""URScript programs: what is a position and what is not, how numbers are written, what is refused."""

import numpy as np
import pytest

from cellcal.calibration.arm.kinematics import load_model
from cellcal.calibration.geometry import exp_rotation, homogeneous_matrix
from cellcal.drivers.program_registry import read_program
from cellcal.drivers.programs.errors import ProgramFileError
from cellcal.drivers.programs.positions import CARTESIAN, JOINTS, NO_NUMBER, UNREAD, PositionChange
from cellcal.drivers.universal_robots.program_files.script_numbers import (
    java_text,
    poses_of,
    renew_numbers,
    six_of,
)
from cellcal.drivers.universal_robots.program_files.script_positions import CONFLICTS, NOT_READ
from cellcal.drivers.universal_robots.program_files.script_program import ScriptProgram, read_script

_POSE = "p[.1, -.2, .3, 0, 3.14, 0]"
_LIST = "[0, -1.57, 1.57, -1.57, -1.57, 0]"


def _read_script(*lines: str) -> ScriptProgram:
    return read_script("lid.script", "\n".join(lines).encode())


@pytest.mark.parametrize(
    ("line", "names", "kinds"),
    [
        (f"movel({_POSE}, a=1.2, v=0.25)", ["line 1"], [CARTESIAN]),
        (f"movej({_LIST}, a=1.4)", ["line 1"], [JOINTS]),
        (f"movel(pose={_POSE})", ["line 1"], [CARTESIAN]),
        (f"movec({_POSE}, {_POSE}, a=1)", ["line 1", "line 1 (2)"], [CARTESIAN, CARTESIAN]),
        (f"movej(get_inverse_kin({_POSE}, qnear={_LIST}), a=1)", ["line 1"], [CARTESIAN]),
        (f"movej(get_inverse_kin({_POSE}, {_LIST}), a=1)", ["line 1"], [CARTESIAN]),
        (f"x = get_forward_kin({_LIST})", ["line 1"], [JOINTS]),
        (f"global A_p={_POSE}\nglobal A_q={_LIST}", ["A"], [CARTESIAN]),
        (f"home = {_LIST}\nmovej(home, a=1)", ["home"], [JOINTS]),
        (f"top = {_POSE}  # above\nmovel(top)", ["top"], [CARTESIAN]),
        (f"movel(\n  {_POSE},\n  a=1)", ["line 2"], [CARTESIAN]),
        (f"servoj({_LIST}, \\\n  t=0.008)", ["line 1"], [JOINTS]),
        (f"F = {_POSE}\nmovel(pose_trans(F, {_POSE}))", ["line 2"], [CARTESIAN]),
        (f"F = {_POSE}\nB = {_POSE}\nmovel(pose_trans(F, B))", ["B"], [CARTESIAN]),
    ],
)
def test_what_a_move_goes_to_is_a_position(line: str, names: list[str], kinds: list[str]):
    positions = _read_script(line).positions
    assert (list(positions.names), list(positions.kinds)) == (names, kinds)


@pytest.mark.parametrize(
    ("line", "code"),
    [
        (f"movel(pose_add(get_actual_tcp_pose(), {_POSE}))", "relative"),
        (f"A = {_POSE}\nmovel(pose_trans(A, {_POSE}))\nmovel(A)", "relative"),
        ("movel(target)", "computed"),
        ("movel(x + y)", "computed"),
        (f"movel(interpolate_pose({_POSE}, {_POSE}, 0.5))", "computed"),
        (f"go({_POSE})", "computed"),
        (f"A = {_POSE}\nA = get_actual_tcp_pose()\nmovel(A)", "computed"),
        (f"a = {_POSE}\nb = a", "computed"),
        ('x = socket_read_ascii_float(6, "cam")', "foreign"),
    ],
)
def test_what_else_moves_the_arm_or_holds_poses_is_reported(line: str, code: str):
    assert code in {remark.code for remark in _read_script(line).remarks}


@pytest.mark.parametrize(
    "line",
    [
        f"# movel({_POSE})",
        f'textmsg("movel({_POSE})")',
        "force_mode(p[0,0,0,0,0,0], [0,0,1,0,0,0], [0,0,-5,0,0,0], 2, [.1,.1,.1,.3,.3,.3])",
        "set_target_payload(0.5, [0, 0, 0], [0, 0, 0, 0, 0, 0])",
        "speedj([0, 0, 0, 0, 0, 0.1], 1, 0.5)",
        f"set_tcp({_POSE})",
    ],
)
def test_what_no_move_goes_to_is_no_position(line: str):
    assert len(_read_script(line).positions) == 0


def test_frames_and_tools_are_named_with_their_positions():
    file = _read_script(
        f"set_tcp({_POSE})", "Plane_1 = p[1, 0, 0, 0, 0, 0]", f"movel(pose_trans(Plane_1, {_POSE}))",
        "grip = p[0, 0, 0.2, 0, 0, 0]", "set_tcp(grip)", f"movel({_POSE})", "set_tcp(measured)", f"movel({_POSE})",
    )  # fmt: skip
    assert file.positions.user_frames == ("Plane_1", "base", "base")
    assert file.positions.tools == ("line 1", "grip", None)
    assert file.frames.base_frame["Plane_1"].position_m == (1.0, 0.0, 0.0)
    assert file.frames.flange_tip["grip"].position_m == (0.0, 0.0, 0.2)
    assert any("more than one tool" in remark.text for remark in file.remarks)


_SET_A, _SET_B = "set_tcp(p[0,0,0.1,0,0,0])", "set_tcp(p[0,0,0.2,0,0,0])"
_SUB = ("def sub():", _SET_B, "end")


@pytest.mark.parametrize(
    ("lines", "words"),
    [
        ((_SET_A, f"movel({_POSE})", _SET_B), ""),
        ((f"movel({_POSE})", _SET_A), "below"),
        (("set_tcp(measured)", f"movel({_POSE})"), "computed"),
        ((f"W = {_POSE}", _SET_A, "movel(W)", _SET_B, "movel(W)"), "different"),
        ((_SET_A, "if (b):", _SET_B, "end", f"movel({_POSE})"), "way"),
        ((_SET_A, "if (b):", _SET_B, "else:", f"movel({_POSE})", "end"), "way"),
        ((_SET_A, "while (b):", _SET_B, f"movel({_POSE})", "end"), ""),
        ((_SET_A, "if (b):", _SET_A, "end", f"movel({_POSE})"), ""),
        ((f"W = {_POSE}", _SET_A, "movel(W)", _SET_A, "movel(W)"), ""),
        ((_SET_A, "if (b):", "i = 1", "end", f"movel({_POSE})"), ""),
        ((_SET_A, "sub()", f"movel({_POSE})", *_SUB), "way"),
        ((*_SUB, _SET_A, f"movel({_POSE})", "sub()"), ""),
        ((*_SUB, f"movel({_POSE})", "sub()"), "way"),
        ((*_SUB, "movel([0, -1, 1, -1, 0, 0])", "sub()"), "way"),
        ((*_SUB, "sub()", f"movel({_POSE})"), ""),
        (("if (b):", _SET_A, "end", f"movel({_POSE})"), "way"),
        ((*_SUB, "if (b):", "sub()", "end", f"movel({_POSE})"), "way"),
        ((*_SUB, "def go():", f"movel({_POSE})", "end", "sub()", "go()"), ""),
        ((*_SUB, "def go():", f"movel({_POSE})", "end", "go()", "sub()", "go()"), "way"),
        ((*_SUB, "def go():", f"movel({_POSE})", "go()", "end"), "way"),
    ],
)
def test_a_place_whose_tool_is_not_one_is_barred(lines: tuple[str, ...], words: str):
    file = _read_script(*lines)
    assert sorted(file.positions.barred) == ([0] if words else [])
    assert words in file.positions.barred.get(0, "")


def test_a_place_out_of_a_list_is_computed_and_no_damage():
    file = _read_script(f"Places = [{_POSE}, {_POSE}]", "movel(Places[0], a=1.2)", "movej(Places[i + 1])")
    assert file.positions.kinds == (UNREAD, UNREAD)
    assert len(file.positions.barred) == 2
    assert [remark.code for remark in file.remarks if remark.line == 2] == ["computed"]


def test_pose_and_joints_of_a_public_program_agree_under_the_nominal_arm():
    # Saved by a simulator of the maker (UR5e, PolyScope 5.13), printed in masayuki-kono's article on URSim, 2023.
    file = _read_script(
        "global Waypoint_1_p=p[-.143968656714, -.435620060803, .202030025428, "
        "-.001221359682, 3.116276528482, .038891915637]",
        "global Waypoint_1_q=[-1.6006999999999998, -1.7271, -2.2029999999999994, "
        "-0.8079999999999998, 1.5951, -0.030999999999999694]",
    )
    flange = load_model("ur5e").base_flange(file.positions.joints)[0]
    assert np.abs(flange - file.positions.frame_tip[0]).max() < 1e-9  # controllers use 1.570796327 for pi/2


def test_a_change_touches_its_numbers_and_keeps_their_form():
    text = (
        f"movel({_POSE}, a=1.2)  # {_POSE}\n  global A_p = p[.143968656714,-.4, 1E-3, 0,0,0]\n"
        "  global A_q=[-1.6006999999999998, -1.7, 0.0, 0.0, 1.5, 0.0]\n"
    )
    file = read_script("lid.script", text.encode())
    shift = homogeneous_matrix(np.eye(3), np.array([0.05, 0.0, 0.0]))
    moved = (
        file.with_changes(PositionChange(np.array([0]), frame_tip=shift @ file.positions.frame_tip[:1]))
        .to_bytes()
        .decode()
    )
    assert moved == text.replace("movel(p[.1, ", "movel(p[.150000000, ")
    change = PositionChange(
        np.array([1]), frame_tip=shift @ file.positions.frame_tip[1:], joints=file.positions.joints[1:] + 1e-5
    )
    assert (
        "[-1.6006899999999997, -1.69999, 1.0E-5, 1.0E-5, 1.50001, 1.0E-5]"
        in file.with_changes(change).to_bytes().decode()
    )


def test_a_place_with_pose_and_joints_needs_both():
    file = _read_script(f"global A_p={_POSE}", f"global A_q={_LIST}")
    with pytest.raises(ProgramFileError, match="holds a pose and its joints") as refused:
        file.with_changes(PositionChange(np.array([0]), frame_tip=file.positions.frame_tip))
    assert refused.value.line == 1
    assert "kinematics" in refused.value.remedy


def test_what_a_place_cannot_hold_is_refused():
    file = _read_script(f"movel({_POSE})", f"movej({_LIST})")
    for change in (
        PositionChange(np.array([0]), joints=np.zeros((1, 6))),
        PositionChange(np.array([1]), frame_tip=np.eye(4)[None]),
        PositionChange(np.array([0]), frame_tip=np.diag([2.0, 1.0, 1.0, 1.0])[None]),
        PositionChange(np.array([1]), joints=np.full((1, 6), np.inf)),
        PositionChange(np.array([1]), joints=np.array([[0, 0, 0, 0, 0, np.nan]])),
        PositionChange(np.array([0]), configurations=["N U T"]),
    ):
        with pytest.raises(ProgramFileError) as refused:
            file.with_changes(change)
        assert refused.value.remedy


@pytest.mark.parametrize(
    "numbers",
    [
        ".1, .2, .3, 0, 3.14",
        "nan, .2, .3, 0, 3.14, 0",
        ".1 .2, .3, 0, 3.14, 0",
        ".1, 1.2.3, .3, 0, 3.14, 0",
        ".1, , .3, 0, 3.14, 0",
        ".1, 1e, .3, 0, 3.14, 0",
        ".1, -, .3, 0, 3.14, 0",
    ],
)
@pytest.mark.parametrize("text", ["movel(p[{}], a=1)", "movej([{}], a=1)", "pick = p[{}]\nmovel(pick)"])
def test_a_pose_with_a_number_that_is_none_leaves_the_others(text: str, numbers: str):
    positions = _read_script(*text.format(numbers).split("\n"), f"movel({_POSE})").positions
    assert positions.kinds == (UNREAD, CARTESIAN)
    assert positions.barred == {0: NO_NUMBER}


@pytest.mark.parametrize(
    ("text", "line", "column"),
    [
        ("x = f(.1, .2, 1.2.3)", 1, 15),
        ("y = 3\n  movel(p[.1, 0, 0, 0, 0, 0], a=1", 2, 8),
        ("movel p[.1, 0, 0, 0, 0, 0])", 1, 27),
        ('textmsg("open)', 1, 9),
        ("def a():\n  while True:\n    sync()\n  end\n", 1, 1),
        ("def a():\nend\nend\n", 3, 1),
        ("x = 1\rmovel(p[.1, 0, 0, 0, 0, 0])", 1, 6),
        ("x = 1\0", 1, 6),
        ("movel(p[1e9, 0, 0, 0, 0, 0])", 1, 9),
        ("movel(p[1e400, 0, 0, 0, 0, 0])", 1, 9),
        ("x = 1_0", 1, 5),
        ("x = Größe", 1, 7),
        ("x = " + "[" * 101 + "]" * 101, 1, 105),
    ],
)
def test_what_is_not_understood_is_refused_with_line_and_column(text: str, line: int, column: int):
    with pytest.raises(ProgramFileError) as refused:
        read_script("lid.script", text.encode())
    assert (refused.value.line, refused.value.column) == (line, column)
    assert refused.value.remedy


def test_rotation_vectors_keep_their_branch():
    rng = np.random.default_rng(5)
    axis = rng.normal(size=(500, 3))
    axis /= np.linalg.norm(axis, axis=1, keepdims=True)
    angle = np.concatenate([rng.uniform(0, 9, 400), [0.0, np.pi, 2 * np.pi, 1e-13, 3 * np.pi] * 20])[:, None]
    six = np.concatenate([rng.normal(size=(500, 3)), axis * angle], axis=1)
    assert np.array_equal(six_of(poses_of(six), six), six)
    little = homogeneous_matrix(exp_rotation(rng.normal(size=(500, 3)) * 1e-4), np.zeros(3))
    turned = poses_of(six) @ little
    near = six_of(turned, six)
    assert np.abs(poses_of(near) - turned).max() < 1e-13
    same_turns = (
        (angle[:, 0] > 0.1) & (np.abs(angle[:, 0] % (2 * np.pi)) > 0.1) & (-angle[:, 0] % (2 * np.pi) > 0.1)
    )
    assert np.abs(near - six)[same_turns].max() < 0.02


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (0.0, "0.0"),
        (1.0, "1.0"),
        (-0.5, "-0.5"),
        (1e-3, "0.001"),
        (1.25e-4, "1.25E-4"),
        (-8.844411260213857e-8, "-8.844411260213857E-8"),
        (2.5e7, "2.5E7"),
    ],
)
def test_doubles_are_printed_as_java_prints_them(value: float, text: str):
    assert java_text(value) == text
    assert float(java_text(value)) == value


def test_typed_numbers_get_nanometres_and_printed_ones_keep_their_decimals():
    assert renew_numbers(["0.4", "-.2", "+1", "0", "3.14", "0."], [0.4123, -0.2, 1.5, 1e-10, -3.14, 0]) == [
        "0.412300000", "-.2", "+1.500000000", "0", "-3.140000000", "0.",
    ]  # fmt: skip
    assert renew_numbers([".143968656714"] * 6, [-0.0012] * 6) == ["-.001200000000"] * 6


def test_both_kinds_are_read_by_name():
    assert len(read_program("lid.script", f"movel({_POSE})".encode()).positions) == 1


def test_a_huge_line_is_read():
    text = "x = [" + "1, " * 20000 + "1]\n" + f"movel({_POSE})" + " " * 100_000 + "# " + "9" * 100_000
    assert len(read_script("lid.script", text.encode()).positions) == 1


@pytest.mark.parametrize(
    ("lines", "barred"),
    [
        (("over = pose_trans(plane_1, pick)", "movel(over)"), {"pick": NOT_READ}),
        (("over = pose_trans(plane_1, pick)", "movel(over)", "movel(pick)"), {"pick": CONFLICTS}),
        (
            ("place = pose_trans(pose_trans(plane_1, pick), p[0,0,0.1,0,0,0])", "movel(place)"),
            {"pick": NOT_READ},
        ),
        (("over = pose_trans(pick, p[0,0,-0.1,0,0,0])", "movel(over)", "movel(pick)"), {}),
    ],
)
def test_a_point_in_a_frame_of_the_installation_is_left_and_named(
    lines: tuple[str, ...], barred: dict[str, str]
):
    positions = _read_script("pick = p[0.4,0.1,0.2,0,3.1,0]", *lines).positions
    assert {positions.names[row]: why for row, why in positions.barred.items()} == barred


_OVER_LINES = "[.1, -.2, # above\n  .3,\n\t0, \\\n3.14, 0]"


@pytest.mark.parametrize(
    ("text", "kind"),
    [
        (f"movel(p{_OVER_LINES}, a=1.2)", CARTESIAN),
        (f"movel(\n  p{_OVER_LINES}\n  , a=1.2)", CARTESIAN),
        (f"pick = p{_OVER_LINES}\nmovel(pick)", CARTESIAN),
        (f"movej(get_inverse_kin(p{_OVER_LINES},\n  qnear={_LIST}))", CARTESIAN),
        (f"movej({_OVER_LINES}, a=1)", JOINTS),
    ],
)
def test_six_numbers_over_several_lines_are_read_and_written_in_their_layout(text: str, kind: str):
    program = _read_script(text)
    assert program.positions.kinds == (kind,)
    assert program.positions.shifts == ()
    six = np.array([[0.1, -0.2, 0.25, 0.0, 3.14, 0.0]])
    if kind == JOINTS:
        change = PositionChange(np.array([0]), joints=six)
    else:
        joints = program.positions.joints if "qnear" in text else None
        change = PositionChange(np.array([0]), frame_tip=poses_of(six), joints=joints)
    assert program.with_changes(change).text == text.replace(" .3,", " .250000000,")


@pytest.mark.parametrize(
    ("lines", "what"),
    [
        (["movel(p[.1 + x,\n 0, 0, 0, 0, 0])"], "movel"),
        (["movej(get_inverse_kin(p[.1 + x, 0, 0, 0, 0, 0]))"], "movej"),  # a pose, of which one is computed
        (["q = get_inverse_kin(p[.1 + x, 0, 0, 0, 0, 0])", "movej(q)"], "the program"),
        ([f"movej(get_inverse_kin({_POSE}, qnear=[d2r(10), 0, 1, 0, 1, 0]))"], "qnear"),
        (["seed = [d2r(10), 0, 1, 0, 1, 0]", f"movej(get_inverse_kin({_POSE}, qnear=seed))"], "the program"),
    ],
)
def test_a_computed_number_of_a_pose_or_of_joints_to_start_from_is_a_finding(lines: list[str], what: str):
    assert [shift.what for shift in _read_script(*lines).positions.shifts] == [what]


@pytest.mark.parametrize("near", ["get_actual_joint_positions()", "get_inverse_kin(p[.1, 0, 0, 0, 0, 0])"])
def test_joints_to_start_from_that_follow_the_arm_are_no_finding(near: str):
    program = _read_script(f"seed = {near}", f"movej(get_inverse_kin({_POSE}, qnear=seed))")
    assert program.positions.shifts == ()


@pytest.mark.parametrize(
    ("line", "sets"),
    [
        ("if a[2]==0.5:", False),
        ("while a[2] == 0.5:", False),
        ("if True: a[2] = 0.5", True),
        ("if True:\na[2]=0.5", True),
    ],
)
def test_an_element_is_set_behind_a_colon_and_not_by_a_comparison(line: str, sets: bool):
    positions = _read_script(f"a = {_POSE}", *line.split("\n"), "end", "movel(a)").positions
    assert bool(positions.shifts or positions.barred) is sets
