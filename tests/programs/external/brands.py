"""Programs with external axes in five spellings: written and read here, with patterns of these tests only."""

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np
from scipy.spatial.transform import Rotation

from tests.programs.external.hand_geometry import Array

_NUMBER = r"[-+]?\d*\.?\d+(?:[eE][-+]?\d+)?"


@dataclass(frozen=True, eq=False)
class WrittenPoint:
    """A point as a file has it: a pose in a user frame or joints, and its external axes by name."""

    tip: Array | None
    joints: Array | None  # [rad]
    axes: dict[str, float] = field(default_factory=dict)  # mm or deg


@dataclass(frozen=True, eq=False)
class BrandSpelling:
    """How one brand writes a program."""

    brand: str
    model: str
    file: str
    rail: str  # the name of an axis that may carry the robot
    table: str
    tool: str
    frame: str
    postures: tuple[tuple[float, ...], ...]  # [deg], all of one configuration
    write: Callable[[Sequence[WrittenPoint], str], str]  # and the frame that they stand in
    read: Callable[[str], list[WrittenPoint]]
    in_joints: bool = True  # joint points are written, too


def _numbers(text: str) -> list[float]:
    return [float(each) for each in re.findall(_NUMBER, text)]


def _tip(place_mm: Sequence[float], turn: Rotation) -> Array:
    found = np.eye(4)
    found[:3, :3], found[:3, 3] = turn.as_matrix(), np.asarray(place_mm) * 1e-3
    return found


# FANUC -----------------------------------------------------------------------------------------------------------------


def write_fanuc(points: Sequence[WrittenPoint], frame: str, option: str = "") -> str:
    moves = "".join(f"{k:4d}:L P[{k}] 100mm/sec FINE {option}   ;\n" for k in range(1, len(points) + 1))
    records = []
    for k, point in enumerate(points, start=1):
        groups: dict[int, list[str]] = {}
        own = ""
        for name, value in point.axes.items():
            if name.startswith("GP"):
                unit = "deg"
                groups.setdefault(int(name[2]), []).append(f"\tJ{name[-1]}= {value:.6f} {unit}")
            else:
                own += f",\n\t{name}= {value:.6f} {'mm' if name == 'E1' else 'deg'}"
        if point.tip is not None:
            x, y, z = point.tip[:3, 3] * 1e3
            w, p, r = Rotation.from_matrix(point.tip[:3, :3]).as_euler("xyz", degrees=True)
            text = (
                f"\tUF : {frame}, UT : 1,\t\tCONFIG : 'N U T, 0, 0, 0',\n"
                f"\tX = {x:.6f}  mm,\tY = {y:.6f}  mm,\tZ = {z:.6f}  mm,\n"
                f"\tW = {w:.6f} deg,\tP = {p:.6f} deg,\tR = {r:.6f} deg{own}"
            )
        else:
            assert point.joints is not None
            angles = ",\n".join(
                f"\tJ{i}= {v:.6f} deg" for i, v in enumerate(np.degrees(point.joints), start=1)
            )
            text = f"\tUF : {frame}, UT : 1,\n{angles}{own}"
        body = f"   GP1:\n{text}\n"
        for group, axes in sorted(groups.items()):
            body += f"   GP{group}:\n\tUF : F, UT : F,\n" + ",\n".join(axes) + "\n"
        records.append(f"P[{k}]{{\n{body}}};\n")
    return (
        "/PROG  RAIL\n/ATTR\nCOMMENT\t\t= \"\";\nDEFAULT_GROUP\t= 1,*,*,*,*;\n/MN\n" + moves + "/POS\n" + "".join(records)
        + "/END\n"
    )  # fmt: skip


def read_fanuc(text: str) -> list[WrittenPoint]:
    found = []
    for record in re.findall(r"P\[\d+\]\{(.*?)\};", text, re.DOTALL):
        first, *others = re.split(r"GP[2-9]:", record)
        numbers = re.findall(r"([A-Z]\d?) *= *(" + _NUMBER + r") +(?:mm|deg)", first)
        values = {name: float(value) for name, value in numbers}
        axes = {name: value for name, value in values.items() if name[0] == "E"}
        for group, other in enumerate(others, start=2):
            for name, value in re.findall(r"(J\d) *= *(" + _NUMBER + r")", other):
                axes[f"GP{group} {name}"] = float(value)
        if "X" in values:
            turn = Rotation.from_euler("xyz", [values[k] for k in "WPR"], degrees=True)
            found.append(WrittenPoint(_tip([values[k] for k in "XYZ"], turn), None, axes))
        else:
            joints = np.radians([values[f"J{i}"] for i in range(1, 7)])
            found.append(WrittenPoint(None, joints, axes))
    return found


