"""The commands as a stranger types them: exit codes, one object on stdout, sentences on stderr."""

import json
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

from cellcal.service.configuration.cell_file import read_cell_file
from tests.machine_speed import stretched_s

ROOT = Path(__file__).parents[2]


def run_cellcal(*words: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "cellcal", *words]
    return subprocess.run(command, capture_output=True, text=True, timeout=stretched_s(280.0), check=False)


def test_help_names_every_command() -> None:
    ended = run_cellcal("--help")
    assert ended.returncode == 0
    for name in (
        "demo",
        "fakes",
        "check",
        "watch",
        "procedures",
        "run",
        "runs",
        "show",
        "resume",
        "certificate",
        "verify",
        "mastering",
        "identify",
        "models",
        "ur-model",
    ):
        assert name in ended.stdout


_REAL_CELL = str(ROOT / "deploy/example_cells/fanuc_draw_wire.toml")


def test_the_version_is_the_packages() -> None:
    declared = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["version"]
    assert run_cellcal("--version").stdout.strip() == declared


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (("dmo",), "demo"),
        (("run", "mastering_record"), "cell"),
        (("check", "/no/such/cell.toml"), "there is no such file"),
        (("models", "ur99"), "ur"),
        (("run", "drift_chek", "--cell", _REAL_CELL), "Did you mean drift_check"),  # and reaches no device
        (("run", "drift_check", "--cell", _REAL_CELL, "--set", "nope=1"), "no setting nope"),
        (
            ("run", "drift_check", "--cell", _REAL_CELL, "-s", "poses=5", "-s", "poses=6"),
            "poses is given twice",
        ),
        (
            ("run", "drift_check", "--cell", _REAL_CELL, "--answers", "/dev/zero"),
            "it is not a plain file. What to do",
        ),
        (("run", "drift_check", "--cell", _REAL_CELL, "--answers", "/no/answers.json"), "/no/answers.json"),
    ],
)
def test_a_wrong_word_is_a_sentence_and_no_trace(words: tuple[str, ...], says: str) -> None:
    ended = run_cellcal(*words)
    assert ended.returncode in (2, 4)
    assert ended.stdout == ""
    assert says in " ".join(ended.stderr.split())
    assert "Traceback" not in ended.stderr


def test_models_as_json_is_one_object() -> None:
    listed = json.loads(run_cellcal("models", "--json").stdout)
    names = {model["name"] for model in listed["models"]}
    assert {
        "ur5e",
        "ur10",
        "ur10e",
        "abb_irb120",
        "fanuc_m6ib",
        "fanuc_r2000ic_165f",
        "kuka_kr6_r900",
    } <= names


def test_procedures_are_listed() -> None:
    listed = json.loads(run_cellcal("procedures", "--json").stdout)
    names = {procedure["name"] for procedure in listed["procedures"]}
    assert {"mastering_record", "mastering_recovery", "six_point_tcp", "three_point_frame"} <= names


@pytest.mark.parametrize(
    "path", sorted((ROOT / "deploy" / "example_cells").glob("*.toml")), ids=lambda p: p.stem
)
def test_the_example_cells_are_valid(path: Path) -> None:
    assert read_cell_file(path).robots


def test_a_cell_that_is_switched_off_is_reported_device_by_device(tmp_path: Path) -> None:
    text = (ROOT / "deploy" / "example_cells" / "fanuc_draw_wire.toml").read_text()
    text = text.replace("192.168.0.20", "127.0.0.1").replace("port = 502 ", "port = 1 ")
    text = text.replace('"/var/lib/cellcal/cell-7"', f'"{tmp_path}"')
    text = text.replace('interface = "socketcan" ', 'interface = "socketcand"\nhost = "127.0.0.1"\nport = 1 ')
    cell = tmp_path / "cell.toml"
    cell.write_text(text)
    ended = run_cellcal("check", str(cell), "--json")
    assert ended.returncode == 5
    report = json.loads(ended.stdout)
    assert not report["all_reached"]
    assert {device["name"]: device["state"] for device in report["devices"]} == {
        "fanuc": "unreachable", "wire": "unreachable"
    }  # fmt: skip
    assert all(device["remedy"] for device in report["devices"])
