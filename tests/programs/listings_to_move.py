"""FANUC listings whose motions are absolute, incremental, led, shifted, computed and mixed, with their cell."""

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from scipy.spatial.transform import Rotation

from tests.programs.fanuc_motion import Controller, pose

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
    1: pose((1500.0, 0.0, 700.0, 0.0, 0.0, 0.0)),
    2: pose((1450.0, 100.0, 750.0, 180.0, 0.0, 30.0)),
}
DOWN = np.diag([1.0, -1.0, -1.0])


@dataclass
class Case:
    """A listing, what the controller holds, how the work moves, and the positions that must go along."""

    text: str
    controller: Controller
    change: np.ndarray
    plain: set[str] = field(default_factory=set)


class _Writer:
    def __init__(self, rng: np.random.Generator) -> None:
        self.rng = rng
        self.lines: list[str] = []
        self.records: list[str] = []
        self.plain: set[str] = set()
        self.frame = 1
        self.any_increment = False  # any position of the program may be one
        self.numbers: dict[int, int] = {}
        self.registers = {k: self._amount() for k in range(1, 13)}

    def _amount(self) -> tuple[float, ...]:
        turn = self.rng.uniform(-20, 20, 3) if self.rng.random() < 0.3 else np.zeros(3)
        place = self.rng.uniform(-90, 90, 3) * (self.rng.random(3) < 0.7)
        return tuple(np.round([*place, *turn], 3).tolist())

    def record(self, values: tuple[float, ...], *, open_frame: bool = False) -> int:
        number = len(self.records) + 1
        frame = "F" if open_frame else str(self.frame)
        x, y, z, w, p, r = (f"{value:9.3f}" for value in values)
        comment = ':"INC Offset"' if self.rng.random() < 0.1 else ""
        self.records.append(
            f"P[{number}{comment}]{{\n   GP1:\n\tUF : {frame}, UT : 1,\t\tCONFIG : 'N U T, 0, 0, 0',\n"
            f"\tX ={x}  mm,\tY ={y}  mm,\tZ ={z}  mm,\n\tW ={w} deg,\tP ={p} deg,\tR ={r} deg\n}};\n"
        )
        return number

    def place(self, *, plain: bool = True, open_frame: bool = False) -> int:
        """Write a position over the work with the tool down."""
        base = np.eye(4)
        base[:3, :3] = Rotation.from_rotvec(self.rng.uniform(-0.3, 0.3, 3)).as_matrix() @ DOWN
        base[:3, 3] = np.array([1.5, 0.0, 0.7]) + self.rng.uniform(-0.25, 0.25, 3)
        matrix = np.linalg.inv(FRAMES[self.frame]) @ base
        angles = Rotation.from_matrix(matrix[:3, :3]).as_euler("xyz", degrees=True)
        number = self.record((*(matrix[:3, 3] * 1e3).tolist(), *angles.tolist()), open_frame=open_frame)
        if plain and not open_frame:  # which frame holds is not certain in a program that chooses several
            self.plain.add(f"P[{number}]")
        return number

    def amount(self) -> int:
        """Write a position that holds an amount."""
        return self.record((*self.rng.uniform(-60, 60, 3).tolist(), 0.0, 0.0, 0.0))

    def register(self) -> int:
        return int(self.rng.integers(1, 13))

    def say(self, *lines: str) -> None:
        self.lines += lines

    def move(self, target: str, options: str = "", kind: str = "") -> None:
        kind = kind or ("J" if self.rng.random() < 0.3 else "L")
        speed = "100%" if kind == "J" else "250mm/sec"
        end = "FINE" if self.rng.random() < 0.5 else "CNT50"
        self.say(f"{kind} {target} {speed} {end}{' ' + options if options else ''}    ")


def _absolute(make: _Writer) -> None:
    number = make.place(open_frame=bool(make.rng.random() < 0.1))
    target = f"P[{number}:INC]" if make.rng.random() < 0.1 else f"P[{number}]"
    make.move(target, _pick(make, ["", "ACC80", "Skip,LBL[9]"]))


