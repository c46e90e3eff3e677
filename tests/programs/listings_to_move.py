"""FANUC listings whose motions are absolute, incremental, led, shifted, computed and mixed, with their cell."""

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from scipy.spatial.transform import Rotation

from tests.programs.fanuc_motion import FanucControllerState, pose_from_xyzwpr

PROJECT = """format = 1
name = "moved"
[robot]
serial = "F1"
model = "fanuc_r2000ic_165f"
smallest_sigma = 0.0001
[tools.1.entered]
position_mm = [0, 0, 150]
[frames.1]
position_mm = [1500, 0, 700]
fanuc_wpr_deg = [0, 0, 0]
[frames.2]
position_mm = [1450, 100, 750]
fanuc_wpr_deg = [180, 0, 30]
"""
FRAMES = {
    1: pose_from_xyzwpr((1500.0, 0.0, 700.0, 0.0, 0.0, 0.0)),
    2: pose_from_xyzwpr((1450.0, 100.0, 750.0, 180.0, 0.0, 30.0)),
}
DOWN = np.diag([1.0, -1.0, -1.0])


@dataclass
class ListingCase:
    """A listing, what the controller holds, how the work moves, and the positions that must go along."""

    text: str
    controller: FanucControllerState
    change: np.ndarray
    plain: set[str] = field(default_factory=set)


class _ListingWriter:
    def __init__(self, rng: np.random.Generator) -> None:
        self.rng = rng
        self.lines: list[str] = []
        self.records: list[str] = []
        self.plain: set[str] = set()
        self.frame = 1
        self.any_increment = False  # any position of the program may be one
        self.numbers: dict[int, int] = {}
        self.registers = {k: self._draw_amount() for k in range(1, 13)}

    def _draw_amount(self) -> tuple[float, ...]:
        turn = self.rng.uniform(-20, 20, 3) if self.rng.random() < 0.3 else np.zeros(3)
        place = self.rng.uniform(-90, 90, 3) * (self.rng.random(3) < 0.7)
        return tuple(np.round([*place, *turn], 3).tolist())

    def write_record(self, values: tuple[float, ...], *, open_frame: bool = False) -> int:
        number = len(self.records) + 1
        frame = "F" if open_frame else str(self.frame)
        x, y, z, w, p, r = (f"{value:9.3f}" for value in values)
        comment = ':"INC Offset"' if self.rng.random() < 0.1 else ""
        self.records.append(
            f"P[{number}{comment}]{{\n   GP1:\n\tUF : {frame}, UT : 1,\t\tCONFIG : 'N U T, 0, 0, 0',\n"
            f"\tX ={x}  mm,\tY ={y}  mm,\tZ ={z}  mm,\n\tW ={w} deg,\tP ={p} deg,\tR ={r} deg\n}};\n"
        )
        return number

    def write_position(self, *, plain: bool = True, open_frame: bool = False) -> int:
        """Write a position over the work with the tool down."""
        base = np.eye(4)
        base[:3, :3] = Rotation.from_rotvec(self.rng.uniform(-0.3, 0.3, 3)).as_matrix() @ DOWN
        base[:3, 3] = np.array([1.5, 0.0, 0.7]) + self.rng.uniform(-0.25, 0.25, 3)
        matrix = np.linalg.inv(FRAMES[self.frame]) @ base
        angles = Rotation.from_matrix(matrix[:3, :3]).as_euler("xyz", degrees=True)
        number = self.write_record((*(matrix[:3, 3] * 1e3).tolist(), *angles.tolist()), open_frame=open_frame)
        if plain and not open_frame:  # which frame holds is not certain in a program that chooses several
            self.plain.add(f"P[{number}]")
        return number

    def write_amount(self) -> int:
        """Write a position that holds an amount."""
        return self.write_record((*self.rng.uniform(-60, 60, 3).tolist(), 0.0, 0.0, 0.0))

    def next_register(self) -> int:
        return int(self.rng.integers(1, 13))

    def add_lines(self, *lines: str) -> None:
        self.lines += lines

    def add_move(self, target: str, options: str = "", kind: str = "") -> None:
        kind = kind or ("J" if self.rng.random() < 0.3 else "L")
        speed = "100%" if kind == "J" else "250mm/sec"
        end = "FINE" if self.rng.random() < 0.5 else "CNT50"
        self.add_lines(f"{kind} {target} {speed} {end}{' ' + options if options else ''}    ")


def _add_absolute_moves(make: _ListingWriter) -> None:
    number = make.write_position(open_frame=bool(make.rng.random() < 0.1))
    target = f"P[{number}:INC]" if make.rng.random() < 0.1 else f"P[{number}]"
    make.add_move(target, _pick_one(make, ["", "ACC80", "Skip,LBL[9]"]))


def _add_circle(make: _ListingWriter) -> None:
    via, end = make.write_position(), make.write_position()
    make.add_lines(f"C P[{via}]    \n    :  P[{end}] 100mm/sec FINE    ")


