"""Every option of the commands that engineers type says something, or is refused: none is passed over."""

import inspect
from collections.abc import Mapping, Sequence
from dataclasses import fields
from pathlib import Path

import pytest

from cellcal.service.cli import identify, poses, program
from cellcal.service.cli.app import run_command_line
from cellcal.service.cli.delivery import LoginOptions, compare, fetch
from cellcal.service.exit_codes import ExitCode
from tests.unit.helpers.simulated_arm import tracker_points
from tests.unit.test_identify_report import file_of

ALWAYS = "always"  # whatever else is given, its value is read, or refused with what is wrong about it
IDENTIFY: Mapping[str, str | Sequence[str]] = {
    "measurements": ALWAYS, "robot": ALWAYS, "mounting": ALWAYS, "columns": ALWAYS, "joints": ALWAYS,
    "joint_coupling": ALWAYS, "layout": ALWAYS, "show_layout": ALWAYS, "as_json": ALWAYS,
    "level": ("--show-layout", "--level", "2"),
    "check": ("--show-layout", "--check", "other.csv"),
    "train_rows": ("--show-layout", "--train-rows", "20"),
    "seed": ("--show-layout", "--seed", "3"),
    "start": ("--show-layout", "--start", "previous"),
    "free": ("--show-layout", "--free", "offsets"),
    "residual_model": ("--show-layout", "--residual-model"),
    "limit": ("--show-layout", "--limit", "1mm"),
    "accept_offset_sd": ("--show-layout", "--accept-offset-sd", "1deg"),
    "accept_offsets": ("--accept-offsets", "J2 offset"),
    "at": ("--show-layout", "--at", "at.csv"),
    "at_csv": ("--at-csv", "out.csv"),
    "at_convention": ("--at-convention", "fanuc_wpr"),
    "at_identified": ("--at-identified",),
    "dh": ("--show-layout", "--dh"),
    "plot": ("--show-layout", "--plot", "pictures"),
    "units": ("--units", "rotation=deg"),
    "convention": ("--convention", "fanuc_wpr"),
    "sheet": ("--sheet", "Points"),
    "save": ("--show-layout", "--save", "sets"),
    "serial": ("--serial", "4711"),
    "by": ("--by", "Ada"),
    "urdf": ("--show-layout", "--urdf", "arm.urdf"),
    "geometric_joints": ("--geometric-joints",),
    "project_axes": ("--show-layout", "--project-axes", "axes"),
}  # fmt: skip
POSES: Mapping[str, str | Sequence[str]] = {
    "robot": ALWAYS, "sigma_mm": ALWAYS, "kind": ALWAYS, "tool_mm": ALWAYS, "count": ALWAYS, "accept_tip_mm": ALWAYS,
    "accept_worst_tip_mm": ALWAYS, "accept_offset_deg": ALWAYS, "criterion": ALWAYS, "level": ALWAYS,
    "drop_redundant": ALWAYS, "candidates": ALWAYS, "seed": ALWAYS, "after": ALWAYS, "tests": ALWAYS, "shape": ALWAYS,
    "description": ALWAYS, "out": ALWAYS, "as_json": ALWAYS,
    "sigma_deg": ("--sigma-deg", "0.02"),
    "anchor_mm": ("--anchor-mm", "1", "2", "3"),
    "wire_range_mm": ("--kind", "pose", "--wire-range-mm", "1000"),
    "offsets": ("--accept-tip-mm", "0.1", "--offsets", "J2 offset"),
    "tip_link": ("--tip-link", "tool0"),
    "mesh_folder": ("--mesh-folder", "meshes"),
}  # fmt: skip
_OUTPUTS: Mapping[str, str | Sequence[str]] = {
    "out": ALWAYS, "replace": ALWAYS, "json": ALWAYS, "csv": ALWAYS, "html": ALWAYS, "diff": ALWAYS, "top": ALWAYS,
    "language": ("--out", "o", "--language", "de"),
}  # fmt: skip
_MOVE: Mapping[str, str | Sequence[str]] = {
    "files": ALWAYS, "project": ALWAYS, "offset": ALWAYS, "frame": ALWAYS, "joints": ALWAYS, "before": ALWAYS,
    "after": ALWAYS, **_OUTPUTS,
}  # fmt: skip
_REGISTERS: Mapping[str, str | Sequence[str]] = {
    "files": ALWAYS, "project": ALWAYS, "clone": ALWAYS, "offset": ALWAYS,
    "frame": ("--frame", "2"),
    "joints": ("--clone", "other.toml", "--joints", "keep"),
    "out": ("--out", "registers"),
}  # fmt: skip
_LOGIN: Mapping[str, str | Sequence[str]] = {
    "user": ("--user", "Ada"),
    "password_file": ("--password-file", "secret.txt"),
    "certificate": ("--certificate", "shown.pem"),
    "host_keys": ("--host-key", f"SHA256:{'a' * 43}"),
    "timeout_s": ALWAYS,
}
COMMANDS = {
    "identify": (identify.identify, IDENTIFY, ("identify", "{rows}", "--robot", "abb_irb120")),
    "poses": (poses.poses, POSES, ("poses", "--robot", "ur10e", "--sigma-mm", "0.1")),
    "move": (program.move, _MOVE, ("program", "move", "--project", "p.toml", "--offset", "1,2,3")),
    "clone": (program.clone, {"master": ALWAYS, "target": ALWAYS, "files": ALWAYS, **_OUTPUTS},
              ("program", "clone", "a.toml", "b.toml")),
    "compensate": (program.compensate, {"files": ALWAYS, "project": ALWAYS, "download": ALWAYS, **_OUTPUTS},
                   ("program", "compensate", "--project", "p.toml")),
    "inspect": (program.inspect, {"files": ALWAYS, "project": ALWAYS, "points": ALWAYS, "roundtrip": ALWAYS,
                "as_json": ALWAYS, "robot": ("--robot", "ur10e", "--project", "p.toml")}, ("program", "inspect")),
    "status": (program.status, {"projects": ALWAYS, "as_json": ALWAYS}, ("program", "status")),
    "registers": (program.registers, _REGISTERS, ("program", "registers", "--project", "p.toml")),
    "fetch": (fetch, {"addresses": ALWAYS, "out": ALWAYS, "as_json": ALWAYS, **_LOGIN}, ("program", "fetch", ".")),
    "compare": (compare, {"address": ALWAYS, "programs": ALWAYS, "as_json": ALWAYS, **_LOGIN},
                ("program", "compare", ".", "{rows}")),
}  # fmt: skip
IDLE = [
    pytest.param(name, option, id=f"{name} {option}")
    for name, (_, options, _) in COMMANDS.items()
    for option, said in options.items()
    if said != ALWAYS
]


