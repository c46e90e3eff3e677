"""FANUC listings with every oddity of the grammar, from a seed."""

import numpy as np

SUFFIX = ".ls"

_ENGLISH = """/ATTR
OWNER\t\t= MNEDITOR;
COMMENT\t\t= "{comment}";
PROG_SIZE\t= {size};
CREATE\t\t= DATE 24-03-{day:02d}  TIME 10:11:12;
MODIFIED\t= DATE 25-03-{day:02d}  TIME 10:11:{day:02d};
FILE_NAME\t= ;
VERSION\t\t= 0;
LINE_COUNT\t= {lines};
MEMORY_SIZE\t= {size};
PROTECT\t\t= READ_WRITE;
TCD:  STACK_SIZE\t= 0,
      TASK_PRIORITY\t= 50,
      TIME_SLICE\t= 0,
      BUSY_LAMP_OFF\t= 0,
      ABORT_REQUEST\t= 0,
      PAUSE_REQUEST\t= 0;
DEFAULT_GROUP\t= 1,*,*,*,*;
CONTROL_CODE\t= 00000000 00000000;
"""
_GERMAN = """/ATTR
EIGN.\t\t= MNEDITOR;
KOMMENTAR\t= "{comment}";
PROG_GRÖßE\t= {size};
ERSTELL\t\t= TAG 10-07-{day:02d}  ZEIT 16:38:32;
GEÄNDERT\t= TAG 17-03-{day:02d}  ZEIT 18:30:48;
DATEI_NAME\t= EQPRGAPC;
VERSION\t\t= 0;
ZEILEN\t\t= {lines};
SPEICHERGR.\t= {size};
SCHUTZ\t\t= LESEN_SCHREIB;
TCD:  STACK_GRÖßE\t= 0,
      TASK_PRIORITY\t= 50,
      ZEITSCHEIBE\t= 0;
DEFAULT_GRUP\t= 1,*,*,*,*;
KONTROLLCODE\t= 00000000 00000000;
"""
_APPLICATIONS = (
    "/APPL\n",
    "/APPL\n\nAUTO_SINGULARITY_HEADER;\n  ENABLE_SINGULARITY_AVOIDANCE   : TRUE;\n",
    "/APPL\n  SPOT : TRUE ; \n  SPOT Welding Equipment Number : 1 ;\n/APPL\n",
    "",
)
_STATEMENTS = (
    "  !PICK UP ;", "  UFRAME_NUM=1 ;", "  UTOOL_NUM=R[3] ;", "  CALL GRIP    ;", "  WAIT    .30(sec) ;", "   ;",
    "  //CALL EQTCHPOS('MOTN035',1,1,(-3)) ;", "  PR[7,3]=PR[7,3]+40    ;", "  R[5:Offset X]=R[5:Offset X]+1    ;",
    "L PR[9:Home] 100mm/sec FINE    ;", "  IF R[1]=2,JMP LBL[9] ;", "  A[718]=AN ;", "  AUFRUF EQSTART    ;",
    "  OFFSET CONDITION PR[3]    ;", "//J P[99] 100% FINE    ;", "  DO[76]=ON ;", "L P[R[4]] 500mm/sec CNT50    ;",
    "  VISION GET_OFFSET 'CAM' VR[1] JMP LBL[3] ;", "  $SSR.$SINGLESTEP=R[819] ;", "  SKIP CONDITION DI[1]=ON    ;",
    "  PR[GP1:7,3:Offset]=R[2:INC]    ;",
)  # fmt: skip
_MOVES = (
    "J P[{n}] 100% FINE    ;",
    "L P[{n}:über] 500mm/sec CNT100 Offset,PR[1]    ;",
    "L P[{n}] R[2]mm/sek CNT0 ACC100    ;",
    "J P[{n}] 100% CNT0 ACC100 TB    .10sec,P-SPS    ;\n      1:  TC_ONLINE (ON) ;\n      2:  !x ;\n       ------ ;",
    "C P[{n}]    \n    :  P[{n}] 300mm/sec CNT10    ;",
    "L P[{n}] 100mm/sec FINE Tool_Offset,PR[26] INC    ;",
    "L P[{n}] 50mm/sec FINE Skip,LBL[2],PR[99]=LPOS    ;",
)


