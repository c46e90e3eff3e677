"""Yaskawa jobs: the maker's layout read and written, pulses, variables, configurations, refusals."""

import dataclasses

import numpy as np
import pytest

from cellcal.calibration.arm.kinematics import load_model
from cellcal.calibration.geometry import homogeneous_matrix
from cellcal.drivers.programs.errors import ProgramFileError
from cellcal.drivers.programs.positions import CARTESIAN, JOINTS, NO_NUMBER, UNREAD, PositionChange
from cellcal.drivers.yaskawa.program_files.programs import BRAND, read
from tests.programs.fuzz import check_mutants, check_roundtrip, token_invariant
from tests.programs.generate_yaskawa import generate

PULSES_PER_DEG = np.array([1341.4, -1341.4, 1341.4, 1000.0, 1000.0, 622.0, 900.0, 800.0])
RATIOS = np.degrees(PULSES_PER_DEG)
JOB = b"""/JOB\r
//NAME TESTTCPX\r
//POS\r
///NPOS 3,1,1,4,0,0\r
///TOOL 23\r
///POSTYPE PULSE\r
///PULSE\r
C00000=2730,-84461,-101368,0,-77310,67137\r
///TOOL 13\r
C00001=76697,-73189,-80544,374,-78336,86207\r
///USER 8\r
///TOOL 23\r
///POSTYPE USER\r
///RECTAN\r
///RCONF 0,0,0,0,1,0,0,0\r
C00002=410.000,-0.016,120.147,-170.32,90.00,-170.32\r
P0010=100.250,-20.500,310.205,30.00,-45.00,60.00\r
///RCONF 1,0,0,0,0,0,0,0\r
P0011=0.000,0.000,-25.000,0.00,0.00,0.00\r
P0012=1.000,2.000,3.000,0.00,0.00,0.00\r
///POSTYPE BASE\r
///RCONF 0,0,0,0,0,0,0,0\r
P0026=-276.205,101.089,162.089,0.08,-83.39,-19.88\r
BC00002=1250.500\r
///POSTYPE PULSE\r
///PULSE\r
EC00001=-4096,12\r
//INST\r
///DATE 2012/04/25 14:11\r
///COMM 1ER PROGRAM POUR VERIFIER LE TCP\r
///ATTR SC,RW,RJ\r
////FRAME USER 8\r
///GROUP1 RB1,BS1\r
NOP\r
MOVJ C00000 VJ=25.00\r
MOVJ C00001 VJ=25.00\r
SFTON P011\r
MOVL C00002 V=100.0\r
MOVL P010 V=50.0\r
'MOVL P012 V=50.0 is a remark\r
MOVL P026 V=50.0\r
SFTOF\r
SETE P026 (3) 500\r
MOVL P[I000] V=50.0\r
END\r
"""


def elementary_rotation(axis: int, degrees: float) -> np.ndarray:
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    i, j = (axis + 1) % 3, (axis + 2) % 3
    turn = np.eye(3)
    turn[i, i] = turn[j, j] = c
    turn[i, j], turn[j, i] = -s, s
    return turn


def test_a_job_is_read_as_the_maker_describes_it() -> None:
    job = BRAND.read("TESTTCPX.JBI", JOB)
    positions = job.positions
    assert job.to_bytes() == JOB
    assert (job.name, job.brand) == ("TESTTCPX", "yaskawa")
    assert positions.names == ("C00000", "C00001", "C00002", "P0010", "P0011", "P0012", "P0026")
    assert positions.kinds == ("pulses", "pulses", CARTESIAN, CARTESIAN, "shift", "shift", "shift")
    assert positions.tools == ("23", "13", "23", "23", "23", "23", "23")
    assert positions.user_frames == (None, None, "8", "8", "8", "8", "BASE")
    assert positions.configurations[2] == "0,0,0,0,1,0,0,0"
    assert positions.lines.tolist()[:3] == [8, 10, 16]
    # fixed axes: the specified frame turned about z, then its own y, then its own x
    turned = elementary_rotation(2, 60.0) @ elementary_rotation(1, -45.0) @ elementary_rotation(0, 30.0)
    assert np.allclose(
        positions.frame_tip[3], homogeneous_matrix(turned, np.array([0.10025, -0.0205, 0.310205]))
    )
    assert positions.external[1, 1:3].tolist() == [-4096.0, 12.0]
    assert [column.name for column in positions.external_columns] == ["B1", "S1", "S2"]
    assert positions.external[2, 0] == pytest.approx(1.2505)
    assert positions.resolution_m[2] == pytest.approx(1e-6)
    assert positions.resolution_rad[2] == pytest.approx(np.radians(0.01))
    assert set(job.frames.base_frame) == {"ROBOT"}  # what carries the robot is not known here


