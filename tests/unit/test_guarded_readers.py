"""What a document may hold, and that nothing in the program reads one past its guarded reader."""

import ast
import gzip
import os
import re
from pathlib import Path

import pytest

from cellcal.calibration.documents import DocumentError
from cellcal.calibration.documents.csv_text import parse_rows, split_row
from cellcal.calibration.documents.gzip_bytes import unpack_gzip
from cellcal.calibration.documents.json_text import parse_json
from cellcal.calibration.documents.plain_files import read_plain_bytes, read_plain_text, text_of
from cellcal.calibration.documents.toml_text import parse_toml
from cellcal.calibration.documents.xml_text import parse_xml
from cellcal.calibration.documents.zip_archives import open_zip
from cellcal.drivers.programs.errors import ProgramFileError
from cellcal.service.engineering.programs.files import read_bytes
from cellcal.service.unexpected_errors import explain_os_error

ROOT = Path(__file__).parents[2]
READERS = {
    "json": {"load", "loads", "JSONDecoder"},
    "orjson": {"loads"},
    "tomllib": {"load", "loads"},
    "csv": {"reader", "DictReader"},
    "gzip": {"open", "GzipFile", "decompress"},
    "zlib": {"decompress", "decompressobj"},
    "pickle": {"load", "loads"},
    "yaml": {"load", "safe_load"},
    "zipfile": {"ZipFile"},
    "tarfile": {"open"},
}
FORBIDDEN_NAMES = {"fromstring", "iterparse", "XMLParser", "ZipFile", "GzipFile", "genfromtxt", "loadtxt"}
METHODS = {"read_text", "read_bytes"}
# A file without any of these words is not parsed.
READER_WORD = re.compile(rf"\b(?:{'|'.join({*READERS, *FORBIDDEN_NAMES, *METHODS, 'open'})})\b")
# Where a library is used for its own package's data, for a channel between our own processes, or to write.
ALLOWED = {
    "calibration/documents": READERS.keys() | FORBIDDEN_NAMES | METHODS,
    "calibration/reference_data/__init__.py": {"read_text"},
    "drivers/draw_wire/modbus_registers.py": {"read_text"},
    "drivers/draw_wire/objects.py": {"read_text"},
    "drivers/modbus_robot/profile.py": {"read_text"},
    "drivers/touch_probe/registers.py": {"read_text"},
    "drivers/wire/tables.py": {"read_text", "csv"},
    "drivers/wire/child.py": {"json"},
    "drivers/universal_robots/program_files/urp_archive.py": {
        "zlib"
    },  # has limits of its own: ratio and size
    "service/engineering/bench/child.py": {"numpy"},
    "service/engineering/bench/real.py": {"read_text"},
    "service/certificates/pdf.py": {"read_bytes"},
    "service/export/archive.py": {"tarfile"},  # the one guarded reader of backups
    "service/export/cell_metrics.py": {"read_text"},  # /proc
    "service/web/liveness.py": {"read_text"},  # /proc
    "service/runs/software_identity.py": {"read_bytes"},
    "service/engineering/programs/jobs/preview.py": {"zipfile", "ZipFile"},  # writes
    "drivers/yaskawa/program_files/job_columns.py": {"fromstring"},  # of NumPy: one number after the other
}


def _reader_names(path: Path) -> set[str]:
    """Return what a module reads formats with."""
    found: set[str] = set()
    text = path.read_text(encoding="utf-8")
    if not READER_WORD.search(text):
        return found
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.ImportFrom) and node.module in READERS:
            found |= {node.module for name in node.names if name.name in READERS[node.module]}
        if not isinstance(node, ast.Call):
            continue
        called = node.func
        if isinstance(called, ast.Name) and called.id in FORBIDDEN_NAMES:
            found.add(called.id)
        if isinstance(called, ast.Attribute):
            module = called.value.id if isinstance(called.value, ast.Name) else ""
            if called.attr in READERS.get(module, ()):
                found.add(module)
            if called.attr in METHODS | FORBIDDEN_NAMES:
                found.add(called.attr)
            if called.attr == "open" and _reads_a_path(node):
                found.add("open")
        if isinstance(called, ast.Name) and called.id == "open" and _open_mode(node)[:1] == "r":
            found.add("open")
    return found


