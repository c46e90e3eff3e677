"""PolyScope programs: where a waypoint is, what a change writes, and what is refused.

Poses are computed here with 40 digits from the XML itself, by a chain of our own.
"""

import gzip
import re
import xml.etree.ElementTree as ET
import zlib
from collections.abc import Iterator

import mpmath
import numpy as np
import pytest

from cellcal.calibration.arm.kinematics import DhTable
from cellcal.calibration.geometry import Array, exp_rotation, homogeneous_matrix
from cellcal.drivers.programs.errors import ProgramFileError
from cellcal.drivers.programs.positions import CARTESIAN, JOINTS, NO_NUMBER, UNREAD, PositionChange
from cellcal.drivers.universal_robots.program_files.programs import BRAND
from cellcal.drivers.universal_robots.program_files.script_program import read_script
from cellcal.drivers.universal_robots.program_files.urp_archive import MOST_XML_BYTES
from cellcal.drivers.universal_robots.program_files.urp_kinematics import pose_distances
from cellcal.drivers.universal_robots.program_files.urp_program import UrpProgram, read_urp
from cellcal.service.engineering.programs.batches import read_batches
from cellcal.service.engineering.programs.files import find_programs
from tests.programs.fuzz import check_mutants
from tests.programs.generate_universal_robots_urp import ARMS, consistent, generate, packed, unpacked

# A waypoint of a UR10e and what PolyScope printed for it: pharmbio/robotlab, notes.md.
_JOINTS = (
    "1.9942498207092285, -1.6684614620604457, 1.9330504576312464, "
    "-0.2718423169902344, 1.3209004402160645, 0.0036344528198242188"
)
_PRINTED = ".433025361705, -.467959205379, .522310714714, 1.500318891221, .521427297251, .530987104689"
_MICROMETRE_OF_A_MILLIMETRE = 1e-9  # 1e-6 mm in metres


def _kinematics_xml(tag: str, arm: int, status: str = "LINEARIZED") -> str:
    theta, a, d, alpha = ARMS[arm]
    return (
        f'<{tag} status="{status}"><deltaTheta value="{theta}"/><a value="{a}"/><d value="{d}"/>'
        f'<alpha value="{alpha}"/><jointChecksum value="-1, 2, 3, 4, 5, 6"/></{tag}>'
    )


def _urp_bytes(*waypoints: str, arm: int = 0, head: str = "") -> bytes:
    inner = "\n".join(waypoints)
    text = (
        f'{head}<URProgram name="lid">\n{_kinematics_xml("kinematics", arm)}\n<children><MainProgram><children>'
        f"<Move><children>\n{inner}\n</children></Move></children></MainProgram></children></URProgram>"
    )
    return gzip.compress(text.encode(), mtime=5)


def _waypoint_xml(
    name: str = "Waypoint_1", arm: int = 0, status: str = "LINEARIZED", tool: str = "0, 0, 0, 0, 0, 0"
) -> str:
    return (
        f'<Waypoint type="Fixed" name="{name}"><position><JointAngles angles="{_JOINTS}"/>'
        f'<TCPOffset pose="{tool}"/>{_kinematics_xml("Kinematics", arm, status)}</position>'
        '<BaseToFeature pose="0, 0, 0, 0, 0, 0"/></Waypoint>'
    )


def _parse_six(text: str) -> list[mpmath.mpf]:
    return [mpmath.mpf(number.strip()) for number in text.split(",")]


