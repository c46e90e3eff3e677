"""KUKA data lists with every oddity that controllers, editors and people put into them."""

import numpy as np

SUFFIX = ".dat"

_HEADER = (
    "&ACCESS RVP",
    "&REL 27",
    "&COMMENT Greifer {X 1.0} \xfcber Band",
    r"&PARAM TEMPLATE = C:\KRC\Roboter\Template\vorgabe",
    r"&PARAM EDITMASK = *",
)
_FOLDS = (
    ";FOLD EXTERNAL DECLARATIONS;%{PE}%MKUKATPBASIS,%CEXT,%VCOMMON,%P",
    ";FOLD BASISTECH EXT;%{PE}%MKUKATPBASIS,%CEXT,%VEXT,%P",
    "EXT  BAS (BAS_COMMAND  :IN,REAL  :IN )",
    "DECL INT SUCCESS",
    ";ENDFOLD (BASISTECH EXT)",
    ";ENDFOLD (EXTERNAL DECLARATIONS)",
)
_OTHERS = (
    "",
    "   ",
    "; ----------------------------",
    ";DECL E6POS XOLD={X 1.0,Y 2.0,Z 3.0,A 0.0,B 0.0,C 0.0,S 2,T 2} nicht mehr",
    "DECL PDAT PPDAT1={VEL 100.000,ACC 100.000,APO_DIST 100.000,APO_MODE #CPTP,GEAR_JERK 50.0000,EXAX_IGN 0}",
    "DECL LDAT LCPDAT1={VEL 2.00000,ACC 100.000,APO_DIST 100.000,ORI_TYP #VAR,CIRC_TYP #BASE,"
    "CB {AUX_PT {ORI #CONSIDER,E1 #CONSIDER},TARGET_PT {ORI #INTERPOLATE,E1 #INTERPOLATE}}}",
    'DECL MODULEPARAM_T LAST_TP_PARAMS={PARAMS[] "Kuka.PointName=P7; {X 1.0,Y 2.0} ; Kuka.blend=1"}',
    'DECL CHAR TEXT[]="}{; DECL E6POS XP1={X 0,Y 0"',
    "DECL REAL RSPEED=0.25",
    "INT  ICOUNT = 7   ; Z\xe4hler",
    "DECL INT NOS[5]",
    "NOS[1]=4",
    "DECL stPart PART1={POINT {X 1.0,Y 2.0,Z 3.0,A 0.0,B 0.0,C 0.0},N 3}",
    "DECL FRAME SHIFT={X 0.0,Y 0.0,Z 100.0,A 0.0,B 0.0,C 0.0}",
    "DECL E6POS XLATER",
    "decl e6pos xNever, xNever2",
    "TOOL_DATA[3]={X 12.5,Y 0.0,Z 180.25,A 0.0,B -45.0,C 0.0}",
    "BASE_DATA[ 4 ]={X 1500.0,Y -200.5,Z 812.0,A 90.0,B 0.0,C 0.0}",
    'TOOL_NAME[3,]="Zange {1}"',
    "IMPORT E6POS XFROM IS /R1/Module/TEIL_1..XP1",
)


def generate(seed: int) -> bytes:
    """Return one data list."""
    rng = np.random.default_rng([seed, 11])
    lines = [f"DEFDAT  TEIL_{seed} PUBLIC", *_FOLDS]
    if rng.random() < 0.7:
        lines = [*_HEADER[: int(rng.integers(1, len(_HEADER) + 1))], *lines]
    used: set[str] = set()
    for number in range(1, int(rng.integers(2, 14))):
        lines += _point_lines(rng, number)
        odd = _OTHERS[int(rng.integers(len(_OTHERS)))]
        if odd not in used or not odd.startswith(("DECL", "decl")):
            lines.append(odd)
            used.add(odd)
    if "DECL E6POS XLATER" in used and rng.random() < 0.5:
        lines.append("XLATER=" + pose_text(rng))
    if rng.random() < 0.4:
        lines += _array_lines(rng)
    lines.append("ENDDAT")
    end = "\n" if rng.random() < 0.2 else "\r\n"
    text = end.join(lines) + (end if rng.random() < 0.8 else "")
    return text.encode("latin-1")


def _point_lines(rng: np.random.Generator, number: int) -> list[str]:
    kind = int(rng.integers(12))
    name = f"P{number}"
    if kind == 0:
        lines = [f"DECL E6AXIS X{name}={axes_text(rng)}"]
    elif kind == 1:
        lines = [f"DECL AXIS X{name}={axes_text(rng, external=False)}"]
    elif kind == 2:
        lines = [f"DECL GLOBAL E6POS X{name} = {pose_text(rng)}  ; global"]
    elif kind == 3:
        lines = [f"GLOBAL POS  X{name}={pose_text(rng, external=False)}"]
    elif kind == 4:
        lines = [f"decl frame x{name.lower()}={pose_text(rng, state=False, external=False)}"]
    elif kind == 5:
        lines = [f"DECL E6POS X{name}={pose_text(rng)},XQ{number}={pose_text(rng)}"]
    elif kind == 6:
        lines = [f"DECL E6POS X{name}={{X 1.0,Y 2.0,Z 3.0}}"]
    elif kind == 7:
        lines = [f"DECL E6POS X{name}", f"X{name}={pose_text(rng)}"]
    elif kind in (8, 9):
        lines = [
            f"DECL E6POS X{name}={pose_as_printed(rng)}",
            f"DECL LDAT LC{name}={{VEL 2.0,ACC 100.0,ORI_TYP #VAR}}",
        ]
    else:
        lines = [f"DECL E6POS X{name}={pose_text(rng)}"]
    if rng.random() < 0.75:
        lines.append(_frame_data(rng, name))
    return lines


