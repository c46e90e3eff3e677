"""A controller that saves its variables: .VA text written from the maker's layout, with drives of its own making."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

RATIOS = (229.091, 290.25, 270.176, 199.833, 197.353, 122.14)  # an R-2000iB/210F
SIGNS = (-1, -1, 1, 1, 1, 1)
COUPLING = {(4, 3): -0.009, (5, 3): -0.0098, (5, 4): -0.0099}  # of the axis that is turned along
FIXTURE_DEG = (0.0, 24.6528, -94.2241, 0.0, -85.7759, 0.0)


@dataclass
class VariablesController:
    """What a controller holds; ``save_variables`` writes it."""

    counts: list[int] = field(
        default_factory=lambda: [135258, 17407548, 16205417, 26643508, 387752, -46902634]
    )
    mastered: bool = True
    states: list[int] = field(default_factory=lambda: [2] * 6)
    ratios: Sequence[float] = RATIOS
    reference_rad: list[float] | None = None
    reference_counts: list[int] | None = None
    frames: dict[int, tuple[float, ...]] = field(default_factory=dict)
    tools: dict[int, tuple[float, ...]] = field(default_factory=dict)
    ending: str = "\r\n"
    groups: int = 2
    rail: bool = False  # a seventh axis of group 1, in mm

    def coupling_matrix(self) -> np.ndarray:
        n = len(self.ratios)
        matrix = np.diag([s * 2 * np.pi / (i * 2**19) for s, i in zip(SIGNS[:n], self.ratios, strict=True)])
        for (row, column), share in COUPLING.items():
            if row < n:
                matrix[row, column] = share * matrix[row, row]
        return matrix

    def counts_at(self, joints_rad: Sequence[float]) -> list[int]:
        """Return what the encoders read at joint angles; solved row by row, because the matrix is triangular."""
        matrix, moved = self.coupling_matrix(), []
        for row, angle in enumerate(joints_rad):
            along = sum(matrix[row, i] * moved[i] for i in range(row))
            moved.append((angle - along) / matrix[row, row])
        return [zero + round(m) for zero, m in zip(self.counts, moved, strict=True)]

    def save_variables(self, folder: Path, *, lower: bool = False) -> Path:
        folder.mkdir(parents=True, exist_ok=True)
        for name, text in (
            ("SYSMAST.VA", self.sysmast_text()),
            ("SYMOTN.VA", self.symotn_text()),
            ("SYSFRAME.VA", self.sysframe_text()),
            ("POSREG.VA", self.posreg_text()),
        ):
            data = text.replace("\n", self.ending).encode("cp437")
            (folder / (name.lower() if lower else name)).write_bytes(data)
        return folder

    def sysmast_text(self) -> str:
        lines = [f"[*SYSTEM*]$DMR_GRP  Storage: SHADOW  Access: RW  : ARRAY[{self.groups}] OF DMR_GRP_T"]
        for group in range(1, self.groups + 1):
            first = group == 1
            head = f"     Field: $DMR_GRP[{group}].$"
            counts = self.counts if first else []
            reference = (self.reference_rad or []) if first else []
            lines += [f"{head}MASTER_DONE Access: RW: BOOLEAN = {str(self.mastered or not first).upper()}"]
            lines += array_lines(f"{head}OT_MINUS", "BOOLEAN", ["FALSE"] * 9)
            lines += array_lines(f"{head}MASTER_COUN", "INTEGER", nine_lines(counts, "0"))
            lines += [f"{head}REF_DONE Access: RW: BOOLEAN = {str(first and bool(reference)).upper()}"]
            lines += array_lines(
                f"{head}REF_POS", "REAL", nine_lines([f"{v:.6e}" for v in reference], "0.000000e+00")
            )
            taken = (self.reference_counts or self.counts_at(reference)) if reference else []
            lines += array_lines(f"{head}REF_COUNT", "INTEGER", nine_lines(taken, "0"))
            lines += array_lines(
                f"{head}EACHMST_DON", "INTEGER", nine_lines(self.states if first else [2], "0")
            )
            lines += array_lines(f"{head}DSP_ST_HIS2", "INTEGER", ["Uninitialized"] * 9)
            lines += [f"{head}GRAV_MAST Access: RW: INTEGER = -1"]
        return "\n".join([*lines, "", "[*SYSTEM*]$FMS_GRP  Storage: CMOS  Access: RW  : INTEGER = 3", "", ""])

    def symotn_text(self) -> str:
        lines = ["[*SYSTEM*]$CRCFG  Storage: CMOS  Access: RW  : CRCFG_T = "]
        lines += ["   Field: $CRCFG.$GROUP_MASK Access: RW: INTEGER = 1", ""]
        lines += [f"[*SYSTEM*]$PARAM_GROUP  Storage: SHADOW  Access: RW  : ARRAY[{self.groups}] OF MRR_GRP_T"]
        for group in range(1, self.groups + 1):
            head = f"     Field: $PARAM_GROUP[{group}].$"
            ratios = list(self.ratios) if group == 1 else []
            scales = [f"{2**19 * i / 360:.6e}" for i in ratios]
            gears = [f"{1 / i:.6e}" for i in ratios]
            matrix = self.coupling_matrix() if group == 1 else np.zeros((0, 0))
            if self.rail and group == 1:
                scales, gears = [*scales, "2.184533e+04"], [*gears, "5.000000e+00"]
            n = len(scales)
            lines += array_lines(f"{head}ENCSCALES", "REAL", nine_lines(scales, "0.000000e+00"))
            fixture = [f"{v:.6e}" for v in FIXTURE_DEG] if group == 1 else []
            lines += array_lines(f"{head}MASTER_POS", "REAL", nine_lines(fixture, "0.000000e+00"))
            lines += array_lines(f"{head}MOSIGN", "BOOLEAN", ["FALSE", *["TRUE"] * 8])
            lines += array_lines(f"{head}GEAR_RATIO", "REAL", nine_lines(gears, "0.000000e+00"))
            lines += [f"{head}INTERACTION  ARRAY[9] OF INTERACT_T"]
            for i in range(1, 10):
                row = []
                for j in range(n):
                    inside = i <= len(matrix) and j < len(matrix)
                    value = matrix[i - 1, j] if inside else (4.57e-05 if i == j + 1 else 0.0)
                    row.append(f"{value:.6e}" if i <= n else "Uninitialized")
                name = f"    {head}INTERACTION[{i}].$INTERACTION"
                lines += array_lines(name, "REAL", nine_lines(row, "Uninitialized"), "          ")
        return "\n".join([*lines, ""])

    def sysframe_text(self) -> str:
        lines = ["[*SYSTEM*]$CELL_FLOOR  Storage: SHADOW  Access: RW  : POSITION = "]
        lines += [*block_lines(1, (0.0,) * 6), ""]
        for name, frames in (("$MNUFRAME", self.frames), ("$MNUTOOL", self.tools)):
            lines += [f"[*SYSTEM*]{name}  Storage: SHADOW  Access: RW  : ARRAY[{self.groups},9] OF POSITION"]
            for group in range(1, self.groups + 1):
                for n in range(1, 10):
                    values = frames.get(n, (0.0,) * 6) if group == 1 else (0.0,) * 6
                    lines += [f"    [{group},{n}] = ", *block_lines(group, values)]
            number = f"[*SYSTEM*]{name}NUM  Storage: CMOS  Access: RW  : ARRAY[{self.groups}] OF BYTE"
            lines += ["", number, *[f"      [{g}] = {g - 1}" for g in range(1, self.groups + 1)], ""]
        return "\n".join(lines)

    def posreg_text(self) -> str:
        lines = [f"[*POSREG*]$POSREG  Storage: SHADOW  Access: RW  : ARRAY[{self.groups},5] OF Position Reg"]
        lines += [
            "    [1,1] =   'Höhe'   Group: 1",
            *joint_lines("deg", (45.0, -45.0, 60.0, -175.0, 90.0, 180.0)),
            "",
        ]
        lines += ["    [1,2] =   '' ", *block_lines(1, (2894.795, 285.018, -506.546, 90.156, 1.465, 95.934))]
        lines += ["  EXT1:  ******** mm  ", "    [1,3] =   'Home2' Uninitialized", "    [1,4] =   '' "]
        lines += [*block_lines(1, (1.0, 0.0, -0.25, 0.0, 0.0, 0.0)), "  EXT1:    40.492 mm  "]
        lines += ["    [1,5] =   '' Uninitialized"]
        for group in range(2, self.groups + 1):
            lines += [f"    [{group},1] =   ''   Group: {group}", "  J1 =   200.000 mm  ", ""]
            lines += [f"    [{group},{n}] =   '' Uninitialized" for n in range(2, 6)]
        return "\n".join(
            [*lines, "", "[*POSREG*]$MAXPREGNUM  Storage: CMOS  Access: RW  : INTEGER = 5", "", ""]
        )


def nine_lines(values: Sequence[object], rest: str) -> list[str]:
    return [*map(str, values), *[rest] * (9 - len(values))]


def array_lines(head: str, kind: str, values: Sequence[str], indent: str = "      ") -> list[str]:
    return [
        f"{head}  ARRAY[{len(values)}] OF {kind}",
        *[f"{indent}[{i}] = {v}" for i, v in enumerate(values, 1)],
    ]


def format_number(value: float) -> str:
    """Write as ``%9.3f`` with the zero before the point dropped, except in 0.000."""
    text = f"{value:.3f}"
    if float(text) != 0 and abs(float(text)) < 1:
        text = text.replace("0.", ".", 1)
    return f"{text:>9}"


def block_lines(group: int, values: Sequence[float]) -> list[str]:
    pairs = [f"{name}: {format_number(v)}" for name, v in zip("XYZWPR", values, strict=True)]
    config = "N D B, 0, 0, 0" if group == 1 else ""
    return [
        f"  Group: {group}   Config: {config}",
        "  " + "   ".join(pairs[:3]),
        "  " + "   ".join(pairs[3:]),
    ]


def joint_lines(unit: str, values: Sequence[float]) -> list[str]:
    pairs = [f"J{i} = {format_number(v)} {unit}" for i, v in enumerate(values, 1)]
    return ["  " + "   ".join(pairs[:3]) + " ", "  " + "   ".join(pairs[3:]) + " "]