def generate(seed: int) -> bytes:
    """Return one listing: 1 to 9 positions, one in 40 with hundreds."""
    rng = np.random.default_rng([seed, 19])
    count = int(rng.integers(150, 400)) if seed % 40 == 39 else int(rng.integers(1, 10))
    german = bool(rng.random() < 0.25)
    numbers = np.sort(rng.choice(np.arange(1, 4 * count + 1), size=count, replace=False)).tolist()
    if rng.random() < 0.2:
        rng.shuffle(numbers)
    writer = _PositionWriter(rng, german)
    records = [writer.position_record(number) for number in numbers]
    body = _statement_lines(rng, numbers)
    attributes = (_GERMAN if german else _ENGLISH).format(
        comment=_pick_one(rng, ["", "Tomar en ST1540", "Führung öffnen", "A;B /POS"]),
        size=int(rng.integers(300, 9000)),
        day=int(rng.integers(1, 28)),
        lines=body.count("\n"),
    )
    kind = _pick_one(rng, ["", "\t  Macro", "\t  Cond", "  Process"])
    head = f"/PROG  TEST{seed}{kind}\n{attributes}{_pick_one(rng, _APPLICATIONS)}/MN\n{body}"
    text = f"{head}/POS\n{''.join(records)}/END\n"
    return _encode_text(rng, text)


def _encode_text(rng: np.random.Generator, text: str) -> bytes:
    data = text.encode("cp850" if rng.random() < 0.5 else "cp437", errors="replace")
    ending = int(rng.integers(5))
    if ending == 0:
        return data.replace(b"\n", b"\r\n")
    if ending == 1:  # mixed
        lines = data.split(b"\n")
        return b"".join(line + (b"\r\n", b"\n")[int(rng.integers(2))] for line in lines[:-1]) + lines[-1]
    if ending == 2:
        return data.rstrip(b"\n")
    if ending == 3:
        return data + b"\r\n\x1a"
    return data


def _statement_lines(rng: np.random.Generator, numbers: list[int]) -> str:
    lines = []
    for number in numbers:
        if rng.random() < 0.9:
            lines.append(_pick_one(rng, _MOVES).format(n=number))
        if rng.random() < 0.5:
            lines.append(_pick_one(rng, _STATEMENTS))
    return "".join(f"{i:4d}:{line}\n" for i, line in enumerate(lines, start=1))


