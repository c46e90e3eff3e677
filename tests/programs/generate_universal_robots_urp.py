"""PolyScope programs (gzip XML) in the forms that public ones show; knows nothing of the reader."""

import gzip
from xml.sax.saxutils import quoteattr

import numpy as np

from cellcal.drivers.programs.positions import PositionChange, ProgramFile
from cellcal.drivers.universal_robots.program_files.urp_program import UrpProgram

SUFFIX = ".urp"

# A UR10e and another, standard DH: theta, a, d, alpha. The first is that of a public program (pharmbio/robotlab, notes.md).
ARMS = (
    (
        "-8.844411260213857E-8, -0.032582961261549755, -0.8772929446404238, 0.9098787703504071, 2.101429764675086E-6, -1.9523604853220917E-7",
        "1.2280920183406098E-4, -0.6118328650166482, -0.35064142434212725, 6.353071874199852E-5, -8.491717228743712E-5, 0.0",
        "0.18107019996630838, -11.986107840354439, 254.02185121292118, -241.86139249326118, 0.11978728860232488, 0.11569307278026907",
        "1.570573614624119, 0.0016638537326948237, -0.0018631164519257151, 1.5706607381785331, -1.5704473543987978, 0.0",
    ),
    (
        "1.1E-7, 8.1E-4, -3.3E-4, 9.0E-4, 1.5E-6, -2.2E-7",
        "8.1E-5, -0.6129, -0.5714, 4.0E-5, -3.3E-5, 0.0",
        "0.1808, 2.5E-4, -3.1E-4, 0.1744, 0.1198, 0.1166",
        "1.5703, -5.0E-4, 7.0E-4, 1.5704, -1.5701, 0.0",
    ),
)  # fmt: skip


def generate(seed: int) -> bytes:
    """Return a program; the same seed gives the same bytes."""
    rng = np.random.default_rng([seed, 13])
    text = _program_xml(rng)
    if rng.random() < 0.15:
        text = "".join(line.strip() for line in text.split("\n"))
    if rng.random() < 0.1:
        return text.encode("utf-8")
    return gzip.compress(
        text.encode("utf-8"), compresslevel=int(rng.integers(1, 10)), mtime=int(rng.integers(2**31))
    )


def unpacked(data: bytes) -> bytes:
    """Return the XML."""
    return gzip.decompress(data) if data.startswith(b"\x1f\x8b") else data


def packed(xml: bytes) -> bytes:
    """Return a file of damaged XML."""
    return gzip.compress(xml, mtime=0)


def consistent(file: ProgramFile, change: PositionChange) -> PositionChange:
    """Return a change whose poses are those of its joints: a waypoint stores joints, and its pose follows."""
    if not isinstance(file, UrpProgram) or change.joints is None:
        return change
    return PositionChange(
        change.rows, frame_tip=file.poses_at(change.rows, change.joints), joints=change.joints
    )


def _program_xml(rng: np.random.Generator) -> str:
    lines = ['<?xml version="1.0" encoding="UTF-8" standalone="no"?>'] if rng.random() < 0.7 else []
    lines.append(
        '<URProgram name="cell &amp; lid" installation="default" installationRelativePath="default" '
        'directory="/programs" createdIn="5.11.5.1010327" lastSavedIn="5.11.5.1010327" '
        'robotSerialNumber="20195599999" crcValue="3747380250">'
    )
    arm = int(rng.integers(len(ARMS)))
    lines += _kinematics_node(rng, "kinematics", arm, "  ", "LINEARIZED")
    lines += ["  <children>", "    <!-- <Waypoint type='Fixed'/> is no waypoint here -->"]
    lines += _extra_nodes(rng)
    lines += ['    <MainProgram runOnlyOnce="true" InitVariablesNode="false">', "      <children>"]
    number = 1
    for move in range(int(rng.integers(1, 4))):
        count = int(rng.integers(1, 5))
        lines += _move_node(rng, move, number, count, arm)
        number += count
    lines += ["      </children>", "    </MainProgram>", "  </children>", "</URProgram>", ""]
    return "\n".join(lines)


