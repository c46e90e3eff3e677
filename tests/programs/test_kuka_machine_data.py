"""What $CONFIG.DAT and $MACHINE.DAT say of the bases of all programs of their controller."""

from pathlib import Path

import numpy as np
import pytest

from cellcal.calibration.geometry import Pose
from cellcal.drivers.kuka.program_files.machine_data import ROOT_SET
from cellcal.drivers.programs.barred import TURNED_BASE
from cellcal.drivers.programs.positions import ProgramFile
from cellcal.service.engineering.programs.batches import read_batches
from cellcal.service.engineering.programs.files import find_programs
from tests.programs.test_across_files import dat_file, read_programs, src_file

POINT = "{X 1.0,Y 2.0,Z 3.0,A 0.0,B 0.0,C 0.0,S 2,T 2}"
TAUGHT = [
    line
    for number in (0, 1, 2)
    for line in (
        f"DECL E6POS XP{number}={POINT}",
        f'DECL FDAT FP{number}={{TOOL_NO 1,BASE_NO {number},IPO_FRAME #BASE,POINT2[] " "}}',
    )
]
MACHINES = (
    'MACHINE_DEF[1]={NAME[] "KR 6",COOP_KRC_INDEX 1,PARENT[] "WORLD",ROOT {X 0.0,Y 0.0},MECH_TYPE #ROBOT}',
    'MACHINE_DEF[2]={NAME[] "DKP",COOP_KRC_INDEX %d,PARENT[] "WORLD",ROOT {X 900.0,Y 0.0},MECH_TYPE #%s}',
    'MACHINE_FRAME_DAT[1]={MACH_DEF_INDEX 0,PARENT[] "WORLD",GEOMETRY[] " "}',
    'MACHINE_FRAME_DAT[2]={MACH_DEF_INDEX 2,PARENT[] "DKP",GEOMETRY[] " "}',
    "BASE_DATA[1]={X 700.0,Y 0.0,Z 100.0,A 0.0,B 0.0,C 0.0}",
)


def read_cell(
    folder: Path, *, machines: tuple[str, ...] = (), root: str = "", moves: tuple[str, ...] = ()
) -> ProgramFile:
    """Return the taught points of a backup, or the moves of its program where it has some."""
    files = {
        "R1/System/$config.dat": dat_file("$CONFIG", *machines, public="PUBLIC"),
        "R1/Mada/$machine.dat": dat_file(
            "$MACHINE",
            *([f"FRAME $ROBROOT={root} ;ROBOTER IM WELTKOORDINATENSYSTEM [MM,GRAD]"] if root else ()),
            "DECL CYLWORKSPACE $CYLWORKSPACE[8]",
            "$CYLWORKSPACE[1]={X 0.0,Y 0.0,Z 0.0,A 0.0,B 0.0,C 0.0,Z1 0.0,R 0.0,MODE #OFF,STATE FALSE}",
            public="PUBLIC",
        ),
        "R1/Program/a.dat": dat_file("A", *TAUGHT),
        "R1/Program/a.src": src_file("A", *moves),
    }
    name = "a.src" if moves else "a.dat"
    return next(one for file, one in read_programs(folder, files).items() if file.endswith(name))


@pytest.mark.parametrize(
    ("kind", "cooperating", "carried"),
    [("EASYS", 1, True), ("CONVEYOR", 1, True), ("ROBOT", 2, True), ("ROBOT", 1, False), ("NONE", 0, False)],
)
def test_a_base_on_a_machine_needs_a_positioner(
    kind: str, cooperating: int, carried: bool, tmp_path: Path
) -> None:
    machines = tuple(line % (cooperating, kind) if "%" in line else line for line in MACHINES)
    found = read_cell(tmp_path, machines=machines).positions
    assert {row: bar.why for row, bar in found.conditions.items()} == ({2: TURNED_BASE} if carried else {})
    direct = ("$TOOL=TOOL_DATA[1]", "$BASE=BASE_DATA[2]", f"LIN {POINT}")  # which looks at no machine
    assert not read_cell(tmp_path / "direct", machines=machines, moves=direct).positions.conditions


