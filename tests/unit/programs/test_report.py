"""Reports of programs: order, figures, pages and diffs, on results made by hand."""

import csv
import gzip
import io
import json
import multiprocessing
import os
import re
import select
import signal
import time
from collections.abc import Sequence
from html import unescape
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest

from cellcal.calibration.message import make_message
from cellcal.drivers.programs.positions import CARTESIAN, PositionChange, Positions, ProgramFrames, Remark
from cellcal.service.engineering.programs import shares, worker_processes
from cellcal.service.engineering.programs.diff import unified_diff
from cellcal.service.engineering.programs.files import (
    FilesError,
    OutputFolder,
    ProgramSource,
    RefusedProgram,
    find_programs,
)
from cellcal.service.engineering.programs.report import ProgramsReport, entry_of
from cellcal.service.engineering.programs.report_files import report_formats
from cellcal.service.engineering.programs.report_html import as_html
from cellcal.service.engineering.programs.report_sentences import (
    ReportNote,
    accuracy_text,
    list_problems,
    merge_notes,
    verdict_text,
)
from cellcal.service.engineering.programs.result import CHANGED, LEFT, UNCHANGED, ProgramResult
from cellcal.service.exit_codes import ExitCode
from tests.machine_speed import stretched_s
from tests.unit.programs.diff_application import apply_diff


class LineProgram:
    """A program of points along a line, without a file."""

    brand = "fanuc"
    frames = ProgramFrames()

    def __init__(self, name: str, count: int, remarks: tuple[Remark, ...] = ()) -> None:
        self.name, self.remarks = name, remarks
        tips = np.tile(np.eye(4), (count, 1, 1))
        tips[:, 0, 3] = np.arange(count) * 0.1
        self.positions = Positions(
            names=tuple(f'P[{i}:"<b>&"]' for i in range(count)),
            kinds=(CARTESIAN,) * count,
            lines=np.arange(count) + 7,
            groups=np.ones(count, dtype=np.int64),
            frame_tip=tips,
            joints=np.full((count, 6), np.nan),
            external=np.zeros((count, 0)),
            user_frames=("1",) * count,
            tools=(None,) * count,
            configurations=("N U T, 0, 0, 0",) * count,
            resolution_m=np.full(count, 1e-6),
            resolution_rad=np.full(count, 1e-5),
        )

    def to_bytes(self) -> bytes:
        return self.name.encode()

    def with_changes(self, _: PositionChange) -> "LineProgram":
        return self


def make_result(
    name: str, shifts_mm: list[float | None], errors_mm: list[float], is_calibrated: bool = True
) -> ProgramResult:
    """A shift of None is a point that was left."""
    program = LineProgram(name, len(shifts_mm), (Remark(3, "offset", "PR[1] shifts"),))
    is_left = np.array([shift is None for shift in shifts_mm])
    shift = np.array([np.nan if s is None else s / 1e3 for s in shifts_mm])
    base = program.positions.frame_tip.copy() if is_calibrated else np.full((len(is_left), 4, 4), np.nan)
    after = base.copy()
    after[is_left] = np.nan
    words = [LEFT if s is None else UNCHANGED if s == 0 else CHANGED for s in shifts_mm]
    return ProgramResult(
        before=program,
        after=program,
        status=tuple(words),
        reason=tuple("out of reach" if s is None else "" for s in shifts_mm),
        shift_m=shift,
        turn_rad=np.zeros(len(is_left)),
        base_tip_before=base,
        base_tip_after=after,
        expected_error_m=np.where(is_left, np.nan, np.array(errors_mm) / 1e3),
        uncorrected_m=shift,
        warnings=(
            "no accuracy can be foretold",
            make_message("line {line}: {text}", line=3, text="PR[1] shifts"),
        ),
    )


def report_of(*results: ProgramResult) -> ProgramsReport:
    return ProgramsReport(
        "Moved", [entry_of(f"{r.program_name}.ls", f"out/{r.program_name}.ls", r) for r in results]
    )


