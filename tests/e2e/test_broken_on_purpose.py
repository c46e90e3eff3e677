"""What a stranger breaks: every command ends in a sentence with the cure, and in its own exit code."""

import asyncio
import json
import os
import shlex
import signal
import sqlite3
import sys
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from pathlib import Path

import pytest

from cellcal.service.cli.app import run_command_line
from cellcal.service.configuration.cell_file import read_cell_file
from cellcal.service.demo.fake_cell import free_address, running_fakes, write_cell_file
from cellcal.service.demo.fake_cell_client import FakeCellClient
from cellcal.service.exit_codes import ExitCode, exit_code_named
from cellcal.service.record.journal import Journal
from tests.machine_speed import stretched_s

ROOT = Path(__file__).parents[2]
YES = ("wire_is_hooked", "accept_plan", "may_move")


def cell_file(folder: Path, old: str = "", new: str = "") -> Path:
    """Write a cell file whose devices do not answer, with one change."""
    path = write_cell_file(folder, "127.0.0.1", seed=1, time_factor=600.0)
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new, 1) if old else text)
    return path


def run_command(capsys: pytest.CaptureFixture[str], *words: str) -> tuple[int, str]:
    """Run a command here; return its exit code and what it said, on one line."""
    code = run_command_line(words)
    return code, " ".join(capsys.readouterr().err.split())


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        ('model = "fanuc_m6ib"', 'model = "ur99"', "there is no robot model 'ur99'"),
        ('driver = "modbus_robot"', 'driver = "abb"', "there is no driver 'abb'; there are modbus_robot"),
        ('driver = "modbus_robot"\n', "", "names no driver"),
        ('name = "fanuc"', 'name = "../fanuc"', "'../fanuc' is no name"),
        ("range_m = 3.0", "range_m = nan", "finite"),
        ("range_m = 3.0", "range_m = 1e300", "less than or equal to 100"),
    ],
)
def test_a_wrong_value_of_a_cell_file(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], old: str, new: str, says: str
) -> None:
    code, words = run_command(capsys, "check", str(cell_file(tmp_path, old, new)))
    assert code == ExitCode.USAGE
    assert says in words
    assert "Correct the file" in words


@pytest.mark.parametrize(
    ("content", "says"),
    [
        (b"#" * 2_000_000, "is larger than 1 MB"),
        (b"a=" + b"[" * 100_000, "is not valid TOML"),
        (b"\x00\xff\xfe", "not text in UTF-8"),
    ],
    ids=["huge", "deep", "binary"],
)
def test_a_file_that_is_no_cell_file(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], content: bytes, says: str
) -> None:
    (tmp_path / "cell.toml").write_bytes(content)
    code, words = run_command(capsys, "check", str(tmp_path / "cell.toml"))
    assert (code, says in words) == (ExitCode.USAGE, True), words