# KUKA ------------------------------------------------------------------------------------------------------------------


def write_kuka(points: Sequence[WrittenPoint], frame: str, mode: str = "#BASE") -> str:
    lines = ["DEFDAT RAIL PUBLIC"]
    for k, point in enumerate(points, start=1):
        axes = "".join(f",{name} {value:.6f}" for name, value in point.axes.items())
        if point.tip is not None:
            x, y, z = point.tip[:3, 3] * 1e3
            a, b, c = Rotation.from_matrix(point.tip[:3, :3]).as_euler("ZYX", degrees=True)
            place = f"X {x:.6f},Y {y:.6f},Z {z:.6f},A {a:.6f},B {b:.6f},C {c:.6f}"
            lines.append(f"DECL E6POS XP{k}={{{place},S 2,T {KUKA_TURN}{axes}}}")
        else:
            assert point.joints is not None
            angles = ",".join(f"A{i} {v:.6f}" for i, v in enumerate(np.degrees(point.joints), start=1))
            lines.append(f"DECL E6AXIS XP{k}={{{angles}{axes}}}")
        lines.append(f'DECL FDAT FP{k}={{TOOL_NO 1,BASE_NO {frame},IPO_FRAME {mode},POINT2[] " "}}')
    return "\n".join([*lines, "ENDDAT", ""])


def read_kuka(text: str) -> list[WrittenPoint]:
    found = []
    for inner in re.findall(r"DECL E6(?:POS|AXIS) \w+=\{(.*?)\}", text):
        values = {name: float(value) for name, value in re.findall(r"([A-Z]\d?) (" + _NUMBER + ")", inner)}
        axes = {name: value for name, value in values.items() if re.fullmatch(r"E\d", name)}
        if "X" in values:
            turn = Rotation.from_euler("ZYX", [values[k] for k in "ABC"], degrees=True)
            found.append(WrittenPoint(_tip([values[k] for k in "XYZ"], turn), None, axes))
        else:
            found.append(WrittenPoint(None, np.radians([values[f"A{i}"] for i in range(1, 7)]), axes))
    return found


# ABB -------------------------------------------------------------------------------------------------------------------


def write_abb(
    points: Sequence[WrittenPoint], frame: str, tool: str = "tGrip", declarations: Sequence[str] = ()
) -> str:
    names = [f"eax_{letter}" for letter in "abcdef"]
    targets, moves = [], []
    for k, point in enumerate(points, start=1):
        axes = ",".join(f"{point.axes[name]:.6f}" if name in point.axes else "9E9" for name in names)
        if point.tip is not None:
            x, y, z = point.tip[:3, 3] * 1e3
            q1, q2, q3, q0 = Rotation.from_matrix(point.tip[:3, :3]).as_quat()
            targets.append(
                f"CONST robtarget p{k}:=[[{x:.6f},{y:.6f},{z:.6f}],[{q0:.10f},{q1:.10f},{q2:.10f},{q3:.10f}],"
                f"[0,0,0,0],[{axes}]];"
            )
            moves.append(f"MoveL p{k},v100,fine,{tool}\\WObj:={frame};")
        else:
            assert point.joints is not None
            angles = ",".join(f"{v:.6f}" for v in np.degrees(point.joints))
            targets.append(f"CONST jointtarget j{k}:=[[{angles}],[{axes}]];")
            moves.append(f"MoveAbsJ j{k},v100,fine,{tool}\\WObj:={frame};")
    lines = ["MODULE RAIL", *declarations, *targets, "PROC main()", *moves, "ENDPROC", "ENDMODULE", ""]
    return "\n".join(lines)


