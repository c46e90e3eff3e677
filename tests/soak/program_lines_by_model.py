"""Programs of a line of robots by their models: postures drawn at random, points as the controllers write them."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from cellcal.calibration.arm.kinematics import load_model
from cellcal.calibration.geometry import Array
from cellcal.calibration.orientation import values_from
from cellcal.drivers.program_registry import brand_named

_SPREAD_RAD = 0.2
_TOOL_MM = 80.0


@dataclass(frozen=True)
class ProgramPoints:
    """Points of one program."""

    places_mm: Array  # (N, 3)
    turned: Array  # (N, 3 or 4) as the maker writes it
    states: Sequence[str]  # configurations; none where the maker writes joints
    joints_rad: Array  # (N, 6)


@dataclass(frozen=True)
class RobotMaker:
    """How one maker's robot stands and how its programs look."""

    brand: str
    model: str
    middle_rad: tuple[float, ...]  # postures are drawn around it
    convention: str
    unit: str  # of the orientation in the project's keys
    unturned: tuple[int, ...]
    like: str  # a configuration, as a spelling
    tool: str
    frame: str
    files: Callable[[str, ProgramPoints], dict[str, list[str]]]  # lines by suffix
    frame_mm: tuple[float, float, float] = (300.0, 50.0, 100.0)


def line_by_model(maker: RobotMaker, folder: Path, programs: int, points: int, seed: int = 1) -> Path:
    """Write ``programs`` programs of ``points`` points each, and the project, whose path is returned."""
    place = folder / "programs"
    place.mkdir(parents=True)
    key = f"{maker.convention}{maker.unit} = {list(maker.unturned)}"
    project = folder / "project.toml"
    project.write_text(
        f'format = 1\nname = "line"\nprograms = ["programs/*"]\n[robot]\nserial = "1"\nmodel = "{maker.model}"\n'
        f"[tools.{maker.tool}.entered]\nposition_mm = [0, 0, {_TOOL_MM}]\n{key}\n"
        f"[frames.{maker.frame}]\nposition_mm = {list(maker.frame_mm)}\n{key}\n"
    )
    rng = np.random.default_rng(seed)
    for number in range(programs):
        name = f"LINE{number:05d}"
        for suffix, lines in maker.files(name, _draw_points(maker, points, rng)).items():
            (place / f"{name}{suffix}").write_bytes("\r\n".join([*lines, ""]).encode())
    return project


def _draw_points(maker: RobotMaker, count: int, rng: np.random.Generator) -> ProgramPoints:
    model = load_model(maker.model)
    joints = np.array(maker.middle_rad) + rng.uniform(-_SPREAD_RAD, _SPREAD_RAD, (count, model.axis_count))
    base_tip = model.base_flange(joints)
    places = base_tip[:, :3, 3] * 1e3 + base_tip[:, :3, 2] * _TOOL_MM - np.array(maker.frame_mm)
    turned = values_from(maker.convention, base_tip[:, :3, :3])
    rule = brand_named(maker.brand).configurations
    states = [] if rule is None else rule.write_configurations(model, joints, [maker.like] * count)
    return ProgramPoints(places, np.rad2deg(turned) if maker.unit == "_deg" else turned, states, joints)


def _kuka_files(name: str, rows: ProgramPoints) -> dict[str, list[str]]:
    program, data = [f"DEF {name}( )"], [f"DEFDAT {name}"]
    for i, (place, turned, state) in enumerate(
        zip(rows.places_mm, rows.turned, rows.states, strict=True), start=1
    ):
        program += [
            f";FOLD LIN P{i} Vel=0.2 m/s CPDAT{i} Tool[1]:grip Base[1]:table;%{{PE}}%R 8.3.38,%MKUKATPBASIS,%CMOVE,"
            f"%VLIN,%P 1:LIN, 2:P{i}, 3:, 5:0.2, 7:CPDAT{i}",
            "$BWDSTART=FALSE",
            f"LDAT_ACT=LCPDAT{i}",
            f"FDAT_ACT=FP{i}",
            "BAS(#CP_PARAMS,0.2)",
            f"LIN XP{i}",
            ";ENDFOLD",
        ]
        pose = ",".join(f"{axis} {v:.6f}" for axis, v in zip("XYZABC", (*place, *turned), strict=True))
        axes = ",".join(f"E{axis} 0.0" for axis in range(1, 7))
        data += [
            f"DECL E6POS XP{i}={{{pose},{state},{axes}}}",
            f'DECL FDAT FP{i}={{TOOL_NO 1,BASE_NO 1,IPO_FRAME #BASE,POINT2[] " "}}',
            f"DECL LDAT LCPDAT{i}={{VEL 0.2,ACC 100.0,APO_DIST 100.0,APO_FAC 50.0,ORI_TYP #VAR}}",
        ]
    return {".src": [*program, "END"], ".dat": [*data, "ENDDAT"]}


