"""RAPID modules with every oddity that controllers, editors and people put into them."""

import numpy as np

SUFFIX = ".mod"

_EXTERNAL = (
    "[9E9,9E9,9E9,9E9,9E9,9E9]",
    "[9E+09,9E+09,9E+09,9E+09,9E+09,9E+09]",
    "[9E+9,9E+9,9E+9,9E+9,9E+9,9E+9]",
    "[1250.5,9E+09,9E+09,9E+09,9E+09,9E+09]",
    "[0,0,0,0,0,0]",
)
_OTHERS = (
    "",
    "    ! CONST robtarget pOld:=[[1,2,3],[1,0,0,0],[0,0,0,0],[9E9,9E9,9E9,9E9,9E9,9E9]];",
    '    VAR string sText:="[[1,2,3],[1,0,0,0]] ; ! no comment ""quoted""";',
    "    CONST speeddata vSlow:=[50,500,5000,1000];",
    "    PERS pose peShift:=[[10,0,0],[1,0,0,0]];",
    "    VAR num nCount:=0;",
    "    VAR robtarget pRun;",
    "    VAR robtarget pList{20};",
    "    PERS loaddata load1:=[5,[0,0,50],[1,0,0,0],0,0,0];",
    "    VAR robtarget pTaken{3}:=[p1,p2,[[1,2,nCount*(2+1)],[1,0,0,0],[0,0,0,0],[9E9,9E9,9E9,9E9,9E9,9E9]]];",
    "    VAR robtarget pAlso:=p1;",
    "    CONST robtarget pT\xfcr:=[[100,20,5],[1,0,0,0],[0,0,0,0],[9E9,9E9,9E9,9E9,9E9,9E9]];",
    "    CONST robtarget pSum:=[[100+5,0,0],[1,0,0,0],[0,0,0,0],[9E9,9E9,9E9,9E9,9E9,9E9]];",
)
_FRAMES = (
    "    PERS tooldata tGrip:=[TRUE,[[0,0,180.5],[0.70711,0,0.70711,0]],[5,[0,0,50],[1,0,0,0],0,0,0]];",
    '    TASK PERS wobjdata wTable:=[FALSE,TRUE,"",[[1000,-200.5,500],[1,0,0,0]],[[0,0,20],[0,0,0,1]]];',
    '    PERS wobjdata wTurn:=[FALSE,FALSE,"STN_1",[[0,0,0],[1,0,0,0]],[[0,0,0],[1,0,0,0]]];',
    '    PERS wobjdata wHeld:=[TRUE,TRUE,"",[[0,0,0],[1,0,0,0]],[[0,0,0],[1,0,0,0]]];',
    "    PERS tooldata tFixed:=[FALSE,[[900,0,700],[1,0,0,0]],[5,[0,0,50],[1,0,0,0],0,0,0]];",
)
_STATEMENTS = (
    "        ! MoveL [[1,2,3],[1,0,0,0],[0,0,0,0],[9E9,9E9,9E9,9E9,9E9,9E9]],v100,fine,tool0;",
    "        MoveL Offs(p1,0,0,100),v500,z10,tGrip\\WObj:=wTable;",
    "        MoveJ RelTool(p1,0,0,-20\\Rz:=15),v500,z10,tGrip;",
    "        MoveL *,v1000,z50,tool0;",
    "        MoveL p1,v500,z10,tGrip, \\WObj:=wTable;",
    "        MoveJ Offs(RelTool(p1,0,0,5),1,2,3),\\ID:=1,v500,z10,tGrip\\WObj?WObj;",
    "        MoveL pT\xfcr,v500,z10,cell.tGrip\\WObj:=cell.wTable;",
    "        pRun:=Offs(p1,0,0,5);",
    "        PDispOn \\Rot,p1,tGrip;",
    "        PDispOff;",
    "        EOffsSet eax1;",
    "        pRun:=CRobT(\\Tool:=tGrip\\WObj:=wTable);",
    "        p1.trans.z:=p1.trans.z+10;",
    "        Set doGrip;",
    "        IF diReady=1 THEN",
    "        ENDIF",
    '        TPWrite "MoveL p1; [[1,2,3]]";',
    "        nCount:=nCount+1;",
    "        SearchL diTouch,pRun,p1,v20,tGrip\\WObj:=wTable;",
    "        ConfL\\Off;",
    "        WaitTime 0.5;",
)


def generate(seed: int) -> bytes:
    """Return one module."""
    rng = np.random.default_rng([seed, 13])
    lines = ["%%%", "  VERSION:1", "  LANGUAGE:ENGLISH", "%%%", ""] if rng.random() < 0.4 else []
    lines.append(f"MODULE Teil_{seed}" + (" (SYSMODULE, NOSTEPIN)" if rng.random() < 0.2 else ""))
    lines += [line for line in _FRAMES if rng.random() < 0.4]
    targets: list[str] = []
    axes: list[str] = []
    for number in range(1, int(rng.integers(2, 12))):
        lines += _declarations(rng, number, targets, axes)
        odd = _OTHERS[int(rng.integers(len(_OTHERS)))]
        if not odd.strip() or odd not in lines:
            lines.append(odd)
    lines.append("    PROC main()")
    for _ in range(int(rng.integers(2, 20))):
        if rng.random() < 0.65:
            lines.append(_move_instruction(rng, targets, axes))
        else:
            lines.append(_STATEMENTS[int(rng.integers(len(_STATEMENTS)))])
    lines += ["    ENDPROC", *_second_routine(rng), "ENDMODULE"]
    end = "\n" if rng.random() < 0.3 else "\r\n"
    return ("\n".join(lines) + "\n").replace("\n", end).encode("latin-1")