def _add_increment(make: _ListingWriter) -> None:
    make.add_move(f"P[{make.write_amount()}]", _pick_one(make, ["INC", "ACC50 INC", "INC ACC100"]))


def _increment_on_a_circle(make: _ListingWriter) -> None:
    make.add_lines(f"C P[{make.write_amount()}]    \n    :  P[{make.write_amount()}] 100mm/sec FINE INC    ")


def _add_offset(make: _ListingWriter) -> None:
    number = make.write_position()
    make.add_move(f"P[{number}]", f"Offset,PR[{make.next_register()}:Höhe]")
    make.add_move(f"P[{number}]")


def _offset_of_a_condition(make: _ListingWriter) -> None:
    make.add_lines(f"OFFSET CONDITION PR[{make.next_register()}]    ")
    make.add_move(f"P[{make.write_position()}]", "Offset")


def _offset_written_here(make: _ListingWriter) -> None:
    register = make.next_register()
    make.add_lines(f"PR[{register}]=PR[{register}]-PR[{register}]    ")
    make.add_lines(f"PR[{register},{make.rng.integers(1, 4)}]={make.rng.uniform(-80, 80):.2f}    ")
    make.add_move(f"P[{make.write_position()}]", f"Offset,PR[{register}]")


def _tool_offset(make: _ListingWriter) -> None:
    make.add_move(f"P[{make.write_position()}]", f"Tool_Offset,PR[{make.next_register()}]")


def _tool_offset_of_a_condition(make: _ListingWriter) -> None:
    make.add_lines(f"TOOL_OFFSET CONDITION PR[{make.next_register()}]    ")
    make.add_move(f"P[{make.write_position()}]", "Tool_Offset")


def _add_camera_offset(make: _ListingWriter) -> None:
    make.add_move(f"P[{make.write_position(plain=False)}]", "VOFFSET,VR[1]", "L")


def _add_led_motion(make: _ListingWriter) -> None:
    make.add_move(f"P[{make.write_position(plain=False)}]", _pick_one(make, ["COORD", "COORD[LDR]"]), "L")


def _standing_tool(make: _ListingWriter) -> None:
    make.add_move(f"P[{make.write_position(plain=False)}]", "RTCP", "L")


def _add_copied_register(make: _ListingWriter) -> None:
    number, register = make.write_position(plain=False), make.next_register()
    make.add_lines(f"PR[{register}]=P[{number}]    ")
    make.add_move(f"PR[{register}]")


def _copied_and_raised(make: _ListingWriter) -> None:
    number, register = make.write_position(plain=False), make.next_register()
    make.add_lines(
        f"PR[{register}]=P[{number}]    ",
        f"PR[{register},3]=PR[{register},3]+{make.rng.integers(20, 90)}    ",
    )
    make.add_move(f"PR[{register}]")
    if make.rng.random() < 0.5:
        make.add_move(f"P[{number}]")


def _copied_twice(make: _ListingWriter) -> None:
    number, (a, b) = (
        make.write_position(plain=False),
        make.rng.choice(np.arange(1, 13), 2, replace=False).tolist(),
    )
    make.add_lines(f"PR[{a}]=P[{number}]    ", f"PR[{b}]=PR[{a}]    ", f"PR[{b},1]=PR[{b},1]-35.5    ")
    make.add_move(f"PR[{b}]")


def _add_summed_register(make: _ListingWriter) -> None:
    number, (a, b) = (
        make.write_position(plain=False),
        make.rng.choice(np.arange(1, 13), 2, replace=False).tolist(),
    )
    make.registers[b] = (*make.registers[b][:3], 0.0, 0.0, 0.0)
    make.add_lines(f"PR[{a}]=P[{number}]+PR[{b}]    ")
    make.add_move(f"PR[{a}]")


def _raised_from_here(make: _ListingWriter) -> None:
    make.add_move(f"P[{make.write_position()}]")
    register = make.next_register()
    make.add_lines(
        f"PR[{register}]=LPOS    ", f"PR[{register},{make.rng.integers(1, 4)}]=PR[{register},3]+0    "
    )
    make.add_lines(f"PR[{register},2]=PR[{register},2]+50    ")
    make.add_move(f"PR[{register}]")


def _amount_in_a_position(make: _ListingWriter) -> None:
    register = make.next_register()
    make.add_lines(f"PR[{register}]=P[{make.write_amount()}]    ")
    make.add_move(f"P[{make.write_position()}]", f"Offset,PR[{register}]")


def _copied_and_shifted(make: _ListingWriter) -> None:
    number, (a, b) = (
        make.write_position(plain=False),
        make.rng.choice(np.arange(1, 13), 2, replace=False).tolist(),
    )
    make.add_lines(f"PR[{a}]=P[{number}]    ")
    make.add_move(f"PR[{a}]", f"Offset,PR[{b}]")