def test_a_job_that_follows_a_conveyor_says_so() -> None:
    old = b"MOVL C00002 V=100.0\r\n"
    new = b"SYSTART CV#(1) STP=100.0\r\nSYMOVL C00002 V=100.0 CTP=50.0\r\nSYEND CV#(1)\r\n"
    remarks = {
        (r.line, r.code) for r in BRAND.read("a.jbi", JOB.replace(old, new)).remarks if "conveyor" in r.text
    }
    line = JOB.partition(old)[0].count(b"\n") + 1
    assert remarks == {(line, "relative"), (line + 1, "relative")}


def test_what_no_coordinate_shows_is_reported() -> None:
    remarks = [(remark.line, remark.code) for remark in BRAND.read("a.jbi", JOB).remarks]
    assert (8, "pulses") in remarks
    assert (31, "relative") in remarks
    assert (32, "relative") in remarks
    for line, code in ((37, "offset"), (39, "position_register"), (43, "computed"), (44, "indirect")):
        assert (line, code) in remarks
    assert 40 not in [line for line, _ in remarks]  # a remark of the programmer
    assert [line for line, code in remarks if code == "position_register"] == [19, 20, 23, 39, 41]


def _job_bytes(rows: list[str], head: list[str], instructions: list[str], counts: str) -> bytes:
    frame = ["///TOOL 0", "///POSTYPE BASE", "///RECTAN", "///RCONF 0,0,0,0,0,0,0,0"]
    return "\r\n".join(
        [
            "/JOB",
            "//NAME A",
            "//POS",
            f"///NPOS {counts}",
            *frame,
            *rows,
            *head,
            "NOP",
            *instructions,
            "END",
            "",
        ]
    ).encode()


def test_points_of_a_second_robot_are_not_the_robots() -> None:
    rows = [f"{name}={x}.000,0.000,400.000,180.0000,0.0000,0.0000" for x, name in enumerate(
        ("C00000", "C00001", "P00001", "P00002", "P00003"), 500)]  # fmt: skip
    moves = [
        "MOVJ C00000 VJ=5.00  +MOVJ C00001 VJ=5.00",
        "SMOVL P001 V=10.0  +SMOVL P002 V=10.0",
        "MOVL P003 V=9.0",
    ]
    two = _job_bytes(rows, ["//INST", "///GROUP1 RB1", "///GROUP2 RB2"], moves, "2,0,0,3,0,0")
    positions = BRAND.read("a.jbi", two).positions
    assert positions.groups.tolist() == [1, 2, 1, 2, 1]
    station = BRAND.read("a.jbi", two.replace(b"GROUP2 RB2", b"GROUP2 ST1"))
    assert station.positions.groups.tolist() == [1, 1, 1, 1, 1]
    assert [
        r.line for r in station.remarks if r.text.endswith("moves together with another control group.")
    ] == [
        18,
        19,
    ]


def test_arguments_of_a_job_are_passed_over() -> None:
    row = "P00100=500.000,0.000,400.000,180.0000,0.0000,0.0000"
    head = [
        "//ARGINFO",
        "///ARGTYPE B,I,,,,,,",
        "///COMMENT",
        "which part",
        "MOVL P100",
        "",
        "//INST",
        "///GROUP1 RB1",
    ]
    job = BRAND.read("a.jbi", _job_bytes([row], head, ["MOVL P100 V=9.0"], "0,0,0,1,0,0"))
    assert job.positions.kinds == (CARTESIAN,)
    assert [r.line for r in job.remarks] == [19]
    cut = job.to_bytes()[: job.to_bytes().index(b"//INST")]
    with pytest.raises(ProgramFileError, match="ends before its instructions"):
        BRAND.read("a.jbi", cut)


