"""A FANUC listing taught in one fake cell, cloned by the command, and run in the other: files in, files out."""

import difflib
import re
from pathlib import Path

import numpy as np
import pytest

from cellcal.drivers.fanuc.program_files.ls_program import read_ls
from cellcal.service.cli.program import ProgramOutputs, clone
from tests.unit.helpers.cloned_cells import fanuc_listing
from tests.unit.helpers.cloned_program import ClonedCells

_COORDINATES = re.compile(rb"^\t[XYZWPR] = |CONFIG")


@pytest.fixture(scope="module")
def fake_cell_pair(tmp_path_factory: pytest.TempPathFactory) -> tuple[ClonedCells, Path]:
    folder = tmp_path_factory.mktemp("line")
    made = ClonedCells.make(11, folder)
    for i in range(4):
        some = made.joints[10 * i : 10 * i + 10]
        (folder / "master" / f"SPOT{i}.ls").write_bytes(
            fanuc_listing(f"SPOT{i}", made.master.recorded_tips(some), some)
        )
    return made, folder


def test_a_line_is_cloned_by_one_command(fake_cell_pair: tuple[ClonedCells, Path]) -> None:
    made, folder = fake_cell_pair
    sources = sorted((folder / "master").glob("*.ls"))
    before = {path.name: path.read_bytes() for path in sources}

    code = clone(
        folder / "master" / "project.toml",
        folder / "clone" / "project.toml",
        outputs=ProgramOutputs(folder / "clone" / "programs"),
    )

    assert code == 0
    assert {path.name: path.read_bytes() for path in sources} == before
    for i, path in enumerate(sources):
        data = next((folder / "clone" / "programs").rglob(path.name)).read_bytes()
        after = read_ls(path.name, data).positions
        rows = np.arange(10 * i, 10 * i + 10)
        whole = np.zeros((40, 4, 4))
        whole[rows] = after.frame_tip
        missed = made.missed_m(whole, rows)
        assert missed.mean() < 0.25e-3
        assert missed.max() < 0.5e-3
        changed = [
            line[2:]
            for line in difflib.ndiff(before[path.name].decode().splitlines(), data.decode().splitlines())
            if line[0] in "+-"
        ]
        assert changed
        assert all(_COORDINATES.match(line.encode()) for line in changed)
