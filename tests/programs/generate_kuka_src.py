"""KUKA programs with every oddity: points inside moves, folds, offsets, relative moves, frames set on the way."""

from collections.abc import Callable

import numpy as np

from tests.programs.generate_kuka import axes_text, pose_text

SUFFIX = ".src"

_FIXED = (
    "",
    "   ; nur ein Kommentar: PTP {X 1.0,Y 2.0,Z 3.0,A 0.0,B 0.0,C 0.0}",
    ";FOLD PTP P1 CONT Vel=100 % PDAT1 Tool[1]:Greifer Base[2]:Tisch;%{PE}%R 8.3.48,%MKUKATPBASIS",
    "$BWDSTART=FALSE",
    "PDAT_ACT=PPDAT1",
    "FDAT_ACT=FP1",
    "PTP XP1 C_PTP",
    ";ENDFOLD",
    "PTP HOME",
    "PTP HOME Vel= 100 % DEFAULT",
    "LIN XP[I] C_DIS",
    "LIN_REL {X 10.0,Z -5.5} C_DIS",
    "PTP_REL {A1 5.0}",
    "SLIN_REL {X 1.5}",
    "LIN XP1:SHIFT C_DIS",
    "LIN XP1 : {X 0.0,Y 0.0,Z 100.0,A 0.0,B 0.0,C 0.0}",
    "LIN {X 1.0,Y 2.0,Z 3.0,A 0.0,B 0.0,C 0.0}:SHIFT",
    "LIN {Z 20.0}",
    "PTP {A1 30.0}",
    "LIN {X NOM_X,Y 0.0,Z ZSAFE+10,A 0.0,B 90.0,C 0.0}",
    "PTP GETPOS(3, {X 1.0,Y 2.0})",
    "XP1.Z = XP1.Z + 10",
    "XP3=$POS_ACT",
    "XP4=XP1:SHIFT",
    'MSG[]="PTP {X 1.0} ; kein Kommentar"',
    "$OUT[3]=TRUE",
    "WAIT FOR $IN[1]==TRUE",
    "IF ($POS_ACT.Z>500.0) THEN",
    "ENDIF",
    "$VEL.CP=0.25",
    "$APO.CDIS = 0.5000",
    "TRIGGER WHEN DISTANCE=0 DELAY=0 DO $OUT[1]=TRUE",
    "SPLINE",
    "ENDSPLINE",
    "SLIN XP1 WITH $VEL=SVEL_CP(0.008,,LCPDAT1), $TOOL=STOOL2(FP1),$BASE=EK(K(1),K(2),K(3)) C_SPL",
    "CIRC XP2,XP3",
    "FOR I=1 TO 6",
    "ENDFOR",
    "interrupt on 3",
)


def generate(seed: int) -> bytes:
    """Return one program."""
    rng = np.random.default_rng([seed, 12])
    lines = ["&ACCESS RVP", "&REL 3"] if rng.random() < 0.6 else []
    lines += [f"DEF  Teil_{seed} ( )", ";FOLD INI;%{PE}", "  BAS (#INITMOV,0 )", ";ENDFOLD (INI)"]
    lines += _frame_lines(rng)
    for _ in range(int(rng.integers(3, 30))):
        lines.append(
            _move_instruction(rng) if rng.random() < 0.55 else _FIXED[int(rng.integers(len(_FIXED)))]
        )
        lines += _taught_move(rng) if rng.random() < 0.1 else []
    if rng.random() < 0.3:
        lines += ["END", "", "GLOBAL DEF UP()", *_frame_lines(rng), _move_instruction(rng)]
    lines.append("END")
    end = "\n" if rng.random() < 0.2 else "\r\n"
    return (end.join(lines) + end).encode("latin-1")


def _taught_move(rng: np.random.Generator) -> list[str]:
    """Return a move as an inline form writes it; the frame data is that of its point, nearly always."""
    point = int(rng.integers(1, 90))
    return [
        f";FOLD LIN P{point} Vel=0.2 m/s CPDAT{point} Tool[1]:t Base[1]:b;%{{PE}}%R 8.3.38,%MKUKATPBASIS,%CMOVE",
        "$BWDSTART=FALSE",
        f"LDAT_ACT=LCPDAT{point}",
        f"FDAT_ACT=FP{point + int(rng.random() < 0.1)}",
        "BAS(#CP_PARAMS,0.2)",
        f"LIN XP{point}{rng.choice(['', ' C_DIS', ' '])}",
        ";ENDFOLD",
    ]


def _frame_lines(rng: np.random.Generator) -> list[str]:
    kind = int(rng.integers(7))
    base, tool = int(rng.integers(0, 9)), int(rng.integers(0, 9))
    choices: list[list[str]] = [
        [],
        [f"BAS(#TOOL,{tool})", f"BAS (#BASE,{base} )"],
        [f"$TOOL=TOOL_DATA[{tool}]", f"$BASE = BASE_DATA[ {base} ]"],
        [
            "$BASE={X 1462.4854,Y 0.0,Z 664.8991,A 0.0,B 0.0,C 0.0}",
            "$TOOL = {FRAME: X 0,Y 0,Z 150,A 0,B -60.0,C 0}",
        ],
        ["$BASE=$NULLFRAME", f"BAS(#TOOL,{tool})"],
        ["$BASE=BASE_DATA[2]:SHIFT"],
        [f"$BASE=BASE_DATA[{base}]", "BAS(#PTP_PARAMS,100)"],
    ]
    return choices[kind]


def _move_instruction(rng: np.random.Generator) -> str:
    moves: tuple[Callable[[], str], ...] = (
        lambda: f"PTP {axes_text(rng)}",
        lambda: f"CIRC {pose_text(rng)},{pose_text(rng)},CA 90.0 C_DIS",
        lambda: f"circ XP1, {pose_text(rng)}",
        lambda: f"SLIN {pose_text(rng)} WITH $VEL.CP=0.5,$BASE=BASE_DATA[1]",
        lambda: f"XP{int(rng.integers(90))}={pose_text(rng)}",
        lambda: f"ptp  {pose_text(rng)} c_ptp ; Vorposition",
        *[lambda: f"LIN {pose_text(rng)} C_DIS"] * 3,
    )
    return ("  " if rng.random() < 0.5 else "") + moves[int(rng.integers(len(moves)))]()