def _frame_data(rng: np.random.Generator, name: str) -> str:
    frame = "#TCP" if rng.random() < 0.1 else "#BASE"
    tail = (",TQ_STATE FALSE", "", ',POINT2[] "XP{2}"')[int(rng.integers(3))]
    tool, base = int(rng.integers(-1, 17)), int(rng.integers(-1, 33))
    middle = f"TOOL_NO {tool},BASE_NO {base},IPO_FRAME {frame}" + (
        ',POINT2[] " "' if "POINT" not in tail else ""
    )
    return f"DECL FDAT F{name}={{{middle}{tail}}}"


def _array_lines(rng: np.random.Generator) -> list[str]:
    size = int(rng.integers(1, 5))
    return [f"DECL E6POS XARR[{size}]", *(f"XARR[{i + 1}]={pose_text(rng)}" for i in range(size))]


def pose_text(rng: np.random.Generator, *, state: bool = True, external: bool = True) -> str:
    kind = "E6POS" if external else "POS" if state else "FRAME"
    values = [*rng.uniform(-2500, 2500, 3), *rng.uniform(-180, 180, 3)]
    names = [*"XYZABC"]
    texts = [_format_number(rng, value) for value in values]
    if state and rng.random() < 0.85:
        names += ["S", "T"]
        texts += [_flags_text(rng, 3), _flags_text(rng, 6)]
    if external and rng.random() < 0.8:
        count = int(rng.choice([6, 6, 6, 1, 2]))
        names += [f"E{i + 1}" for i in range(count)]
        texts += [
            "0.0" if rng.random() < 0.7 else _format_number(rng, rng.uniform(-900, 900)) for _ in range(count)
        ]
    return _struct_text(rng, kind, names, texts)


def pose_as_printed(rng: np.random.Generator) -> str:
    """Return a pose as controllers print it, with this one's number of decimals."""
    decimals = int(rng.integers(1, 8))
    values = [*rng.uniform(-2500, 2500, 3), *rng.uniform(-180, 180, 3)]
    texts = ["0.0" if rng.random() < 0.1 else f"{value:.{decimals}f}" for value in values]
    struct = ",".join(f"{name} {text}" for name, text in zip("XYZABC", texts, strict=True))
    axes = "".join(f",E{i + 1} {0.0 if i else rng.choice([0.0, 812.5])}" for i in range(6))
    return f"{{{struct},S {rng.integers(8)},T {rng.integers(64)}{axes}}}"


def axes_text(rng: np.random.Generator, *, external: bool = True) -> str:
    names = [f"A{i + 1}" for i in range(6)]
    texts = [_format_number(rng, value) for value in rng.uniform(-170, 170, 6)]
    if external and rng.random() < 0.7:
        names += [f"E{i + 1}" for i in range(6)]
        texts += ["0.0"] * 6
    return _struct_text(rng, "E6AXIS" if external else "AXIS", names, texts)


def _struct_text(rng: np.random.Generator, kind: str, names: list[str], texts: list[str]) -> str:
    order = rng.permutation(len(names)) if rng.random() < 0.15 else np.arange(len(names))
    comma = (",", ",", ",", ", ", " , ")[int(rng.integers(5))]
    gap = " " if rng.random() < 0.9 else "  "
    case = str.lower if rng.random() < 0.1 else str
    body = comma.join(f"{case(names[i])}{gap}{texts[i]}" for i in order)
    prefix = (f"{kind}: ", f"{kind.lower()} :", "", "", "", "")[int(rng.integers(6))]
    return "{" + prefix + body + ("}" if rng.random() < 0.9 else " }")


def _flags_text(rng: np.random.Generator, bits: int) -> str:
    value = int(rng.integers(1 << bits))
    kind = int(rng.integers(8))
    if kind == 0:
        return f"'B{value:0{bits}b}'"
    return f"'H{value:X}'" if kind == 1 else str(value)


def _format_number(rng: np.random.Generator, value: float) -> str:
    exact = f"{value:.9g}"
    exact = exact if "." in exact else f"{value:.1f}"
    texts = (
        "0.0",
        str(round(value)),
        f"{value * 1e-6:.5E}",
        f"{value * 1e-4:.3e}".replace("e-0", "e-"),
        f"{value:.{int(rng.integers(1, 4))}f}",
        f"{value:+.4f}",
        exact,
        exact,
        exact,
    )
    return texts[int(rng.integers(len(texts)))]
