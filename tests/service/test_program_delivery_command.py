"""``cellcal program fetch | compare | deliver | restore`` with an engineer's approval."""

import io
import json
from collections.abc import Callable
from pathlib import Path

import pytest

from cellcal.calibration.errors import CellError
from cellcal.drivers.fanuc.controller_files.program_digests import groups_of
from cellcal.service.cli.app import run_command_line
from cellcal.service.engineering.delivery.comparison import read_programs

CELL = """\
[cell]
name = "cell-7"
data_dir = "{folder}/data"

[[robot]]
name = "r"
driver = "fanuc_rmi"
address = "127.0.0.1"
model = "fanuc_m6ib"
serial = "F-1"
speed_limit_rad_s = 0.3
"""
RunCommand = Callable[..., tuple[int, str]]


@pytest.fixture
def run_cellcal(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> RunCommand:
    def run_command(*arguments: object, typed: str = "") -> tuple[int, str]:
        monkeypatch.setattr("sys.stdin", io.StringIO(typed))
        code = run_command_line(tuple(map(str, arguments)))
        return code, capsys.readouterr().out

    return run_command


@pytest.fixture
def share(tmp_path: Path) -> Path:
    """The share of a controller with one program."""
    (tmp_path / "share").mkdir()
    (tmp_path / "share" / "main.src").write_text("DEF main()\nEND\n")
    (tmp_path / "new").mkdir()
    (tmp_path / "new" / "main.src").write_text("DEF main()\n; moved\nEND\n")
    return tmp_path / "share"


@pytest.fixture
def approval(tmp_path: Path, run_cellcal: RunCommand) -> tuple[object, ...]:
    cell = tmp_path / "cell.toml"
    cell.write_text(CELL.format(folder=tmp_path))
    for name, role, pin in (("Eva", "engineer", "Klemmring-47-Halle"), ("Tim", "technician", "271828")):
        add = ("people", "add", name, "--cell", cell, "--role", role, "--secret-stdin")
        assert run_cellcal(*add, typed=f"{pin}\n")[0] == 0
    return ("--cell", cell, "--secret-stdin", "--copies", tmp_path / "copies")


def test_programs_go_there_and_back(
    tmp_path: Path, share: Path, approval: tuple[object, ...], run_cellcal: RunCommand
) -> None:
    code, out = run_cellcal("program", "fetch", share, "--out", tmp_path / "out", "--json")
    assert code == 0
    (fetched,) = json.loads(out)["controllers"]
    assert (Path(fetched["folder"]) / "main.src").read_bytes() == (share / "main.src").read_bytes()
    compare = ("program", "compare", share, tmp_path / "new")
    assert run_cellcal(*compare)[0] == 3
    deliver = ("program", "deliver", share, tmp_path / "new" / "main.src", *approval, "--approved-by", "Eva")
    assert (
        run_cellcal(*deliver, typed="Klemmring-47-Halle\n")[0] == 4
    )  # nothing tells whether the robot stands
    code, out = run_cellcal(*deliver, "--robot-stands", "--json", typed="Klemmring-47-Halle\n")
    assert code == 0
    delivery = json.loads(out)
    assert (delivery["state"], delivery["approved_by"]) == ("delivered", "Eva")
    assert run_cellcal(*compare)[0] == 0
    assert run_cellcal("verify", Path(delivery["folder"]) / "delivery.json")[0] == 0
    restore = (
        "program",
        "restore",
        delivery["folder"],
        *approval[:3],
        "--approved-by",
        "Eva",
        "--robot-stands",
    )
    assert run_cellcal(*restore, typed="Klemmring-47-Halle\n")[0] == 0
    assert (share / "main.src").read_text() == "DEF main()\nEND\n"


@pytest.mark.parametrize(
    ("name", "pin"), [("Tim", "271828"), ("Eva", "000000"), ("Nob", "Klemmring-47-Halle")]
)
def test_only_an_engineer_with_the_right_pin_approves(
    tmp_path: Path, share: Path, approval: tuple[object, ...], run_cellcal: RunCommand, name: str, pin: str
) -> None:
    deliver = (
        "program",
        "deliver",
        share,
        tmp_path / "new",
        *approval,
        "--approved-by",
        name,
        "--robot-stands",
    )
    assert run_cellcal(*deliver, typed=f"{pin}\n")[0] == 4
    assert (share / "main.src").read_text() == "DEF main()\nEND\n"
    assert not (tmp_path / "copies").exists()


def test_a_program_that_was_changed_since_is_restored_only_on_request(
    tmp_path: Path, share: Path, approval: tuple[object, ...], run_cellcal: RunCommand
) -> None:
    pin, eva = "Klemmring-47-Halle\n", ("--approved-by", "Eva", "--robot-stands")
    deliver = ("program", "deliver", share, tmp_path / "new" / "main.src", *approval, *eva, "--json")
    code, out = run_cellcal(*deliver, typed=pin)
    assert code == 0
    (share / "main.src").write_text("DEF main()\n; taught anew\nEND\n")
    restore = ("program", "restore", json.loads(out)["folder"], *approval[:3], *eva)
    assert run_cellcal(*restore, typed=pin)[0] == 4
    assert (share / "main.src").read_text() == "DEF main()\n; taught anew\nEND\n"
    assert run_cellcal(*restore, "--changed-too", typed=pin)[0] == 0
    assert (share / "main.src").read_text() == "DEF main()\nEND\n"
    copied = [path.read_text() for path in (tmp_path / "copies").glob("*/old/main.src")]
    assert "DEF main()\n; taught anew\nEND\n" in copied


def test_a_fetch_of_no_program_is_no_success(tmp_path: Path, run_cellcal: RunCommand) -> None:
    (tmp_path / "share" / "R1" / "Program").mkdir(parents=True)
    assert run_cellcal("program", "fetch", tmp_path / "share", "--out", tmp_path / "out")[0] != 0


def test_a_comparison_names_what_it_does_not_look_at(
    share: Path, tmp_path: Path, run_cellcal: RunCommand
) -> None:
    """Folders below, an odd name, a name that is not there, two that a controller takes for one."""
    here = tmp_path / "here"
    for folder in (here, share):
        (folder / "cell 2").mkdir(parents=True)
        (folder / "cell 2" / "deep.src").write_bytes(folder.name.encode())
        (folder / "pick and place.src").write_bytes(b"DEF PICK( )")
    for file in share.iterdir():
        if file.is_file():
            (here / file.name).write_bytes(file.read_bytes())
    code, out = run_cellcal("program", "compare", share, here, "--json")
    found = json.loads(out)
    assert (code, set(found["programs"].values())) == (0, {"same"})
    assert found["not_compared"] == {"on the controller": ["cell 2"], "here": ["cell 2"]}
    (here / "MAIN.SRC").write_bytes(b"")
    for paths, why in (
        ((tmp_path / "nothere",), "cannot be read"),
        ((), "no program"),
        ((here,), "one name for"),
    ):
        with pytest.raises(CellError, match=why):
            read_programs(paths)


@pytest.mark.parametrize(
    ("head", "is_same"),
    [("1,*,*,*,*", True), ("1,*,*,*,*,*,*,*", True), ("1,1,*,*,*", False), ("*,1,*,*,*", False)],
)
def test_a_listing_of_another_motion_group_is_another_program(head: str, is_same: bool) -> None:
    text = "/PROG  A\n/ATTR\nDEFAULT_GROUP\t= {};\n/MN\n   1:  ;\n/POS\n/END\n"
    sent, read = (text.format(one).encode() for one in ("1,*,*,*,*", head))
    assert (groups_of(sent) == groups_of(read)) is is_same