def test_the_base_of_a_robot_on_a_track_is_not_the_robots_own() -> None:
    row = "P00100=500.000,0.000,400.000,180.0000,0.0000,0.0000"
    for group, expected_frames in (("RB1,BS1", {"ROBOT"}), ("RB1", {"ROBOT", "BASE"})):
        job = BRAND.read(
            "a.jbi", _job_bytes([row], ["//INST", f"///GROUP1 {group}"], ["MOVL P100 V=9.0"], "0,0,0,1,0,0")
        )
        assert set(job.frames.base_frame) == expected_frames


def test_a_local_variable_is_no_global_one_and_what_is_switched_off_uses_none() -> None:
    rows = [f"P0010{i}=500.000,0.000,40{i}.000,180.0000,0.0000,0.0000" for i in range(3)]
    moves = ["MOVL P100 V=9.0", "COMM SUB P100 P102", "SET LP101 P102", "MOVL LP101 V=9.0"]
    positions = BRAND.read(
        "a.jbi", _job_bytes(rows, ["//INST", "///GROUP1 RB1"], moves, "0,0,0,3,0,0")
    ).positions
    assert positions.kinds == (CARTESIAN, "shift", "shift")


def test_pulses_become_angles_with_ratios_and_go_back_in_whole_pulses() -> None:
    job = read("a.jbi", JOB, pulses_per_rad=RATIOS[:6])
    positions = job.positions
    assert positions.kinds[:2] == (JOINTS, JOINTS)
    pulses = np.array([2730, -84461, -101368, 0, -77310, 67137])
    assert positions.joints[0] == pytest.approx(np.radians(pulses / PULSES_PER_DEG[:6]))
    assert "pulses" not in [remark.code for remark in job.remarks]
    turned = positions.joints[:1] + np.radians([1.0, 1.0, 0.0, 0.0, 0.0, -0.5])
    new = job.with_changes(PositionChange(rows=np.array([0]), joints=turned))
    assert new.to_bytes() == JOB.replace(
        b"C00000=2730,-84461,-101368,0,-77310,67137", b"C00000=4071,-85802,-101368,0,-77310,66826"
    )


def test_a_pulse_position_without_ratios_is_not_moved() -> None:
    job = BRAND.read("a.jbi", JOB)
    assert np.isnan(job.positions.joints[:2]).all()
    with pytest.raises(ProgramFileError, match="C00000 holds pulses") as error_info:
        job.with_changes(
            PositionChange(rows=np.array([0]), joints=np.zeros((1, job.positions.joints.shape[1])))
        )
    assert "Pulses per degree are needed" in error_info.value.remedy
    assert error_info.value.line == 8
    with pytest.raises(ProgramFileError, match="P0011 holds shift"):
        job.with_changes(PositionChange(rows=np.array([4]), frame_tip=np.eye(4)[None]))


def test_a_moved_point_changes_its_numbers_only() -> None:
    job = BRAND.read("a.jbi", JOB)
    shift = homogeneous_matrix(np.eye(3), np.array([0.0, 0.00025, -0.1]))
    new = job.with_changes(
        PositionChange(rows=np.array([2, 3]), frame_tip=shift @ job.positions.frame_tip[2:4])
    )
    assert new.to_bytes() == JOB.replace(b"410.000,-0.016,120.147", b"410.000,0.234,20.147").replace(
        b"100.250,-20.500,310.205", b"100.250,-20.250,210.205"
    )
    same = job.with_changes(PositionChange(rows=np.array([2, 3]), frame_tip=job.positions.frame_tip[2:4]))
    assert same.to_bytes() == JOB


@pytest.mark.parametrize(
    ("old", "new"),
    [
        (b"410.000,-0.016,120.147,-170.32,90.00,-170.32", b"400.000,0,0,180,0,0"),
        (b"410.000,-0.016,120.147,-170.32,90.00,-170.32", b"410.000, -.016, +120.147,-170.32,45.00,-170.32"),
        (b"410.000,-0.016,120.147,-170.32,90.00,-170.32", b"1.5,-0.016,120.147,-170.32,45.00001,-170.3"),
    ],
)
def test_free_numbers_take_what_is_asked(old: bytes, new: bytes) -> None:
    job = BRAND.read("a.jbi", JOB.replace(old, new))
    shift = homogeneous_matrix(elementary_rotation(1, 0.37), np.array([0.0101237, 0.0, 0.0]))
    requested_poses = shift @ job.positions.frame_tip[2:3]
    got = job.with_changes(PositionChange(rows=np.array([2]), frame_tip=requested_poses)).positions
    assert np.abs(got.frame_tip[2, :3, 3] - requested_poses[0, :3, 3]).max() <= 0.501e-6
    assert np.abs(got.frame_tip[2, :3, :3] - requested_poses[0, :3, :3]).max() < 1.5 * got.resolution_rad[2]
    assert got.resolution_rad[2] < np.radians(0.011)


