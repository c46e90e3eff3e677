"""Robots that do not stand at the origin of their controller's world: what files hold is there, and the arm is not."""

from pathlib import Path

import numpy as np
import pytest

from cellcal.calibration.geometry import Array
from cellcal.drivers.programs.positions import ProgramFile
from cellcal.service.engineering.programs.batches import read_batches
from cellcal.service.engineering.programs.files import find_programs
from tests.programs.test_across_files import TARGET, dat_file, move_lines, rapid_module, src_file

MOVES = rapid_module(
    "M", f"CONST robtarget p1:={TARGET};", move_lines("MoveL p1,v10,fine,tool0\\WObj:=wobj0;")
)
HANGING = "-base_frame_pos_z 2.5 -base_frame_orient_u0 0\\\n -base_frame_orient_u1 1"
HANGS = np.array([[1, 0, 0, 0], [0, -1, 0, 0], [0, 0, -1, 2.5], [0, 0, 0, 1]], dtype=float)
TURNED = "-base_frame_pos_x -1 -base_frame_orient_u0 0 -base_frame_orient_u3 1"
TURNS = np.array([[-1, 0, 0, -1], [0, -1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]], dtype=float)


def configuration(*robots: str) -> str:
    """Return a MOC.cfg; of each robot its name and its base frame."""
    entries = [f'\n      -name "{one}\\\n' for one in robots]
    return (
        'MOC:CFG_1.0:5:0::\n#\nRELAY:\n\n      -name "rob1_brake"\n#\nROBOT:\n'
        + "".join(entries)
        + "#\nFOOT:\n"
    )


def read_below(folder: Path, named: str, files: dict[str, str]) -> dict[str, ProgramFile]:
    """Return the programs of a folder of a backup."""
    for name, text in files.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_text(text, newline="")
    sources = find_programs([str(folder / named)]).sources
    return {
        one.source.place.as_posix(): one.program
        for some in read_batches(sources, lambda _: None, [])
        for one in some
    }


@pytest.mark.parametrize("named", ["", "RAPID", "RAPID/TASK1/PROGMOD/m.mod"])
@pytest.mark.parametrize("place", ["SYSPAR/MOC.cfg", "SysPar/moc.CFG"])
@pytest.mark.parametrize(
    ("robots", "stands"),
    [
        ((f'ROB_1" -use_joint_0 "rob1_1" {HANGING}',), HANGS),
        ((f'ROB_1" {HANGING}', f'ROB_2" {TURNED}'), HANGS),
        ((f'ROB_2" {TURNED}', f'ROB_1" {HANGING}'), HANGS),
        (('ROB_1" -base_frame_coordinated "TRACK"',), np.eye(4)),
        (('ROB_1" -use_joint_0 "rob1_1"',), np.eye(4)),
    ],
)
def test_abb(named: str, place: str, robots: tuple[str, ...], stands: Array, tmp_path: Path) -> None:
    files = {place: configuration(*robots), "RAPID/TASK1/PROGMOD/m.mod": MOVES}
    (found,) = read_below(tmp_path, named, files).values()
    assert np.allclose(found.frames.base_frame["wobj0"].to_matrix(), np.linalg.inv(stands))
    assert any("in the world" in one.text for one in found.remarks) is not np.array_equal(stands, np.eye(4))


@pytest.mark.parametrize(
    ("task", "robots", "stands"),
    [
        ("T_ROB_L", (f'ROB_R" {TURNED}', f'ROB_L" {HANGING}'), HANGS),
        ("T_ROB2", (f'ROB_1" {TURNED}', f'ROB_2" {HANGING}'), HANGS),
        ("TASK2", (f'ROB_L" {TURNED}', f'ROB_R" {HANGING}'), None),  # without the backup's list of its tasks
        ("copied", (f'ROB_1" {TURNED}', f'ROB_2" {HANGING}'), None),
        ("TASK2", ('ROB_L"', 'ROB_R"'), np.eye(4)),
    ],
)
def test_abb_with_two_robots(
    task: str, robots: tuple[str, ...], stands: Array | None, tmp_path: Path
) -> None:
    files = {"SYSPAR/MOC.cfg": configuration(*robots), f"RAPID/{task}/m.mod": MOVES}
    (found,) = read_below(tmp_path, "RAPID", files).values()
    if stands is None:
        assert "several robots" in found.positions.barred[0]
    else:
        assert np.allclose(found.frames.base_frame["wobj0"].to_matrix(), np.linalg.inv(stands))
        assert not found.positions.barred


