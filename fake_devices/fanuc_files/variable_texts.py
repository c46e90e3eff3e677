"""The .VA files of the fake controller: SYSMAST, SYMOTN and SYSFRAME, as its file system writes them when read."""

from collections.abc import Iterable, Sequence
from typing import TypeVar

from cellcal.fake_devices.fanuc_files.cabinet import (
    COUNTS_PER_TURN,
    EMPTY,
    MOTOR_SIGNS,
    SPEED_LIMITS_DEG_S,
    FanucCabinet,
)

_NINE = 9
_Value = TypeVar("_Value", int, float)
_FIELD = "     Field: "


def sysmast_text(cabinet: FanucCabinet) -> str:
    """Return SYSMAST.VA."""
    groups = 1 if cabinet.positioner_counts is None else 2
    lines = [f"[*SYSTEM*]$DMR_GRP  Storage: SHADOW  Access: RW  : ARRAY[{groups}] OF DMR_GRP_T"]
    lines += _mastering_lines(
        1,
        cabinet.master_done,
        [*cabinet.counts_at_zero, *_rail(cabinet, cabinet.rail_count_at_zero)],
        [*cabinet.axis_states, *_rail(cabinet, cabinet.rail_state)],
        [*cabinet.pulses(), *cabinet.rail_pulses()],
    )
    if cabinet.positioner_counts is not None:
        done = cabinet.positioner_mastered
        states = [2 if done else 0]
        lines += _mastering_lines(2, done, cabinet.positioner_counts, states, cabinet.positioner_pulses())
    return _joined([*lines, "", "[*SYSTEM*]$MASTER_ENB  Storage: CMOS  Access: RW  : INTEGER = 0", ""])


def symotn_text(cabinet: FanucCabinet) -> str:
    """Return SYMOTN.VA."""
    groups = 1 if cabinet.positioner_counts is None else 2
    lines = ["[*SYSTEM*]$CRCFG  Storage: CMOS  Access: RW  : CRCFG_T = "]
    lines += ["   Field: $CRCFG.$GROUP_MASK Access: RW: INTEGER = 1", ""]
    lines += [f"[*SYSTEM*]$PARAM_GROUP  Storage: SHADOW  Access: RW  : ARRAY[{groups}] OF MRR_GRP_T"]
    matrix = cabinet.link_matrix()
    rows = [[f"{matrix[i, j]:.6e}" for j in range(cabinet.axes)] for i in range(cabinet.axes)]
    signs = [sign > 0 for sign in MOTOR_SIGNS[: cabinet.axes]]
    turns_per_mm = [1 / length for length in _rail(cabinet, cabinet.rail_mm_per_turn)]
    signs += [True for _ in turns_per_mm]
    lines += _drive_lines(1, cabinet.ratios, signs, rows, turns_per_mm)
    if cabinet.states_coupling:
        lines += _coupling_lines(1, cabinet.third_follows_second)
    if cabinet.positioner_counts is not None:
        slides = cabinet.gun_mm_per_turn
        lines += _drive_lines(
            2,
            [] if slides else [cabinet.positioner_ratio],
            [slides is None],
            [],
            [1 / slides] if slides else [],
        )
        if cabinet.states_coupling:
            lines += _coupling_lines(2, coupled=False)
    lines += ["", "[*SYSTEM*]$PLID_GRP  Storage: SHADOW  Access: FP  : ARRAY[1] OF PLID_GRP_T"]
    lines += [f"{_FIELD}$PLID_GRP[1].$CHKER_VER Access: RO: STRING[13] = 'V7.10beta1'"]
    return _joined([*lines, ""])


def sysframe_text(cabinet: FanucCabinet) -> str:
    """Return SYSFRAME.VA."""
    lines = ["[*SYSTEM*]$CELL_FLOOR  Storage: SHADOW  Access: RW  : POSITION = ", *_pose_lines(1, EMPTY), ""]
    for name, poses, most in (("$MNUFRAME", cabinet.frames, 9), ("$MNUTOOL", cabinet.tools, 10)):
        lines += [f"[*SYSTEM*]{name}  Storage: SHADOW  Access: RW  : ARRAY[1,{most}] OF POSITION"]
        for number in range(1, most + 1):
            lines += [f"    [1,{number}] = ", *_pose_lines(1, poses.get(number, EMPTY))]
        lines += [
            "",
            f"[*SYSTEM*]{name}NUM  Storage: SHADOW  Access: RW  : ARRAY[1] OF BYTE",
            "  [1] = 1",
            "",
        ]
    return _joined(lines)


def _rail(cabinet: FanucCabinet, value: _Value | None) -> list[_Value]:
    """Return a value of the rail; nothing where there is no rail."""
    return [] if cabinet.rail_count_at_zero is None or value is None else [value]