def _abb_files(name: str, rows: ProgramPoints) -> dict[str, list[str]]:
    targets, moves = [], []
    for i, (place, turned, state) in enumerate(
        zip(rows.places_mm, rows.turned, rows.states, strict=True), start=1
    ):
        trans, rot = (",".join(f"{v:.{digits}f}" for v in part) for part, digits in ((place, 3), (turned, 9)))
        targets.append(
            f"  CONST robtarget p{i}:=[[{trans}],[{rot}],{state},[9E+09,9E+09,9E+09,9E+09,9E+09,9E+09]];"
        )
        moves.append(f"    MoveL p{i},v200,z10,grip\\WObj:=table;")
    module = [f"MODULE {name}", *targets, f"  PROC r{name}()", *moves, "  ENDPROC", "ENDMODULE"]
    return {".mod": module}


def _yaskawa_files(name: str, rows: ProgramPoints) -> dict[str, list[str]]:
    points, moves, before = [], [], ""
    for i, (place, turned, state) in enumerate(zip(rows.places_mm, rows.turned, rows.states, strict=True)):
        points += [f"///RCONF {state}"] if state != before else []
        points.append(
            f"C{i:05d}={','.join(f'{v:.3f}' for v in place)},{','.join(f'{v:.4f}' for v in turned)}"
        )
        moves.append(f"MOVL C{i:05d} V=375.0 PL=1")
        before = state
    head = ["/JOB", f"//NAME {name}", "//POS", f"///NPOS {len(moves)},0,0,0,0,0", "///USER 1", "///TOOL 1"]
    instruction_lines = ["//INST", "///DATE 2025/03/02 14:11", "///ATTR SC,RW", "///GROUP1 RB1", "NOP"]
    return {".jbi": [*head, "///POSTYPE USER", "///RECTAN", *points, *instruction_lines, *moves, "END"]}


def _universal_robots(name: str, rows: ProgramPoints) -> dict[str, list[str]]:
    lines = [f"def {name}():", f"  set_tcp(p[0.0,0.0,{_TOOL_MM * 1e-3:.12f},0.0,0.0,0.0])"]
    moves = []
    for i, (place, turned, joints) in enumerate(
        zip(rows.places_mm, rows.turned, rows.joints_rad, strict=True), 1
    ):
        pose = ", ".join(f"{v:.12f}" for v in (*place * 1e-3, *turned))
        lines += [
            f"  global Waypoint_{i}_p=p[{pose}]",
            f"  global Waypoint_{i}_q=[{', '.join(map(repr, joints.tolist()))}]",
        ]
        moves += [
            f'  $ {i} "Waypoint_{i}" "breakAfter"',
            f"  movej(get_inverse_kin(Waypoint_{i}_p, qnear=Waypoint_{i}_q), a=1.3962634015954636, v=1.0)",
        ]
    return {".script": [*lines, *moves, "end"]}


MAKERS = {
    "kuka_src": RobotMaker(
        "kuka",
        "kuka_kr6_r900",
        (0, -1.4, 1.6, 0, 0.8, 0),
        "kuka_abc",
        "_deg",
        (0, 0, 0),
        "S 2,T 2",
        "1",
        "1",
        _kuka_files,
    ),
    "abb": RobotMaker(
        "abb",
        "abb_irb120",
        (0, 0.2, 0.1, 0, 0.8, 0),
        "abb_quaternion",
        "",
        (1, 0, 0, 0),
        "[0,0,0,0]",
        "grip",
        "table",
        _abb_files,
    ),
    "yaskawa": RobotMaker(
        "yaskawa",
        "yaskawa_ar2010",
        (0, 0.2, -0.3, 0, -0.8, 0),
        "yaskawa_rpy",
        "_deg",
        (0, 0, 0),
        ",".join("0" * 24),
        "1",
        "1",
        _yaskawa_files,
    ),
    "universal_robots": RobotMaker(
        "universal_robots",
        "ur10e",
        (0, -1.4, 1.6, -1.7, -1.5, 0),
        "ur_rotation_vector",
        "_rad",
        (0, 0, 0),
        "",
        "tcp",
        "base",
        _universal_robots,
        frame_mm=(0.0, 0.0, 0.0),
    ),
}
