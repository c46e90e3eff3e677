"""CELLCAL and CELLCAL_BG: read by our own reader, of the kinds that FANUC allows, and executed line by line."""

import re
from pathlib import Path

import numpy as np
import pytest

from cellcal.drivers.fanuc.program_files.ls_program import read_ls
from cellcal.fake_devices.arm import SimulatedArm
from cellcal.fake_devices.modbus_robot.tp_program import LISTINGS, TpProgram
from cellcal.fake_devices.tp_programs.expressions import TpSyntaxError, compile_expression
from cellcal.fake_devices.tp_programs.listing import (
    Assignment,
    ConditionalStep,
    JointMotion,
    parse_listing,
    read_listing,
)
from cellcal.fake_devices.tp_programs.tasks import TaskStatus, run_background

MAIN, BACKGROUND = LISTINGS / "CELLCAL.LS", LISTINGS / "CELLCAL_BG.LS"
REMARK_LETTERS = 32
MOST_BACKGROUND_LINES = 500  # of mixed logic in one ITP


@pytest.mark.parametrize("path", [MAIN, BACKGROUND])
def test_our_own_reader_reads_the_listings(path: Path) -> None:
    program = read_ls(path.name, path.read_bytes())
    assert program.name == path.stem
    assert program.positions.names == ()
    assert program.to_bytes() == path.read_bytes()


def test_the_mover_has_group_one_and_moves_in_one_line_only() -> None:
    listing = read_listing(MAIN)
    assert listing.has_group
    moves = [each for each in listing.instructions if isinstance(each, JointMotion)]
    assert len(moves) == 1
    text = MAIN.read_text()
    assert "DEFAULT_GROUP\t= 1,*,*,*,*;" in text
    assert text.index("SKIP CONDITION F[20]=ON") < text.index("FINE Skip,LBL")


def test_background_logic_is_mixed_logic_only() -> None:
    listing = read_listing(BACKGROUND)
    assert not listing.has_group
    assert "DEFAULT_GROUP\t= *,*,*,*,*;" in BACKGROUND.read_text()
    for instruction in listing.instructions:
        then = instruction.then if isinstance(instruction, ConditionalStep) else instruction
        assert then is None or isinstance(then, Assignment)
    statements = re.findall(r"^ *\d+: +(.*?) ;$", BACKGROUND.read_text(), re.MULTILINE)
    assert len(statements) == len(listing.instructions) < MOST_BACKGROUND_LINES
    for statement in statements:  # every value and condition stands in brackets
        assert statement.startswith("!") or re.fullmatch(r"(IF \(.*\),)?[RF]\[\d+\]=\(.*\)", statement), (
            statement
        )


@pytest.mark.parametrize("path", [MAIN, BACKGROUND])
def test_remarks_fit_and_lines_are_counted(path: Path) -> None:
    text = path.read_text()
    lines = re.findall(r"^ *(\d+):", text, re.MULTILINE)
    assert [int(n) for n in lines] == list(range(1, len(lines) + 1))
    assert f"LINE_COUNT\t= {len(lines)};" in text
    assert all(
        len(remark) <= REMARK_LETTERS for remark in re.findall(r"^ *\d+:  !(.*) ;", text, re.MULTILINE)
    )


@pytest.mark.parametrize(
    "statement",
    [
        "L P[1] 100mm/sec FINE",
        "CALL X",
        "R[1]=DI[1]",
        "IF R[1]=1,CALL X",
        "WAIT DI[1]=ON",
        "PULSE",
        "UO[3]=ON",
    ],
)
def test_an_instruction_that_is_not_modelled_is_not_accepted(statement: str) -> None:
    with pytest.raises(TpSyntaxError):
        parse_listing(f"/PROG X\n/ATTR\nDEFAULT_GROUP = 1,*;\n/MN\n   1:  {statement} ;\n/POS\n/END\n")


@pytest.mark.parametrize("body", ["WAIT R[1]<>R[2]", "PR[1]=JPOS", "JMP LBL[1]"])
def test_background_logic_that_would_wait_move_or_jump_is_refused(body: str) -> None:
    text = f"/PROG X\n/ATTR\nDEFAULT_GROUP = *,*;\n/MN\n   1:  LBL[1] ;\n   2:  {body} ;\n/POS\n/END\n"
    with pytest.raises(TpSyntaxError, match="only assigns"):
        run_background(parse_listing(text), program_at_rest())


