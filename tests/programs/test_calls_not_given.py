"""Calls of programs that are not given: a changed program that runs such is no PASS, for every brand."""

from pathlib import Path

import pytest

from cellcal.drivers.abb.program_files.rapid_called import called_procedures
from cellcal.drivers.fanuc.program_files.ls_called import called_programs
from cellcal.drivers.kuka.program_files.krl_called import called_routines
from cellcal.drivers.programs.called_routines import moves_no_robot
from cellcal.drivers.universal_robots.program_files.script_called import called_functions, own_functions
from cellcal.drivers.yaskawa.program_files.job_called import called_jobs
from cellcal.service.cli.app import run_command_line
from cellcal.service.exit_codes import ExitCode
from tests.programs.test_absent_places import fanuc, rapid, yaskawa
from tests.programs.test_field_cases import CASES, move_program

SHIFTED = "30,-20,5,0,0,0"


def krl(*lines: str) -> str:
    return (CASES / "kuka" / "lin_rel_rotated.src").read_text().replace("LIN_REL {X 100}", "\n".join(lines))


def script(*lines: str) -> str:
    text = (CASES / "ur" / "component_assignment.script").read_text().splitlines()
    return "\n".join([*text[:3], *lines, text[-2], "end", ""])


FILES = {
    "fanuc": ("offset_pr.LS", lambda call: fanuc("PR[3,3]=50", "L P[1] 99mm/sec FINE Offset,PR[3]", call)),
    "abb": ("pdisp_rotated.mod", rapid),
    "kuka": ("lin_rel_rotated.src", krl),
    "ur": ("component_assignment.script", script),
    "yaskawa": ("one_point_refuses_all.JBI", yaskawa),
}


@pytest.mark.parametrize(
    ("brand", "line", "name"),
    [
        ("fanuc", "CALL PICK_1(3)", "PICK_1"),
        ("fanuc", "CALL OPEN_GRIPPER", ""),
        ("abb", "PickPart 3;", "PickPart"),
        ("abb", "SetDO doGrip,1;", ""),
        ("kuka", "pick_part(3)", "pick_part"),
        ("kuka", "gripper_open(1)", ""),
        ("ur", "pick_part(3)", "pick_part"),
        ("ur", "set_digital_out(1, True)", ""),
        ("yaskawa", "CALL JOB:PICK", "PICK"),
        ("yaskawa", "CALL JOB:MSG-SHOW", ""),
        ("fanuc", "CALL SR[1]", "SR[1]"),
        ("abb", "ok:=DoPick(3);", "DoPick"),
        ("abb", 'Load "HOME:/C.mod"; %"pickC"%;', '%"pickC"%'),
        ("abb", 'CallByVar "pick",nPart;', 'CallByVar "pick",nPart'),
        ("abb", "MoveExtJ jx,v100,fine;", ""),
        ("kuka", "IF pick_ok(3) THEN\nENDIF", "pick_ok"),
        ("kuka", "n = norm(3)", ""),
        ("ur", "x = 1 + pick_part(3)", "pick_part"),
        ("ur", "x = get_pick(3)", ""),
        ("yaskawa", "MACRO1 MJ#(1) ARGF2", "MACRO1 MJ#(1)"),
        ("yaskawa", "CALL IG#(2)", "IG#(2)"),
    ],
)
def test_a_call_of_what_may_move_the_robot_is_a_finding(brand, line, name, tmp_path: Path):
    file, write = FILES[brand]
    moved = move_program(tmp_path, brand, file, offset=SHIFTED, text=write(line))
    found = [one for one in moved.report["findings"] if one["what"] == "CALL"]
    assert [one["point"] for one in found] == ([name] if name else [])
    assert moved.code == ExitCode.REFUSED or not name
    assert not name or "moves by 36.40 mm" in found[0]["text"]


def _move_folder(folder: Path, project: str = "") -> int:
    place = folder / "project.toml"
    place.write_text(
        (CASES / "fanuc" / "project.toml").read_text().replace("[robot]", project + "[robot]", 1)
    )
    words = ["move", folder / "programs", "--project", place, "--offset", SHIFTED, "--out", folder / "out"]
    return run_command_line(["program", *map(str, words)])


