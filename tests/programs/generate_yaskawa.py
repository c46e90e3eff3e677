"""Yaskawa jobs with every oddity that controllers, posts and people put into them."""

import numpy as np

SUFFIX = ".jbi"

_INSTRUCTIONS = (
    "DOUT OT#(5) ON",
    "TIMER T=1.00",
    "'MOVL C00000 V=1.0 is a remark",
    "*LABEL_1",
    "JUMP *LABEL_1 IF IN#(3)=ON",
    "CALL JOB:GRIP IF B001=1",
    "SET B000 1",
    "ARCON AC=100 AVP=100 T=0.50 V=80.0",
    "MOVL P[I001] V=100.0",
    "SETTOOL TL#(1) P095",
    "MFRAME UF#(1) PX000 PX001 PX002",
    "IMOV P091 V=50.0 RF",
    "SFTOF",
    "     ",
    "\t'a tab",
    "/ no division",
    "COMM MOVJ P000 VJ=1.00",
)
_COMMENTS = ("", "1ER PROGRAM POUR VERIFIER LE TCP", "\xe9\xe8 \x83v\x83\x8d\x83O", "'quoted'")


def generate(seed: int) -> bytes:
    """Return a whole, valid job file."""
    rng = np.random.default_rng([seed, 31])
    jobs = 1 if rng.random() < 0.9 else 2
    ending = "\r\n" if rng.random() < 0.7 else "\n"
    text = "".join(_job_text(rng, f"JOB{seed}_{i}", ending) for i in range(jobs))
    if rng.random() < 0.1:
        text = f"'PP version: 1.2{ending}" + text
    return (text if rng.random() < 0.9 else text[: -len(ending)]).encode("latin-1")


class _JobWriter:
    def __init__(self, rng: np.random.Generator) -> None:
        self.rng = rng
        self.lines: list[str] = []
        self.counts = dict.fromkeys(("C", "BC", "EC", "P", "BP", "EX"), 0)
        self.taught: list[str] = []

    def is_chosen(self, share: float) -> bool:
        return bool(self.rng.random() < share)

    def one_of(self, *choices: str) -> str:
        return choices[int(self.rng.integers(len(choices)))]


def _job_text(rng: np.random.Generator, name: str, ending: str) -> str:
    make = _JobWriter(rng)
    count = int(rng.integers(0, 12))
    _write_positions(make, count)
    counts = [str(make.counts[kind]) for kind in ("C", "BC", "EC", "P", "BP", "EX")]
    head = ["/JOB", f"//NAME {name}", "//POS", f"///NPOS {','.join(counts)}"]
    arguments = (
        ["//ARGINFO", "///ARGTYPE B,,,,,,,", "///COMMENT", "what it is", ""] if make.is_chosen(0.1) else []
    )
    lines = [*head, *make.lines, *arguments, "//INST", "///DATE 2012/04/25 14:11"]
    if make.is_chosen(0.8):
        lines.append(
            f"///COMM {make.one_of(*_COMMENTS)}".rstrip() if make.is_chosen(0.5) else "///COMM A  B "
        )
    relative = make.is_chosen(0.3)
    lines.append("///ATTR SC,RW,RJ" if relative else "///ATTR SC,RW")
    if relative:
        lines.append(f"////FRAME USER {rng.integers(1, 63)}")
    lines.append("///GROUP1 RB1,BS1" if make.counts["BC"] else "///GROUP1 RB1")
    if make.counts["EC"]:
        lines.append("///GROUP2 ST1")
    if make.is_chosen(0.2):
        lines.append("///LVARS 5,30,50,0,0,0,0,0")
    lines.append("NOP")
    for taught in make.taught:
        lines += [_move_instruction(make, taught)] if make.is_chosen(0.9) else []
        if make.is_chosen(0.2):
            lines.append(make.one_of(*_INSTRUCTIONS[:9], *_INSTRUCTIONS[12:15]))
    if make.counts["P"] and make.is_chosen(0.6):
        lines += ["SFTON P090 BF", "SETE P090 (1) 100", "SFTOF"]
    if make.is_chosen(0.2):
        lines += list(_INSTRUCTIONS[9:13])
    lines.append("END")
    return ending.join([*lines, ""])


