"""What nothing foresaw: one sentence, a report for its owner only, exit code 70; libraries stay silent."""

import errno
import logging
import os
import re
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from cellcal.drivers.supervision import Supervisor
from cellcal.service.cli import app as command_line
from cellcal.service.cli.app import run_command_line
from cellcal.service.exit_codes import ExitCode, exit_code_of
from cellcal.service.files import replace_file
from cellcal.service.unexpected_errors import OneLineFormatter, explain_os_error, log_in_lines, run_guarded


def _raise_error(error: BaseException) -> int:
    raise error


@pytest.mark.parametrize(
    "error",
    [RuntimeError("two\nlines [red]x[/red] :robot:"), RecursionError("deep"), KeyError("\ud800"), MemoryError(),
     ExceptionGroup("both", [ZeroDivisionError("x"), ValueError("y")])],
)  # fmt: skip
def test_a_command_that_breaks_says_one_sentence_and_writes_a_report(
    error: Exception, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    monkeypatch.setattr(command_line, "call_command", lambda *_, **__: _raise_error(error))
    assert run_command_line(["models"]) == ExitCode.INTERNAL == 70
    captured = capsys.readouterr()
    assert captured.out == ""
    assert "Traceback" not in captured.err
    reports = sorted(tmp_path.glob("cellcal-report-*.txt"))
    assert len(reports) == (2 if isinstance(error, ExceptionGroup) else 1)
    for report in reports:
        assert str(report) in captured.err
        assert re.search(r"^\w+Error", report.read_text(), re.MULTILINE)
        assert report.stat().st_mode & 0o777 == 0o600
    if isinstance(error, RuntimeError) and not isinstance(error, RecursionError):
        assert "two lines [red]x[/red] :robot:" in captured.err


@pytest.mark.parametrize(
    ("number", "words"),
    [(errno.EROFS, "read-only"), (errno.ENOSPC, "disk is full"), (errno.EACCES, "permission was denied"),
     (errno.ENOENT, "no such file"), (errno.EISDIR, "is a folder")],
)  # fmt: skip
def test_refusals_of_the_operating_system_are_reported_as_such(number: int, words: str) -> None:
    message, cure = explain_os_error(OSError(number, os.strerror(number), "/a/b"))
    assert words in message
    assert message.startswith("/a/b: ")
    assert cure.endswith(".")
    assert exit_code_of(OSError(number, "x", "/a/b")) in (ExitCode.USAGE, ExitCode.REFUSED)
    assert exit_code_of(OSError(errno.ENOSPC, "x")) == ExitCode.REFUSED


def test_a_process_of_ours_that_breaks_shows_no_trace(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    assert run_guarded(lambda: _raise_error(IndexError("gone"))) == 70
    message = capsys.readouterr().err
    assert message.count("\n") == 1
    assert "IndexError: gone" in message


@pytest.mark.parametrize(
    "module",
    [
        "cellcal.service.cell_process",
        "cellcal.service.site.publisher",
        "cellcal.service.export.webhook_sender",
    ],
)
def test_every_child_refuses_a_wrong_cell_file_in_one_place(module: str, tmp_path: Path) -> None:
    run = subprocess.run(
        [sys.executable, "-m", module, str(tmp_path / "none.toml")],
        capture_output=True,
        text=True,
        check=False,
    )
    assert run.returncode != 0
    assert "Traceback" not in run.stderr
    assert "none.toml" in run.stderr


def test_a_log_has_no_trace_and_nothing_of_libraries(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    root = logging.getLogger()
    monkeypatch.setattr(root, "handlers", [])
    log_in_lines("%(message)s")
    for library in (
        "pymodbus.logging",
        "can",
        "canopen.network",
        "zenoh",
        "matplotlib.font_manager",
    ):
        logging.getLogger(library).critical("a library speaks")
    for _ in range(3):
        try:
            _raise_error(ValueError("why"))
        except ValueError:
            logging.getLogger("cellcal.service.test").exception("it broke\nhere")
    message = capsys.readouterr().err
    assert re.fullmatch(r"(it broke here \[ValueError: why; report in \S+\]\n){3}", message)
    assert len(list(tmp_path.iterdir())) == 1
    assert isinstance(root.handlers[0].formatter, OneLineFormatter)


def test_our_own_log_is_written_whatever_the_packages_are_named(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(logging.getLogger(), "handlers", [])
    log_in_lines("%(message)s")
    Supervisor().note_failure("a task", OSError("the cable"))
    assert capsys.readouterr().err.startswith("a task failed: OSError: the cable")


def test_the_software_is_identified_in_any_working_folder(tmp_path: Path) -> None:
    code = "from cellcal.service.runs.software_identity import software_versions; print(software_versions()['definition_sha256'])"
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=tmp_path, capture_output=True, text=True, check=False
    )
    assert re.fullmatch(r"[0-9a-f]{64}\n", done.stdout), done.stderr


def test_an_argument_that_is_no_text_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def encode_argument() -> None:
        "\udced".encode()

    monkeypatch.setattr(command_line, "call_command", lambda *_, **__: encode_argument())
    assert run_command_line(["show", "\udced"]) == ExitCode.USAGE
    assert "not text in UTF-8" in capsys.readouterr().err
    assert run_command_line(["show", "last"]) == ExitCode.INTERNAL


@pytest.mark.parametrize(("reads", "code"), [(False, ExitCode.NO_READER), (True, ExitCode.INTERNAL)])
def test_only_our_own_reader_that_left_ends_quietly_and_never_as_a_pass(
    reads: bool, code: ExitCode, tmp_path: Path
) -> None:
    reading, writing = os.pipe()
    if not reads:
        os.close(reading)
    program = (
        "import sys; from cellcal.service.cli import app\n"
        "def broken(*_, **__): raise BrokenPipeError(32, 'Broken pipe')\n"
        "app.call_command = broken; sys.exit(app.run_command_line([]))"
    )
    ended = subprocess.run(
        [sys.executable, "-c", program], stdout=writing, stderr=subprocess.DEVNULL, check=False,
        env={**os.environ, "TMPDIR": str(tmp_path)},
    )  # fmt: skip
    os.close(writing)
    assert ended.returncode == code


@pytest.mark.parametrize("make", [os.mkfifo, lambda path: path.symlink_to(os.devnull)])
def test_a_device_or_a_pipe_is_never_replaced_by_a_file(make: Callable[[Path], None], tmp_path: Path) -> None:
    path = tmp_path / "out.pdf"
    make(path)
    with pytest.raises(OSError, match="not a file"):
        replace_file(path, b"report")
    assert [entry.name for entry in tmp_path.iterdir()] == ["out.pdf"]
    assert not path.is_file()