class NumberState:
    def read_item(self, kind: str, number: int, element: int) -> float | bool:
        return bool(number % 2) if kind == "F" else float(number)

    def read_system(self, name: str) -> float:
        return float(len(name))


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("R[3]+R[4]*2", 11.0),
        ("(R[3]+R[4])*2", 14.0),
        ("R[67] MOD 2+R[67] DIV 2 MOD 2+R[67] DIV 64 MOD 2", 3.0),
        ("R[64] DIV 64 MOD 2", 1.0),
        ("R[1]=1 AND !F[2]", True),
        ("R[1]=1 AND F[2] OR F[1]", True),
        ("!F[1] OR R[2]<>2", False),
        ("R[5]>=5 AND R[5]<=5", True),
        ("$AB[1].$C", 9.0),
    ],
)
def test_mixed_logic(text: str, value: float | bool) -> None:
    assert compile_expression(text)(NumberState()) == value


class Cabinet:
    """A controller on its own, for the programs."""

    def __init__(self) -> None:
        self.arm = SimulatedArm.from_model("fanuc_m6ib", 1, hidden=False)
        self.override_percent, self.mode, self.emergency_stop = 100, 1, False
        self.alarms: list = []
        self.is_mastered = True
        self.tool = self.frame = 0

    def shown_joints(self) -> np.ndarray:
        return self.arm.joints_rad

    def joint_offset(self) -> np.ndarray:
        return np.zeros(6)

    def select_tool(self, number: int) -> None:
        self.tool = number

    def select_frame(self, number: int) -> None:
        self.frame = number

    def report_collision(self, axis: int) -> None:
        raise AssertionError(axis)


def program_at_rest() -> TpProgram:
    return TpProgram(Cabinet())


def run_request(
    program: TpProgram, number: int, scans: int = 20, **registers: float
) -> tuple[float, float, float]:
    """Write arguments, then a request; run some cycles; return R[121] to R[123]."""
    program.registers.update({int(name[1:]): value for name, value in registers.items()})
    program.registers[112] = float(number)  # a heartbeat
    program.registers[101] = float(number)
    for scan in range(scans):
        run_background(program._background, program)
        program.task.run_lines(program._scanned_s + 0.01 * scan)
    return tuple(program.registers[n] for n in (121, 122, 123))  # type: ignore[return-value]


def test_requests_that_are_refused_have_their_reasons() -> None:
    program = program_at_rest()
    cabinet = program._firmware
    run_request(program, 0, 3)
    assert run_request(program, 1, r102=99) == (1, 3, 12)
    assert run_request(program, 2, r102=1, r110=0) == (2, 3, 5)
    assert run_request(program, 3, r102=1, r110=101) == (3, 3, 5)
    assert run_request(program, 4, r102=1, r110=10, r104=171.0) == (4, 3, 3)
    assert run_request(program, 5, r102=7, r110=10, r103=7) == (5, 3, 5)
    assert run_request(program, 6, r102=7, r110=10, r103=2, r104=500.0) == (6, 3, 3)
    cabinet.is_mastered = False
    assert run_request(program, 7, r102=1, r110=10, r104=0.0) == (7, 3, 1)
    assert run_request(program, 8, r102=7, r110=10, r103=1, r104=1.0) == (8, 3, 1)
    cabinet.mode = 2
    assert run_request(program, 9, r102=1, r110=10) == (9, 3, 10)
    cabinet.mode = 1
    assert run_request(program, 10, r102=5, r103=3) == (10, 2, 0)
    assert run_request(program, 11, r102=6, r103=0) == (11, 2, 0)
    assert run_request(program, 12, r102=5, r103=11) == (12, 3, 5)
    assert (cabinet.tool, cabinet.frame) == (3, 0)
    assert run_request(program, 13, r102=1, r111=1) == (13, 4, 8)
    assert not cabinet.arm.is_moving


def test_an_old_request_does_not_count_when_the_program_starts() -> None:
    program = program_at_rest()
    program.registers[101] = 77.0
    program.registers[102], program.registers[110] = 1.0, 50.0
    assert run_request(program, 77) == (77, 0, 0)
    assert program.task.status is TaskStatus.RUNNING


def test_a_lost_heartbeat_ends_the_motion() -> None:
    program = program_at_rest()
    arm = program._firmware.arm
    run_request(program, 0, 3)
    target = np.degrees(arm.joints_rad)
    target[0] += 60.0
    arguments = {f"r{104 + k}": float(v) for k, v in enumerate(target)}
    assert run_request(program, 1, 30, r102=1, r110=1, **arguments) == (1, 1, 0)
    assert program.task.motion is not None
    for _ in range(40):
        run_background(program._background, program)
        program.task.run_lines(arm.clock.real_now_s())
    assert program.flags[20]
    assert program.task.skipped
    while not program.is_at_rest():
        arm.clock.advance(0.1)
    program.task.run_lines(arm.clock.real_now_s())
    assert [program.registers[n] for n in (121, 122, 123)] == [1, 4, 7]
    assert np.degrees(arm.joints_rad)[0] < target[0] - 50.0