def _circle(make: _Writer) -> None:
    via, end = make.place(), make.place()
    make.say(f"C P[{via}]    \n    :  P[{end}] 100mm/sec FINE    ")


def _increment(make: _Writer) -> None:
    make.move(f"P[{make.amount()}]", _pick(make, ["INC", "ACC50 INC", "INC ACC100"]))


def _increment_on_a_circle(make: _Writer) -> None:
    make.say(f"C P[{make.amount()}]    \n    :  P[{make.amount()}] 100mm/sec FINE INC    ")


def _offset(make: _Writer) -> None:
    number = make.place()
    make.move(f"P[{number}]", f"Offset,PR[{make.register()}:Höhe]")
    make.move(f"P[{number}]")


def _offset_of_a_condition(make: _Writer) -> None:
    make.say(f"OFFSET CONDITION PR[{make.register()}]    ")
    make.move(f"P[{make.place()}]", "Offset")


def _offset_written_here(make: _Writer) -> None:
    register = make.register()
    make.say(f"PR[{register}]=PR[{register}]-PR[{register}]    ")
    make.say(f"PR[{register},{make.rng.integers(1, 4)}]={make.rng.uniform(-80, 80):.2f}    ")
    make.move(f"P[{make.place()}]", f"Offset,PR[{register}]")


def _tool_offset(make: _Writer) -> None:
    make.move(f"P[{make.place()}]", f"Tool_Offset,PR[{make.register()}]")


def _tool_offset_of_a_condition(make: _Writer) -> None:
    make.say(f"TOOL_OFFSET CONDITION PR[{make.register()}]    ")
    make.move(f"P[{make.place()}]", "Tool_Offset")


def _camera(make: _Writer) -> None:
    make.move(f"P[{make.place(plain=False)}]", "VOFFSET,VR[1]", "L")


def _led(make: _Writer) -> None:
    make.move(f"P[{make.place(plain=False)}]", _pick(make, ["COORD", "COORD[LDR]"]), "L")


def _standing_tool(make: _Writer) -> None:
    make.move(f"P[{make.place(plain=False)}]", "RTCP", "L")


def _copied(make: _Writer) -> None:
    number, register = make.place(plain=False), make.register()
    make.say(f"PR[{register}]=P[{number}]    ")
    make.move(f"PR[{register}]")


def _copied_and_raised(make: _Writer) -> None:
    number, register = make.place(plain=False), make.register()
    make.say(
        f"PR[{register}]=P[{number}]    ",
        f"PR[{register},3]=PR[{register},3]+{make.rng.integers(20, 90)}    ",
    )
    make.move(f"PR[{register}]")
    if make.rng.random() < 0.5:
        make.move(f"P[{number}]")


def _copied_twice(make: _Writer) -> None:
    number, (a, b) = make.place(plain=False), make.rng.choice(np.arange(1, 13), 2, replace=False).tolist()
    make.say(f"PR[{a}]=P[{number}]    ", f"PR[{b}]=PR[{a}]    ", f"PR[{b},1]=PR[{b},1]-35.5    ")
    make.move(f"PR[{b}]")


def _summed(make: _Writer) -> None:
    number, (a, b) = make.place(plain=False), make.rng.choice(np.arange(1, 13), 2, replace=False).tolist()
    make.registers[b] = (*make.registers[b][:3], 0.0, 0.0, 0.0)
    make.say(f"PR[{a}]=P[{number}]+PR[{b}]    ")
    make.move(f"PR[{a}]")


def _raised_from_here(make: _Writer) -> None:
    make.move(f"P[{make.place()}]")
    register = make.register()
    make.say(f"PR[{register}]=LPOS    ", f"PR[{register},{make.rng.integers(1, 4)}]=PR[{register},3]+0    ")
    make.say(f"PR[{register},2]=PR[{register},2]+50    ")
    make.move(f"PR[{register}]")


def _amount_in_a_position(make: _Writer) -> None:
    register = make.register()
    make.say(f"PR[{register}]=P[{make.amount()}]    ")
    make.move(f"P[{make.place()}]", f"Offset,PR[{register}]")