def test_a_folder_is_no_cell_file(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    code, words = run_command(capsys, "runs", "--cell", str(tmp_path))
    assert (code, "is a folder" in words) == (ExitCode.USAGE, True), words


def test_a_data_dir_that_cannot_be(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = cell_file(tmp_path)
    (tmp_path / "data").write_text("in the way")
    code, words = run_command(capsys, "runs", "--cell", str(path))
    assert code == ExitCode.REFUSED
    assert "cannot be opened" in words
    assert "data_dir" in words


def test_a_relative_data_dir_is_meant_from_the_cell_file(tmp_path: Path) -> None:
    path = cell_file(tmp_path)
    path.write_text(path.read_text().replace(json.dumps(str(tmp_path / "data")), '"journals"'))
    assert read_cell_file(path).cell.data_dir == tmp_path / "journals"


@pytest.mark.parametrize(
    ("content", "says"),
    [(None, "no such file"), ("[1]", "one object"), ("{", "JSON"), ('{"a": true}', "texts")],
)
def test_answers_that_are_none(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], content: str | None, says: str
) -> None:
    answers = tmp_path / "answers.json"
    if content is not None:
        answers.write_text(content)
    words = ("run", "mastering_record", "--cell", str(cell_file(tmp_path)), "--answers", str(answers))
    code, output = run_command(capsys, *words)
    assert (code, says in output) == (ExitCode.USAGE, True), output


@pytest.mark.parametrize(
    "words",
    [
        ("--time-factor", "0"),
        ("--time-factor", "nan"),
        ("--time-factor", "inf"),
        ("--seed", "-1"),
        ("--loss", "motor:J9"),
        ("--keep", "/dev/null"),
    ],
    ids=" ".join,
)
def test_a_demo_that_cannot_be(capsys: pytest.CaptureFixture[str], words: tuple[str, str]) -> None:
    code, output = run_command(capsys, "demo", *words)
    assert code == ExitCode.USAGE
    assert "What to do:" in output


def test_resume_before_any_run(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    code, words = run_command(capsys, "show", "last", "--cell", str(cell_file(tmp_path)))
    assert (code, "no run was made yet" in words) == (ExitCode.USAGE, True), words


def test_a_journal_with_flipped_bytes_is_reported_by_every_command(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = cell_file(tmp_path)
    with Journal.open_file(tmp_path / "data" / "journal.db") as journal:
        for k in range(3):
            journal.append("run-1", "finding", {"k": k})
    with sqlite3.connect(tmp_path / "data" / "journal.db") as raw:
        raw.execute("UPDATE event SET body = replace(body, '\"k\":1', '\"k\":7') WHERE seq = 2")
    raw.close()
    code, words = run_command(capsys, "runs", "--cell", str(path), "--json")
    assert code == ExitCode.SIGNATURE
    assert "damaged after event 1" in words
    assert "Restore a backup" in words


@pytest.mark.parametrize(
    ("code", "ends_in"),
    [
        ("device.stopped", ExitCode.STOPPED),
        ("device.timeout", ExitCode.UNREACHABLE),
        ("device.unreachable", ExitCode.UNREACHABLE),
        ("device.busy", ExitCode.BUSY),
        ("busy", ExitCode.BUSY),
        ("procedure.off_target", ExitCode.REFUSED),
        ("procedure.declined", ExitCode.CANCELLED),
        ("procedure.out_of_tolerance", ExitCode.OUT_OF_TOLERANCE),
        ("store.full", ExitCode.REFUSED),
        ("store.damaged", ExitCode.SIGNATURE),
        ("of no known kind", ExitCode.INTERNAL),
    ],
)
def test_each_code_has_its_exit_code(code: str, ends_in: ExitCode) -> None:
    assert exit_code_named(code) is ends_in


# ------------------------------------------------------------------ on a fake cell, as processes of their own


class CommandProcess:
    """A command as a technician starts it."""

    def __init__(self, process: asyncio.subprocess.Process) -> None:
        self.process = process
        self._lines: list[str] = []

    @classmethod
    async def start(cls, *words: str) -> "CommandProcess":
        return cls(
            await asyncio.create_subprocess_exec(
                *(sys.executable, "-m", "cellcal", *words),
                stdout=asyncio.subprocess.DEVNULL, stderr=asyncio.subprocess.PIPE,
            )
        )  # fmt: skip

    async def read_until(self, is_expected: Callable[[str], bool]) -> None:
        """Read what it says until a line is ``is_expected``."""
        assert self.process.stderr is not None
        while line := (await self.process.stderr.readline()).decode():
            self._lines.append(line.strip())
            if is_expected(line):
                return
        raise AssertionError(f"it ended before: {self._lines}")

    async def wait_for_end(self) -> tuple[int, str]:
        """Wait for its end; return the exit code and all it said, on one line."""
        assert self.process.stderr is not None
        async with asyncio.timeout(stretched_s(120.0)):
            rest = (await self.process.stderr.read()).decode()
            code = await self.process.wait()
        return code, " ".join(" ".join([*self._lines, rest]).split())


@asynccontextmanager
async def fake_cell(
    folder: Path, *, time_factor: float = 600.0
) -> AsyncIterator[tuple[Path, FakeCellClient, tuple[str, ...]]]:
    """Run a fake cell; yield its file, its control port and the settings of every run."""
    with free_address() as address:
        path = write_cell_file(folder, address, seed=1, time_factor=time_factor)
    answers = folder / "answers.json"
    answers.write_text(json.dumps(dict.fromkeys(YES, "yes")))
    async with running_fakes(path) as fake_client:
        yield path, fake_client, ("--cell", str(path), "--answers", str(answers))


async def test_an_emergency_stop_and_a_second_program_in_the_middle_of_a_run(tmp_path: Path) -> None:
    async with fake_cell(tmp_path, time_factor=150.0) as (path, fake_client, events):
        run = await CommandProcess.start("run", "mastering_record", *events)
        await run.read_until(lambda line: "capture 1" in line)

        second, check = await asyncio.gather(
            CommandProcess.start("run", "mastering_record", *events), CommandProcess.start("check", str(path))
        )
        code, words = await second.wait_for_end()
        assert (code, "Wait until that run has ended" in words) == (ExitCode.BUSY, True), words
        code, words = await check.wait_for_end()
        assert (code, "in use" in words) == (ExitCode.BUSY, True), words

        await fake_client.inject_fault("emergency_stop", device="fanuc")
        code, words = await run.wait_for_end()
        assert code == ExitCode.STOPPED, words  # and not the gauge taken away by the two others
        assert "fanuc: " in words  # in a move it stopped, between two it is not ready: both say why
        assert "the emergency stop is pressed" in words
        assert "release the emergency stop" in words

        await fake_client.inject_fault("release_emergency_stop", device="fanuc")
        await fake_client.inject_fault("press_reset")
        code, words = await (await CommandProcess.start("resume", "last", *events)).wait_for_end()
        assert (code, "passed mastering_record" in words) == (ExitCode.PASS, True), words


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
async def test_a_run_that_is_cancelled_says_so_and_leaves_the_arm_at_rest(
    tmp_path: Path, number: signal.Signals
) -> None:
    async with fake_cell(tmp_path) as (_, fake_client, events):
        run = await CommandProcess.start("run", "mastering_record", *events)
        await run.read_until(lambda line: "capture 1" in line)
        run.process.send_signal(number)
        code, words = await run.wait_for_end()
        assert code == ExitCode.CANCELLED, words
        assert "Cancelled." in words
        assert "resume last" in words
        assert not (await fake_client.read_truth())["robots"]["fanuc"]["moving"]


def children_of(pid: int) -> list[str]:
    return Path(f"/proc/{pid}/task/{pid}/children").read_text().split()


async def test_a_demo_that_is_cancelled_leaves_no_fake_behind() -> None:
    demo = await CommandProcess.start("demo")
    await demo.read_until(lambda line: "serial 4711" in line)
    children = children_of(demo.process.pid)
    assert children
    demo.process.send_signal(signal.SIGINT)
    code, words = await demo.wait_for_end()
    assert (code, "Cancelled." in words) == (ExitCode.CANCELLED, True), words
    for child in children:
        with pytest.raises(ProcessLookupError):
            os.kill(int(child), 0)


async def test_fake_processes_behind_a_script_end_on_request(tmp_path: Path) -> None:
    with free_address() as address:
        path = write_cell_file(tmp_path, address, seed=1, time_factor=600.0)
    ignoring = f"trap '' INT; exec {shlex.quote(sys.executable)} -m cellcal fakes {shlex.quote(str(path))}"
    process = await asyncio.create_subprocess_exec(
        "sh", "-c", ignoring, cwd=ROOT, stdout=asyncio.subprocess.PIPE
    )
    assert process.stdout is not None
    assert json.loads(await process.stdout.readline())["ready"]
    children = children_of(process.pid)
    assert children
    process.terminate()
    assert await asyncio.wait_for(process.wait(), stretched_s(60.0)) == ExitCode.PASS
    for child in children:
        with pytest.raises(ProcessLookupError):
            os.kill(int(child), 0)


async def test_the_arm_of_another_model_is_noticed(tmp_path: Path) -> None:
    async with fake_cell(tmp_path) as (path, _, events):
        path.write_text(path.read_text().replace("fanuc_m6ib", "fanuc_r2000ic_165f"))
        code, words = await (await CommandProcess.start("run", "mastering_record", *events)).wait_for_end()
    assert code == ExitCode.REFUSED, words
    assert "from where a fanuc_r2000ic_165f has it" in words


@pytest.mark.parametrize("procedure", ["six_point_tcp", "three_point_frame"])
async def test_the_taught_procedures_with_a_simulated_technician(tmp_path: Path, procedure: str) -> None:
    async with fake_cell(tmp_path) as (path, fake_client, _):
        process = await asyncio.create_subprocess_exec(
            *(sys.executable, str(ROOT / "deploy" / "try_out" / "teach.py"), str(path), str(fake_client.port), procedure),
            stdout=asyncio.subprocess.PIPE, env=os.environ | {"PYTHONPATH": str(ROOT)},
        )  # fmt: skip
        out, _ = await process.communicate()
    assert process.returncode == ExitCode.PASS
    result = json.loads(out)["result"]
    if procedure == "six_point_tcp":
        assert result["read_back"]["position_m"] == pytest.approx([0.03, -0.02, 0.15], abs=1e-4)
    else:
        assert result["taught"]["base_frame"]["quaternion"] == pytest.approx([1, 0, 0, 0], abs=1e-4)