def _reads_a_path(call: ast.Call) -> bool:
    words = [arg.value for arg in call.args if isinstance(arg, ast.Constant)]
    return any(word in ("r", "rb", "rt") for word in words) or any(
        k.arg == "newline" for k in call.keywords
    ) * (not {"w", "x", "a", "wb", "xb"} & set(words))


def _open_mode(call: ast.Call) -> str:
    modes = [arg.value for arg in call.args[1:2] if isinstance(arg, ast.Constant)]
    return str(modes[0]) if modes else "r"


# Opened for a hash, a copy or a lock, in pieces; nothing is parsed.
OPENED = {
    "drivers/file_import/rows.py": {"open"},  # looks at the kind of file and its size itself
    "drivers/wire/sftp_link.py": {"open"},  # a file of a controller, within a limit
    "service/demo/built_pages.py": {"open"},
}


def test_no_format_is_read_past_its_guarded_reader() -> None:
    wrong = {}
    for package in ("calibration", "drivers", "procedures", "service"):
        for path in sorted((ROOT / package).rglob("*.py")):
            name = path.relative_to(ROOT).as_posix()
            allowed = {word for place, words in ALLOWED.items() if name.startswith(place) for word in words}
            rest = _reader_names(path) - allowed - OPENED.get(name, set())
            if rest:
                wrong[name] = sorted(rest)
    assert wrong == {}


@pytest.mark.parametrize(
    "source",
    [
        "json.loads(x)",
        "from csv import reader",
        "p.read_text()",
        "open(p)",
        "p.open('rb')",
        "ET.fromstring(x)",
    ],
)
def test_another_reader_would_be_seen(tmp_path: Path, source: str) -> None:
    (tmp_path / "m.py").write_text(source)
    assert _reader_names(tmp_path / "m.py")


@pytest.mark.parametrize(
    "text",
    ["[" * 100_000, "[" * 65 + '"' + '\\"' * 300_000, '{"a": NaN}', "[-Infinity]", "1e999", "9" * 5000,
     "1" + "0" * 30, '"\\ud800"', '{"\\udfff": 1}', "\ud800", "", "{", '{"a":' * 60_000,
     '{"a": 1, "a": 2}', '[{"b": {"a": [], "a": {}}}]'],
)  # fmt: skip
def test_no_json_past_the_limits(text: str) -> None:
    with pytest.raises(DocumentError, match="not valid JSON"):
        parse_json(text)


def test_json_within_the_limits_is_as_it_was() -> None:
    assert parse_json(b'\xef\xbb\xbf[18446744073709551615, -9223372036854775808, 1.5, "\\ud83d\\ude00", null]') == [
        2**64 - 1, -(2**63), 1.5, "😀", None,
    ]  # fmt: skip
    assert parse_json("[" * 64 + "]" * 64) is not None
    assert parse_json('{"a": 1, "b": 2, "a": 1}') == {"a": 1, "b": 2}


@pytest.mark.parametrize(
    "text",
    ["a." * 200_000 + "a = 1", "a = " + "[" * 1000, "a = inf", "a = -nan", "a = 1e999", "a = " + "1" * 5000,
     "a = 0x" + "f" * 5000, 'a = "\\ud800"', "a = 2026-13-40", 'a = "' + '\\"' * 400_000, "x" * 1_000_001,
     "{" * 5000, "[" * 500_000],
)  # fmt: skip
def test_no_toml_past_the_limits(text: str) -> None:
    with pytest.raises(DocumentError, match="not valid TOML"):
        parse_toml(text)


def test_toml_within_the_limits_is_as_it_was() -> None:
    text = '\ufeffa = """\n' + "." * 100 + '"""\n[b.c]\nd = [1.5, 2.5, "............................"]\n'
    assert parse_toml(text)["b"]["c"]["d"][1] == 2.5
    with pytest.raises(DocumentError) as refused:
        parse_toml("[robot]\nspeeds = [1.0, nan]")
    assert refused.value.key == "robot.speeds[1]"


@pytest.mark.parametrize(
    "text",
    ['<!DOCTYPE a [<!ENTITY b "c">]><a>&b;</a>', "<a>" * 100_000, "<a>" * 200 + "</a>" * 200, "<a", "\ud800",
     b'<?xml version="1.0" encoding="martian"?><a/>', "<a>&b;</a>"],
)  # fmt: skip
def test_no_xml_past_the_limits(text: str | bytes) -> None:
    with pytest.raises(DocumentError, match="no XML"):
        parse_xml(text)


