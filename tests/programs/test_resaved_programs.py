"""Programs in a folder that an editor saved in another encoding are refused by name, never passed over."""

import json
from pathlib import Path

import pytest

from cellcal.service.cli.app import run_command_line
from cellcal.service.exit_codes import ExitCode
from tests.programs.test_abb_passed_targets import BOTH, MODULE
from tests.programs.test_abb_passed_targets import PROJECT as ABB_PROJECT
from tests.programs.test_fanuc_copied_frames import PROJECT, START, listing

TEXTS = {
    "b.LS": (PROJECT, listing(*START, "L P[1] 100mm/sec FINE")),
    "b.mod": (ABB_PROJECT, MODULE.format(BOTH, "")),
}


def move_folder(tmp_path: Path, project: str, files: dict[str, bytes]) -> dict:
    source = tmp_path / "src"
    source.mkdir()
    for name, data in files.items():
        (source / name).write_bytes(data)
    (tmp_path / "project.toml").write_text(project, encoding="utf-8")
    words = [
        "program",
        "move",
        str(source),
        "--project",
        str(tmp_path / "project.toml"),
        "--offset=1,0,0,0,0,0",
    ]
    code = run_command_line([*words, "--out", str(tmp_path / "out"), "--json", str(tmp_path / "r.json")])
    return {**json.loads((tmp_path / "r.json").read_text()), "code": code}


@pytest.mark.parametrize("name", TEXTS)
@pytest.mark.parametrize("encoding", ["utf-16", "utf-16-le", "utf-16-be"])
def test_one_in_utf_16_is_refused_by_name(tmp_path: Path, name: str, encoding: str) -> None:
    project, text = TEXTS[name]
    moved = move_folder(tmp_path, project, {f"a{name[1:]}": text.encode(), name: text.encode(encoding)})
    assert moved["code"] == ExitCode.FILES_REFUSED
    assert [Path(one["file"]).name for one in moved["refused"]] == [name]
    assert "UTF-16" in moved["refused"][0]["message"]
    assert moved["program_count"] == 1


@pytest.mark.parametrize("change", [lambda data: b"\xef\xbb\xbf" + data, bytes.lower])
def test_a_listing_with_a_mark_or_in_small_letters_is_refused_by_name(tmp_path: Path, change) -> None:
    project, text = TEXTS["b.LS"]
    moved = move_folder(tmp_path, project, {"a.LS": text.encode(), "b.LS": change(text.encode())})
    assert moved["code"] == ExitCode.FILES_REFUSED
    assert [Path(one["file"]).name for one in moved["refused"]] == ["b.LS"]


def test_other_files_are_still_passed_over(tmp_path: Path) -> None:
    project, text = TEXTS["b.LS"]
    notes = "notes of a person".encode("utf-16")
    assert move_folder(tmp_path, project, {"a.LS": text.encode(), "b.LS": notes})["code"] == ExitCode.PASS


@pytest.mark.parametrize("suffix", [".modx", ".sysx"])
def test_modules_of_newer_controllers_are_read(tmp_path: Path, suffix: str) -> None:
    project, text = TEXTS["b.mod"]
    moved = move_folder(tmp_path, project, {f"b{suffix}": text.encode()})
    assert (moved["code"], moved["counts"]["changed"]) == (ExitCode.PASS, 2)
    assert (tmp_path / "out" / f"b{suffix}").is_file()
