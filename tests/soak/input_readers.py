"""Every input of files and messages: valid examples, and the reader that the program uses for them.

A reader may refuse with a `CellError` or an `OSError`; anything else would be a trace on a user's terminal.
"""

import json
import shutil
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from cellcal.calibration.arm.kinematics import load_model
from cellcal.calibration.arm.urdf import bare_urdf, read_urdf
from cellcal.calibration.points.alignment import read_alignments
from cellcal.drivers.program_registry import read_program
from cellcal.drivers.yaskawa.absolute_data import read_absolute_data
from cellcal.drivers.yaskawa.tool_file import read_tools
from cellcal.service.configuration.cell_file import read_cell_file
from cellcal.service.configuration.cell_shapes import read_cell_shape
from cellcal.service.demo.fake_cell import write_cell_file
from cellcal.service.engineering.identification.at_points import AtOptions, read_points
from cellcal.service.engineering.identification.identify_start import StartOptions, read_start
from cellcal.service.engineering.identification.pose_planning import read_joints
from cellcal.service.engineering.measured.cells import describes_a_cell, read_cell_layout
from cellcal.service.engineering.measured.layouts import read_layout
from cellcal.service.engineering.measured.measurements import read_measurements
from cellcal.service.engineering.measured.tag_files import read_description, read_tags
from cellcal.service.engineering.parameters.parameter_files import SetOrigin, import_file
from cellcal.service.engineering.parameters.parameter_set import (
    ParameterSet,
    ParameterValue,
    parse_set,
    to_text,
)
from cellcal.service.engineering.parameters.parameter_sets import ParameterSets
from cellcal.service.engineering.parameters.ur_files import read_calibration_conf, write_primary_kinematics
from cellcal.service.engineering.programs.project import read_project
from cellcal.service.engineering.programs.project_arms import nominal_arm
from cellcal.service.export.restore import prove_backup
from cellcal.service.record.signing import check_document, station_key
from cellcal.service.runs.photos import plain_picture
from tests.programs.fuzz import generator_sources

ROOT = Path(__file__).parents[2]
_DOOR_LINE = ROOT / "deploy" / "example_projects" / "door_line"
_MODELS = ROOT / "calibration" / "arm" / "robot_models"
Read = Callable[[Path], object]


@dataclass(frozen=True)
class InputReader:
    """One input: examples that are valid, the name of the file, and its reader."""

    name: str
    file: str
    examples: tuple[bytes, ...]
    read: Read


def file_readers(scratch: Path) -> Iterator[InputReader]:
    """Yield every input; ``scratch`` is a folder for what readers need beside the file."""
    yield from _configuration_readers(scratch)
    yield from _measurement_readers()
    yield from _parameter_readers(scratch)
    yield from _program_readers()
    yield from _controller_readers()
    yield from _signed_readers(scratch)


def _configuration_readers(scratch: Path) -> Iterator[InputReader]:
    cell = write_cell_file(scratch / "cell", "127.0.0.1", seed=1, time_factor=20.0)
    yield InputReader("cell file", "cell.toml", (Path(cell).read_bytes(),), read_cell_file)
    project = scratch / "project"
    shutil.copytree(_DOOR_LINE / "cell_1", project)
    examples = tuple(p.read_bytes() for p in sorted(ROOT.glob("tests/data/field_cases/*/project.toml")))
    here = (project / "project.toml").read_bytes()
    yield InputReader("project", "project/project.toml", (here, *examples), read_project)
    layouts = tuple(p.read_bytes() for p in sorted(ROOT.glob("deploy/layouts/*.toml")))
    yield InputReader("layout", "layout.toml", layouts, read_layout)
    cells = tuple(p.read_bytes() for p in sorted(ROOT.glob("deploy/layouts/cells/*.toml")))
    yield InputReader(
        "layout of a cell", "layout.toml", cells, lambda p: describes_a_cell(p) and read_cell_layout(p)
    )
    models = tuple(p.read_bytes() for p in sorted(_MODELS.glob("*.toml")))
    yield InputReader("robot model", "robot.toml", models, lambda p: nominal_arm(p, "own"))
    arm = load_model("fanuc_m6ib")
    shape = b'margin_mm = 20\n[[sphere]]\nname = "post"\ncentre_in_base_mm = [900, 0, 300]\nradius_mm = 50\n'
    yield InputReader("cell shape", "shape.toml", (shape,), lambda p: read_cell_shape(p, arm))
    urdf = bare_urdf(load_model("ur5e")).encode()
    yield InputReader(
        "URDF", "arm.urdf", (urdf,), lambda p: read_urdf(read_description(p), tip_link="flange")
    )
    alignment = (_DOOR_LINE / "cell_1" / "door_fixture.aln.json").read_bytes()
    yield InputReader(
        "alignments", "a.json", (alignment,), lambda p: read_alignments(p.read_text(encoding="latin-1"))
    )


def _measurement_readers() -> Iterator[InputReader]:
    arm = load_model("fanuc_m6ib")
    rows = tuple(p.read_bytes()[:6000] for p in sorted(ROOT.glob("tests/data/foreign_files/*")))
    yield InputReader("measurements", "rows.csv", rows, lambda p: read_measurements(p, arm))
    head = "name," + ",".join(f"q{i}_deg" for i in range(1, 7)) + ",x_mm,y_mm,z_mm,qw,qx,qy,qz"
    lines = [f"t{i},10,20,30,{i},50,60,{900 + i},{i * 3},400,1,0,0,0" for i in range(12)]
    tags = "\n".join([head, *lines]).encode()
    yield InputReader("tags", "tags.csv", (tags,), read_tags)
    points = "\n".join([head.replace("name,", "target,"), *lines]).encode()
    yield InputReader("points", "at.csv", (points,), lambda p: read_points(AtOptions(p), 6))
    yield InputReader("poses", "poses.csv", (points,), lambda p: read_joints(p, 6))
    yield InputReader("workbook", "rows.xlsx", (_workbook_bytes(),), lambda p: read_measurements(p, arm))