@pytest.mark.parametrize(
    ("old", "new", "row"),
    [
        (b"C00001=76697,-73189", b"C00001=76697;-73189", 1),
        (b"C00002=410.000,", b"C00002=", 2),
        (b"410.000", b"1e3", 2),
        (b"410.000", b"nan", 2),
        (b"410.000,", b"410.000 ", 2),
        (b"410.000", b"", 2),
    ],
)
def test_a_position_with_a_number_that_is_none_leaves_the_others(old: bytes, new: bytes, row: int) -> None:
    whole = BRAND.read("a.jbi", JOB).positions
    job = BRAND.read("a.jbi", JOB.replace(old, new, 1))
    assert job.to_bytes() == JOB.replace(old, new, 1)
    assert job.positions.kinds[row] == UNREAD
    assert job.positions.barred[row] == NO_NUMBER
    assert job.positions.names == whole.names
    others = [at for at in range(len(whole)) if at != row]
    assert [job.positions.kinds[at] for at in others] == [whole.kinds[at] for at in others]


@pytest.mark.parametrize(
    ("old", "new", "line", "words"),
    [
        (b"NPOS 3,1,1", b"NPOS 4,1,1", 1, "says 4 C positions, 3 are there"),
        (b"NPOS 3,1,1", b"NPOS 3\x1d,1,1", 4, "does not give six counts"),
        (b"C00001=76697,", b"C00001=7669.7,", 10, "no ///PULSE position"),
        (b"///PULSE\r\nC00000", b"///PULSES\r\nC00000", 7, "not understood among positions"),
        (b"///POSTYPE USER\r\n", b"", 15, "is not said"),
        (b"///USER 8\r\n", b"", 15, "///USER does not say which"),
        (b"///USER 8\r\n", b"///USER A\r\n", 11, "names no number"),
        (b"C00001=7", b"C00000=7", 10, "C00000 is there a second time"),
        (b"END\r\n", b"", 1, "without END"),
        (b"//INST\r\n", b"", 28, "not understood among positions"),
        (b"/JOB", b"/JOG", 1, "/JOG is not understood"),
        (b"///RCONF 1,0", b"///RCONF A,0", 18, "not understood among positions"),
        (b"NOP\r\n", b"NOP\r\n//POS\r\n", 35, "is not understood"),
    ],
)
def test_damage_is_refused_with_its_line(old: bytes, new: bytes, line: int, words: str) -> None:
    data = JOB.replace(old, new, 1)
    assert data != JOB
    with pytest.raises(ProgramFileError, match=words) as error_info:
        BRAND.read("a.jbi", data)
    assert error_info.value.line == line
    assert error_info.value.remedy


def test_several_jobs_in_one_file_keep_their_names_apart() -> None:
    positions = BRAND.read("a.jbi", JOB + JOB).positions
    assert positions.names[7:9] == ("C00000@53", "C00001@55")
    assert positions.external[8, 1:3].tolist() == [-4096.0, 12.0]


def test_what_is_no_job_is_refused() -> None:
    for data in (b"", b"hello\n", JOB.decode().encode("utf-16"), b"/JOB\n//NAME A\n", b"x" * 5000):
        with pytest.raises(ProgramFileError):
            BRAND.read("a.jbi", data)
    assert BRAND.writes_program(b"'PP 1\r\n/JOB\r\n")
    assert not BRAND.writes_program(b"[Setup]\r\n")