def _mastering_lines(
    group: int, done: bool, counts: Sequence[int], states: Sequence[int], pulses: Sequence[int]
) -> list[str]:
    head = f"{_FIELD}$DMR_GRP[{group}].$"
    return [
        f"{head}MASTER_DONE Access: RW: BOOLEAN = {str(done).upper()}",
        *_array(f"{head}OT_MINUS", "BOOLEAN", ["FALSE"] * _NINE),
        *_array(f"{head}MASTER_COUN", "INTEGER", _nine(counts, "0")),
        f"{head}REF_DONE Access: RW: BOOLEAN = FALSE",
        *_array(f"{head}REF_POS", "REAL", ["0.000000e+00"] * _NINE),
        *_array(f"{head}REF_COUNT", "INTEGER", ["0"] * _NINE),
        *_array(f"{head}EACHMST_DON", "INTEGER", _nine(states, "0")),
        *_array(f"{head}SPC_COUNT", "INTEGER", _nine(pulses, "0")),
        *_array(f"{head}DSP_ST_HIS2", "INTEGER", ["Uninitialized"] * _NINE),
        f"{head}SHIFT_ERROR Access: RW: INTEGER = 0",
    ]


def _drive_lines(
    group: int,
    ratios: Sequence[float],
    positive: Sequence[bool],
    rows: Sequence[Sequence[str]],
    turns_per_mm: Sequence[float] = (),
) -> list[str]:
    """Return the drives of a group; ``turns_per_mm`` are of the axes that slide, which follow those that turn."""
    head = f"{_FIELD}$PARAM_GROUP[{group}].$"
    scales = [f"{COUNTS_PER_TURN * ratio / 360:.6e}" for ratio in ratios]
    scales += [f"{COUNTS_PER_TURN * turns:.6e}" for turns in turns_per_mm]
    ratio_texts = [f"{1 / ratio:.6e}" for ratio in (*ratios, *turns_per_mm)]
    limits = [f"{limit:.6e}" for limit in SPEED_LIMITS_DEG_S[: len(ratios)]]
    lines = [
        f"{head}BELT_ENABLE Access: RW: BOOLEAN = FALSE",
        *_array(f"{head}ENCSCALES", "REAL", _nine(scales, "0.000000e+00")),
        *_array(f"{head}JNTVELLIM", "REAL", _nine(limits, "0.000000e+00")),
        *_array(f"{head}MASTER_POS", "REAL", ["0.000000e+00"] * _NINE),
        *_array(
            f"{head}MOSIGN",
            "BOOLEAN",
            _nine([str(each).upper() for each in positive], "FALSE"),
        ),
        *_array(f"{head}GEAR_RATIO", "REAL", _nine(ratio_texts, "0.000000e+00")),
        f"{head}INTERACTION  ARRAY[9] OF INTERACT_T",
    ]
    for row in range(1, _NINE + 1):
        values = rows[row - 1] if row <= len(rows) else []
        name = f"    {head}INTERACTION[{row}].$INTERACTION"
        lines += _array(name, "REAL", _nine(values, "Uninitialized"), indent="          ")
    extra = f"{head}DH_EXTRA"
    return [
        *lines,
        f"{extra}  ARRAY[1] OF DH_EXTRA_LON",
        f"    {extra}[1].$VALID Access: RW: BOOLEAN = FALSE",
    ]


def _coupling_lines(group: int, coupled: bool) -> list[str]:
    head = f"{_FIELD}$PARAM_GROUP[{group}].$"
    couples = ["0", "0", "-2" if coupled else "0", *["0"] * 6]
    lines = [f"{head}INTRAC_NUM  ARRAY[9] OF INTRAC_N_T"]
    for row in range(1, _NINE + 1):
        numbers = ["0", "267" if coupled and row == 3 else "0", *["0"] * 7]
        lines += _array(f"    {head}INTRAC_NUM[{row}].$INTRAC_NUM", "INTEGER", numbers, indent="          ")
    return [*lines, *_array(f"{head}AXS_COUPLE", "SHORT", couples)]


def _pose_lines(group: int, values: Sequence[float]) -> list[str]:
    pairs = [f"{name}: {_field_text(value)}" for name, value in zip("XYZWPR", values, strict=True)]
    return [
        f"  Group: {group}   Config: N D B, 0, 0, 0",
        "  " + "   ".join(pairs[:3]),
        "  " + "   ".join(pairs[3:]),
    ]


def _field_text(value: float) -> str:
    text = f"{value:.3f}"
    return f"{text.replace('0.', '.', 1) if 0 < abs(float(text)) < 1 else text:>9}"


def _nine(values: Iterable[object], rest: str) -> list[str]:
    found = [str(value) for value in values]
    return [*found, *[rest] * (_NINE - len(found))]


def _array(head: str, kind: str, values: Sequence[str], *, indent: str = "      ") -> list[str]:
    elements = [f"{indent}[{number}] = {value}" for number, value in enumerate(values, 1)]
    return [f"{head}  ARRAY[{len(values)}] OF {kind}", *elements]


def _joined(lines: Sequence[str]) -> str:
    return "\n".join(lines) + "\n"