def _extra_nodes(rng: np.random.Generator) -> list[str]:
    extras = (
        '    <Script type="File"><cachedContents>movel(p[0.1, 0.2, 0.3, 0, 3.14, 0], a=1 &lt; 2)</cachedContents></Script>',
        "    <Script><cachedContents><![CDATA[ x = [1, 2] <Waypoint> ]]></cachedContents></Script>",
        "    <InitVariablesNode/>",
        '    <Waypoint type="Relative" name="step"><motionParameters/><fromPosition><JointAngles angles="'
        '0.0, -1.5, 1.5, -1.5, -1.5, 0.0"/></fromPosition></Waypoint>',
        '    <Waypoint type="Variable" name="here" kinematicsFlags="-1"><variable name="v"/></Waypoint>',
        "    <Comment comment='9.5 \"mm\" &gt; 3 > 2, G&#246;teborg Größe'/>",
        "    <Wait type=\"Sleep\"><waitTime>0.22</waitTime></Wait>",
        '    <Assignment><expression><ExpressionChar character="p"/><ExpressionChar character="["/></expression></Assignment>',
        '    <Contributed strategyClass="com.maker.cap"><dataModel><data key="width" value="80.0"/></dataModel></Contributed>',
    )  # fmt: skip
    return [str(extra) for extra in rng.choice(extras, size=int(rng.integers(0, 6)))]


def _move_node(rng: np.random.Generator, move: int, first: int, count: int, arm: int) -> list[str]:
    kind = ("MoveJ", "MoveL", "MoveP")[int(rng.integers(3))]
    feature = '<feature class="GeomFeatureReference" referencedName="Joint_0_name"/>'
    base_feature = "0.0, 0.0, 0.0, 0.0, 0.0, 0.0"
    if move and rng.random() < 0.3:
        feature = '<feature class="GeomFeatureReference" reference="../../Move/feature"/>'
    elif rng.random() < 0.4:
        feature = '<feature class="GeomFeatureReference" referencedName="Plane_1"/>'
        base_feature = _join_six([*rng.normal(size=3) * 0.4, *rng.normal(size=3)])
    tool = _join_six(
        [*rng.normal(size=3) * 0.1, *(rng.normal(size=3) if rng.random() < 0.5 else (0.0, 0.0, 0.0))]
    )
    lines = [
        f'        <Move motionType="{kind}" speed="1.0471975511965976" acceleration="1.3962634015954636" useActiveTCP="false">',
        f"          {feature}",
        "          <children>",
    ]
    for i in range(first, first + count):
        lines += _waypoint_node(rng, i, arm, tool, base_feature)
    return [*lines, "          </children>", "        </Move>"]


def _waypoint_node(rng: np.random.Generator, i: int, arm: int, tool: str, base_feature: str) -> list[str]:
    name = (f"Waypoint_{i}", f"点 {i}", f'over "lid" {i}', f"a&b {i}")[int(rng.integers(4))]
    joints = rng.uniform(-3.1, 3.1, size=6)
    head = f'            <Waypoint type="Fixed" name={quoteattr(name)} kinematicsFlags="4">'
    status = "LINEARIZED"
    if rng.random() < 0.1:
        status = ("NOT_LINEARIZED", "NOT_INITIALIZED")[int(rng.integers(2))]
    own = arm if rng.random() < 0.8 else int(rng.integers(len(ARMS)))
    quote = "'" if rng.random() < 0.2 else '"'
    return [
        head,
        '              <motionParameters blendRadius="0.012"/>',
        "              <position>",
        f"                <JointAngles angles={quote}{_join_six(list(joints))}{quote}/>",
        f'                <TCPOffset pose = "{tool}"/>',
        *_kinematics_node(rng, "Kinematics", own, "                ", status),
        "              </position>",
        f'              <BaseToFeature pose="{base_feature}"/>',
        "            </Waypoint>",
    ]


def _kinematics_node(rng: np.random.Generator, tag: str, arm: int, indent: str, status: str) -> list[str]:
    checks = ", ".join(str(int(value)) for value in rng.integers(-(2**31), 2**31, size=6))
    names = ("deltaTheta", "a", "d", "alpha")
    values = [f'{indent}  <{name} value="{text}"/>' for name, text in zip(names, ARMS[arm], strict=True)]
    return [
        f'{indent}<{tag} status="{status}" validChecksum="true">',
        *values,
        f'{indent}  <jointChecksum value="{checks}"/>',
        f"{indent}</{tag}>",
    ]


def _join_six(values: list[float]) -> str:
    return ", ".join(_format_double(float(value)) for value in values)


def _format_double(value: float) -> str:
    text = repr(value)
    return text.replace("e-0", "E-").replace("e-", "E-") if "e" in text else text