def test_the_worst_comes_first_and_what_was_left_before_it() -> None:
    report = report_of(
        make_result("A", [1.0, None, 0.0], [0.3, 0.0, 0.1]), make_result("B", [2.0, 3.0], [0.5, 0.2])
    )
    shown = [(p.program, p.point[:4], p.is_excluded) for p in report.worst_first(9)]
    assert shown == [
        ("A", "P[1:", True), ("B", "P[0:", False), ("A", "P[0:", False), ("B", "P[1:", False), ("A", "P[2:", False),
    ]  # fmt: skip
    assert report.status_counts == {CHANGED: 3, UNCHANGED: 1, LEFT: 1}
    assert [entry.program for entry in report.programs_worst_first()] == ["A", "B"]
    assert report.exit_code is ExitCode.REFUSED
    report.refused.append(RefusedProgram("x.ls", "damaged.", "Mend it."))
    assert report.exit_code is ExitCode.FILES_REFUSED
    assert "1 file refused" in verdict_text(report)
    assert accuracy_text(report).startswith("Expected error at most 0.50 mm")


def test_without_expected_errors_the_largest_shift_is_the_worst() -> None:
    report = report_of(make_result("A", [1.0, 5.0, 2.0], [np.nan] * 3))
    assert [p.shift_m for p in report.worst_first(3)] == pytest.approx([5e-3, 2e-3, 1e-3])
    assert "Expected" not in accuracy_text(report)


def test_a_sentence_is_printed_once_with_its_programs_and_lines() -> None:
    report = report_of(*(make_result(name, [1.0], [0.1]) for name in "ABCDE"))
    assert list_problems(report) == [
        "A, B, C and 2 more programs: no accuracy can be foretold",
        "A (line 3), B (line 3), C (line 3) and 2 more programs: PR[1] shifts",
    ]
    many = merge_notes([ReportNote("A", line, "shifts") for line in range(1, 9)])
    assert many == ["A (lines 1, 2, 3 and 5 more): shifts"]


@pytest.mark.parametrize("is_calibrated", [True, False])
def test_the_page_is_complete_escaped_and_makes_no_request(is_calibrated: bool) -> None:
    report = report_of(
        make_result("A<script>", [1.0, None, 2.5, 0.0], [0.1, 0.0, 0.4, np.nan], is_calibrated)
    )
    page = as_html(report)
    assert "<script" not in page
    assert not re.search(r"(?:src|href)\s*=|url\(|@import|https?:", page)
    root = ElementTree.fromstring(
        re.sub(r"<!doctype html>|<meta[^>]*>", "", page).replace("class=n", 'class="n"')
    )
    drawings = root.findall(".//svg[@role='img']")
    assert len(drawings) == 4
    for drawing in drawings:
        assert len(drawing.findall(".//path[@class='left']")) == 1
        assert len(drawing.findall(".//circle")) == 3
    titles = [title.text or "" for title in root.findall(".//svg/path/title")]
    assert all("left as it was. out of reach" in title for title in titles)
    assert ("in the robot's base" if is_calibrated else "in each point's own user frame") in unescape(page)
    assert page.count('<td class="bad">out of reach</td>') == 1


def test_the_colours_are_those_of_the_legend() -> None:
    page = as_html(report_of(make_result("A", [1.0, 10.0], [0.1, 0.1])))
    legend = re.findall(r'background:(#\w+)"></i>([^<]*)<', page)
    assert legend[0][1].startswith("1.00 to 2.00")
    assert legend[8][1] == "9.00 to 10.00 mm"
    assert legend[9][1] == "0.100 mm"
    fills = re.findall(r'fill="(#\w+)"><title>[^<]*moved (\d+)', page)
    assert (legend[0][0], "1") in fills
    assert (legend[8][0], "10") in fills


def test_a_large_line_makes_a_small_page_that_keeps_the_worst() -> None:
    shifts: list[float | None] = [float(i % 97) / 10 + 0.1 for i in range(20_000)]
    shifts[12_345] = None
    page = as_html(report_of(make_result("BIG", shifts, [0.1] * 20_000)))
    assert len(page) < 4_000_000
    assert "3000 of 20000 points are drawn" in page
    assert "The worst 500 of 20000 points" in page
    assert "P[12345:&quot;&lt;b&gt;&amp;&quot;]</td>" in page