def _place_as_an_amount(make: _ListingWriter) -> None:
    number, register = make.write_position(plain=False), make.next_register()
    make.add_move(f"P[{number}]")
    make.add_lines(f"PR[{register}]=P[{number}]    ")
    make.add_lines(f"PR[{register}]=PR[{register}]-P[{make.write_position(plain=False)}]    ")
    option = _pick_one(make, ["Offset,PR[{}]", "Tool_Offset,PR[{}]"]).format(register)
    make.add_move(f"P[{make.write_position(plain=False)}]", option)


def _increment_from_a_register(make: _ListingWriter) -> None:
    register = make.next_register()
    make.add_lines(f"PR[{register}]=P[{make.write_amount()}]    ")
    make.add_move(f"PR[{register}]", "INC")


def _chosen_increment(make: _ListingWriter) -> None:
    number = make.write_amount()
    make.add_lines(f"R[{number}]={number}    ")
    make.add_move(f"P[R[{number}]]", "INC")
    make.any_increment = True


def _add_chosen_register(make: _ListingWriter) -> None:
    number = make.write_position()
    make.add_lines(f"R[{number}]={number}    ")
    make.add_move(f"P[R[{number}]]")


def _other_frame(make: _ListingWriter) -> None:
    make.frame = 3 - make.frame
    make.add_lines(f"UFRAME_NUM={make.frame} ")


def _add_loop(make: _ListingWriter) -> None:
    label, counter = len(make.lines) + 20, len(make.lines) + 100
    make.add_lines(f"R[{counter}]=0    ", f"LBL[{label}] ", f"UFRAME_NUM={make.frame} ")
    _pick_one(make, BLOCKS[:12])(make)
    make.add_lines(f"R[{counter}]=R[{counter}]+1    ", f"IF R[{counter}]<2,JMP LBL[{label}] ")


def _add_silent_change(make: _ListingWriter) -> None:
    lines = [
        "!P[1] INC Offset,PR[1] ", "//L P[1] 100mm/sec FINE INC    ", "WAIT    .30(sec) ", "DO[3]=ON ",
        "!then ; COORD P[1] INC ", "!P[1]\n    :  UFRAME_NUM=2 INC ", "--eg:L P[1] RTCP\n    :  Offset,PR[1] ",
        "//L P[1] 100mm/sec\n    :  FINE COORD    ", "MESSAGE[P[1] INC COORD] ",
    ]  # fmt: skip
    make.add_lines(_pick_one(make, lines))


def _pick_one(make: _ListingWriter, choices):
    return choices[int(make.rng.integers(len(choices)))]


BLOCKS: list[Callable[[_ListingWriter], None]] = [
    _add_absolute_moves, _add_absolute_moves, _add_circle, _add_increment, _increment_on_a_circle,
    _add_offset, _offset_of_a_condition, _tool_offset,
    _add_camera_offset, _add_led_motion, _standing_tool, _offset_written_here, _tool_offset_of_a_condition,
    _add_copied_register, _copied_and_raised,
    _copied_twice, _add_summed_register, _raised_from_here, _copied_and_shifted, _place_as_an_amount,
    _increment_from_a_register, _chosen_increment, _amount_in_a_position, _add_chosen_register,
    _other_frame, _add_loop, _add_silent_change,
]  # fmt: skip


def generate_listing(seed: int) -> ListingCase:
    """Return one listing with the move of its work: a third of the moves do not turn."""
    rng = np.random.default_rng([seed, 231])
    make = _ListingWriter(rng)
    make.add_lines("UFRAME_NUM=1 ", "UTOOL_NUM=1 ")
    _add_absolute_moves(make)
    for _ in range(int(rng.integers(2, 8))):
        _pick_one(make, BLOCKS)(make)
    body = "".join(f"{number:4d}:  {line};\n" for number, line in enumerate(make.lines, 1))
    body = (
        body.replace(":  //", "://").replace(":  L ", ":L ").replace(":  J ", ":J ").replace(":  C ", ":C ")
    )
    text = (
        f'/PROG  M{seed}\n/ATTR\nCOMMENT\t\t= "INC";\nDEFAULT_GROUP\t= 1,*,*,*,*;\n/MN\n{body}/POS\n'
        f"{''.join(make.records)}/END\n"
    )
    return ListingCase(
        text.replace("\n", "\r\n") if rng.random() < 0.3 else text,
        FanucControllerState(FRAMES, make.registers),
        _work_moves(rng),
        set() if make.any_increment else make.plain,
    )


def _work_moves(rng: np.random.Generator) -> np.ndarray:
    """Return how the work moves in the base: about its own place."""
    turn = np.zeros(3) if rng.random() < 0.33 else np.array([0, 0, rng.uniform(-0.5, 0.5)])
    if rng.random() < 0.3 and turn.any():
        turn = rng.uniform(-0.2, 0.2, 3)
    change, centre = np.eye(4), np.array([1.5, 0.0, 0.7])
    change[:3, :3] = Rotation.from_rotvec(turn).as_matrix()
    change[:3, 3] = centre - change[:3, :3] @ centre + rng.uniform(-0.08, 0.08, 3)
    return change