@pytest.mark.parametrize("name", COMMANDS)
def test_every_option_is_known_to_say_something_or_to_be_refused(name: str) -> None:
    command, options, _ = COMMANDS[name]
    found = []
    for parameter in inspect.signature(command).parameters.values():
        grouped = {"outputs": program.ProgramOutputs, "login": LoginOptions}.get(parameter.name)
        found += [parameter.name] if grouped is None else [each.name for each in fields(grouped)]
    assert sorted(found) == sorted(options)


@pytest.fixture(scope="module")
def rows(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return file_of(tracker_points("abb_irb120", 30), tmp_path_factory.mktemp("rows") / "rows.csv")


@pytest.mark.parametrize(("name", "option"), IDLE)
def test_an_option_that_nothing_would_read_is_refused(
    name: str, option: str, rows: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    _, options, begin = COMMANDS[name]
    typed = [word.format(rows=rows) for word in (*begin, *options[option])]
    assert run_command_line(typed) == ExitCode.USAGE
    said = " ".join(capsys.readouterr().err.split())
    assert (
        next(word for word in options[option][::-1] if word.startswith("--") and word != "--show-layout")
        in said
    )
    assert any(why in said for why in ("no effect", "no workbook", "names the robot already"))


def test_an_option_beside_what_it_needs_is_read(rows: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert (
        run_command_line(
            ["identify", str(rows), "--robot", "abb_irb120", "--units", "position=mm", "--show-layout"]
        )
        == 0
    )
    assert 'position = "mm"' in capsys.readouterr().out