def read_abb(text: str) -> list[WrittenPoint]:
    names = [f"eax_{letter}" for letter in "abcdef"]
    found = []
    for kind, inner in re.findall(r"CONST (robtarget|jointtarget) \w+:=(.*?);", text):
        numbers = _numbers(inner)
        axes = {name: value for name, value in zip(names, numbers[-6:], strict=True) if value < 8e9}
        if kind == "robtarget":
            q0, q1, q2, q3 = numbers[3:7]
            found.append(WrittenPoint(_tip(numbers[:3], Rotation.from_quat([q1, q2, q3, q0])), None, axes))
        else:
            found.append(WrittenPoint(None, np.radians(numbers[:6]), axes))
    return found


# Yaskawa ---------------------------------------------------------------------------------------------------------------


def write_yaskawa(points: Sequence[WrittenPoint], frame: str) -> str:
    base = any(name[0] == "B" for point in points for name in point.axes)
    station = any(name[0] == "S" for point in points for name in point.axes)
    count = len(points)
    lines = [
        "/JOB", "//NAME RAIL", "//POS", f"///NPOS {count},{count * base},{count * station},0,0,0", f"///USER {frame}",
        "///TOOL 1", "///POSTYPE USER", "///RECTAN", "///RCONF 0,0,0,0,0,0,0,0",
    ]  # fmt: skip
    for k, point in enumerate(points):
        assert point.tip is not None
        x, y, z = point.tip[:3, 3] * 1e3
        rx, ry, rz = Rotation.from_matrix(point.tip[:3, :3]).as_euler("xyz", degrees=True)
        lines.append(f"C{k:05d}={x:.6f},{y:.6f},{z:.6f},{rx:.6f},{ry:.6f},{rz:.6f}")
    for letter, there in (("B", base), ("E", station)):
        if there:
            lines += ["///POSTYPE PULSE", "///PULSE"]
            name = "B1" if letter == "B" else "S1"
            lines += [f"{letter}C{k:05d}={round(point.axes[name] * 100)}" for k, point in enumerate(points)]
    lines += ["//INST", "///DATE 2026/01/01 10:00", "///ATTR SC,RW,RJ", "///GROUP1 RB1", "NOP"]
    lines += [f"MOVL C{k:05d} V=100.0" for k in range(count)]
    return "\n".join([*lines, "END", ""])


def read_yaskawa(text: str) -> list[WrittenPoint]:
    rows = dict(re.findall(r"^((?:C|BC|EC)\d{5})=(.*)$", text, re.MULTILINE))
    found = []
    for key in sorted(name for name in rows if name[0] == "C"):
        numbers = _numbers(rows[key])
        axes = {
            name: _numbers(rows[f"{letter}{key}"])[0] / 100
            for letter, name in (("B", "B1"), ("E", "S1"))
            if f"{letter}{key}" in rows
        }
        turn = Rotation.from_euler("xyz", numbers[3:6], degrees=True)
        found.append(WrittenPoint(_tip(numbers[:3], turn), None, axes))
    return found


_UP = tuple(
    (8.0 * k + 6, 6.0 - 4 * k, -6.0 + 3 * k, 12 + 5 * k, -52.0 - 3 * k, 10.0 + 4 * k) for k in range(5)
)
_KUKA = tuple(
    (-8.0 * k - 6, -92.0 + 4 * k, 96.0 - 3 * k, -12.0 - 5 * k, 48.0 + 3 * k, -10.0 - 4 * k) for k in range(5)
)
_ABB = tuple(
    (8.0 * k + 6, 6.0 - 4 * k, 6.0 + 3 * k, 12 + 5 * k, 48.0 + 3 * k, 10.0 + 4 * k) for k in range(5)
)
KUKA_TURN = 0b101011
BRANDS = {
    "fanuc": BrandSpelling(
        "fanuc", "fanuc_m6ib", "rail.ls", "E1", "GP2 J1", "1", "2", _UP, write_fanuc, read_fanuc
    ),
    "kuka": BrandSpelling(
        "kuka", "kuka_kr6_r900", "rail.dat", "E1", "E2", "1", "2", _KUKA, write_kuka, read_kuka
    ),
    "abb": BrandSpelling(
        "abb", "abb_irb120", "rail.mod", "eax_a", "eax_b", "tGrip", "wTab", _ABB, write_abb, read_abb
    ),
    "yaskawa": BrandSpelling(
        "yaskawa",
        "yaskawa_ar2010",
        "rail.jbi",
        "B1",
        "S1",
        "1",
        "2",
        _UP,
        write_yaskawa,
        read_yaskawa,
        in_joints=False,
    ),
}