def test_lists_beside_the_programs_tell_of_the_machine_only(tmp_path: Path) -> None:
    """Named are the programs; a table of bases that is not named is none of the project's."""
    machines = tuple(line % (1, "EASYS") if "%" in line else line for line in MACHINES)
    read_cell(tmp_path, machines=machines, root="{X 0.0,Y 200.0,Z 600.0,A 0.0,B 0.0,C 0.0}")
    sources = find_programs([str(tmp_path / "R1" / "Program" / "a.dat")]).sources
    ((one,),) = read_batches(sources, lambda _: None, [])
    assert {row: bar.why for row, bar in one.program.positions.conditions.items()} == {2: TURNED_BASE}
    assert one.program.frames.base_frame["0"].position_m == (0.0, -0.2, -0.6)
    assert not one.program.frames.cell_base_frame


def test_bases_of_files_are_seen_from_the_root_of_the_robot(tmp_path: Path) -> None:
    found = read_cell(
        tmp_path, machines=MACHINES[-1:], root="{X 0.0,Y 200.0,Z 600.0,A 90.0,B 0.0,C 0.0}"
    ).frames
    zero, one = found.base_frame["0"].to_matrix(), found.cell_base_frame["1"].to_matrix()
    turn = np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    assert np.allclose(zero[:3, :3], turn)
    assert np.allclose(zero[:3, 3], turn @ [0.0, -0.2, -0.6])
    assert np.allclose(one[:3, 3], turn @ [0.7, -0.2, -0.5])


@pytest.mark.parametrize("root", ["", "{X 0.0,Y 0.0,Z 0.0,A 0.0,B 0.0,C 0.0}"])
def test_a_robot_at_the_origin_changes_nothing(root: str, tmp_path: Path) -> None:
    found = read_cell(tmp_path, machines=MACHINES[-1:], root=root).frames
    assert found.base_frame.get("0", Pose((0.0, 0.0, 0.0))) == Pose((0.0, 0.0, 0.0))
    assert found.cell_base_frame["1"].position_m == pytest.approx((0.7, 0.0, 0.1))


ROOT = "{X 0.0,Y 0.0,Z 50.0,A 0.0,B 0.0,C 0.0}"


@pytest.mark.parametrize(
    "statement",
    [
        f"$ROBROOT={ROOT}",
        "$robroot.z=50.0",
        "$ROBROOT=ROOT_OF[2]",
        f"$WORLD={ROOT}",
        "SHIFT_ROOT($ROBROOT)",
        'CAST_FROM(DATA[],OFFSET,"%.4r",$ROBROOT)',
    ],
)
@pytest.mark.parametrize("file", ["R1/Program/a.src", "R1/Program/cell/b.src", "R1/System/sps.sub"])
def test_a_root_that_a_program_sets_leaves_every_place(statement: str, file: str, tmp_path: Path) -> None:
    files = {
        "R1/Program/a.dat": dat_file("A", *TAUGHT, "DECL E6AXIS XHOME={A1 0,A2 -90,A3 90,A4 0,A5 0,A6 0}"),
        "R1/Program/a.src": src_file("A"),
        "other/R1/Program/c.dat": dat_file("C", *TAUGHT),
    }
    files[file] = src_file(Path(file).stem, statement)
    found = {Path(name).name: one.positions for name, one in read_programs(tmp_path, files).items()}
    left_names = [
        name for row, name in enumerate(found["a.dat"].names) if found["a.dat"].barred.get(row) == ROOT_SET
    ]
    assert left_names == ["XP0", "XP1", "XP2"]
    assert not found["c.dat"].barred  # of another controller


def test_a_root_that_is_only_read_leaves_nothing(tmp_path: Path) -> None:
    lines = ("IF $ROBROOT.Z==50.0 THEN", "HEIGHT=$ROBROOT.Z", "ENDIF", "BASE_DATA[9]=$ROBROOT")
    files = {"a.dat": dat_file("A", *TAUGHT), "a.src": src_file("A", *lines)}
    assert not read_programs(tmp_path, files)["a.dat"].positions.barred
