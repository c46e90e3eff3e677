"""Programs that set their frames and tools to numbers, in random ways, and where each way puts the tool.

A program is a list of statements that is written in a brand's language and executed here, with other choices at each
branch each time. Nothing here is the product's but the numbers of the nominal arms.
"""

import re
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from random import Random

import numpy as np
from scipy.spatial.transform import Rotation

from tests.programs.external.brands import BRANDS, KUKA_TURN, read_fanuc
from tests.programs.external.hand_geometry import Array, arm, flange_of, pose

TOOLS = (pose((0.01, -0.02, 0.11), (0.0, 0.2, 0.0)), pose((0.0, 0.03, 0.09), (0.1, 0.0, 0.3)))
FRAMES = (
    pose((0.35, -0.15, 0.12), (0.02, -0.03, 0.5)),
    pose((0.1, 0.2, 0.05), (0.0, 0.0, -1.2)),
    pose((-0.2, 0.05, 0.3), (0.4, 0.1, 0.0)),
)
_UR = tuple(
    (8.0 * k + 6, -80.0 + 4 * k, 96.0 - 3 * k, -100 - 5 * k, -85.0 - 3 * k, 10.0 + 4 * k) for k in range(5)
)
ARMS = {name: (one.model, one.postures) for name, one in BRANDS.items()} | {
    "universal_robots": ("ur10e", _UR)
}
_MOST_STEPS = 60  # of one way through a program


@dataclass(frozen=True)
class Statement:
    """A statement: "frame", "tool", "move", "if", "loop", "call", "skip" (a jump over what it holds) or "still"."""

    kind: str
    number: int = 0
    inside: tuple["Statement", ...] = ()
    other: tuple["Statement", ...] = ()  # of an if