def test_csv_and_json_hold_every_point_and_no_nan() -> None:
    found = [make_result("A", [1.0, None], [0.25, 0.0]), make_result("B", [0.0], [np.nan])]
    written = {
        kind: form.head
        + form.between.join(form.one("a.ls", "out/a.ls", one) for one in found)
        + form.end(report_of(*found))
        for kind, form in report_formats("Moved").items()
    }
    points = list(csv.DictReader(io.StringIO(written["csv"].decode())))
    assert [(p["program"], p["status"], p["shift_mm"]) for p in points] == [
        ("A", "changed", "1.0"), ("A", "left", ""), ("B", "unchanged", "0.0"),
    ]  # fmt: skip
    loaded = json.loads(written["json"], parse_constant=pytest.fail)
    assert loaded["programs"][0]["points"][1]["shift_mm"] is None
    assert loaded["programs"][0]["points"][1]["reason"] == "out of reach"
    assert (loaded["point_count"], loaded["counts"]["left"], loaded["exit_code"]) == (3, 1, 4)
    nothing = report_formats("Nothing")["json"]
    assert json.loads(nothing.head + nothing.end(ProgramsReport("Nothing")))["programs"] == []
    assert written["diff"] == b""


OLD = b"/PROG A\r\n! \x81ber \x84\r\n" + b"".join(b"X = %d.000 mm\r\n" % i for i in range(40)) + b"/END"
NEW = (
    OLD.replace(b"X = 3.000", b"X = 3.125")
    .replace(b"X = 39.000", b"X = -9.250")
    .replace(b"X = 20.0", b"X = 20.5")
)


def test_the_diff_makes_the_new_program_of_the_old_one() -> None:
    for old, new in (
        (OLD, NEW),
        (OLD + b"\r\n", NEW + b"\r\n"),
        (b"a", b"b"),
        (b"\n", b"x\n"),
        (b"a\nb\n", b"a\nc\n"),
    ):
        assert apply_diff(old, unified_diff(old, new, "a.ls", "a.ls")) == new


def test_a_diff_shows_the_coordinates_alone_packed_or_not() -> None:
    diff = unified_diff(OLD, NEW, "a", "b")
    assert unified_diff(gzip.compress(OLD), gzip.compress(NEW), "a", "b") == diff
    removed = [line for line in diff.split(b"\n")[2:] if line.startswith(b"-")]
    assert removed == [b"-X = 3.000 mm\r", b"-X = 20.000 mm\r", b"-X = 39.000 mm\r"]
    assert diff.count(b"@@ -") == 3
    assert b"! \x81ber \x84\r\n" in unified_diff(
        OLD, OLD.replace(b"X = 0.", b"X = 1."), "a", "b"
    )  # CP437 stays
    assert unified_diff(OLD, OLD, "a", "b") == b""
    with pytest.raises(ValueError, match="lines"):
        unified_diff(OLD, OLD + b"\n", "a", "b")


def test_files_folders_and_patterns_are_found_once(tmp_path: Path) -> None:
    (tmp_path / "in" / "sub").mkdir(parents=True)
    program = b"/PROG A\n/MN\n/POS\n/END\n"
    for name in ("in/a.ls", "in/sub/b.LS", "in/alarms.ls"):
        (tmp_path / name).write_bytes(program if "alarms" not in name else b"ERRALL\n")
    named = [str(tmp_path / "in"), str(tmp_path / "in" / "a.ls"), str(tmp_path / "in" / "*.ls")]
    found = find_programs(named[:2])
    assert [str(source.place) for source in found.sources] == ["a.ls", "sub/b.LS"]
    assert not found.refused
    assert [path.name for path in found.passed_over] == ["alarms.ls"]
    globbed = find_programs(named[2:])
    assert [source.path.name for source in globbed.sources] == ["a.ls"]
    assert [path.name for path in globbed.passed_over] == ["alarms.ls"]
    named_log = find_programs([str(tmp_path / "in" / "alarms.ls")])
    assert [source.path.name for source in named_log.sources] == ["alarms.ls"]
    (tmp_path / "in" / "alarms.ls").write_bytes(
        program[8:]
    )  # its beginning was lost: refused when it is read
    assert [source.path.name for source in find_programs(named[2:]).sources] == ["a.ls", "alarms.ls"]
    (tmp_path / "in" / "alarms.ls").write_bytes(b"ERRALL\n")
    (tmp_path / "in" / "job.jbi").write_bytes(b"//NAME A\n//POS\n")
    assert [source.path.name for source in find_programs(named[:1]).sources] == ["a.ls", "job.jbi", "b.LS"]
    (tmp_path / "in" / "job.jbi").unlink()
    with pytest.raises(FilesError):
        find_programs([])
    (tmp_path / "in" / "A.LS").write_bytes(program)
    clash = find_programs(named[:1])
    assert [source.path.name for source in clash.sources] == ["b.LS"]
    assert sorted(Path(one.file).name for one in clash.refused) == ["A.LS", "a.ls"]
    (tmp_path / "empty").mkdir()
    empty = find_programs([str(tmp_path / "empty"), str(tmp_path / "none"), str(tmp_path / "*.no")])
    assert [one.message for one in empty.refused] == [
        "there is no robot program in this folder.", "there is no such file or folder.",
        "no file matches this pattern.",
    ]  # fmt: skip


