"""Programs of a folder in a form that is not read: their points stay, and no command calls that complete."""

import json
from pathlib import Path

import pytest

from cellcal.service.cli.app import run_command_line
from cellcal.service.exit_codes import ExitCode
from tests.programs.test_abb_passed_targets import PROJECT, REST
from tests.programs.test_controller_tasks import MOVING


def move_folder(tmp_path: Path, *names: str, beside: bool = True) -> int:
    """Move a folder that holds a module and files of these names; return the exit code."""
    folder = tmp_path / "programs"
    folder.mkdir()
    if beside:
        (folder / "A.mod").write_text(MOVING.format(name="A", rest=REST.replace("-1", "0")), encoding="ascii")
    for name in names:
        (folder / name).write_bytes(b"\x01\x02\x00\x03 no text")
    (tmp_path / "project.toml").write_text(PROJECT, encoding="utf-8")
    words = ["program", "move", folder, "--project", tmp_path / "project.toml", "--offset=0,0,0,0,0,5"]
    words += ["--out", tmp_path / "out", "--json", tmp_path / "r.json"]
    return run_command_line([str(word) for word in words])


@pytest.mark.parametrize(
    ("names", "unread"),
    [
        (["PICK.TP"], ["PICK.TP"]),
        (["cell.urpx", "PLACE.tp"], ["PLACE.tp", "cell.urpx"]),
        (["math.kl"], []),  # a source of KAREL: functions, as a rule without a place of the robot
        (["-BCKED8-.TP"], []),  # what the controller's editor keeps
    ],
)
def test_a_folder_whose_programs_were_not_all_read_is_not_called_complete(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], names: list[str], unread: list[str]
) -> None:
    code = move_folder(tmp_path, *names)
    report = json.loads((tmp_path / "r.json").read_text(encoding="utf-8"))
    assert [Path(file).name for file in report["unread"]] == unread
    assert code == report["exit_code"] == (ExitCode.REFUSED if unread else ExitCode.PASS)
    output = " ".join(capsys.readouterr().out.split())
    assert ("not read, and" in output) == bool(unread)
    assert all(name in output for name in unread)


def test_a_folder_of_unread_programs_alone_says_how_they_are_saved_as_text(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    code = move_folder(tmp_path, "PICK.TP", beside=False)
    assert code == ExitCode.FILES_REFUSED
    assert "PICK.TP" in " ".join(capsys.readouterr().out.split())