@dataclass
class RandomProgram:
    """A main routine and the routines that it may call."""

    seed: int
    random: Random = field(init=False)
    moves: int = 0
    routines: list[tuple[Statement, ...]] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.random = Random(self.seed)
        self.routines = [self._block(3, 0), self._block(2, 0, calls=False), (Statement("still"),)]
        opening = (Statement("frame", 0), Statement("tool", 0), self._move())
        rest = self._block(6, 2)
        self.routines.insert(0, (*(opening if self.random.random() < 0.8 else ()), *rest, self._move()))

    def _move(self) -> Statement:
        self.moves += 1
        return Statement("move", self.moves)

    def _block(self, most: int, depth: int, *, calls: bool = True) -> tuple[Statement, ...]:
        kinds = ["frame", "frame", "tool", "move", "move", "move", "still"]
        kinds += ["if", "loop", "skip"] if depth else []
        kinds += ["call"] if calls and depth else []
        found = []
        for _ in range(self.random.randint(1, most)):
            kind = self.random.choice(kinds)
            inside = self._block(3, depth - 1) if kind in ("if", "loop", "skip") else ()
            if (
                kind == "loop" and calls and self.random.random() < 0.4
            ):  # it comes back to the move behind the call
                inside = (self._move(), *inside[:1], Statement("call", self.random.randint(1, 3)))
            other = self._block(2, depth - 1) if kind == "if" and self.random.random() < 0.5 else ()
            number = self.random.randint(1, 3) if kind == "call" else self.random.randrange(3)
            found.append(
                self._move()
                if kind == "move"
                else Statement(kind, number % 2 if kind == "tool" else number, inside, other)
            )
        return tuple(found)

    def sets(self, kind: str) -> bool:
        """Return whether any routine has a statement of a kind."""
        waiting = [one for routine in self.routines for one in routine]
        while waiting:
            one = waiting.pop()
            waiting += [*one.inside, *one.other]
            if one.kind == kind:
                return True
        return False

    def places_seen(self, ways: int) -> dict[int, set[tuple[int, int]]]:
        """Return by move the frames and tools that executions bring to it; -1 for what was there before."""
        seen: dict[int, set[tuple[int, int]]] = {}
        for _ in range(ways):
            state = [-1, -1]
            for kind, number in self._execute(self.routines[0], [_MOST_STEPS]):
                if kind == "move":
                    seen.setdefault(number, set()).add((state[0], state[1]))
                else:
                    state[kind == "tool"] = number
        return seen

    def _execute(self, block: Sequence[Statement], left: list[int]) -> Iterator[tuple[str, int]]:
        for one in block:
            left[0] -= 1
            if one.kind in ("frame", "tool", "move"):
                yield one.kind, one.number
            elif one.kind == "call":
                yield from self._execute(self.routines[one.number], left)
            elif one.kind == "if":
                yield from self._execute(one.inside if self.random.random() < 0.5 else one.other, left)
            elif one.kind == "skip" and self.random.random() < 0.5:
                yield from self._execute(one.inside, left)
            elif one.kind == "loop":
                for _ in range(self.random.randint(0, 3) if left[0] > 0 else 0):
                    yield from self._execute(one.inside, left)

    def posture(self, brand: str, number: int) -> Array:
        """Return the joints at a move [rad]."""
        postures = ARMS[brand][1]
        step = np.array([0.3, -0.2, 0.4, 0.5, -0.3, 0.6]) * (number // 5)
        return np.asarray(np.radians(np.array(postures[number % len(postures)]) + step))

    def targets(self, brand: str) -> dict[int, Array]:
        """Return the tip of each move in one of the frames that it may be in, at postures of the arm."""
        seen = self.places_seen(8)
        found = {}
        for number in range(1, self.moves + 1):
            frame, tool = min(seen.get(number, {(0, 0)}), key=lambda each: each[0] < 0)
            flange = flange_of(arm(ARMS[brand][0]), self.posture(brand, number))
            found[number] = np.linalg.inv(FRAMES[frame]) @ flange @ TOOLS[tool]
        return found


def write_kuka(program: RandomProgram, targets: dict[int, Array]) -> dict[str, str]:
    """Return the files of a program as RoboDK's post-processor for KRC2 and KRC4 writes frames."""
    files = {}
    for number, routine in enumerate(program.routines):
        begin = ["BAS(#INITMOV,0)", "BAS(#FRAMES)", "BAS(#TOOL,0)", "BAS(#BASE,0)"] if number == 0 else []
        lines = [f"DEF R{number} ( )", *begin, *_krl(program, routine, targets), "END", ""]
        files[f"r{number}.src"] = "\n".join(lines)
    if program.seed % 2:  # all in one file
        return {"r0.src": "\n".join(files.values())}
    return files


def _krl(program: RandomProgram, block: Sequence[Statement], targets: dict[int, Array]) -> Iterator[str]:
    for at, one in enumerate(block):
        inside = list(_krl(program, one.inside, targets))
        if one.kind in ("frame", "tool"):
            which, matrix = ("BASE", FRAMES) if one.kind == "frame" else ("TOOL", TOOLS)
            if program.seed % 3 == 1:  # as posts with a data list write it
                yield f"{which}_DATA[2] = {{FRAME: {_krl_place(matrix[one.number])}}}"
                yield f"${which} = {which}_DATA[2]"
            else:
                yield f"${which} = {{FRAME: {_krl_place(matrix[one.number])}}}"
        elif one.kind == "move":
            yield f"LIN {{{_krl_place(targets[one.number])},S 2,T {KUKA_TURN}}} ; P{one.number};"
        elif one.kind == "if":
            other = list(_krl(program, one.other, targets))
            yield from ["IF $IN[1]==TRUE THEN", *inside, *(["ELSE", *other] if other else []), "ENDIF"]
        elif one.kind == "loop":
            head, tail = (("FOR I=1 TO N", "ENDFOR"), ("WHILE $IN[2]", "ENDWHILE"))[at % 2]
            yield from [head, *inside, tail]
        elif one.kind == "skip":
            label = f"AWAY{id(one)}"
            yield from ["IF $IN[3] THEN", f"GOTO {label}", "ENDIF", *inside, f"{label}:"]
        else:
            yield f"R{one.number} ( )" if one.kind == "call" else "$OUT[5]=TRUE"


def _krl_place(matrix: Array) -> str:
    x, y, z = matrix[:3, 3] * 1e3
    a, b, c = Rotation.from_matrix(matrix[:3, :3]).as_euler("ZYX", degrees=True)
    return f"X {x:.6f},Y {y:.6f},Z {z:.6f},A {a:.6f},B {b:.6f},C {c:.6f}"


def write_abb(program: RandomProgram, targets: dict[int, Array]) -> dict[str, str]:
    """Return the module of a program as RoboDK's post-processor for IRC5 writes frames."""
    lines = [
        "MODULE MOD_R0",
        "LOCAL PERS tooldata rdkTool := [TRUE,[[0,0,0],[1,0,0,0]],[2,[0,0,15],[1,0,0,0],0,0,0.005]];",
        'LOCAL PERS wobjdata rdkWObj := [FALSE, TRUE, "", [[0,0,0],[1,0,0,0]],[[0,0,0],[1,0,0,0]]];',
        "VAR speeddata rdkSpeed := [250,500,5000,1000]; ! set default speed",
    ]
    for number, routine in enumerate(program.routines):
        lines += [f"PROC R{number}()", "ConfJ \\On;", *_rapid(program, routine, targets), "ENDPROC"]
    return {"r0.mod": "\n".join([*lines, "ENDMODULE", ""])}


def _rapid(program: RandomProgram, block: Sequence[Statement], targets: dict[int, Array]) -> Iterator[str]:
    for at, one in enumerate(block):
        inside = list(_rapid(program, one.inside, targets))
        if one.kind == "frame":
            yield from _rapid_frame(_rapid_place(FRAMES[one.number]), (program.seed + at) % 3)
        elif one.kind == "tool":
            yield f"rdkTool.tframe := {_rapid_place(TOOLS[one.number])};"
        elif one.kind == "move":
            target = f"[{_rapid_place(targets[one.number])[1:-1]},[0,0,0,0],[9E9,9E9,9E9,9E9,9E9,9E9]]"
            yield f"MoveL {target},rdkSpeed,z1,rdkTool,\\WObj:=rdkWObj; ! P{one.number};"
        elif one.kind == "if":
            other = list(_rapid(program, one.other, targets))
            yield from ["IF di1=1 THEN", *inside, *(["ELSE", *other] if other else []), "ENDIF"]
        elif one.kind == "loop":
            head, tail = (("FOR i FROM 1 TO n DO", "ENDFOR"), ("WHILE di2=1 DO", "ENDWHILE"))[at % 2]
            yield from [head, *inside, tail]
        elif one.kind == "skip":
            label = f"away{id(one)}"
            yield from [f"IF di3=1 GOTO {label};", *inside, f"{label}:"]
        else:
            yield f"R{one.number};" if one.kind == "call" else "SetDO D_OUT_5, 1;"


def _rapid_frame(place: str, way: int) -> list[str]:
    trans, _, rot = place[1:-1].partition("],")
    if way == 0:
        return [f"rdkWObj.uframe := {place};"]
    if way == 1:
        return [f'rdkWObj := [FALSE, TRUE, "", {place},[[0,0,0],[1,0,0,0]]];']
    return [f"rdkWObj.uframe.trans := {trans}];", f"rdkWObj.uframe.rot:={rot};"]


def _rapid_place(matrix: Array) -> str:
    x, y, z = matrix[:3, 3] * 1e3
    q1, q2, q3, q0 = Rotation.from_matrix(matrix[:3, :3]).as_quat()
    return f"[[{x:.6f},{y:.6f},{z:.6f}],[{q0:.10f},{q1:.10f},{q2:.10f},{q3:.10f}]]"


def write_fanuc(program: RandomProgram, targets: dict[int, Array]) -> dict[str, str]:
    """Return the listings of a program as RoboDK's post-processor for R-30iA writes frames."""
    files = {}
    for number, routine in enumerate(program.routines):
        labels = iter(range(1, 1000))
        lines = [f"{at:4d}:{line} ;" for at, line in enumerate(_tp(routine, labels), start=1)]
        records = "".join(_tp_record(one, targets[one]) for one in _moves_in(routine))
        head = f'/PROG  R{number}\n/ATTR\nCOMMENT\t\t= "RoboDK sequence";\nDEFAULT_GROUP\t= 1,*,*,*,*;\n/MN\n'
        files[f"r{number}.ls"] = head + "\n".join([*lines, "/POS", records + "/END", ""])
    return files


def _moves_in(block: Sequence[Statement]) -> list[int]:
    found = []
    for one in block:
        found += [one.number] if one.kind == "move" else [*_moves_in(one.inside), *_moves_in(one.other)]
    return found


def _tp(block: Sequence[Statement], labels: Iterator[int]) -> Iterator[str]:
    for at, one in enumerate(block):
        inside, other = list(_tp(one.inside, labels)), list(_tp(one.other, labels))
        if one.kind in ("frame", "tool"):
            which, matrix = ("UFRAME", FRAMES) if one.kind == "frame" else ("UTOOL", TOOLS)
            turn = Rotation.from_matrix(matrix[one.number][:3, :3]).as_euler("xyz", degrees=True)
            numbers = [*(matrix[one.number][:3, 3] * 1e3), *turn]
            yield from (f"  PR[9,{axis}]={value:.6f}" for axis, value in enumerate(numbers, start=1))
            yield from (f"  {which}[9]=PR[9]", f"  {which}_NUM=9")
        elif one.kind == "move":
            yield f"L P[{one.number}] 100mm/sec FINE"
        elif one.kind == "if":
            first, second = next(labels), next(labels)
            yield from [
                f"  IF DI[1]=OFF,JMP LBL[{first}]",
                *inside,
                f"  JMP LBL[{second}]",
                f"  LBL[{first}]",
            ]
            yield from [*other, f"  LBL[{second}]"]
        elif one.kind == "loop" and at % 2:
            yield from ["  FOR R[1]=1 TO R[2]", *inside, "  ENDFOR"]
        elif one.kind == "loop":
            first, second = next(labels), next(labels)
            yield from [f"  LBL[{first}]", f"  IF DI[2]=OFF,JMP LBL[{second}]", *inside]
            yield from [f"  JMP LBL[{first}]", f"  LBL[{second}]"]
        elif one.kind == "skip":
            label = next(labels)
            yield from [f"  IF DI[3]=ON,JMP LBL[{label}]", *inside, f"  LBL[{label}]"]
        else:
            yield f"  CALL R{one.number}" if one.kind == "call" else "  DO[5]=ON"


def _tp_record(number: int, matrix: Array) -> str:
    x, y, z = matrix[:3, 3] * 1e3
    w, p, r = Rotation.from_matrix(matrix[:3, :3]).as_euler("xyz", degrees=True)
    return (
        f"P[{number}]{{\n   GP1:\n    UF : 9, UT : 9,        CONFIG : 'N U T, 0, 0, 0',\n"
        f"\tX = {x:.6f}  mm,\tY = {y:.6f}  mm,\tZ = {z:.6f}  mm,\n"
        f"\tW = {w:.6f} deg,\tP = {p:.6f} deg,\tR = {r:.6f} deg\n}};\n"
    )


def write_script(program: RandomProgram, targets: dict[int, Array]) -> dict[str, str]:
    """Return the URScript of a program as RoboDK's post-processor writes frames."""
    lines = ["def R0_main():", "global speed_ms = 0.250", f"global ref_frame = {_ur_pose(np.eye(4))}"]
    for number, routine in enumerate(program.routines[1:], start=1):
        lines += [f"def R{number}():", *_urscript(program, routine, targets), "end"]
    return {
        "r0.script": "\n".join(
            [*lines, *_urscript(program, program.routines[0], targets), "end", "R0_main()", ""]
        )
    }


def _urscript(program: RandomProgram, block: Sequence[Statement], targets: dict[int, Array]) -> Iterator[str]:
    for at, one in enumerate(block):
        inside = list(_urscript(program, one.inside, targets)) or ["sync()"]
        if one.kind == "frame":
            yield f"ref_frame = {_ur_pose(FRAMES[one.number])}"
        elif one.kind == "tool":
            yield f"set_tcp({_ur_pose(TOOLS[one.number])})"
        elif one.kind == "move":
            target = _ur_pose(targets[one.number])
            yield f"movel(pose_trans(ref_frame,{target}),1.2,speed_ms,0,0.000) # P{one.number};"
        elif one.kind == "if":
            other = list(_urscript(program, one.other, targets))
            yield from [
                "if (get_standard_digital_in(1)):",
                *inside,
                *(["else:", *other] if other else []),
                "end",
            ]
        elif one.kind == "loop":
            yield from [f"while (get_standard_digital_in({at % 5})):", *inside, "end"]
        elif one.kind == "skip":
            yield from ["if (not get_standard_digital_in(3)):", *inside, "end"]
        else:
            yield f"R{one.number}()" if one.kind == "call" else "set_standard_digital_out(5, True)"


def _ur_pose(matrix: Array) -> str:
    numbers = [*matrix[:3, 3], *Rotation.from_matrix(matrix[:3, :3]).as_rotvec()]
    return f"p[{', '.join(f'{value:.9f}' for value in numbers)}]"


def read_targets(brand: str, text: str) -> dict[int, Array]:
    """Return the tips of the moves, by their numbers in comments."""
    found = {}
    for number, record in re.findall(r"P\[(\d+)\]\{(.*?)\};", text, re.DOTALL):
        (point,) = read_fanuc(f"P[{number}]{{{record}}};")
        assert point.tip is not None
        found[int(number)] = point.tip
    for line in text.splitlines():
        number = re.search(r"P(\d+);$", line)
        if number is None:
            continue
        if brand == "kuka":
            values = dict(re.findall(r"\b([XYZABC]) (-?[\d.]+)", line))
            x, y, z, a, b, c = (float(values[name]) for name in "XYZABC")
            turn = Rotation.from_euler("ZYX", [a, b, c], degrees=True)
        elif brand == "universal_robots":
            x, y, z, *rotvec = (float(one) for one in re.findall(r"-?\d+\.\d{9}", line))
            x, y, z, turn = x * 1e3, y * 1e3, z * 1e3, Rotation.from_rotvec(rotvec)
        else:
            x, y, z, q0, q1, q2, q3 = (float(one) for one in re.findall(r"-?\d+\.\d+", line)[:7])
            turn = Rotation.from_quat([q1, q2, q3, q0])
        matrix = np.eye(4)
        matrix[:3, :3], matrix[:3, 3] = turn.as_matrix(), np.array([x, y, z]) * 1e-3
        found[int(number[1])] = matrix
    return found


WRITERS: dict[str, Callable[[RandomProgram, dict[int, Array]], dict[str, str]]] = {
    "kuka": write_kuka,
    "abb": write_abb,
    "fanuc": write_fanuc,
    "universal_robots": write_script,
}