def _workbook_bytes() -> bytes:
    import io

    from openpyxl import Workbook

    book = Workbook()
    sheet = book.active
    assert sheet is not None
    sheet.append([f"q{i}_deg" for i in range(1, 7)] + ["x_mm", "y_mm", "z_mm"])
    for i in range(10):
        sheet.append([10 + i, 20, 30, 40, 50 - i, 60, 900.5 + i, 100, 300])
    out = io.BytesIO()
    book.save(out)
    return out.getvalue()


def _parameter_readers(scratch: Path) -> Iterator[InputReader]:
    ur, conf = load_model("ur5e"), ROOT / "tests" / "data" / "field_cases" / "ur" / "good_conf_large_d"
    confs = (
        tuple(p.read_bytes() for p in sorted(conf.rglob("*")) if p.is_file())
        if conf.is_dir()
        else (conf.read_bytes(),)
    )
    who = SetOrigin("R-1", "anna", "2026-01-01T00:00:00+00:00", "")
    sets = scratch / "sets"

    def import_parameters(path: Path) -> object:
        shutil.rmtree(sets, ignore_errors=True)
        return import_file(ParameterSets(sets), path, ur, who)

    yield InputReader("calibration.conf", "calibration.conf", confs, import_parameters)
    try:
        stream = write_primary_kinematics(read_calibration_conf(confs[0].decode(), ur))
        yield InputReader("primary interface", "primary.bin", (stream,), import_parameters)
    except ValueError:
        pass
    report = json.dumps({
        "robot": "ur5e",
        "parameters": [
            {"name": "a2", "unit": "m", "value": 1e-4, "sigma": 1e-5, "prior": 1e-3, "held": False},
        ],
        "places": {"kind": "point", "flange_tool": np.eye(4).tolist(), "devices": [
            {"device_base": np.eye(4).tolist(), "anchor_in_base_m": [1, 0, 0], "zero_m": 0.0, "scale": 1.0}]},
    }).encode()  # fmt: skip
    yield InputReader("report as parameters", "report.json", (report,), import_parameters)
    yield InputReader(
        "report as start", "s.json", (report,), lambda p: read_start(StartOptions(str(p)), ur, "point")
    )
    draft = ParameterSet(
        "R-1",
        "ur5e",
        "0",
        "2026-01-01T00:00:00Z",
        "anna",
        "test",
        (ParameterValue("a1", "m", 1e-4, 1e-5),),
        version=1,
    )
    text = to_text(draft).encode()
    yield InputReader("parameter set", "v0001.toml", (text,), import_parameters)
    yield InputReader(
        "parameter set alone", "v0001.toml", (text,), lambda p: parse_set(p.read_text(encoding="latin-1"))
    )


def _program_readers() -> Iterator[InputReader]:
    for source in generator_sources():
        examples = tuple(source.generate(seed) for seed in range(8))
        name = f"A{source.suffix}"
        yield InputReader(
            f"program {source.name}", name, examples, lambda p: read_program(p.name, p.read_bytes())
        )


def _controller_readers() -> Iterator[InputReader]:
    home = b"//ABSO\r\n///RBPRM 1,63,0\r\n1,-52,1,-81234,1,70125,1,4903\r\n1,-11020,1,-79008,0,0,0,0\r\n"
    tool = b"//TOOL 0\r\n///NAME\r\n0.0,0.0,100.0,0.0,0.0,0.0\r\n0.0,0.0,0.0\r\n1.5\r\n0.0,0.0,0.0\r\n0,0\r\n"
    yield InputReader(
        "home positions of Yaskawa", "ABSO.DAT", (home,), lambda p: read_absolute_data(p.read_text("latin-1"))
    )
    yield InputReader("tools of Yaskawa", "TOOL.CND", (tool,), lambda p: read_tools(p.read_text("latin-1")))


def _signed_readers(scratch: Path) -> Iterator[InputReader]:
    key = station_key(scratch / "station")
    signed = key.sign_document("cellcal test 1", {"a": 1.5, "b": ["x", None, True], "c": {"d": "é"}}).encode()
    yield InputReader("signed document", "c.json", (signed,), lambda p: check_document(p.read_bytes()))
    archive = _archive_bytes(scratch)
    yield InputReader("backup", "b.cellcal-backup", (archive,), prove_backup)
    png = (
        b"\x89PNG\r\n\x1a\n\x00\x00\x00\rIHDR\x00\x00\x00\x08\x00\x00\x00\x08\x08\x02\x00\x00\x00KmT\x82"
        b"\x00\x00\x00\x02IDATxx\x00\x00\x00\x00\x00\x00\x00\x00IEND\xaeB`\x82"
    )
    yield InputReader("picture", "p.png", (png,), lambda p: plain_picture(p.read_bytes()))


def _archive_bytes(scratch: Path) -> bytes:
    from cellcal.service.export.archive import write_archive

    source = scratch / "journal.db"
    source.write_bytes(b"SQLite format 3\0" + b"\0" * 500)
    made = scratch / "made.cellcal-backup"
    content = {"cell": "demo", "journal": {"events": 0, "head": ""}}
    write_archive(
        made, {"data/journal.db": source, "cell.toml": source}, content, station_key(scratch / "station")
    )
    return made.read_bytes()


@contextmanager
def place_file(reader: InputReader, scratch: Path, content: bytes) -> Iterator[Path]:
    """Yield a file of a content under the input's name."""
    path = scratch / reader.file
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(content)
    yield path