def test_cells_and_packed_data_have_limits() -> None:
    for read in (parse_rows, split_row):
        with pytest.raises(DocumentError, match="separated values"):
            read("a" * 140_000)
    bomb = gzip.compress(b"\0" * 20_000_000)
    with pytest.raises(DocumentError, match="unpacks to more"):
        unpack_gzip(bomb, 1_000_000)
    for damaged in (bomb[:-9], bomb + b"x", b"\x1f\x8b\x08"):
        with pytest.raises(DocumentError):
            unpack_gzip(damaged, 30_000_000)
    with pytest.raises(DocumentError):
        open_zip(b"PK\x03\x04")


def _open_descriptors() -> int:
    return len(list(Path("/proc/self/fd").iterdir()))


def test_a_file_that_cannot_be_read_is_named_and_no_descriptor_is_lost(tmp_path: Path) -> None:
    unreadable = Path("/proc/self/mem")  # a plain file whose first byte gives an input or output error
    taken = _open_descriptors()
    for path, kind in ((tmp_path, IsADirectoryError), (unreadable, OSError)):
        for _ in range(3):
            with pytest.raises(kind) as refused:
                read_plain_bytes(path)
            assert refused.value.filename == os.fspath(path)
            assert explain_os_error(refused.value)[0].startswith(f"{path}: ")
    assert _open_descriptors() == taken


def test_only_plain_files_of_a_size_are_read(tmp_path: Path) -> None:
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    for unusual in (pipe, Path("/dev/zero"), Path("/dev/null"), Path("a\0b")):
        with pytest.raises(DocumentError):
            read_plain_bytes(unusual)
    with pytest.raises(IsADirectoryError):
        read_plain_bytes(tmp_path)
    large = tmp_path / "large"
    large.write_bytes(b"x" * 2001)
    with pytest.raises(DocumentError, match="larger than 2 kB") as refused:
        read_plain_bytes(large, 2000)
    assert refused.value.message == f"{large} cannot be used: it is larger than 2 kB."
    for raw, text in (
        ("ä".encode("utf-16"), "ä"),
        ("ä".encode("utf-8-sig"), "ä"),
        (b"\xff", None),
        (b"a\0", None),
    ):
        large.write_bytes(raw)
        if text is None:
            with pytest.raises(DocumentError, match="not text"):
                read_plain_text(large)
        else:
            assert read_plain_text(large) == text


@pytest.mark.parametrize("digits", [20, 400, 4300, 6000, 100_000])
@pytest.mark.parametrize("shape", ["a = {}", "[t]\nb = [1, {}]", "a = -{}", "# 1{}\na = {}"])
def test_a_whole_number_is_refused_in_our_own_words_however_long_it_is(digits: int, shape: str) -> None:
    with pytest.raises(DocumentError) as refused:
        parse_toml(shape.format(*["9" * digits] * 2))
    assert "a whole number is larger than 64 bits" in refused.value.message
    assert "sys." not in refused.value.message
    assert len(refused.value.message) < 200


@pytest.mark.parametrize(
    "pointer",
    [
        "version https://git-lfs.github.com/spec/v1\noid sha256:4d7a214614ab2935c943f9e0ff69d22e\nsize 12345\n",
        "/annex/objects/SHA256E-s12345--4d7a214614ab2935c943f9e0ff69d22e.csv\n",
    ],
    ids=["git-lfs", "git-annex"],
)
def test_a_pointer_to_a_file_that_was_not_downloaded_is_called_so(pointer: str, tmp_path: Path) -> None:
    path = tmp_path / "arm.urdf"
    path.write_text(pointer, encoding="ascii")
    for read in (read_plain_bytes, read_plain_text):
        with pytest.raises(DocumentError, match="was not downloaded") as refused:
            read(path)
        assert "git lfs pull" in refused.value.remedy
    with pytest.raises(DocumentError, match="was not downloaded"):
        text_of(pointer.encode())  # what a page uploads
    with pytest.raises(ProgramFileError, match="was not downloaded") as left:
        read_bytes(path)
    assert left.value.remedy == refused.value.remedy


def test_a_text_about_pointers_is_read(tmp_path: Path) -> None:
    path = tmp_path / "notes.txt"
    path.write_text("see /annex/objects/ and version https://git-lfs.github.com/spec/v1\n", encoding="ascii")
    assert read_plain_text(path).startswith("see")