@pytest.mark.parametrize(
    ("tasks", "stands"),
    [
        (("TASK1: (T_ROB_L,,)", "TASK2: (T_ROB_R,name,)"), HANGS),
        (("TASK1: (T_COMM,,)", "TASK2: (T_ROB_L,,)", "TASK3: (T_ROB_R,,)"), TURNS),
        (("TASK1: (T_ROB_L,,)", "TASK2: (T_COMM,,)"), None),
        ((), None),
    ],
)
def test_abb_tasks_by_the_list_of_the_backup(
    tasks: tuple[str, ...], stands: Array | None, tmp_path: Path
) -> None:
    """The folders of a backup count all tasks, those that move nothing, too."""
    files = {
        "SYSPAR/MOC.cfg": configuration(f'ROB_L" {TURNED}', f'ROB_R" {HANGING}'),
        "BackInfo/backinfo.txt": ">>SYSTEM_ID:\nA\n\n"
        + "".join(f">>{one}\nPROGMOD/m.mod @ \n\n" for one in tasks),
        "RAPID/TASK2/m.mod": MOVES,
    }
    (found,) = read_below(tmp_path, "RAPID/TASK2", files).values()
    if stands is None:
        assert "several robots" in found.positions.barred[0]
    else:
        assert np.allclose(found.frames.base_frame["wobj0"].to_matrix(), np.linalg.inv(stands))
        assert not found.positions.barred


def test_abb_a_task_before_the_first_robot_moves_no_folder_to_the_next_robot(tmp_path: Path) -> None:
    files = {
        "SYSPAR/MOC.cfg": configuration(f'ROB_1" {TURNED}', f'ROB_2" {HANGING}'),
        "BACKINFO/backinfo.txt": ">>SYSTEM_ID:\nA\n>>TASK1: (T_COMM,,)\n>>TASK2: (T_ROB1,,)\n>>TASK3: (T_ROB2,,)\n",
        "RAPID/TASK2/m.mod": MOVES,
    }
    (found,) = read_below(tmp_path, "RAPID", files).values()
    assert np.allclose(found.frames.base_frame["wobj0"].to_matrix(), np.linalg.inv(TURNS))


def test_a_list_that_is_named_with_programs_counts_and_is_no_program(tmp_path: Path) -> None:
    """As an upload has them: all in one folder."""
    (tmp_path / "moc.cfg").write_text(configuration(f'ROB_1" {HANGING}'))
    (tmp_path / "m.mod").write_text(MOVES)
    found = find_programs([str(tmp_path / name) for name in ("m.mod", "moc.cfg")])
    ((one,),) = read_batches(found.sources, lambda _: None, [])
    assert not found.refused
    assert np.allclose(one.program.frames.base_frame["wobj0"].to_matrix(), np.linalg.inv(HANGS))


def test_abb_work_objects_of_another_module(tmp_path: Path) -> None:
    work = 'PERS wobjdata w1:=[FALSE,TRUE,"",[[100,0,0],[1,0,0,0]],[[0,0,500],[1,0,0,0]]];'
    files = {
        "SYSPAR/MOC.cfg": configuration(f'ROB_1" {HANGING}'),
        "RAPID/TASK1/PROGMOD/m.mod": MOVES.replace("wobj0", "w1"),
        "RAPID/TASK1/SYSMOD/frames.sys": rapid_module("FRAMES", work),
    }
    found = read_below(tmp_path, "RAPID", files)["TASK1/PROGMOD/m.mod"]
    assert np.allclose(found.frames.cell_base_frame["w1"].to_matrix()[:3, 3], [0.1, 0.0, 2.0])


@pytest.mark.parametrize("named", ["", "R1/Program"])
def test_kuka(named: str, tmp_path: Path) -> None:
    root = "FRAME $ROBROOT={X 0.0,Y 0.0,Z 600.0,A 0.0,B 180.0,C 0.0}"
    machine, base = dat_file("$MACHINE", root, public="PUBLIC"), "$BASE={X 700,Y 0,Z 100,A 0,B 0,C 0}"
    point = "LIN {X 1,Y 2,Z 3,A 0,B 0,C 0}"
    files = {
        "R1/Mada/$machine.dat": machine,
        "R1/Program/a.src": src_file("A", base, "$TOOL=TOOL_DATA[1]", point),
    }
    found = next(one for name, one in read_below(tmp_path, named, files).items() if name.endswith("a.src"))
    assert np.allclose(
        found.frames.base_frame[found.positions.user_frames[0]].to_matrix()[:3, 3], [-0.7, 0.0, 0.5]
    )
    assert np.allclose(found.frames.base_frame["0"].to_matrix()[:3, 3], [0.0, 0.0, 0.6])
    carried = machine.replace("ENDDAT", "DECL EX_KIN $EX_KIN={ET1 #ERSYS,ET2 #NONE}\r\nENDDAT")
    files["R1/Mada/$machine.dat"] = carried
    found = next(one for name, one in read_below(tmp_path, named, files).items() if name.endswith("a.src"))
    assert np.allclose(
        found.frames.base_frame[found.positions.user_frames[0]].to_matrix()[:3, 3], [0.7, 0.0, 0.1]
    )