def _copied_and_shifted(make: _Writer) -> None:
    number, (a, b) = make.place(plain=False), make.rng.choice(np.arange(1, 13), 2, replace=False).tolist()
    make.say(f"PR[{a}]=P[{number}]    ")
    make.move(f"PR[{a}]", f"Offset,PR[{b}]")


def _place_as_an_amount(make: _Writer) -> None:
    number, register = make.place(plain=False), make.register()
    make.move(f"P[{number}]")
    make.say(f"PR[{register}]=P[{number}]    ")
    make.say(f"PR[{register}]=PR[{register}]-P[{make.place(plain=False)}]    ")
    option = _pick(make, ["Offset,PR[{}]", "Tool_Offset,PR[{}]"]).format(register)
    make.move(f"P[{make.place(plain=False)}]", option)


def _increment_from_a_register(make: _Writer) -> None:
    register = make.register()
    make.say(f"PR[{register}]=P[{make.amount()}]    ")
    make.move(f"PR[{register}]", "INC")


def _chosen_increment(make: _Writer) -> None:
    number = make.amount()
    make.say(f"R[{number}]={number}    ")
    make.move(f"P[R[{number}]]", "INC")
    make.any_increment = True


def _chosen(make: _Writer) -> None:
    number = make.place()
    make.say(f"R[{number}]={number}    ")
    make.move(f"P[R[{number}]]")


def _other_frame(make: _Writer) -> None:
    make.frame = 3 - make.frame
    make.say(f"UFRAME_NUM={make.frame} ")


def _looped(make: _Writer) -> None:
    label, counter = len(make.lines) + 20, len(make.lines) + 100
    make.say(f"R[{counter}]=0    ", f"LBL[{label}] ", f"UFRAME_NUM={make.frame} ")
    _pick(make, BLOCKS[:12])(make)
    make.say(f"R[{counter}]=R[{counter}]+1    ", f"IF R[{counter}]<2,JMP LBL[{label}] ")


def _silent(make: _Writer) -> None:
    lines = ["!P[1] INC Offset,PR[1] ", "//L P[1] 100mm/sec FINE INC    ", "WAIT    .30(sec) ", "DO[3]=ON "]
    make.say(_pick(make, lines))


def _pick(make: _Writer, choices):
    return choices[int(make.rng.integers(len(choices)))]


BLOCKS: list[Callable[[_Writer], None]] = [
    _absolute, _absolute, _circle, _increment, _increment_on_a_circle, _offset, _offset_of_a_condition, _tool_offset,
    _camera, _led, _standing_tool, _offset_written_here, _tool_offset_of_a_condition, _copied, _copied_and_raised,
    _copied_twice, _summed, _raised_from_here, _copied_and_shifted, _place_as_an_amount,
    _increment_from_a_register, _chosen_increment, _amount_in_a_position, _chosen, _other_frame, _looped, _silent,
]  # fmt: skip


def generate(seed: int) -> Case:
    """Return one listing with the move of its work: a third of the moves do not turn."""
    rng = np.random.default_rng([seed, 231])
    make = _Writer(rng)
    make.say("UFRAME_NUM=1 ", "UTOOL_NUM=1 ")
    _absolute(make)
    for _ in range(int(rng.integers(2, 8))):
        _pick(make, BLOCKS)(make)
    body = "".join(f"{number:4d}:  {line};\n" for number, line in enumerate(make.lines, 1))
    body = (
        body.replace(":  //", "://").replace(":  L ", ":L ").replace(":  J ", ":J ").replace(":  C ", ":C ")
    )
    text = (
        f'/PROG  M{seed}\n/ATTR\nCOMMENT\t\t= "INC";\nDEFAULT_GROUP\t= 1,*,*,*,*;\n/MN\n{body}/POS\n'
        f"{''.join(make.records)}/END\n"
    )
    return Case(
        text.replace("\n", "\r\n") if rng.random() < 0.3 else text,
        Controller(FRAMES, make.registers),
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