def test_changes_that_cannot_be_written_are_refused() -> None:
    job, rows = BRAND.read("a.jbi", JOB), np.array([2])
    pose = job.positions.frame_tip[rows]
    far = pose.copy()
    far[0, 0, 3] = 2e3
    endless = pose.copy()
    endless[0, 0, 3] = np.inf
    bent = pose.copy()
    bent[0, 0, 0] += 0.1
    for change, words in (
        (PositionChange(rows=np.array([9]), frame_tip=pose), "not there"),
        (PositionChange(rows=np.array([2, 2]), frame_tip=np.vstack([pose, pose])), "one twice"),
        (PositionChange(rows=rows, frame_tip=np.vstack([pose, pose])), "in place of"),
        (PositionChange(rows=rows, frame_tip=far), "cannot take 2000000"),
        (PositionChange(rows=rows, frame_tip=endless), "not finite"),
        (PositionChange(rows=rows, frame_tip=bent), "pose that is none"),
        (PositionChange(rows=rows, configurations=["1,0,0,0,1,0,0,0"]), "another configuration"),
        (PositionChange(rows=rows, user_frames=["9"]), "another user frame"),
    ):
        with pytest.raises(ProgramFileError, match=words):
            job.with_changes(change)
    unchanged = PositionChange(rows=rows, configurations=["0,0,0,0,1,0,0,0"], user_frames=["8"])
    assert job.with_changes(unchanged).to_bytes() == JOB
    for ratios in ([0.0] * 6, [np.nan] * 6, RATIOS[:5]):
        with pytest.raises(ProgramFileError, match="per radian"):
            read("a.jbi", JOB, pulses_per_rad=ratios)


def test_generated_jobs_with_ratios() -> None:
    brand = dataclasses.replace(BRAND, read=lambda name, data: read(name, data, pulses_per_rad=RATIOS))
    tally = check_roundtrip(brand, generate, range(60))
    assert not tally.failures
    assert tally.positions > 200
    assert sum(token_invariant(brand, generate(seed), seed) for seed in range(60)) > 30
    broken = check_mutants(brand, generate, range(10_000, 10_150))
    assert not broken.failures
    assert broken.refused > 50


def test_a_configuration_tells_postures_apart() -> None:
    model, rule = load_model("kuka_kr6_r900"), BRAND.configurations
    assert rule is not None
    rng = np.random.default_rng(4)
    joints = rng.uniform(-1.4, 1.4, size=(200, 6)) + np.array([0.0, -1.2, 1.4, 0.0, 0.0, 0.0])
    joints[:, [3, 5]] *= 4.0
    spelled = rule.write_configurations(model, joints, ["0,0,0,0,0,0,0,7"] * len(joints))
    assert rule.matches_postures(model, joints, spelled).all()
    assert rule.matches_postures(model, joints, [""] * len(joints)).all()
    assert all(text.endswith(",0,7") for text in spelled)
    assert len(set(spelled)) > 6
    for place in (0, 3, 4):
        others = [flip_character(text, place) for text in spelled]
        agreeing = rule.matches_postures(model, joints, others)
        assert agreeing.mean() < 0.01  # borders only
        if place in (3, 4):
            assert rule.matches_postures(model, joints, others, turns=False).all()
    published = np.tile([0.0, -1.2, 1.4, 0.0, 0.5, 0.0], (6, 1))
    published[:, 3] = np.radians([0.0, 89.0, 91.0, -91.0, 271.0, -271.0])  # the maker's table of R
    assert [text[0] for text in rule.write_configurations(model, published, ["0,0,0,0,0,0"] * 6)] == list(
        "001100"
    )
    assert [text[6] for text in rule.write_configurations(model, published, ["0,0,0,0,0,0"] * 6)] == list(
        "000011"
    )


def flip_character(text: str, place: int) -> str:
    numbers = text.split(",")
    numbers[place] = "10"[int(numbers[place])]
    return ",".join(numbers)


def test_points_under_a_signed_rconf_are_named_and_cost_no_other() -> None:
    """RoboDK writes the turns of an axis: -1 behind half a turn the other way."""
    positions = BRAND.read("a.jbi", JOB.replace(b"///RCONF 1,0,0,0,0", b"///RCONF 1,0,0,0,-1", 1)).positions
    signed, unsigned = positions.configurations.index("1,0,0,0,-1,0,0,0"), positions.names.index("C00002")
    assert "///RCONF 1,0,0,0,-1,0,0,0" in positions.barred[signed]
    assert unsigned not in positions.barred