def test_a_new_place_keeps_what_came_meanwhile(tmp_path: Path) -> None:
    (tmp_path / "a.ls").write_bytes(b"old")
    source = ProgramSource(tmp_path / "a.ls", Path("a.ls"))
    place = OutputFolder(tmp_path / "out" / "deep", [source])
    assert place.write_program(source, b"new").read_bytes() == b"new"
    assert [path.name for path in (tmp_path / "out" / "deep").iterdir()] == ["a.ls"]
    with pytest.raises(FilesError):
        OutputFolder(tmp_path / "a.ls", [source])


def test_a_large_line_is_shared_out_and_comes_back_in_order(tmp_path: Path, monkeypatch) -> None:
    sources = []
    for i in range(40):
        path = tmp_path / f"{i}.ls"
        path.write_bytes(b"x" * (300 + i))
        sources.append(ProgramSource(path, Path(path.name)))
    one = list(shares.share_work(_pid_and_names, sources))
    assert [name for part in one for name in part[1]] == [f"{i}.ls" for i in range(40)]
    assert {part[0] for part in one} == {os.getpid()}
    monkeypatch.setattr(worker_processes, "_WORTH_BYTES", 1000)
    monkeypatch.setattr(worker_processes, "_AT_ONCE_BYTES", 1000)
    monkeypatch.setattr(worker_processes, "_processor_count", lambda: 2)
    many = list(shares.share_work(_pid_and_names, sources))
    assert [name for part in many for name in part[1]] == [f"{i}.ls" for i in range(40)]
    assert len(many) > 10
    assert os.getpid() not in {part[0] for part in many}
    with pytest.raises(ZeroDivisionError):
        list(shares.share_work(lambda some: 1 // (len(some) - len(some)), sources))


def test_a_process_that_is_ended_from_outside_ends_the_work_with_a_sentence(
    tmp_path: Path, monkeypatch
) -> None:
    path = tmp_path / "a.ls"
    path.write_bytes(b"x" * 300)
    sources = [ProgramSource(path, Path(path.name))] * 4
    monkeypatch.setattr(worker_processes, "_WORTH_BYTES", 1000)
    monkeypatch.setattr(worker_processes, "_AT_ONCE_BYTES", 300)
    monkeypatch.setattr(worker_processes, "_processor_count", lambda: 2)
    theirs = list(
        worker_processes.run_in_processes(lambda _: (signal.getsignal(signal.SIGTERM), os.getpid()), sources)
    )
    assert {handler for handler, _ in theirs} == {signal.SIG_DFL}
    assert os.getpid() not in {pid for _, pid in theirs}
    with pytest.raises(FilesError, match="ended from outside"):
        list(worker_processes.run_in_processes(lambda _: os.kill(os.getpid(), signal.SIGKILL), sources))


def test_no_process_outlives_a_command_that_was_killed(tmp_path: Path, monkeypatch) -> None:
    path = tmp_path / "a.ls"
    path.write_bytes(b"x" * 300)
    monkeypatch.setattr(worker_processes, "_WORTH_BYTES", 1000)
    monkeypatch.setattr(worker_processes, "_AT_ONCE_BYTES", 300)
    monkeypatch.setattr(worker_processes, "_processor_count", lambda: 2)
    alive, held_end = os.pipe()  # ends when no process holds it

    def hang_in_worker(_: Sequence[ProgramSource]) -> None:
        os.write(held_end, b"x")
        time.sleep(600)
        os._exit(1)  # where this test fails

    command = multiprocessing.get_context("fork").Process(
        target=lambda: list(
            worker_processes.run_in_processes(hang_in_worker, [ProgramSource(path, Path(path.name))] * 4)
        )
    )
    command.start()
    os.close(held_end)
    assert os.read(alive, 1) == b"x"
    assert os.read(alive, 1) == b"x"  # two are at work
    command.kill()
    ended, _, _ = select.select([alive], [], [], stretched_s(60.0))
    assert ended
    assert os.read(alive, 1) == b""
    command.join()
    os.close(alive)


def _pid_and_names(sources: Sequence[ProgramSource]) -> tuple[int, list[str]]:
    return os.getpid(), [source.path.name for source in sources]