def _second_routine(rng: np.random.Generator) -> list[str]:
    if rng.random() < 0.6:
        return []
    return [
        "    LOCAL PROC rOwn(num nWhich)",
        f"        CONST robtarget p1:={_robtarget_text(rng)};",
        "        MoveL p1,v100,fine,tool0;",
        "    ERROR",
        "        RETRY;",
        "    ENDPROC",
    ]


def _declarations(rng: np.random.Generator, number: int, targets: list[str], axes: list[str]) -> list[str]:
    storage = ("CONST", "PERS", "VAR", "LOCAL CONST", "TASK PERS", "const")[int(rng.integers(6))]
    kind = int(rng.integers(8))
    if kind == 0:
        axes.append(f"jp{number}")
        return [f"    {storage} jointtarget jp{number}:={_external_axes_text(rng)};"]
    if kind == 1:
        size = int(rng.integers(1, 4))
        targets.append(f"ar{number}{{{int(rng.integers(1, size + 1))}}}")
        body = ",\n        ".join(_robtarget_text(rng) for _ in range(size))
        return [f"    {storage} robtarget ar{number}{{{size}}}:=[{body}];"]
    if kind == 2:
        rows = ",".join("[" + ",".join(_robtarget_text(rng) for _ in range(2)) + "]" for _ in range(2))
        return [f"    CONST robtarget mx{number}{{2,2}}:=[{rows}];"]
    if kind == 3:
        targets.append(f"P{number}")
        return [f"    {storage} RobTarget p{number} := ! taught\n      {_robtarget_text(rng, broken=True)} ;"]
    targets.append(f"p{number}")
    return [f"    {storage} robtarget p{number}:={_robtarget_text(rng)};"]


def _move_instruction(rng: np.random.Generator, targets: list[str], axes: list[str]) -> str:
    kind = int(rng.integers(10))
    tool = ("tGrip", "tool0", "TGRIP", "tFixed")[int(rng.choice(4, p=[0.5, 0.25, 0.2, 0.05]))]
    frame = ("", "\\WObj:=wTable", " \\WObj := wobj0", "\\wobj:=wHeld")[
        int(rng.choice(4, p=[0.3, 0.4, 0.25, 0.05]))
    ]
    to = targets[int(rng.integers(len(targets)))] if targets and kind < 5 else _robtarget_text(rng)
    target = _robtarget_text(rng)
    moves = (
        f"MoveAbsJ {axes[0] if axes else _external_axes_text(rng)}\\NoEOffs,v1000,fine,{tool};",
        f"MoveC {to}, {target},\n          v500,z10,{tool}{frame};",
        f"MoveLDO {to},v500,z10,{tool}{frame},doGun,1;",
        f"ArcL {to},v100,seam1,weld1\\Weave:=weave1,fine,{tool}{frame};",
        f"MoveL\\Conc,{to},[200,500,5000,1000],z10,{tool}{frame};",
        *[f"Move{'LJ'[kind % 2]} {to},v1000\\T:=2,fine\\Inpos:=inpos50,{tool}{frame};"] * 4,
        f"MoveAbsJ {_external_axes_text(rng)},v1000,z50,tool0;",
    )
    return "        " + moves[kind]


def _robtarget_text(rng: np.random.Generator, *, broken: bool = False) -> str:
    place = ",".join(_format_number(rng, value) for value in rng.uniform(-2000, 2000, 3))
    flags = ",".join(str(int(value)) for value in [*rng.integers(-3, 3, 3), rng.integers(0, 8)])
    external = _EXTERNAL[int(rng.integers(len(_EXTERNAL)))]
    comma = (",\n     ! orientation [ follows\n     " if broken else ",") if rng.random() < 0.9 else " , "
    body = comma.join([f"[{place}]", f"[{_quaternion_text(rng)}]", f"[{flags}]", external])
    return f"[{body}]" if rng.random() < 0.9 else f"[ {body} ]"


def _quaternion_text(rng: np.random.Generator) -> str:
    kind = int(rng.integers(5))
    if kind == 0:
        return ("1,0,0,0", "0,0,1,0", "0,-1,0,0", "0.7071,0,0.7071,0")[int(rng.integers(4))]
    values = rng.normal(size=4)
    values /= np.linalg.norm(values)
    digits = (9, 6, 5, 4)[kind - 1]
    texts = [f"{value:.{digits}f}" for value in values]
    if rng.random() < 0.3:
        texts[int(np.argmin(np.abs(values)))] = f"{values[int(np.argmin(np.abs(values)))]:.6E}"
    return ",".join(texts)


def _external_axes_text(rng: np.random.Generator) -> str:
    texts = [_format_number(rng, value) for value in rng.uniform(-170, 170, 6)]
    if rng.random() < 0.15:
        texts[4:] = ["9E9", "9E+09"]
    return f"[[{','.join(texts)}],{_EXTERNAL[int(rng.integers(len(_EXTERNAL)))]}]"


def _format_number(rng: np.random.Generator, value: float) -> str:
    texts = (
        "0",
        str(round(value)),
        f"{value:.1f}",
        f"{value:.2f}",
        f"{value:.6f}",
        f"{value * 1e-5:.6E}",
        f"{value % 1:.3f}".lstrip("0") or ".5",
        f"{value:.9g}",
    )
    return texts[int(rng.integers(len(texts)))]
