"""Who takes part, where each is found, and how one runs: alone in a process, single-threaded."""

import os
import subprocess
import sys
import tempfile
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

import cellcal
from cellcal.calibration.documents.json_text import parse_json
from cellcal.calibration.errors import CellError
from cellcal.calibration.geometry import Array
from cellcal.calibration.message import make_message
from cellcal.service.engineering.bench.child import MISSING

_HERE = Path(__file__).parent
_DEADLINE_S = 1200.0
_ONE_THREAD = {f"{name}_NUM_THREADS": "1" for name in ("OPENBLAS", "OMP", "MKL", "NUMEXPR", "VECLIB")}


class BenchError(CellError):
    """A benchmark could not be run as asked."""

    code = "bench"


@dataclass(frozen=True, slots=True)
class Contestant:
    """A program under ``peers``; ``wants`` says how to install what it measures."""

    name: str
    program: str
    wants: str
    ours: bool = False
    variant: str = ""  # another way to use the same package


OURS = Contestant("cellcal", "own.py", "this package", ours=True)
PEERS = (
    Contestant("pinocchio", "pinocchio_loop.py", "pin==4.1.0 (the extra `planning`)"),
    Contestant("pinocchio lean", "pinocchio_loop.py", "pin==4.1.0 (the extra `planning`)", variant="_lean"),
    Contestant("roboticstoolbox", "roboticstoolbox_peer.py", "roboticstoolbox-python==1.5.0"),
    Contestant("pybotics", "pybotics_peer.py", "pybotics==3.1.2 numpy<2 scipy"),
    Contestant("figaroh", "figaroh_peer.py", "figaroh==1.0.2"),
)


@dataclass(frozen=True, slots=True)
class AbsentContestant:
    """A contestant that did not run, and why, in words for the table."""

    contestant: Contestant
    reason: str


Answers = dict[str, Array]


def parse_interpreters(words: tuple[str, ...]) -> dict[str, Path]:
    """Read ``NAME=PATH`` words: which interpreter a peer is installed for."""
    names = {peer.name for peer in PEERS}
    found = {}
    for word in words:
        name, separator, path = word.partition("=")
        if not separator or name not in names:
            raise BenchError(
                f"--peer-python {word} is not NAME=PATH.",
                remedy=f"NAME is one of {', '.join(sorted(names))}.",
            )
        if not os.access(path, os.X_OK):
            raise BenchError(f"{path} is not an interpreter.", remedy="Name the python of the peer's venv.")
        found[name] = Path(path)
    return found


def run_contestant(
    contestant: Contestant, topic: str, inputs: Mapping[str, Array], interpreters: Mapping[str, Path]
) -> Answers | AbsentContestant:
    """Run one contestant on one topic, and return its answers or why there are none."""
    interpreter = interpreters.get(contestant.name, Path(sys.executable))
    paths = [str(Path(cellcal.__file__).resolve().parents[1])] if contestant.ours else []
    with tempfile.TemporaryDirectory() as folder:
        source, sink = Path(folder) / "in.npz", Path(folder) / "out.npz"
        np.savez(source, **inputs)  # type: ignore[arg-type]  # the stub takes names for its own flags
        program = [str(_HERE / "child.py"), str(_HERE / "peers" / contestant.program)]
        command = [
            str(interpreter),
            "-I",
            *program,
            topic + contestant.variant,
            str(source),
            str(sink),
            *paths,
        ]
        try:
            done = subprocess.run(
                command,
                env={**os.environ, **_ONE_THREAD},
                capture_output=True,
                text=True,
                timeout=_DEADLINE_S,
                check=False,
            )
        except subprocess.TimeoutExpired:
            return AbsentContestant(contestant, f"did not end within {_DEADLINE_S:g} s")
        if done.returncode != 0:
            return AbsentContestant(contestant, _failure_reason(contestant, done.returncode, done.stderr))
        with np.load(sink) as answers:
            return dict(answers)


def _failure_reason(contestant: Contestant, code: int, errors: str) -> str:
    last = errors.strip().splitlines()[-1] if errors.strip() else make_message("exit code {code}", code=code)
    if code != MISSING:
        return f"failed: {last}"
    missing = parse_json(last)["missing"]
    option = f"--peer-python {contestant.name}=PATH/bin/python"
    return f"not installed: {missing} ({contestant.wants}; in a venv of its own: {option})"