class _PositionWriter:
    """Writes records the way one controller, or one generator of programs, does."""

    def __init__(self, rng: np.random.Generator, german: bool) -> None:
        self.rng = rng
        self.keyword = "KONFIG" if german else "CONFIG"
        self.digits = int(rng.choice([3, 3, 3, 3, 0, 1, 2, 4, 6, 8]))
        self.style = _pick_one(rng, ["controller"] * 6 + ["plain", "tight"])
        self.groups = int(rng.choice([1, 1, 1, 2, 4]))
        self.extended = _pick_one(rng, [[], [], [], ["mm"], ["deg", "mm"], ["mm", "mm", "deg"]])
        self.scara = bool(rng.random() < 0.08)
        self.prefix = "R" if rng.random() < 0.05 else ""  # of a tool that stands in the cell

    def position_record(self, number: int) -> str:
        name = _pick_one(self.rng, ["", "", "", ':"Safe pos"', ':""', ':"übÄr {}; P[1]"'])
        blocks = [self._group_text(group) for group in range(1, self.groups + 1)]
        gap = "\n" if self.style == "plain" else ""
        return f"P[{number}{name}]{{\n{''.join(blocks)}{gap}}};\n"

    def _group_text(self, group: int) -> str:
        if group > 1:
            return self._joint_form(
                group, [_pick_one(self.rng, ["mm", "deg"])] * int(self.rng.integers(1, 3))
            )
        chance = self.rng.random()
        if chance < 0.12:
            return self._joint_form(1, ["deg"] * 6)
        return self._cartesian_text(taught=chance < 0.9)

    def _cartesian_text(self, *, taught: bool) -> str:
        rng = self.rng
        frames = f"UF : {_frame_text(rng)}, UT : {_frame_text(rng)}" if taught else "UF : F, UT : F"
        config = self._configuration_text() if taught else _pick_one(rng, ["", "N D B, 0, 0, 0"])
        place = rng.normal(size=3) * _pick_one(rng, [1500.0, 1500.0, 0.3, 1e-4])
        angles = rng.uniform([-180, -90, -180], [180, 90, 180])
        angles = np.where(rng.random(3) < 0.2, _pick_one(rng, [0.0, 180.0, -180.0, 90.0, -90.0]), angles)
        if rng.random() < 0.1:
            angles[1] = _pick_one(rng, [90.0, -90.0, 89.9999, -89.999])
        texts = [self._format_number(v) if taught else " ********" for v in (*place, *angles)]
        units = [" mm"] * 3 + ["deg"] * 3
        names = [self.prefix + name for name in "XYZWPR"]
        words = [f"{n} ={t} {u}" for n, t, u in zip(names, texts, units, strict=True)]
        words += self._extended_axes(taught=taught)
        lines = [words[i : i + 3] for i in range(0, len(words), 3)]
        text = ",\n".join("\t" + ",\t".join(line) for line in lines)
        return self._tighten_spacing(f"   GP1:\n\t{frames},\t\t{self.keyword} : '{config}',\n{text}\n")

    def _extended_axes(self, *, taught: bool) -> list[str]:
        return [
            f"E{i}={self._format_number(self.rng.normal() * 900) if taught else ' ********'} {unit:>3}"
            for i, unit in enumerate(self.extended, start=1)
        ]

    def _joint_form(self, group: int, units: list[str]) -> str:
        values = [self._format_number(v) for v in self.rng.uniform(-175, 175, len(units))]
        if self.rng.random() < 0.08:
            values = [" ********"] * len(units)
        words = [f"J{i}={v} {u:>3}" for i, (v, u) in enumerate(zip(values, units, strict=True), start=1)]
        words += self._extended_axes(taught=True) if group == 1 else []
        lines = [words[i : i + 3] for i in range(0, len(words), 3)]
        text = ",\n".join("\t" + ",\t".join(line) for line in lines)
        return self._tighten_spacing(f"   GP{group}:\n\tUF : 0, UT : {_frame_text(self.rng)},\t\n{text}\n")

    def _configuration_text(self) -> str:
        rng = self.rng
        if self.scara:
            return _pick_one(rng, ["R, 0, 0, 0", "L, 0, 0, 0"])
        letters = " ".join(_pick_one(rng, pair) for pair in ("NF", "UD", "TB"))
        turns = ", ".join(str(int(turn)) for turn in rng.choice([0, 0, 0, 1, -1, 2], size=3))
        return f"{letters}, {turns}"

    def _format_number(self, value: float) -> str:
        """Return the blanks after "=" and the number."""
        text = f"{value:.{self.digits}f}"
        if self.style != "controller":
            return text if self.style == "tight" else " " + text
        if value != 0.0 and self.digits:
            sign, digits = ("-", text[1:]) if text.startswith("-") else ("", text)
            text = sign + (digits[1:] if digits.startswith("0.") else digits)
        return " " + text.rjust(6 + self.digits)

    def _tighten_spacing(self, text: str) -> str:
        return text.replace(" : ", ":").replace("\t", "") if self.style == "tight" else text


def _frame_text(rng: np.random.Generator) -> str:
    return _pick_one(rng, ["0", "1", "1", "2", "9", "10", "F"])


def _pick_one(rng, choices):
    return choices[int(rng.integers(len(choices)))]