def _write_positions(make: _JobWriter, count: int) -> None:
    numbers = sorted(make.rng.choice(60, size=count, replace=False).tolist())
    shared = int(make.rng.integers(0, count + 1))
    make.lines.append(f"///TOOL {make.rng.integers(0, 64)}" if make.is_chosen(0.9) else "'no tool")
    with_base, with_station = make.is_chosen(0.2), make.is_chosen(0.2)
    for part, kind in ((numbers[:shared], "C"), (numbers[shared:], "P")):
        digits = 5 if kind == "C" or make.is_chosen(0.7) else 4
        mode = ""
        for number in part:
            if not mode or make.is_chosen(0.2):
                mode = _pick_mode(make)
            name = f"{kind}{number:0{digits}d}"
            make.lines.append(f"{name}={_numbers_text(make, mode)}")
            make.counts[kind] += 1
            make.taught.append(f"{kind}{number:05d}" if kind == "C" else f"P{number:03d}")
    if shared and with_base:
        make.lines += ["///POSTYPE BASE", "///RECTAN"]
        _write_variables(make, "BC", numbers[:shared], lambda: f"{make.rng.normal() * 500:.3f}")
    if shared and with_station:
        make.lines += ["///POSTYPE PULSE", "///PULSE"]
        _write_variables(make, "EC", numbers[:shared], lambda: str(make.rng.integers(-90000, 90000)))
    if make.is_chosen(0.3):
        make.lines += ["///POSTYPE ROBOT", "///RECTAN", "///RCONF 0,0,0,0,0,0,0,0"]
        make.lines.append("P00090=0.000,0.000,-25.000,0.00,0.00,0.00")
        make.counts["P"] += 1


def _write_variables(make: _JobWriter, kind: str, numbers: list[int], value) -> None:
    for number in numbers:
        if make.is_chosen(0.9):
            make.lines.append(
                f"{kind}{number:05d}={','.join(value() for _ in range(1 + make.is_chosen(0.3)))}"
            )
            make.counts[kind] += 1


def _pick_mode(make: _JobWriter) -> str:
    kind = make.one_of("PULSE", "RECTAN", "RECTAN", "RECTAN", "ANGLE")
    postype = kind if kind != "RECTAN" else make.one_of("BASE", "ROBOT", "USER", "USER")
    if postype == "USER":
        make.lines.append(f"///USER {make.rng.integers(0, 64)}")
    elif make.is_chosen(0.1):
        make.lines.append(f"///TOOL {make.rng.integers(0, 64)}")
    make.lines += [f"///POSTYPE {postype}", f"///{kind}" + (" " if make.is_chosen(0.1) else "")]
    if kind == "RECTAN":
        flags = [str(int(flag)) for flag in make.rng.integers(0, 2, size=6)]
        make.lines.append(f"///RCONF {','.join(flags + ['0'] * (int(make.rng.choice([6, 8, 24])) - 6))}")
    return kind


def _numbers_text(make: _JobWriter, mode: str) -> str:
    rng = make.rng
    gap = make.one_of(",", ",", ",", ", ")
    if mode == "PULSE":
        return gap.join(str(n) for n in rng.integers(-150_000, 150_000, size=6)) + (" " * (gap == ", "))
    if mode == "ANGLE":
        return gap.join(f"{v:.4f}" for v in rng.normal(size=6) * 60)
    place, angle = rng.normal(size=3) * 800, rng.uniform(-180, 180, size=3)
    if make.is_chosen(0.1):
        angle[1] = float(rng.choice([90.0, -90.0, 0.0]))
    style = int(rng.integers(6))
    digits = 2 if style == 1 else 4
    texts = [f"{v:.3f}" for v in place] + [f"{v:.{digits}f}" for v in angle]
    if style == 2:
        texts = ["0.000", "-0.000", *texts[2:3], "180.0000", "0.0000", "-180.0000"]
    elif style == 3:
        texts = [*texts[:3], "180", "0", "0"]
    elif style == 4:
        texts = [f"{v:.6f}" for v in (*place, *angle)]
    elif style == 5 and make.is_chosen(0.3):
        texts.append(f"{rng.normal() * 50:.4f}")
    return gap.join(texts)


def _move_instruction(make: _JobWriter, taught: str) -> str:
    kind = make.one_of("MOVJ", "MOVL", "MOVL", "MOVC", "MOVS")
    speed = "VJ=25.00" if kind == "MOVJ" else "V=375.0"
    with_station = taught.startswith("C") and make.counts["EC"] and make.is_chosen(0.3)
    extra = f" +MOVJ EC{taught[1:]}" if with_station else make.one_of("", " PL=0", " ACC=50 DEC=50")
    return f"{kind} {taught} {speed}{extra}"