def _write_listing(folder: Path, name: str, *lines: str) -> None:
    (folder / "programs").mkdir(exist_ok=True)
    text = fanuc("PR[3,3]=50", "L P[1] 99mm/sec FINE", *lines).replace("OFFPR", name)
    (folder / "programs" / f"{name}.LS").write_text(text)


def test_a_given_program_and_one_that_the_project_names_are_no_findings(tmp_path: Path):
    _write_listing(tmp_path, "MAIN", "CALL SEAL")
    assert _move_folder(tmp_path) == ExitCode.REFUSED
    (tmp_path / "a").mkdir()
    _write_listing(tmp_path / "a", "MAIN", "CALL SEAL")
    assert _move_folder(tmp_path / "a", 'programs_without_motion = ["seal*"]\n') == ExitCode.PASS
    (tmp_path / "b").mkdir()
    _write_listing(tmp_path / "b", "MAIN", "CALL SEAL")
    _write_listing(tmp_path / "b", "SEAL")
    assert _move_folder(tmp_path / "b") == ExitCode.PASS


@pytest.mark.parametrize(
    ("find", "text", "names"),
    [
        (called_programs, "/PROG A\n/MN\n 1: !CALL NO ;\n 2: IF R[1]=1,CALL P2 ;\n 3: Pick Tool ;\n 4: Hand Open ;\n/POS\n", ["P2", "Pick Tool"]),
        (called_procedures, 'MODULE M\nRECORD r\nnum a;\nENDRECORD\nPROC main()\nCASE 1: rA\\Fast,3;\nIF di1=1 rB;\nx:=3;\nIF a GOTO l1;\nl1:\nTPWrite "5% of 7%";\n%"rC"+s%;\nENDPROC\nENDMODULE\n', ["rA", "rB", '%"rC"+s%']),
        (called_routines, "DEF a()\n;FOLD SET GRP;%{PE}%MKUKATPGRP\nH51(1)\n;ENDFOLD\nINTERRUPT DECL 3 WHEN $IN[1] DO hit()\nRSI_ON(#ABSOLUTE)\nRSI_Control(TRUE)\ngo_on(1)\nx[2]=f(3)\nEND\n", ["hit", "RSI_Control", "go_on"]),
        (called_functions, 'def a():\n  textmsg("p()") # q()\n  if (x): do_it() end\n  pick()\n  y = drop(2) + cam.move(1)\nend\n', ["pick", "drop"]),
        (called_jobs, "/JOB\n//INST\nNOP\n'CALL JOB:NO\nCALL JOB:A IF IN#(1)=ON\nPSTART JOB:B SUB1\nEND\n", ["A", "B"]),
    ],
)  # fmt: skip
def test_calls_are_found_where_they_stand(find, text, names):
    assert [one.name for one in find(text.encode())] == names


def test_script_nodes_of_a_program_of_polyscope_call_what_it_does_not_hold():
    node = "<Script><cachedContents>def own():&#xD;\nend\nown()\npick_part(3)\ntextmsg(&quot;drop(1)&quot;)</cachedContents></Script>"
    data = f"<URProgram>\n{node}<Wait name='pick(2)'/>\n</URProgram>".encode()
    assert [(one.line, one.name) for one in called_functions(data)] == [(4, "own"), (5, "pick_part")]
    assert own_functions(data) == {"OWN"}


@pytest.mark.parametrize(
    ("name", "still"),
    [
        ("OPEN_GRIPPER", True), ("rInit", True), ("VAC_ON", True), ("msgShow", True), ("GO_HOME", True),
        ("GLUE_ON", True), ("CALC_OFFS", True), ("Greifer_auf", True), ("Pick2", False), ("OpenDoorMove", False),
        ("GLUE_SEAM", False), ("MAIN", False), ("CheckPick", False), ("XYZ", False), ("GRIPPER_CHANGE", False),
    ],
)  # fmt: skip
def test_a_name_says_that_nothing_moves(name, still):
    assert moves_no_robot(name) is still


def test_the_first_statement_of_a_rapid_function_is_a_call() -> None:
    text = b"MODULE m\nFUNC bool done(num n)\n  PickPart n;\nRETURN TRUE;\nENDFUNC\nENDMODULE\n"
    assert [(each.line, each.name) for each in called_procedures(text)] == [(3, "PickPart")]
