"""How long a line of programs takes with the whole command: processor time, time on two free cores, memory."""

import os
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from tests.soak.campaign_figures import CampaignFigures
from tests.soak.program_lines import line_of_programs
from tests.soak.program_lines_by_model import MAKERS, line_by_model

MOST_S, MOST_SMALL_S, MOST_MB = 60.0, 2.0, 1000.0
_LOOK_S = 0.25
_TICKS = os.sysconf("SC_CLK_TCK")


@dataclass(frozen=True)
class CommandCost:
    """What one command took."""

    wall_s: float
    parent_s: float  # of the processor, in the command's own process
    all_s: float  # in all of its processes
    peak_mb: float  # of all together, what they share counted once

    @property
    def two_cores_s(self) -> float:
        """At most so long where two cores are free: what the workers do halves, and nothing else overlaps."""
        return self.parent_s + (self.all_s - self.parent_s) / 2


def of_one_brand() -> dict[str, tuple[Callable[[int], CampaignFigures], int]]:
    """Return the campaign for the programs of one brand, as ``programs_speed.kuka_src``."""
    return {
        f"programs_speed.{brand}": (partial(programs_speed, only=brand), 1_000_000)
        for brand in ("fanuc", *MAKERS)
    }


def programs_speed(points: int, only: str = "") -> CampaignFigures:
    """Clone, compensate and move ``points`` points of FANUC in programs of 1000 and of 40, and 30 programs of 40.

    Of other brands, programs of 1000 points are moved.
    """
    words, reached = [], True
    with tempfile.TemporaryDirectory() as folder:
        for what, command in _program_lines(Path(folder), points, only):
            took = _run_command(command)
            reached &= took.two_cores_s < MOST_S and took.peak_mb < MOST_MB
            words.append(f"{what}: {_describe_cost(took)}")
            _print_text(words[-1])
        if only in ("", "fanuc"):
            small = _run_small(Path(folder) / "small")
            words.append(f"clone 30 programs of 40: {_describe_cost(small)}")
            reached &= small.all_s < MOST_SMALL_S
    return CampaignFigures("programs_speed: " + "; ".join(words), bool(reached))


def _program_lines(folder: Path, points: int, only: str) -> Iterator[tuple[str, list[str]]]:
    """Write a line of programs after the other, and yield what is done with it and by which command."""
    for each in (1000, 40) if only in ("", "fanuc") else ():
        place = folder / f"of_{each}"
        projects = line_of_programs(place, max(points // each, 1), each)
        for name, command in _program_commands(*projects).items():
            yield f"{name} {points} in programs of {each}", [*command, "--out", str(place / name)]
    for name, maker in MAKERS.items():
        if only in ("", name):
            project = line_by_model(maker, folder / name, max(points // 1000, 1), 1000)
            out = ["--out", str(folder / name / "moved")]
            yield f"{name}: move {points} in programs of 1000", [*_move_command(project, maker.frame), *out]


def _run_small(place: Path) -> CommandCost:
    """Return the quickest of three: the first one also fills the file system's memory."""
    projects = line_of_programs(place, 30, 40)
    runs = [
        _run_command([*_program_commands(*projects)["clone"], "--out", str(place / f"out{i}")])
        for i in range(3)
    ]
    return min(runs, key=lambda took: took.all_s)


def _program_commands(master: Path, clone: Path) -> dict[str, list[str]]:
    base = [sys.executable, "-m", "cellcal", "program"]
    one = ["--project", str(master)]
    return {
        "clone": [*base, "clone", str(master), str(clone)],
        "compensate": [*base, "compensate", *one],
        "move": _move_command(master, "2"),
    }


def _move_command(project: Path, frame: str) -> list[str]:
    base = [sys.executable, "-m", "cellcal", "program", "move"]
    return [*base, "--project", str(project), "--frame", frame, "--offset", "12,0,-3.5,0,0,1.5"]


def _describe_cost(took: CommandCost) -> str:
    return (
        f"{took.all_s:.1f} s CPU, at most {took.two_cores_s:.1f} s on two free cores ({took.wall_s:.1f} s here), "
        f"{took.peak_mb:.0f} MB"
    )


def _run_command(command: list[str]) -> CommandCost:
    started = time.monotonic()
    with subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE) as process:
        look = _ProcessSampler(process.pid)
        look.start()
        assert process.stderr is not None
        errors = process.stderr.read()
        _, status, usage = os.wait4(process.pid, 0)
        process.returncode = os.waitstatus_to_exitcode(status)
        look.ended.set()
        look.join()
    if process.returncode not in (0, 4):  # 4: a point was left
        raise RuntimeError(f"{command}: {process.returncode}\n{errors.decode(errors='replace')[-2000:]}")
    return CommandCost(
        time.monotonic() - started, look.parent_s, usage.ru_utime + usage.ru_stime, look.peak_mb
    )


class _ProcessSampler(threading.Thread):
    """Looks at a process and its children while they run."""

    def __init__(self, pid: int) -> None:
        super().__init__(daemon=True)
        self._pid = pid
        self.ended = threading.Event()
        self.peak_mb = self.parent_s = 0.0

    def run(self) -> None:
        while not self.ended.wait(_LOOK_S):
            try:
                children = Path(f"/proc/{self._pid}/task/{self._pid}/children").read_text().split()
                ticks = Path(f"/proc/{self._pid}/stat").read_text().rpartition(")")[2].split()[11:13]
                self.parent_s = sum(map(int, ticks)) / _TICKS
                self.peak_mb = max(self.peak_mb, sum(map(_size_mb, [str(self._pid), *children])))
            except (OSError, ValueError):
                continue  # it ended meanwhile


def _size_mb(pid: str) -> float:
    """Return a process' memory, what it shares with others counted in parts."""
    try:
        lines = Path(f"/proc/{pid}/smaps_rollup").read_text().splitlines()
    except OSError:
        return 0.0
    return sum(int(line.split()[1]) for line in lines if line.startswith("Pss:")) / 1e3


def _print_text(text: str) -> None:
    sys.stderr.write(f"{time.strftime('%H:%M:%S')} {text}\n")