def _rotation_matrix(vector: list[mpmath.mpf]) -> mpmath.matrix:
    angle = mpmath.sqrt(sum(v * v for v in vector))
    if not angle:
        return mpmath.eye(3)
    x, y, z = (v / angle for v in vector)
    skew = mpmath.matrix([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return mpmath.eye(3) + mpmath.sin(angle) * skew + (1 - mpmath.cos(angle)) * skew * skew


def _frame_matrix(six: list[mpmath.mpf]) -> mpmath.matrix:
    matrix = mpmath.eye(4)
    matrix[:3, :3] = _rotation_matrix(six[3:])
    for i in range(3):
        matrix[i, 3] = six[i]
    return matrix


def _flange_matrix(joints: list[mpmath.mpf], kinematics: ET.Element) -> mpmath.matrix:
    columns = [_parse_six(kinematics.find(tag).attrib["value"]) for tag in ("deltaTheta", "d", "a", "alpha")]  # type: ignore[union-attr]
    flange = mpmath.eye(4)
    for q, theta, d, a, alpha in zip(joints, *columns, strict=True):
        c, s, ca, sa = mpmath.cos(q + theta), mpmath.sin(q + theta), mpmath.cos(alpha), mpmath.sin(alpha)
        flange *= mpmath.matrix(
            [[c, -s * ca, s * sa, a * c], [s, c * ca, -c * sa, a * s], [0, sa, ca, d], [0, 0, 0, 1]]
        )
    return flange


def _true_poses(data: bytes) -> Iterator[tuple[str, Array]]:
    """Yield every fixed waypoint's pose in its feature, from the XML with 40 digits."""
    with mpmath.workdps(40):
        for waypoint in ET.fromstring(unpacked(data)).iter("Waypoint"):
            position = waypoint.find("position")
            if waypoint.get("type") != "Fixed" or position is None:
                continue
            kinematics, feature = position.find("Kinematics"), waypoint.find("BaseToFeature")
            angles, tool = position.find("JointAngles"), position.find("TCPOffset")
            assert kinematics is not None
            assert feature is not None
            assert angles is not None
            assert tool is not None
            tip = _flange_matrix(_parse_six(angles.attrib["angles"]), kinematics) * _frame_matrix(
                _parse_six(tool.attrib["pose"])
            )
            pose = _frame_matrix(_parse_six(feature.attrib["pose"])) ** -1 * tip
            yield kinematics.attrib["status"], np.array(pose.tolist(), dtype=float)


def _largest_deviation_m(file: UrpProgram) -> float:
    """Return the largest distance of a declared pose from the true one [m], attitudes on a lever of a metre."""
    true = list(_true_poses(file.to_bytes()))
    kinds = [kind for kind in file.positions.kinds if kind != UNREAD]  # these stand behind the waypoints
    assert len(true) == len(kinds)
    worst = 0.0
    for (status, pose), kind, declared_pose in zip(true, kinds, file.positions.frame_tip, strict=False):
        assert kind == (CARTESIAN if status == "LINEARIZED" else JOINTS)
        if kind == CARTESIAN:
            worst = max(worst, float(np.abs(declared_pose - pose).max()))
    return worst


def test_the_joints_of_a_waypoint_give_the_pose_that_polyscope_printed():
    file = read_urp("lid.urp", _urp_bytes(_waypoint_xml()))
    script = read_script(
        "lid.script", f"global Waypoint_1_p=p[{_PRINTED}]\nglobal Waypoint_1_q=[{_JOINTS}]\n".encode()
    )
    base_tip = file.columns.base_feature[:1] @ file.positions.frame_tip[:1]
    far_m, turned_rad = pose_distances(base_tip, script.positions.frame_tip[:1])
    assert far_m[0] < 2e-12  # twelve decimals are printed
    assert turned_rad[0] < 2e-12


@pytest.mark.parametrize("seed", range(12))
def test_a_waypoint_is_where_its_own_joints_tool_feature_and_kinematics_put_it(seed: int):
    assert _largest_deviation_m(read_urp("cell.urp", generate(seed))) < _MICROMETRE_OF_A_MILLIMETRE


@pytest.mark.parametrize("seed", range(12))
def test_new_poses_become_joints_that_give_them(seed: int):
    file = read_urp("cell.urp", generate(seed))
    rows = np.flatnonzero(np.array(file.positions.kinds) == CARTESIAN)
    shift = homogeneous_matrix(
        exp_rotation(np.array([0.004, -0.003, 0.002])), np.array([0.003, 0.002, -0.004])
    )
    expected_poses = file.positions.frame_tip[rows] @ shift
    try:
        moved = file.with_changes(PositionChange(rows, frame_tip=expected_poses))
    except ProgramFileError as refused:
        assert "out of reach" in str(refused)  # noqa: PT017 - drawn at random: some stand stretched out
        return
    assert np.abs(moved.positions.frame_tip[rows] - expected_poses).max() < _MICROMETRE_OF_A_MILLIMETRE
    assert _largest_deviation_m(moved) < _MICROMETRE_OF_A_MILLIMETRE
    assert np.median(np.abs(moved.positions.joints[rows] - file.positions.joints[rows])) < 0.05


def test_pose_and_joints_that_do_not_agree_are_refused_and_those_that_do_are_written():
    file = read_urp("lid.urp", _urp_bytes(_waypoint_xml(tool="0, 0, 0.1, 0, 0, 0")))
    rows, joints = np.array([0]), file.positions.joints + 0.01
    with pytest.raises(ProgramFileError, match="do not agree"):
        file.with_changes(PositionChange(rows, frame_tip=file.positions.frame_tip, joints=joints))
    moved = file.with_changes(PositionChange(rows, frame_tip=file.poses_at(rows, joints), joints=joints))
    assert np.array_equal(moved.positions.joints, joints)


@pytest.mark.parametrize("status", ["NOT_LINEARIZED", "NOT_INITIALIZED", "VALID"])
def test_kinematics_that_are_not_the_arms_give_no_pose_and_take_none(status: str):
    file = read_urp("lid.urp", _urp_bytes(_waypoint_xml(status=status)))
    assert file.positions.kinds == (JOINTS,)
    assert any("unknown" in remark.text and remark.code == "foreign" for remark in file.remarks)
    with pytest.raises(ProgramFileError, match="not known") as refused:
        file.with_changes(PositionChange(np.array([0]), frame_tip=np.eye(4)[None]))
    assert refused.value.remedy
    assert np.allclose(
        file.with_changes(PositionChange(np.array([0]), joints=np.ones((1, 6)))).positions.joints, 1.0
    )


def test_a_waypoint_of_another_arm_keeps_its_own_kinematics_and_is_reported():
    file = read_urp("lid.urp", _urp_bytes(_waypoint_xml(), _waypoint_xml("Waypoint_2", arm=1)))
    apart = np.linalg.norm(file.positions.frame_tip[0, :3, 3] - file.positions.frame_tip[1, :3, 3])
    assert 1e-4 < apart < 0.02
    assert any("another arm" in remark.text for remark in file.remarks)


def test_another_arms_kinematics_keep_the_poses_or_the_joints():
    file = read_urp("lid.urp", _urp_bytes(_waypoint_xml(), _waypoint_xml("Waypoint_2")))
    theta, a, d, alpha = (np.array([float(number) for number in column.split(",")]) for column in ARMS[1])
    table = DhTable.from_rows(np.stack([theta, d, a, alpha], axis=1))
    clone = file.with_kinematics(table, [2**32 - 7, 1, 2, 3, 4, 5], keep_poses=True)
    assert np.abs(clone.positions.frame_tip - file.positions.frame_tip).max() < _MICROMETRE_OF_A_MILLIMETRE
    assert np.abs(clone.positions.joints - file.positions.joints).max() > 1e-4
    assert _largest_deviation_m(clone) < _MICROMETRE_OF_A_MILLIMETRE
    same_joints_file = file.with_kinematics(table, [2**32 - 7, 1, 2, 3, 4, 5], keep_poses=False)
    assert np.array_equal(same_joints_file.positions.joints, file.positions.joints)
    assert b"-7, 1, 2, 3, 4, 5" in unpacked(same_joints_file.to_bytes())
    assert np.abs(same_joints_file.positions.frame_tip - file.positions.frame_tip).max() > 1e-4
    assert same_joints_file.frames.kinematics is not None
    assert (
        np.abs(
            same_joints_file.frames.kinematics.base_flange(same_joints_file.positions.joints)[0]
            - same_joints_file.positions.frame_tip[0]
        ).max()
        < 1e-12
    )


def pose_misfit_m(file: UrpProgram) -> float:
    """Return how far the stored pose of the first waypoint is from its own joints [m]."""
    computed = file.poses_at(np.array([0]), file.positions.joints[:1])
    return float(np.linalg.norm((file.positions.frame_tip[:1] - computed)[0, :3, 3]))


def test_a_pose_that_is_stored_changes_with_the_joints():
    pose = "0.433025361705, -0.467959205379, 0.522310714714, 1.500318891221, 0.521427297251, 0.530987104689"
    old = (
        f'<Waypoint type="Fixed" name="W"><position joints="{_JOINTS}" pose="{pose}"/>'
        f'<poseInFeatureCoordinates pose="{pose}"/><outputFlangePose pose="{pose}"/></Waypoint>'
    )
    file = read_urp("old.urp", _urp_bytes(old))
    assert pose_misfit_m(file) < 2e-12
    joints = file.positions.joints + 0.02
    moved = file.with_changes(PositionChange(np.array([0]), joints=joints))
    assert pose_misfit_m(moved) < 1e-11
    stored = re.findall(r' pose="([^"]*)"', unpacked(moved.to_bytes()).decode())
    poses = np.array([[float(number) for number in each.split(",")] for each in stored])
    assert poses.shape == (3, 6)
    assert np.ptp(poses, axis=0).max() < 1e-14
    assert pose_misfit_m(read_urp("old.urp", _urp_bytes(old.replace("0.4330", "0.4340")))) == pytest.approx(
        1e-3, rel=1e-6
    )


def test_a_file_keeps_its_header_and_the_same_change_gives_the_same_bytes():
    data = _urp_bytes(_waypoint_xml())
    change = PositionChange(np.array([0]), joints=np.full((1, 6), 0.5))
    first, second = (read_urp("lid.urp", data).with_changes(change).to_bytes() for _ in range(2))
    assert first == second
    assert first[:10] == data[:10]
    assert read_urp("lid.urp", data).with_changes(PositionChange(np.array([], dtype=int))).to_bytes() == data


def _gzip_bomb() -> bytes:
    deflate = zlib.compressobj(9, zlib.DEFLATED, 31)
    blank = b" " * (1 << 20)
    return b"".join(deflate.compress(blank) for _ in range(2 * MOST_XML_BYTES >> 20)) + deflate.flush()


_ENTITY = '<!DOCTYPE x [<!ENTITY a "aaaa"><!ENTITY b "&a;&a;">]>'


@pytest.mark.parametrize(
    ("data", "says"),
    [
        (_gzip_bomb(), "unpack to more"),
        (_urp_bytes(_waypoint_xml())[:-30], "too soon"),
        (_urp_bytes(_waypoint_xml()) + b"more", "follows"),
        (b"\x1f\x8b\x08", "too soon"),
        (b"PK\x03\x04", "neither gzip nor XML"),
        (_urp_bytes(_waypoint_xml(), head=_ENTITY), "parts that no program needs"),
        (
            _urp_bytes(_waypoint_xml(), head='<!DOCTYPE x SYSTEM "file:///etc/passwd">'),
            "parts that no program needs",
        ),
        (
            packed('<?xml version="1.0" encoding="UTF-16"?><URProgram/>'.encode("utf-16")),
            "two ways",
        ),
        (packed(b"<Installation/>"), "no URProgram"),
        (packed(b"<URProgram><a></URProgram>"), "damaged"),
        (_urp_bytes(_waypoint_xml().replace("1.99", "199e9")), "beyond"),
        (_urp_bytes(_waypoint_xml().replace('<deltaTheta value="', '<deltaTheta value="nan')), "six numbers"),
        (
            _urp_bytes(_waypoint_xml().replace("<position>", _waypoint_xml() + "<position>", 1)),
            "inside another",
        ),
    ],
)
def test_what_is_damaged_or_dangerous_is_refused_with_a_cure(data: bytes, says: str):
    with pytest.raises(ProgramFileError, match=says) as refused:
        BRAND.read("cell.urp", data)
    assert refused.value.file == "cell.urp"
    assert refused.value.remedy


@pytest.mark.parametrize(
    ("old", "new"),
    [("1.99", "1.9.9"), ("-0.27", "nan"), ('"0, 0, 0,', '"0, 0 0,'), ("1.9942498207092285,", "")],
)
def test_a_waypoint_with_a_number_that_is_none_leaves_the_others(old: str, new: str):
    broken = _waypoint_xml("A").replace(old, new, 1)
    positions = read_urp("cell.urp", _urp_bytes(broken, _waypoint_xml("B"))).positions
    assert (positions.names, positions.kinds[1]) == (("B", "A"), UNREAD)
    assert positions.barred == {1: NO_NUMBER}


def test_an_error_names_line_and_column():
    with pytest.raises(ProgramFileError) as refused:
        read_urp(
            "cell.urp",
            packed(
                b'<URProgram>\n<Waypoint><position>\n<JointAngles angles="1, 2, 3, 4, 5, 600"/></position></Waypoint></URProgram>'
            ),
        )
    assert (refused.value.line, refused.value.column) == (3, 22)


def test_damage_inside_the_xml_is_refused_or_kept_to_the_last_byte():
    tally = check_mutants(
        BRAND,
        generate,
        range(0, 900, 2),
        suffix=".urp",
        unpacked=unpacked,
        packed=packed,
        consistent=consistent,
    )
    assert not tally.failures
    assert tally.refused > 80
    assert tally.changed > 40


def test_an_installation_gives_the_frames_that_are_beyond_doubt_and_names_the_others():
    text = (
        b'<Installation name="cell"><TCPSettings><TCP name="grip" pose="0, 0, 0.2, 0, 0, 0"/>'
        b'<TCP name="none"/></TCPSettings>'
        b'<GeomPlaneNode name="Plane_1"><Pose pose="1, 0, 0, 0, 0, 0"/></GeomPlaneNode>'
        b'<GeomPlaneNode name="Plane_2"><P pose="1, 0, 0, 0, 0, 0"/><P pose="2, 0, 0, 0, 0, 0"/></GeomPlaneNode>'
        b"</Installation>"
    )
    file = BRAND.read("cell.installation", packed(text))
    assert file.to_bytes() == packed(text)
    assert len(file.positions) == 0
    assert {name: pose.position_m for name, pose in file.frames.flange_tip.items()} == {
        "grip": (0.0, 0.0, 0.2)
    }
    assert {name: pose.position_m for name, pose in file.frames.base_frame.items()} == {
        "base": (0.0, 0.0, 0.0),
        "Plane_1": (1.0, 0.0, 0.0),
    }
    assert sum("not read" in remark.text for remark in file.remarks) == 2
    with pytest.raises(ProgramFileError, match="no positions"):
        file.with_changes(PositionChange(np.array([0])))


@pytest.mark.parametrize(
    ("node", "turns"),
    [
        ("<Force type='Simple'><children/></Force>", False),
        ("<Direction><children/></Direction>", False),
        ("<Pallet><children/></Pallet>", True),
        ("<ConveyorTracking/>", True),
    ],
)
def test_a_node_that_is_not_known_is_a_finding(node, turns):
    program = read_urp("a.urp", _urp_bytes(f"{_waypoint_xml()}</children></Move>{node}<Move><children>"))
    (shift,) = program.positions.shifts
    assert shift.what == f"the node {re.match('<([A-Za-z]+)', node)[1]}"
    assert (shift.quaternion is None) == turns  # a shift of the work leaves a direction as it is


def _expression_xml(text: str) -> str:
    return f"<expression>{''.join(f'<ExpressionChar character={c!r}/>' for c in text)}</expression>"


@pytest.mark.parametrize(
    ("node", "feature", "is_left"),
    [
        ("<Assignment><variable name='Plane_1_var'/></Assignment>", "Plane_1", True),
        ("<Script><cachedContents>Plane_1_var = seen</cachedContents></Script>", "Plane_1", True),
        (
            f"<Assignment><variable name='a'/>{_expression_xml('swap(Plane_1_var)')}</Assignment>",
            "Plane_1",
            True,
        ),
        ("<Comment/>", "Plane_1_var", True),
        ("<Assignment><variable name='Plane_1_var'/></Assignment>", "Plane_12", False),
        ("<Assignment><variable name='Plane_1'/></Assignment>", "Plane_1", False),
    ],
)
def test_waypoints_in_a_feature_that_the_program_may_set_are_left(node, feature, is_left):
    """PolyScope's variable features: what a program assigns to Plane_1_var moves the waypoints in Plane_1."""
    move = f"<Move><feature class='GeomFeatureReference' referencedName='{feature}'/><children>"
    program = read_urp(
        "a.urp", _urp_bytes(f"{_waypoint_xml()}</children></Move>{node}{move}{_waypoint_xml('W2')}")
    )
    assert program.positions.user_frames == ("base", feature)
    assert sorted(program.positions.barred) == [1] * is_left


SETS = "<Assignment><variable name='Plane_1_var'/></Assignment>"
CALLS = "<SubProgram reference='../a'/>"


@pytest.mark.parametrize(
    ("file", "text", "own", "is_left"),
    [
        ("b.urp", SETS, CALLS, True),
        ("b.urp", SETS + CALLS, "", True),
        ("b.urp", CALLS + f"<a>{_expression_xml('swap(Plane_1_var)')}</a>", "", True),
        ("b.urp", SETS, "", False),  # neither calls the other
        ("b.urp", SETS.replace("Plane_1", "Plane_2"), CALLS, False),
        ("b.script", "def look():\n  global Plane_1_var = get_actual_tcp_pose()\nend\n", "", True),
        ("b.script", "def look():\n  here = get_actual_tcp_pose()\nend\n", CALLS, False),
    ],
)
def test_waypoints_in_a_feature_that_a_called_or_calling_program_sets_are_left(
    file, text, own, is_left, tmp_path
):
    move = "<Move><feature class='GeomFeatureReference' referencedName='Plane_1'/><children>"
    (tmp_path / "a.urp").write_bytes(
        _urp_bytes(f"{_waypoint_xml()}</children></Move>{own}{move}{_waypoint_xml('W2')}")
    )
    other = _urp_bytes(f"{_waypoint_xml()}</children></Move>{text}<Move><children>")
    (tmp_path / file).write_bytes(text.encode() if file.endswith("script") else other)
    sources = find_programs([str(tmp_path)]).sources
    found = {
        one.source.place.name: one.program
        for some in read_batches(sources, lambda _: None, [])
        for one in some
    }
    assert sorted(found["a.urp"].positions.barred) == [1] * is_left


def test_nodes_that_move_nothing_are_no_findings():
    nodes = "<Wait type='Sleep'/><Popup/><Set/><SubProgram reference='../a'/><SafeHome/><Comment/><If><children/></If>"
    program = read_urp("a.urp", _urp_bytes(f"{_waypoint_xml()}</children></Move>{nodes}<Move><children>"))
    assert program.positions.shifts == ()


@pytest.mark.parametrize(
    "value", ["p[0.1,-0.2,0.3,0,3.14,0]", "0.1, -0.2, 0.3, 0, 3.14, 0", "{q: [1,2,3,-1,0.5,0]}"]
)
@pytest.mark.parametrize("form", ["<data key='at' value='{}'/>", "<pose>{}</pose>"])
def test_a_position_in_a_node_of_a_urcap_is_left_and_named(value, form):
    node = (
        f"<Contributed><dataModel>{form.format(value)}<data key='f' value='[9]'/></dataModel></Contributed>"
    )
    program = read_urp("a.urp", _urp_bytes(f"{_waypoint_xml()}</children></Move>{node}<Move><children>"))
    assert program.positions.kinds[1:] == (UNREAD,)
    assert "URCap" in program.positions.barred[1]
